"""What lies behind the edges of an image: surfaces carried on underneath those in front of them.

From a lens point (u, v), a surface of slope ``C_b`` behind one of slope ``C_f`` shows up to ``C_b - C_f``
pixels of what the lens centre does not see. There a pinhole image has no data; the paper leaves these rays
out (section 3.2), which fails for a blurred foreground before a sharp background (Figure 7b). Here the
surface behind is carried on: from every pixel that may be uncovered, eight directions are searched for the
first pixel behind it, and what they find of one surface is averaged, the nearer the more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.surfaces import NEIGHBOURS
from fewrays.parallel import Execution

__all__ = [
    "AGREEMENT",
    "MIXED_WIDTH",
    "Background",
    "carry_on",
    "find_behind",
    "guess_background",
]

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]
Bool = npt.NDArray[np.bool_]

MIXED_WIDTH = 3
"""Pixels of an edge: one that mixes two surfaces, with a depth between, and one beside it."""

AGREEMENT = 4.0
"""Tolerances of slope that finds in different directions may differ by and be averaged."""


@dataclass(frozen=True, eq=False)
class Background:
    """What is believed to be behind the pixels of an image.

    Parameters
    ----------
    light : ndarray of float32, (H, W, 4)
        Radiance and opacity.
    slope : ndarray of float32, (H, W)
        In pixels; more than the image's own.
    known : ndarray of bool, (H, W)
        Where there is anything near that it can be guessed from.
    """

    light: Float32
    slope: Float32
    known: Bool


def guess_background(
    light: Float32,
    slope: Float32,
    front: Float32,
    edge: Bool,
    needed: Bool,
    tolerance: float,
    reach: int,
    execution: Execution,
) -> Background:
    """Guess what is behind every pixel of an image, as `fewrays.dynamic.kernel.guess_background` does.

    Parameters
    ----------
    light : ndarray of float32, (H, W, 4)
        Radiance and opacity of the image.
    slope, front, edge, needed, tolerance, reach
        As in `find_behind`.
    execution : Execution
        Of no account here.

    Returns
    -------
    Background
    """
    del execution
    return carry_on(light, slope, edge, find_behind(slope, front, edge, needed, tolerance, reach), tolerance)


def find_behind(
    slope: Float32, front: Float32, edge: Bool, needed: Bool, tolerance: float, reach: int
) -> Int32:
    """Search the eight directions for surfaces behind each pixel.

    Parameters
    ----------
    slope : ndarray of float32, (H, W)
        Slopes of the image in pixels.
    front : ndarray of float32, (H, W)
        Slope of the surface that covers each pixel.
    edge : ndarray of bool, (H, W)
        Pixels that may show a mixture of surfaces. The first within `MIXED_WIDTH` that is none is taken
        instead, if all up to it are behind.
    needed : ndarray of bool, (H, W)
        Pixels to search from.
    tolerance : float
        In pixels: a surface is behind where its slope is greater by more.
    reach : int
        Pixels to search.

    Returns
    -------
    ndarray of int32, (8, H, W)
        For each of `NEIGHBOURS`, the distance in steps to the pixel found; 0 where there is none. A surface
        is found only from as far as a view from the lens rim can uncover it.
    """
    height, width = slope.shape
    steps = np.zeros((len(NEIGHBOURS), height, width), np.int32)
    for found, (down, right) in zip(steps.reshape(len(NEIGHBOURS), -1), NEIGHBOURS, strict=True):
        length = np.hypot(down, right)
        looking = np.flatnonzero(needed)
        for step in range(1, reach + 1):
            row, column = looking // width + step * down, looking % width + step * right
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            # Not even the farthest surface could show from here on.
            inside &= step * length <= slope.max() - front.flat[looking] + 1
            looking, row, column = looking[inside], row[inside], column[inside]
            if looking.size == 0:
                break
            gap = slope[row, column] - front.flat[looking]
            hit = (gap > tolerance) & (step * length <= gap + 1)
            chosen = looking[hit]
            found[chosen] = _purest(slope, front, edge, tolerance, chosen, step, (down, right))
            looking = looking[~hit]
    return steps


def _purest(
    slope: Float32,
    front: Float32,
    edge: Bool,
    tolerance: float,
    pixel: npt.NDArray[np.intp],
    step: int,
    direction: tuple[int, int],
) -> Int32:
    """Return how many steps to go for the first that is no edge, of `MIXED_WIDTH` pixels that are behind."""
    height, width = slope.shape
    best = np.full(len(pixel), step, np.int32)
    going = np.ones(len(pixel), bool)
    for further in range(step, step + MIXED_WIDTH):
        row, column = pixel // width + further * direction[0], pixel % width + further * direction[1]
        going &= (row >= 0) & (row < height) & (column >= 0) & (column < width)
        i, j = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
        going &= slope[i, j] - front.flat[pixel] > tolerance
        best[going & ~edge[i, j]] = further
        going &= edge[i, j]
    return best


def carry_on(light: Float32, slope: Float32, edge: Bool, steps: Int32, tolerance: float) -> Background:
    """Average what the eight directions found.

    The median of their slopes, of two in the middle the farther, decides which surface is carried on; finds
    count where they belong to it, by the inverse square of their distance.

    Parameters
    ----------
    light : ndarray of float32, (H, W, 4)
        Radiance and opacity of the image.
    slope : ndarray of float32, (H, W)
    edge : ndarray of bool, (H, W)
        As in `find_behind`.
    steps : ndarray of int32, (8, H, W)
        Of `find_behind`.
    tolerance : float
        In pixels of slope: `AGREEMENT` times as much may finds that are averaged differ.

    Returns
    -------
    Background
    """
    shape = slope.shape
    rows, columns = np.arange(shape[0])[:, None], np.arange(shape[1])
    offsets = np.array(NEIGHBOURS)
    length = np.hypot(*offsets.T)[:, None, None]
    from_row = np.clip(rows + steps * offsets[:, :1, None], 0, shape[0] - 1)
    from_column = np.clip(columns + steps * offsets[:, 1:, None], 0, shape[1] - 1)
    found = slope[from_row, from_column]
    # A mixture counts for nothing where what is none is hardly farther away.
    nearest = np.where(steps > 0, steps, np.iinfo(np.int32).max - MIXED_WIDTH).min(axis=0)
    pure = (steps > 0) & ~edge[from_row, from_column]
    counts = np.where((pure & (steps <= nearest + MIXED_WIDTH)).any(axis=0), pure, steps > 0)
    ascending = np.sort(np.where(counts, found, np.inf), axis=0)
    middle = np.count_nonzero(counts, axis=0) // 2
    anchor = np.take_along_axis(ascending, np.minimum(middle, len(offsets) - 1)[None], axis=0)[0]
    total, mean, mean_slope = np.zeros(shape), np.zeros((*shape, 4)), np.zeros(shape)
    for i in range(len(offsets)):
        agrees = counts[i] & (np.abs(found[i] - anchor) <= AGREEMENT * tolerance)
        weight = np.where(agrees, 1 / (np.maximum(steps[i], 1) * length[i]) ** 2, 0.0)
        total += weight
        mean += weight[..., None] * light[from_row[i], from_column[i]]
        mean_slope += weight * found[i]
    known = total > 0
    total[~known] = 1
    return Background(
        (mean / total[..., None]).astype(np.float32), (mean_slope / total).astype(np.float32), known
    )
