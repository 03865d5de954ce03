"""Smoothed copies of planes: where their blocks are, at what resolution, and how they are made.

Copies are made for one band of the image after the other, so that they take little memory. What is smoothed
by more than a pixel or two changes slowly over the image, whatever the lens point: such planes are copied at
half the image's resolution and laid behind one another there, and only the result is interpolated. That goes
for planes in front of all that is sharper, and for planes behind all of it: others would have to be
interpolated one by one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.multiplane.maps import BLOCK, Grid, Maps, Shear, native_planes, number_blocks
from fewrays.multiplane.smoothing import Smoothing, touched_places
from fewrays.parallel import Execution, map_ranges
from fewrays.temporal.locations import Locations

__all__ = ["Band", "Copies", "copied_places", "farthest_shifts", "gaussians", "halved_planes"]

Bools = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

_HALVED_SIGMA = 1.5  # pixels; what has been smoothed more than that needs half a cell per pixel
_HALVED_BLUR = 17 / 12  # square pixels
"""Variance that half the resolution brings along: two interpolations between points two pixels apart instead
of one between pixels, 2 · 4/6 - 1/6, and means of four pixels, (4 - 1) / 12."""
_MOST_BYTES = 2**26  # that copies should take
_ROWS = 24  # of blocks that are smoothed at once


@dataclass(frozen=True, eq=False)
class Copies:
    """Smoothed copies of planes as the views of an image look at them; planes that stay as they are, too.

    Parameters
    ----------
    maps : Maps
        Planes as the lens at hand sees them.
    smoothing : Smoothing
    is_halved : ndarray of bool, (K,)
        Copies of half the image's resolution: planes before all others, and behind all others.
    shear : Shear
    grid : Grid
        Of copies. Those at half resolution are in units of two pixels.
    slots : ndarray of int32
        Where blocks of planes that are not smoothed begin, of all places of `grid`; -1 for others.
    touched : ndarray of bool
        Which places of `grid` smoothed planes may reach.
    """

    maps: Maps
    smoothing: Smoothing
    is_halved: Bools
    shear: Shear
    grid: Grid
    slots: Int32
    touched: Bools

    @classmethod
    def of_maps(cls, maps: Maps, smoothing: Smoothing) -> Copies:
        """Choose where copies have blocks, at half resolution where that is enough."""
        is_halved = halved_planes(smoothing)
        pitch = np.where(is_halved, 2, 1)
        shear = Shear(maps.shear.slope / pitch, maps.shear.motion / pitch[:, None])
        grid = _copied_grid(replace(maps.grid, cells=smoothing.cells), is_halved)
        is_sharp = np.repeat(smoothing.sigma == 0, maps.grid.shape.prod(axis=1))
        slots = np.full(grid.slot_count, -1, np.int32)
        slots[np.repeat(smoothing.sigma == 0, grid.shape.prod(axis=1))] = maps.slots[is_sharp]
        touched = copied_places(touched_places(maps, smoothing), maps.grid, grid, is_halved)
        return cls(maps, smoothing, is_halved, shear, grid, slots, touched)

    @property
    def front_end(self) -> int:
        """Number of planes at half resolution before all others."""
        return int(np.logical_and.accumulate(self.is_halved).sum())

    @property
    def back_begin(self) -> int:
        """First of the planes at half resolution behind all others."""
        rest = self.is_halved[self.front_end :]
        return len(self.is_halved) - int(np.logical_and.accumulate(rest[::-1]).sum())

    def native(self) -> _native.DepthPlanes:
        """Return the copies as native code reads them."""
        return native_planes(self.shear, self.grid, self.maps.scale)

    def bands(self) -> list[tuple[int, int]]:
        """Return the rows of tiles of the image's bands, from top to bottom: first and end."""
        cells = np.repeat(self.grid.cells.astype(np.int64) ** 2, self.grid.shape.prod(axis=1))
        rows = -(-self.maps.height // _native.TILE_ROWS)
        size = int(cells[self.touched].sum()) * _native.UNIT_HALVES * 2
        step = max(1, min(rows, rows * _MOST_BYTES // max(size, 1)))
        return [(first, min(first + step, rows)) for first in range(0, rows, step)]

    def smooth_band(self, rows: tuple[int, int], farthest: Float64, execution: Execution) -> Band:
        """Smooth planes as far as a band of the image sees them.

        Parameters
        ----------
        rows : (int, int)
            First and end of the rows of tiles.
        farthest : ndarray, (K,)
            How far views shift each plane down or up at most, in pixels.
        execution : Execution
            Threads to use.

        Returns
        -------
        Band
            Its planes can be seen from all views in its rows of tiles.
        """
        near = self.touched & self._blocks_near(*rows, farthest)
        places, units = number_blocks(near, self.grid)
        halves = np.empty(units * _native.UNIT_HALVES + 2 * _native.HALF_PADDING, np.uint16)
        halves[: _native.HALF_PADDING] = halves[-_native.HALF_PADDING :] = 0
        parts = self._parts(near)
        planes, copies, sigma = (
            self.maps.native(),
            self.native(),
            gaussians(self.smoothing, self.is_halved).astype(np.float32),
        )
        is_halved = self.is_halved.astype(np.uint8)

        def work(first: int, last: int) -> None:
            _native.multiplane_smooth(
                planes,
                self.maps.slots,
                self.maps.halves,
                sigma,
                copies,
                is_halved,
                places,
                parts,
                first,
                last,
                halves,
            )

        map_ranges(work, len(parts), replace(execution, progress=False), chunk=1)
        return Band(np.maximum(places, self.slots), halves)

    def _blocks_near(self, first: int, end: int, farthest: Float64) -> Bools:
        """Return which places for blocks rows of tiles can see."""
        near = np.zeros(self.grid.slot_count, np.bool_)
        pitch = np.where(self.is_halved, 2, 1)
        reach = np.ceil(farthest / pitch).astype(np.int64) + 3
        top = (first * _native.TILE_ROWS // pitch - reach - self.grid.corner[:, 1]) // BLOCK[0]
        bottom = -((self.grid.corner[:, 1] - end * _native.TILE_ROWS // pitch - reach) // BLOCK[0])
        for plane, (columns, rows) in enumerate(self.grid.shape):
            begin, stop = (min(max(int(row), 0), int(rows)) for row in (top[plane], bottom[plane]))
            first_slot = self.grid.first_slot[plane]
            near[first_slot + begin * columns : first_slot + stop * columns] = True
        return near

    def _parts(self, near: Bools) -> Int32:
        """Cut planes that have blocks to smooth into parts (N, 3): plane, first row of blocks, end."""
        parts = []
        for plane, (columns, rows) in enumerate(self.grid.shape):
            first_slot = self.grid.first_slot[plane]
            own = near[first_slot : first_slot + rows * columns].reshape(rows, columns)
            used = np.flatnonzero(own.any(axis=1))
            if len(used):
                parts += [
                    (plane, row, min(row + _ROWS, used[-1] + 1))
                    for row in range(used[0], used[-1] + 1, _ROWS)
                ]
        return np.array(parts, np.int32).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Band:
    """Planes smoothed as far as some rows of an image's tiles see them.

    Parameters
    ----------
    slots : ndarray of int32
        Where blocks begin, of all places of `Copies.grid`: those of smoothed planes in `halves`, others in
        the maps' own.
    halves : ndarray of uint16
        The smoothed blocks.
    """

    slots: Int32
    halves: npt.NDArray[np.uint16]


def halved_planes(smoothing: Smoothing) -> Bools:
    """Return which planes are looked at with half the image's resolution, (K,)."""
    is_smooth = (smoothing.sigma > _HALVED_SIGMA) & (smoothing.cells == 1)
    before, behind = (np.logical_and.accumulate(each) for each in (is_smooth, is_smooth[::-1]))
    halved: Bools = before | behind[::-1]
    return halved


def gaussians(smoothing: Smoothing, is_halved: Bools) -> Float64:
    """Return the standard deviations in pixels that planes are smoothed with, (K,).

    What half the resolution blurs by itself is taken off.
    """
    variance = np.square(smoothing.sigma) - np.where(is_halved, _HALVED_BLUR, 0.0)
    sigma: Float64 = np.sqrt(variance)
    return sigma


def farthest_shifts(shear: Shear, shrink: Float32, where: Locations) -> Float64:
    """Return how far views shift each plane along each axis at most, in pixels, (K, 2)."""
    farthest = np.zeros((len(shear.slope), 2))
    for uv, time, offset in zip(where.uv, where.t, where.offset, strict=True):
        shift = shrink[:, None] * (offset - shear.slope[:, None] * uv) - shear.motion * (time - 0.5)
        np.maximum(farthest, np.abs(shift), out=farthest)
    return farthest


def _copied_grid(grid: Grid, is_halved: Bools) -> Grid:
    """Put blocks of half resolution around those of planes."""
    block = np.array(BLOCK[::-1])
    corner = grid.corner // (2 * block) * block
    shape = -(-(grid.corner + grid.shape * block - 2 * corner) // (2 * block))
    halved = is_halved[:, None]
    return Grid(
        grid.cells,
        np.where(halved, corner, grid.corner).astype(np.int32),
        np.where(halved, shape, grid.shape).astype(np.int32),
    )


def copied_places(kept: Bools, grid: Grid, copied: Grid, is_halved: Bools) -> Bools:
    """Return which places of copies lie where any of their planes' places is kept."""
    places = np.zeros(copied.slot_count, np.bool_)
    for plane, (columns, rows) in enumerate(grid.shape):
        own = kept[grid.first_slot[plane] :][: rows * columns].reshape(rows, columns)
        pitch = 2 if is_halved[plane] else 1
        (left, top), (copied_left, copied_top) = (
            each.corner[plane] // BLOCK[::-1] for each in (grid, copied)
        )
        copied_columns, copied_rows = copied.shape[plane]
        copy = places[copied.first_slot[plane] :][: copied_rows * copied_columns]
        row = (top + np.arange(rows)) // pitch - copied_top
        column = (left + np.arange(columns)) // pitch - copied_left
        np.logical_or.at(copy.reshape(copied_rows, copied_columns), np.ix_(row, column), own)
    return places
