"""What all tiles of a published layered reconstruction share: tiling, partitions and the filter rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.layered_published.filters import FilterRule
from fewrays.layered_published.partitions import Partitions

__all__ = ["Plan"]


@dataclass(frozen=True)
class Plan:
    """Everything that a tile needs to know besides the samples.

    Parameters
    ----------
    height, width : int
        Image size in pixels.
    tile, ring : int
        Side of a tile and width of the ring of pixels around it whose samples it uses (section 6.3).
    partitions : Partitions
        Depth partitions in slope.
    rule : FilterRule
        How a layer's slopes become a filter.
    max_layers : int or None
        Largest number of layers in a tile (section 7.1.5).
    slots : ndarray of int32, (partitions.count,)
        Place of each partition in the per-layer images, -1 for partitions that no sample falls into.
    """

    height: int
    width: int
    tile: int
    ring: int
    partitions: Partitions
    rule: FilterRule
    max_layers: int | None
    slots: npt.NDArray[np.int32]

    @property
    def tile_columns(self) -> int:
        """Tiles in a row of tiles."""
        return -(-self.width // self.tile)

    @property
    def tile_count(self) -> int:
        """Number of tiles."""
        return self.tile_columns * -(-self.height // self.tile)

    def tile_rectangle(self, tile: int) -> tuple[int, int, int, int]:
        """Row, column, height and width of a tile, cut off at the image's right and bottom edges."""
        row, column = (self.tile * part for part in divmod(tile, self.tile_columns))
        return row, column, min(self.tile, self.height - row), min(self.tile, self.width - column)
