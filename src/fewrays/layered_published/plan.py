"""What all tiles of a published layered reconstruction share: tiling, partitions and the filter rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.layered_published.filters import FilterRule
from fewrays.layered_published.partitions import Partitions
from fewrays.tiling import Tiling

__all__ = ["Plan"]


@dataclass(frozen=True, kw_only=True)
class Plan(Tiling):
    """Everything that a tile needs to know besides the samples.

    Parameters
    ----------
    height, width, tile
        See `Tiling`.
    ring : int
        Width of the ring of pixels around a tile whose samples it uses as well (section 6.3).
    partitions : Partitions
        Depth partitions in slope.
    rule : FilterRule
        How a layer's slopes become a filter.
    max_layers : int or None
        Largest number of layers in a tile (section 7.1.5).
    slots : ndarray of int32, (partitions.count,)
        Place of each partition in the per-layer images, -1 for partitions that no sample falls into.
    """

    ring: int
    partitions: Partitions
    rule: FilterRule
    max_layers: int | None
    slots: npt.NDArray[np.int32]
