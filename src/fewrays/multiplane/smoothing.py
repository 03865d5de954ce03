"""Planes smoothed for the views that they are looked at with.

A plane that is blurred over a wide disc is seen from N lens points, and so N times, at places that blur puts
far apart. A Gaussian about as wide as a third of their distance closes the gaps between them. How far they
are apart depends on lens, focus and number of views, so planes are stored sharp and smoothed copies are made
for every image. Where the Gaussian is half a pixel wide, these need no more than one cell per pixel. They are
made for one band of the image after the other, so that they take little memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.aperture import Aperture
from fewrays.multiplane.maps import BLOCK, Grid, Maps, Shear, number_blocks
from fewrays.parallel import Execution, map_ranges
from fewrays.temporal.locations import Locations

__all__ = [
    "Band",
    "Smoothing",
    "band_rows",
    "distance_between",
    "farthest_shift",
    "smooth_band",
    "touched_places",
    "widened",
]

Bools = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

_LEAST_SIGMA = 0.3  # pixels; a Gaussian narrower than that has no second tap to speak of
_MOST_SIGMA = 10.0  # pixels
_COARSE_SIGMA = 0.5  # pixels; what has been smoothed that much needs one cell per pixel
_NEAR = 2.0  # pixels
_SQUARE = 4.0  # square lens units: all lens points lie in [-1, 1]²
_DARK = 1e-9  # light per square lens unit that is none
_MOST_BYTES = 2**26  # that smoothed copies of planes should take
_ROWS = 24  # of blocks that are smoothed at once


@dataclass(frozen=True, eq=False)
class Smoothing:
    """How planes are smoothed for an image.

    Parameters
    ----------
    sigma : ndarray, (K,)
        Standard deviation of the Gaussian in pixels; 0 for planes that stay as they are.
    built : ndarray of int32, (K,)
        Cells per pixel and axis of planes as they were built.
    cells : ndarray of int32, (K,)
        The same of smoothed planes: one where there were two and the Gaussian is wide.
    """

    sigma: Float64
    built: Int32
    cells: Int32

    @classmethod
    def of_views(cls, slope: Float64, cells: Int32, distance: float, strength: float) -> Smoothing:
        """Choose how planes of slopes (K,) and cells (K,) are smoothed for lens points a distance apart.

        With `distance` d in lens units, blur puts them ``|C| d`` pixels apart: the unit of `strength`.
        """
        sigma = strength * np.abs(slope) * distance
        sigma = np.where(sigma > _LEAST_SIGMA, np.minimum(sigma, _MOST_SIGMA), 0.0)
        return cls(sigma, cells, np.where((cells == 2) & (sigma > _COARSE_SIGMA), 1, cells).astype(np.int32))

    @property
    def variance(self) -> Float64:
        """The variance along each axis of all that blurs the planes, in squared pixels, (K,).

        Sharing a ray out among cells convolves with a triangle two cells wide, of the variance 1/6; so does
        interpolation. The mean of n cells convolves with n points.
        """
        built, cells = np.square(self.built, dtype=np.float64), np.square(self.cells, dtype=np.float64)
        return 1 / (6 * built) + 1 / (6 * cells) + (1 / cells - 1 / built) / 12 + np.square(self.sigma)


def distance_between(aperture: Aperture, where: Locations) -> float:
    """Return how far apart neighbouring lens points are, in lens units, as a root of the mean square.

    Where a square lens unit gets a share p of the light, each of N points of equal light has ``1 / (N p)``
    square units to itself. The mean of that over the points is about the N-th part of all the area that lets
    light pass. It is more than the variance of the points tells: at a Gaussian's foot few lie far apart, and
    there they are seen one by one first.
    """
    area = float(np.mean(1 / np.maximum(aperture.density(where.uv), _DARK)))
    return math.sqrt(min(area, _SQUARE) / where.count)


@dataclass(frozen=True, eq=False)
class Band:
    """Planes smoothed as far as some rows of an image's tiles see them.

    Parameters
    ----------
    slots : ndarray of int32
        Where blocks begin, as in `Maps`: those of smoothed planes in `halves`, others in the maps' own.
    halves : ndarray of uint16
        The smoothed blocks.
    """

    slots: Int32
    halves: npt.NDArray[np.uint16]


def farthest_shift(shear: Shear, shrink: Float32, where: Locations) -> Float64:
    """Return how far views shift each plane down or up at most, in pixels, (K,)."""
    farthest = np.zeros(len(shear.slope))
    for (_, v), time, (_, y) in zip(where.uv, where.t, where.offset, strict=True):
        shift = shrink * (y - shear.slope * v) - shear.motion[:, 1] * (time - 0.5)
        np.maximum(farthest, np.abs(shift), out=farthest)
    return farthest


def band_rows(maps: Maps, smoothing: Smoothing) -> list[tuple[int, int]]:
    """Return the rows of tiles of an image's bands, from top to bottom: first and end."""
    kept = np.add.reduceat(maps.slots >= 0, maps.grid.first_slot, dtype=np.int64)
    units = np.where(smoothing.sigma > 0, kept * smoothing.cells.astype(np.int64) ** 2, 0).sum()
    rows = -(-maps.height // _native.TILE_ROWS)
    step = max(1, min(rows, rows * _MOST_BYTES // max(int(units) * _native.UNIT_HALVES * 2, 1)))
    return [(first, min(first + step, rows)) for first in range(0, rows, step)]


def smooth_band(
    maps: Maps, smoothing: Smoothing, farthest: Float64, rows: tuple[int, int], execution: Execution
) -> Band:
    """Smooth planes as far as a band of the image sees them.

    Parameters
    ----------
    maps : Maps
        Planes as the lens at hand sees them.
    smoothing : Smoothing
    farthest : ndarray, (K,)
        What `farthest_shift` returned.
    rows : (int, int)
        First and end of the rows of tiles.
    execution : Execution
        Threads to use.

    Returns
    -------
    Band
        Its planes can be seen from all views in its rows of tiles.
    """
    wide = touched_places(maps, smoothing)
    near = wide & _blocks_near(maps.grid, *rows, farthest)
    places, units = number_blocks(near, replace(maps.grid, cells=smoothing.cells))
    halves = np.empty(units * _native.UNIT_HALVES + 2 * _native.HALF_PADDING, np.uint16)
    halves[: _native.HALF_PADDING] = halves[-_native.HALF_PADDING :] = 0
    parts = _parts(maps.grid, near)
    native, sigma = maps.native(), smoothing.sigma.astype(np.float32)

    def work(first: int, last: int) -> None:
        _native.multiplane_smooth(
            native, maps.slots, maps.halves, sigma, smoothing.cells, places, parts, first, last, halves
        )

    map_ranges(work, len(parts), replace(execution, progress=False), chunk=1)
    smoothed = np.repeat(smoothing.sigma > 0, maps.grid.shape.prod(axis=1))
    return Band(np.where(smoothed, places, maps.slots), halves)


def touched_places(maps: Maps, smoothing: Smoothing) -> Bools:
    """Return which places for blocks smoothed planes may reach."""
    touched = np.zeros(maps.grid.slot_count, np.bool_)
    for plane, (columns, rows) in enumerate(maps.grid.shape):
        if smoothing.sigma[plane] > 0:
            first = maps.grid.first_slot[plane]
            own = slice(first, first + rows * columns)
            kept = maps.slots[own].reshape(rows, columns) >= 0
            touched[own] = widened(kept, float(smoothing.sigma[plane])).reshape(-1)
    return touched


def widened(kept: Bools, sigma: float) -> Bools:
    """Return which blocks (R, C) a Gaussian of a standard deviation in pixels may bring something to.

    Without these, what lies close to a block's border would end there, and small lights would show it. Of
    its weight 98 % lie within two standard deviations, and samples touch the blocks of what is near anyway.
    """
    for size in BLOCK:
        wide = kept.copy()
        blocks = math.ceil(max(2 * sigma - _NEAR, 0.0) / size)
        for step in range(1, min(blocks, len(kept) - 1) + 1):
            wide[step:] |= kept[:-step]
            wide[:-step] |= kept[step:]
        kept = wide.T  # columns next; the second time, rows again
    return kept


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
