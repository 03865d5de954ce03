"""Which neighbouring pixels show one surface.

Two pixels are taken for one surface where their slopes differ by no more than a tolerance in pixels: that is
how far a view from the lens rim can pull them apart, so that what opens between them is no wider.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

__all__ = ["NEIGHBOURS", "edges_of_surfaces", "front_slopes", "neighbour_pairs", "slope_gradient"]

Float32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
Slices = tuple[slice, ...]

NEIGHBOURS = tuple(offset for offset in itertools.product((-1, 0, 1), repeat=2) if offset != (0, 0))
"""Row and column offsets of a pixel's eight neighbours."""


def neighbour_pairs(shape: tuple[int, ...], offset: tuple[int, ...]) -> tuple[Slices, Slices]:
    """Return slices of the pixels that have a neighbour at an offset, and of these neighbours."""
    pairs = [_pair(size, step) for size, step in zip(shape, offset, strict=True)]
    return tuple(here for here, _ in pairs), tuple(there for _, there in pairs)


def edges_of_surfaces(slope: Float32, tolerance: float) -> Bool:
    """Tell which pixels (H, W) have one among their eight neighbours that shows another surface."""
    edge = np.zeros(slope.shape, bool)
    for here, there in _half_of_pairs(slope.shape):
        apart = np.abs(slope[here] - slope[there]) > tolerance
        edge[here] |= apart
        edge[there] |= apart
    return edge


def front_slopes(slope: Float32) -> Float32:
    """Return the least slope of every pixel (H, W) and its eight neighbours."""
    least = slope.copy()
    for here, there in _half_of_pairs(slope.shape):
        least[here] = np.minimum(least[here], slope[there])
        least[there] = np.minimum(least[there], slope[here])
    return least


def slope_gradient(slope: Float32, tolerance: float, shown: Bool) -> Float32:
    """Return how fast the slope changes from pixel to pixel within a surface.

    Parameters
    ----------
    slope : ndarray of float32, (H, W)
        In pixels.
    tolerance : float
        Slopes of neighbours that differ by more belong to different surfaces.
    shown : ndarray of bool, (H, W)
        Pixels that hold a surface.

    Returns
    -------
    ndarray of float32, (H, W)
        Sum of the largest changes along x and along y, in pixels per pixel: from a lens point at the rim,
        the pixel looks up to that much wider than from the lens centre.
    """
    total = np.zeros(slope.shape, np.float32)
    for offset in ((0, 1), (1, 0)):
        here, there = neighbour_pairs(slope.shape, offset)
        change = np.abs(slope[here] - slope[there])
        change[(change > tolerance) | ~shown[here] | ~shown[there]] = 0
        steepest = np.zeros(slope.shape, np.float32)
        steepest[here] = change
        steepest[there] = np.maximum(steepest[there], change)
        total += steepest
    return total


def _half_of_pairs(shape: tuple[int, ...]) -> Iterator[tuple[Slices, Slices]]:
    """Every pair of neighbours once."""
    return (neighbour_pairs(shape, offset) for offset in NEIGHBOURS if offset > (0, 0))


def _pair(size: int, step: int) -> tuple[slice, slice]:
    """Slices along one axis of the elements with a neighbour `step` away, and of these."""
    if step >= 0:
        return slice(0, max(size - step, 0)), slice(min(step, size), size)
    return slice(min(-step, size), size), slice(0, max(size + step, 0))
