"""Depth partitions and the layers that a tile really has (layered, section 6.2 and 7.1.5).

A layer's range of slopes is the exact one of its samples, where the paper rounds it to bins of slope: finding
both costs the same here, and a narrower range has the more effective filter.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Layer", "Partitions", "active_layers"]


@dataclass(frozen=True)
class Partitions:
    """Disjoint ranges of slope, front to back, whose boundaries are multiples of a bin.

    Parameters
    ----------
    bin_size : float
        Width of a bin of slope in pixels.
    first_bin : int
        Index of the first bin of `table`: bin b covers slopes ``[b, b + 1) * bin_size``.
    table : ndarray of uint8
        Partition of each bin. Slopes before the first and after the last bin belong to the end partitions.
    """

    bin_size: float
    first_bin: int
    table: npt.NDArray[np.uint8]

    @classmethod
    def of_constant_energy(
        cls, per_side: int, *, sigma_u: float, sigma_x: float, bin_size: float
    ) -> Partitions:
        """Partition so that every layer's worst-case filter has the same energy.

        A layer's filter has energy ``sigma_x sigma_u``, with ``sigma_x = 2 sigma_u / |1/c_min - 1/c_max|``
        (Eq. 12 and 16): equal energies mean boundaries uniform in 1/c. For a given ``sigma_x`` of the worst
        case they lie at ``|c| = sigma_x / (2 sigma_u k)``, k = 1, 2, …; the outermost partitions reach to
        infinity and the innermost to the focal plane.

        Parameters
        ----------
        per_side : int
            Partitions on either side of the focal plane, >= 1. Boundaries that fall into one bin merge.
        sigma_u : float
            Standard deviation of the aperture in lens units.
        sigma_x : float
            Screen-space extent of the worst case's filter, in pixels.
        bin_size : float
            In pixels.

        Returns
        -------
        Partitions
        """
        outermost = sigma_x / (2 * sigma_u)
        boundaries = np.round(outermost / np.arange(1, per_side) / bin_size).astype(np.int64)
        boundaries = np.unique(np.concatenate([-boundaries, [0], boundaries]))
        bins = np.arange(boundaries[0] - 1, boundaries[-1] + 1)
        table = np.searchsorted(boundaries, bins, side="right").astype(np.uint8)
        return cls(bin_size, int(bins[0]), table)

    @property
    def count(self) -> int:
        """Number of partitions."""
        return int(self.table[-1]) + 1

    def of_slope(self, slope: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
        """Partition of each slope (float32, in pixels): an array of its shape, smaller numbers in front."""
        # In float32 as in the native kernel, so that both put a sample into the same partition.
        with np.errstate(over="ignore"):
            bins = np.floor(slope * np.float32(1 / self.bin_size))
        index = np.clip(bins - self.first_bin, 0, len(self.table) - 1).astype(np.int64)
        result: npt.NDArray[np.uint8] = self.table[index]
        return result


@dataclass(frozen=True)
class Layer:
    """Neighbouring partitions that are filtered as one, with what their samples really are.

    Parameters
    ----------
    first, last : int
        The partitions.
    c_min, c_max : float
        Smallest and largest slope in pixels.
    """

    first: int
    last: int
    c_min: float
    c_max: float


def active_layers(
    partition: npt.NDArray[np.uint8], slope: npt.NDArray[np.float32], max_layers: int | None
) -> list[Layer]:
    """Find the layers of a tile, front to back.

    Every partition that holds a sample is a layer. While there are more than `max_layers`, the two neighbours
    whose union costs least are joined: the one with the narrowest range of ``1 / c``, hence the filter of
    largest energy; joining across the focal plane costs most.

    Parameters
    ----------
    partition, slope : ndarray, (N,)
        Partition and slope of each sample.
    max_layers : int or None
        At least 1; no limit when None.

    Returns
    -------
    list of Layer
    """
    layers = []
    for index in np.unique(partition):
        members = slope[partition == index]
        layers.append(Layer(int(index), int(index), float(members.min()), float(members.max())))
    while max_layers is not None and len(layers) > max_layers:
        joined = [_join(front, back) for front, back in itertools.pairwise(layers)]
        best = _cheapest(joined)
        layers[best : best + 2] = [joined[best]]
    return layers


def _join(front: Layer, back: Layer) -> Layer:
    return Layer(front.first, back.last, front.c_min, back.c_max)


def _cheapest(layers: Sequence[Layer]) -> int:
    """Index of the layer with the most effective filter; the first of equals.

    Ranges on one side of the focal plane are compared by ``sigma_x`` (largest wins), written as the
    reciprocal so that a range that touches the focal plane is merely infinite. Ranges across it come after
    all others, the narrowest first.
    """
    costs = []
    for layer in layers:
        product, spread = layer.c_min * layer.c_max, layer.c_max - layer.c_min
        costs.append((0, spread / product) if product > 0 else (1, spread))
    return costs.index(min(costs))
