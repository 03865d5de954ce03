"""What the cells of a plane hold, as arrays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.multiplane.maps import BLOCK, Maps

__all__ = ["blocks_of", "whole_layer"]

Float64 = npt.NDArray[np.float64]


def blocks_of(maps: Maps, plane: int) -> Iterator[tuple[int, int, Float64]]:
    """Yield each block of a plane: its row and column among the plane's, and what its cells hold.

    Opacity and premultiplied radiance, ``(9 cells, 33 cells, 4)``: with the row and column that follow.
    """
    cells = int(maps.grid.cells[plane])
    columns, rows = maps.grid.shape[plane]
    first = maps.grid.first_slot[plane]
    slots = maps.slots[first : first + columns * rows].reshape(rows, columns)
    size = cells**2 * _native.UNIT_HALVES
    for row, column in np.argwhere(slots >= 0):
        begin = _native.HALF_PADDING + int(slots[row, column]) * _native.UNIT_HALVES
        halves = maps.halves[begin : begin + size].view(np.float16).astype(np.float64)
        interleaved = halves.reshape(4, cells, cells, BLOCK[0] + 1, BLOCK[1] + 1)
        layer = interleaved.transpose(3, 1, 4, 2, 0).reshape(
            (BLOCK[0] + 1) * cells, (BLOCK[1] + 1) * cells, 4
        )
        yield int(row), int(column), layer * [1.0, *3 * [maps.scale[plane]]]


def whole_layer(maps: Maps, plane: int) -> Float64:
    """Return opacity and premultiplied radiance of all cells of a plane, (R, C, 4)."""
    cells = int(maps.grid.cells[plane])
    columns, rows = maps.grid.shape[plane]
    height, width = BLOCK[0] * cells, BLOCK[1] * cells
    layer = np.zeros((rows * height, columns * width, 4))
    for row, column, block in blocks_of(maps, plane):
        own = layer[row * height : (row + 1) * height, column * width : (column + 1) * width]
        own[:] = block[:height, :width]
    return layer
