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

__all__ = ["CHANNELS", "MAP_CELLS", "DevicePlanes"]

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
        What the host knows: all but the blocks. Its ``slots`` and ``halves`` are empty.
    slots : array of int32
        As `Maps.slots`.
    texels : array of uint16, (maps, `MAP_CELLS`, `CHANNELS`)
        Half-precision numbers, as bits, of one map after the other: a block has ``cells²``.
    blocks : array of int32, (B,)
        Which places have a block, in order.
    first_block, first_map : ndarray of int64, (K + 1,)
        Of each plane, and the end.
    """

    outline: Maps
    slots: Any
    texels: Any
    blocks: Any
    first_block: _Int64
    first_map: _Int64

    @classmethod
    def of_maps(cls, machine: Machine, maps: Maps) -> DevicePlanes:
        """Copy planes to the card."""
        kept = maps.slots >= 0
        first_block, first_map = ends_of_planes(maps, kept)
        texels = machine.xp.empty((int(first_map[-1]), MAP_CELLS, CHANNELS), np.uint16)
        padding = _native.HALF_PADDING
        halves = machine.on_device(maps.halves[padding : len(maps.halves) - padding], np.uint16)
        for first, end, cells in _ranges(first_map, maps):
            own = halves[first * _native.UNIT_HALVES : end * _native.UNIT_HALVES]
            # A block holds one channel after the other, each with all its maps.
            apart = own.reshape(-1, CHANNELS, cells**2, MAP_CELLS)
            texels[first:end] = apart.transpose(0, 2, 3, 1).reshape(-1, MAP_CELLS, CHANNELS)
        return cls(
            outline_of(maps),
            machine.on_device(maps.slots, np.int32),
            texels,
            machine.on_device(np.flatnonzero(kept), np.int32),
            first_block,
            first_map,
        )

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
        return replace(self.outline, slots=machine.on_host(self.slots), halves=halves)

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
        return int(self.texels.nbytes + self.slots.nbytes + self.blocks.nbytes)


def outline_of(maps: Maps) -> Maps:
    """Return what is left of planes without their blocks."""
    return replace(maps, slots=np.zeros(0, np.int32), halves=np.zeros(0, np.uint16))


def ends_of_planes(maps: Maps, kept: npt.NDArray[np.bool_]) -> tuple[_Int64, _Int64]:
    """Return the first block and the first map of each plane, (K + 1,), for the places that have blocks."""
    numbers = np.concatenate([[0], np.cumsum(kept)])
    ends = np.append(maps.grid.first_slot, len(kept))
    first_block = numbers[ends].astype(np.int64)
    maps_of_planes = np.diff(first_block) * maps.grid.cells.astype(np.int64) ** 2
    return first_block, np.concatenate([[0], np.cumsum(maps_of_planes)])


def _ranges(first_map: _Int64, maps: Maps) -> list[tuple[int, int, int]]:
    """First and last map of each run of planes of one resolution, and its cells."""
    cells = maps.grid.cells
    starts = [0, *(np.flatnonzero(np.diff(cells)) + 1).tolist(), len(cells)]
    return [
        (int(first_map[start]), int(first_map[end]), int(cells[start]))
        for start, end in pairwise(starts)
        if end > start
    ]
