"""Regions of an image, and how their coarse maps are filtered.

Layers of coarse bins are filtered as maps that many tiles read. Maps of the whole image would grow with it,
so a large image is reconstructed region by region, and only a region's maps are in memory. Maps of the
coarsest bins are small whatever the image, and need margins wider than a region: they serve all regions.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.tiling import Tiling

__all__ = ["DEEPEST_TILE_LEVEL", "MAX_REGION", "CoarsePass", "Region", "RegionPlan"]

DEEPEST_TILE_LEVEL = 1
"""Layers of bins up to this level are filtered tile by tile, those of coarser bins as maps."""

_DEEPEST_REGION_LEVEL = 3  # up to which every region has maps of its own
_MARGIN = 12  # bins of a map around its region, at least: parts of the aperture look out of it
_TILE = 256  # bins along a side of a tile of a map, at least

MAX_REGION = (_TILE - 2 * _MARGIN) * 2**_DEEPEST_REGION_LEVEL
"""Side of a region in pixels, at most: with margins, that of a tile of the maps of its deepest level."""


@dataclass(frozen=True)
class Region:
    """A rectangle of the image.

    Parameters
    ----------
    left, top, right, bottom : int
        In pixels.
    tiles : ndarray of int32
        The numbers of its tiles.
    """

    left: int
    top: int
    right: int
    bottom: int
    tiles: npt.NDArray[np.int32]


@dataclass(frozen=True)
class CoarsePass:
    """Levels of coarse layers that are filtered together, and the tiles of their maps.

    Parameters
    ----------
    region : Region
        That their maps cover, with a margin of bins around it.
    first, last : int
        The levels.
    side : int
        Of a tile, in pixels.
    """

    region: Region
    first: int
    last: int
    side: int

    @property
    def left(self) -> int:
        """Left edge of the first tile, in pixels from the image's."""
        return self.map_window(self.last)[1] << self.last

    @property
    def top(self) -> int:
        """Upper edge of the first tile, in pixels from the image's."""
        return self.map_window(self.last)[0] << self.last

    @property
    def right(self) -> int:
        """Where the last tile may end, in pixels from the image's left edge."""
        return self.region.right + (_MARGIN << self.last)

    @property
    def bottom(self) -> int:
        """Where the last tile may end, in pixels from the image's upper edge."""
        return self.region.bottom + (_MARGIN << self.last)

    @property
    def rows(self) -> int:
        """Rows of tiles."""
        return -(-(self.bottom - self.top) // self.side)

    @property
    def columns(self) -> int:
        """Columns of tiles."""
        return -(-(self.right - self.left) // self.side)

    def map_window(self, level: int) -> tuple[int, int, int, int]:
        """First row and column of a map, in bins from the image's corner, and its rows and columns."""
        size: int = 2**level
        row, column = (edge // size - _MARGIN for edge in (self.region.top, self.region.left))
        end_row, end_column = (-(-edge // size) + _MARGIN for edge in (self.region.bottom, self.region.right))
        return row, column, end_row - row, end_column - column


@dataclass(frozen=True)
class RegionPlan:
    """The regions of an image, and the passes that fill maps for all of them and for each.

    Parameters
    ----------
    whole : Region
        The image.
    regions : list of Region
    deepest_level : int
        Up to which there are layers.
    """

    whole: Region
    regions: list[Region]
    deepest_level: int

    @classmethod
    def covering(cls, tiling: Tiling, deepest_level: int) -> RegionPlan:
        """Cut an image into regions of whole tiles, as alike as possible."""
        rows, columns = (
            np.array_split(np.arange(-(-extent // tiling.tile)), -(-extent // MAX_REGION))
            for extent in (tiling.height, tiling.width)
        )
        regions = [_region(tiling, *tiles) for tiles in itertools.product(rows, columns)]
        whole = _region(tiling, np.concatenate(rows), np.concatenate(columns))
        return cls(whole, regions, deepest_level)

    @property
    def _deepest_region_level(self) -> int:
        return (
            self.deepest_level if len(self.regions) == 1 else min(self.deepest_level, _DEEPEST_REGION_LEVEL)
        )

    def passes_for_all(self) -> list[CoarsePass]:
        """Return the passes whose maps serve all regions."""
        return _passes(self.whole, self._deepest_region_level + 1, self.deepest_level)

    def passes_for(self, region: Region) -> list[CoarsePass]:
        """Return the passes whose maps serve one region."""
        return _passes(region, DEEPEST_TILE_LEVEL + 1, self._deepest_region_level)


def _region(tiling: Tiling, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]) -> Region:
    """Rectangle of some rows and columns of tiles, which follow each other."""
    return Region(
        int(columns[0]) * tiling.tile,
        int(rows[0]) * tiling.tile,
        min(int(columns[-1] + 1) * tiling.tile, tiling.width),
        min(int(rows[-1] + 1) * tiling.tile, tiling.height),
        np.add.outer(rows * tiling.tile_columns, columns).ravel().astype(np.int32),
    )


def _passes(region: Region, level: int, deepest: int) -> list[CoarsePass]:
    """How levels of coarse layers are filtered for a region: two at a time, or more.

    Layers of several levels share a pass over the samples. The deeper a level, the farther its samples lie
    from where they count, so tiles grow with it; a tile that holds the whole region serves deeper levels as
    well, as long as the margin that these need does not outgrow it.
    """
    passes = []
    while level <= deepest:
        last = min(level + 1, deepest)
        side = _TILE * 2**last
        if side >= max(region.bottom - region.top, region.right - region.left):
            last = max(last, min(deepest, (side // _MARGIN).bit_length() - 1))
        passes.append(CoarsePass(region, level, last, side))
        level = last + 1
    return passes
