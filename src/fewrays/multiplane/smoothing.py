"""Planes smoothed for the views that they are looked at with.

A plane that is blurred over a wide disc is seen from N lens points, and so N times, at places that blur puts
far apart. A Gaussian about as wide as a third of their distance closes the gaps between them. How far they
are apart depends on lens, focus and number of views, so planes are stored sharp and smoothed copies are made
for every image. These are made for one band of the image after the other, so that they take little memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.multiplane.maps import BLOCK, Grid, Maps, Shear, number_blocks
from fewrays.parallel import Execution, map_ranges
from fewrays.temporal.locations import Locations

__all__ = ["Band", "farthest_shift", "smoothed_bands", "smoothing_of"]

Bools = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

_LEAST_SIGMA = 0.3  # pixels; a Gaussian narrower than that has no second tap to speak of
_MOST_BYTES = 2**27  # that smoothed copies of planes should take
_ROWS = 24  # of blocks that are smoothed at once


@dataclass(frozen=True, eq=False)
class Band:
    """Rows of tiles of an image, and planes smoothed as far as these see them.

    Parameters
    ----------
    first, end : int
        Rows of tiles.
    slots : ndarray of int32
        Where blocks begin, as in `Maps`: those of smoothed planes in `halves`, others in the maps' own.
    halves : ndarray of uint16
        The smoothed blocks.
    is_smoothed : ndarray of uint8, (K,)
        1 for smoothed planes.
    """

    first: int
    end: int
    slots: Int32
    halves: npt.NDArray[np.uint16]
    is_smoothed: npt.NDArray[np.uint8]


def smoothing_of(slope: Float64, where: Locations, smoothing: float) -> Float64:
    """Return the standard deviation in pixels (K,) that planes of slopes (K,) are smoothed with, 0 for none.

    N lens points share a disc that has the aperture's variance V along each axis, and so the area ``4 π V``;
    that of each has the side ``d = √(4 π V / N)``. Blur puts them ``|C| d`` pixels apart.
    """
    weight = where.weight[:, None].astype(np.float64)
    variance = float((np.square(where.uv, dtype=np.float64) * weight).sum() / 2)
    sigma = smoothing * np.abs(slope) * math.sqrt(4 * math.pi * variance / where.count)
    wide: Float64 = np.where(sigma > _LEAST_SIGMA, sigma, 0.0)
    return wide


def farthest_shift(shear: Shear, shrink: Float32, where: Locations) -> Float64:
    """Return how far views shift each plane down or up at most, in pixels, (K,)."""
    farthest = np.zeros(len(shear.slope))
    for (_, v), time, (_, y) in zip(where.uv, where.t, where.offset, strict=True):
        shift = shrink * (y - shear.slope * v) - shear.motion[:, 1] * (time - 0.5)
        np.maximum(farthest, np.abs(shift), out=farthest)
    return farthest


def smoothed_bands(maps: Maps, sigma: Float64, farthest: Float64, execution: Execution) -> Iterator[Band]:
    """Yield the bands of an image, from top to bottom.

    Parameters
    ----------
    maps : Maps
        Planes as the lens at hand sees them.
    sigma : ndarray, (K,)
        Standard deviations in pixels; 0 for planes that stay as they are.
    farthest : ndarray, (K,)
        What `farthest_shift` returned.
    execution : Execution
        Threads to use.

    Yields
    ------
    Band
        Its planes can be seen from all views in its rows of tiles.
    """
    wide = np.repeat(sigma > 0, maps.grid.shape.prod(axis=1)) & (maps.slots >= 0)
    squares = np.repeat(maps.grid.cells.astype(np.int64) ** 2, maps.grid.shape.prod(axis=1))
    size = int(squares[wide].sum()) * _native.UNIT_HALVES * 2
    rows = -(-maps.height // _native.TILE_ROWS)
    step = max(1, min(rows, rows * _MOST_BYTES // max(size, 1)))
    for first in range(0, rows, step):
        end = min(first + step, rows)
        near = wide & _blocks_near(maps.grid, first, end, farthest)
        yield Band(first, end, *_smooth(maps, sigma, wide, near, execution))


def _blocks_near(grid: Grid, first: int, end: int, farthest: Float64) -> Bools:
    """Return which places for blocks rows of tiles can see."""
    near = np.zeros(grid.slot_count, np.bool_)
    reach = np.ceil(farthest).astype(np.int64) + 2
    top = (first * _native.TILE_ROWS - reach - grid.corner[:, 1]) // BLOCK[0]
    bottom = -((grid.corner[:, 1] - end * _native.TILE_ROWS - reach) // BLOCK[0])
    for plane, (columns, rows) in enumerate(grid.shape):
        begin, stop = (min(max(int(row), 0), int(rows)) for row in (top[plane], bottom[plane]))
        near[grid.first_slot[plane] + begin * columns : grid.first_slot[plane] + stop * columns] = True
    return near


def _smooth(
    maps: Maps, sigma: Float64, wide: Bools, near: Bools, execution: Execution
) -> tuple[Int32, npt.NDArray[np.uint16], npt.NDArray[np.uint8]]:
    """Return slots, smoothed blocks and smoothed planes of a `Band`."""
    places, units = number_blocks(near, maps.grid)
    halves = np.empty(units * _native.UNIT_HALVES + 2 * _native.HALF_PADDING, np.uint16)
    halves[: _native.HALF_PADDING] = halves[-_native.HALF_PADDING :] = 0
    parts = _parts(maps.grid, near)
    native = maps.native()

    def work(first: int, last: int) -> None:
        _native.multiplane_smooth(
            native, maps.slots, maps.halves, sigma.astype(np.float32), places, parts, first, last, halves
        )

    map_ranges(work, len(parts), replace(execution, progress=False), chunk=1)
    return np.where(wide, places, maps.slots), halves, (sigma > 0).astype(np.uint8)


def _parts(grid: Grid, near: Bools) -> Int32:
    """Cut planes that have blocks to smooth into parts (N, 3): plane, first row of blocks, end."""
    parts = []
    for plane, (columns, rows) in enumerate(grid.shape):
        first_slot = grid.first_slot[plane]
        own = near[first_slot : first_slot + rows * columns].reshape(rows, columns)
        used = np.flatnonzero(own.any(axis=1))
        if len(used):
            parts += [
                (plane, row, min(row + _ROWS, used[-1] + 1)) for row in range(used[0], used[-1] + 1, _ROWS)
            ]
    return np.array(parts, np.int32).reshape(-1, 3)
