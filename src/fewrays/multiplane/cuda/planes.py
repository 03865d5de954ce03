"""`DevicePlanes`: maps of radiance and opacity in a card's memory.

They are cut into the same blocks as on the host (`fewrays.multiplane.maps`), in the same order. Within a
block the four channels of a cell lie beside each other, so that one load brings them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.cuda.machine import Machine
from fewrays.lens import Lens
from fewrays.multiplane.maps import Maps

__all__ = ["CHANNELS", "MAP_CELLS", "DevicePlanes", "plane_records"]

CHANNELS = 4
"""Opacity, and radiance times opacity."""

MAP_CELLS = _native.UNIT_HALVES // CHANNELS
"""Cells of a map: of a block with one cell per pixel, with those that repeat its neighbours'."""

_Int64 = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class DevicePlanes:
    """Planes from front to back, in a card's memory.

    Parameters
    ----------
    outline : Maps
        What the host knows: all but the blocks themselves. Its ``halves`` are empty.
    slots : array of int32
        The slots of `outline` once more.
    texels : array of uint16, (maps, `MAP_CELLS`, `CHANNELS`)
        Half-precision numbers, as bits, of one map after the other: a block has ``cells²``.
    first_map : ndarray of int64, (K + 1,)
        Of each plane, and the end.
    """

    outline: Maps
    slots: Any
    texels: Any
    first_map: _Int64

    @classmethod
    def of_maps(cls, machine: Machine, maps: Maps) -> DevicePlanes:
        """Copy planes to the card."""
        first_map = _first_map(maps)
        texels = machine.xp.empty((int(first_map[-1]), MAP_CELLS, CHANNELS), np.uint16)
        padding = _native.HALF_PADDING
        halves = machine.on_device(maps.halves[padding : len(maps.halves) - padding], np.uint16)
        for first, end, cells in _ranges(first_map, maps):
            own = halves[first * _native.UNIT_HALVES : end * _native.UNIT_HALVES]
            # A block holds one channel after the other, each with all its maps.
            apart = own.reshape(-1, CHANNELS, cells**2, MAP_CELLS)
            texels[first:end] = apart.transpose(0, 2, 3, 1).reshape(-1, MAP_CELLS, CHANNELS)
        outline = replace(maps, halves=np.zeros(0, np.uint16))
        return cls(outline, machine.on_device(maps.slots, np.int32), texels, first_map)

    def to_maps(self, machine: Machine) -> Maps:
        """Copy them to the host."""
        padding = _native.HALF_PADDING
        halves = np.zeros(int(self.first_map[-1]) * _native.UNIT_HALVES + 2 * padding, np.uint16)
        inner = halves[padding : len(halves) - padding]
        texels = machine.on_host(self.texels)
        for first, end, cells in _ranges(self.first_map, self.outline):
            together = texels[first:end].reshape(-1, cells**2, MAP_CELLS, CHANNELS)
            own = inner[first * _native.UNIT_HALVES : end * _native.UNIT_HALVES]
            own[:] = together.transpose(0, 3, 1, 2).ravel()
        return replace(self.outline, halves=halves)

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.outline.height

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.outline.width

    @property
    def lens(self) -> Lens:
        """The lens of the samples."""
        return self.outline.lens

    @property
    def plane_count(self) -> int:
        """Number of planes, K."""
        return self.outline.plane_count

    @property
    def nbytes(self) -> int:
        """Bytes of the card's memory that they take."""
        return int(self.texels.nbytes + self.slots.nbytes)


def plane_records(maps: Maps) -> npt.NDArray[np.int32]:
    """Return planes as ``DepthPlane`` in ``native/math/depth_plane.h`` has them, as bits, (K, 10)."""
    shears = np.column_stack([maps.shear.slope, maps.shear.motion, maps.scale]).astype(np.float32)
    grids = [maps.grid.cells, maps.grid.corner, maps.grid.shape, maps.grid.first_slot]
    return np.column_stack([shears.view(np.int32), *grids]).astype(np.int32)


def _first_map(maps: Maps) -> _Int64:
    """Return the first map of each plane, and the end, (K + 1,)."""
    blocks = np.add.reduceat(maps.slots >= 0, maps.grid.first_slot, dtype=np.int64)
    return np.concatenate([[0], np.cumsum(blocks * maps.grid.cells.astype(np.int64) ** 2)])


def _ranges(first_map: _Int64, maps: Maps) -> list[tuple[int, int, int]]:
    """First and last map of each run of planes of one resolution, and its cells."""
    cells = maps.grid.cells
    starts = [0, *(np.flatnonzero(np.diff(cells)) + 1).tolist(), len(cells)]
    return [
        (int(first_map[start]), int(first_map[end]), int(cells[start]))
        for start, end in pairwise(starts)
        if end > start
    ]
