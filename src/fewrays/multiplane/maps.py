"""`Maps`: radiance and opacity as the lens centre sees them, and how planes appear from elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.errors import SampleError
from fewrays.lens import Lens

__all__ = ["BLOCK", "Grid", "Maps", "Shear", "native_planes", "number_blocks"]

BLOCK = (_native.BLOCK_ROWS, _native.BLOCK_COLUMNS)
"""Height and width in pixels of a block, the part of a plane that is either kept or left out."""

Int32 = npt.NDArray[np.int32]
Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Shear:
    """How planes appear from other lens points and times than the lens centre at half time.

    Parameters
    ----------
    slope : ndarray, (K,)
        In pixels per lens unit, rising from front to back.
    motion : ndarray, (K, 2)
        In pixels per shutter interval.
    """

    slope: npt.NDArray[np.float64]
    motion: npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Grid:
    """Where planes have blocks.

    Parameters
    ----------
    cells : ndarray of int32, (K,)
        Cells of a plane per pixel and axis.
    corner : ndarray of int32, (K, 2)
        Left and top of the first block, in pixels.
    shape : ndarray of int32, (K, 2)
        Columns and rows of blocks.
    """

    cells: Int32
    corner: Int32
    shape: Int32

    @cached_property
    def first_slot(self) -> Int32:
        """Number of the first block of each plane among all places for blocks, (K,)."""
        counts = self.shape.prod(axis=1)
        first: Int32 = (np.cumsum(counts) - counts).astype(np.int32)
        return first

    @property
    def slot_count(self) -> int:
        """Places for blocks in all planes."""
        return int(self.shape.prod(axis=1).sum())


@dataclass(frozen=True, eq=False)
class Maps:
    """Planes from front to back.

    Plane k holds what lies at slopes around ``shear.slope[k]`` and moves by about ``shear.motion[k]``. It is
    kept in blocks; where no sample hit anything there is none.

    Parameters
    ----------
    height, width : int
        Image size in pixels.
    lens : Lens
        The lens that the slopes belong to.
    shear : Shear
        How planes appear from the lens.
    grid : Grid
        Where planes have blocks.
    slots : ndarray of int32
        Of every place for a block, plane by plane and row by row, where its halves begin, in units; -1 for
        none. See ``native/multiplane.h``.
    halves : ndarray of uint16
        Half-precision opacity and premultiplied radiance of the blocks.
    scale : ndarray, (K,)
        What the stored radiance of each plane has to be multiplied with: a power of two.
    """

    height: int
    width: int
    lens: Lens
    shear: Shear
    grid: Grid
    slots: Int32
    halves: npt.NDArray[np.uint16]
    scale: npt.NDArray[np.float64]

    @property
    def plane_count(self) -> int:
        """Number of planes, K."""
        return len(self.shear.slope)

    @property
    def nbytes(self) -> int:
        """Bytes that the maps take."""
        return self.halves.nbytes + self.slots.nbytes

    def through(self, lens: Lens) -> Maps:
        """Return the same planes with the slopes that they have through another lens.

        Slopes are linear in 1 / depth, so that ``C' = a C + b`` with ``a = c0' / c0`` and
        ``b = c1' - a c1`` (temporal, section 6). The maps stay as they are.

        Raises
        ------
        SampleError
            For planes of a pinhole, all of whose slopes are the same.
        """
        if (lens.c0, lens.c1) == (self.lens.c0, self.lens.c1):
            return replace(self, lens=lens)
        if self.lens.c0 == 0:
            raise SampleError(
                "these planes were made through a pinhole, which tells no depths apart; build them from "
                "samples that were traced through a lens",
                field="lens",
            )
        factor = lens.c0 / self.lens.c0
        slope = factor * self.shear.slope + (lens.c1 - factor * self.lens.c1)
        return replace(self, lens=lens, shear=replace(self.shear, slope=slope))

    def native(self) -> _native.DepthPlanes:
        """Return the planes as native code reads them."""
        return native_planes(self.shear, self.grid, self.scale)


def native_planes(
    shear: Shear, grid: Grid, scale: npt.NDArray[np.float64], most_blur: float = math.inf
) -> _native.DepthPlanes:
    """Return shear, grid and scale as native code reads them.

    Blur radii above `most_blur`, in pixels, count as this one.
    """
    shears = np.column_stack([shear.slope, shear.motion, scale]).astype(np.float32)
    grids = np.column_stack([grid.cells, grid.corner, grid.shape, grid.first_slot]).astype(np.int32)
    return _native.DepthPlanes(np.ascontiguousarray(shears), np.ascontiguousarray(grids), most_blur)


def number_blocks(kept: npt.NDArray[np.bool_], grid: Grid) -> tuple[npt.NDArray[np.int32], int]:
    """Return where each block's halves begin, in units, -1 for places without one, and the units in all."""
    slots = np.full(len(kept), -1, np.int32)
    units = 0
    for cells, first, places in zip(grid.cells, grid.first_slot, grid.shape.prod(axis=1), strict=True):
        own = np.flatnonzero(kept[first : first + places])
        each = int(cells) ** 2
        slots[first + own] = units + each * np.arange(len(own))
        units += each * len(own)
    return slots, units
