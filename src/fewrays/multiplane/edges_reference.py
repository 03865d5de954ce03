"""Rays gathered along edges, in plain NumPy: the definition of ``native/multiplane_edges.cpp``.

In focus nothing blurs what single cells have wrong, and at 4 samples per pixel a cell of a third of a pixel
has less than half a ray. But what is sharp is mostly an edge, and an edge changes little along its own
direction: there a cell may look for rays much farther than across it. Which way that is, the gradients around
it tell (their *structure tensor*, Foerstner and Guelch 1987), as in regression with steered kernels (Takeda
et al. 2007). Gradients are those of the estimate of cells twice as wide, which is there already.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

__all__ = ["gather_along_edges"]

Float64 = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Scalar = TypeVar("Scalar", bound=np.generic)

_UNSEEN_EDGE = 1e-3  # squares of gradients that count as no edge
_FARTHEST = 12.0  # cells
_DARKEST = 1e-20  # squares of radiance that count as none
_BINOMIAL: Float64 = np.array([1, 6, 15, 20, 15, 6, 1]) / 64


def gather_along_edges(sums: Float64, coarse: Float64, along: float) -> Float64:
    """Add to the sums of cells those of the cells along the edges that run through them.

    Parameters
    ----------
    sums : ndarray, (R, C, 5)
        Rays that hit each cell, their radiance, and all rays.
    coarse : ndarray, (R / 2, C / 2, 4)
        Opacity and radiance of cells twice as wide.
    along : float
        Rays to look for, to each side.

    Returns
    -------
    ndarray, (R, C, 5)
        Cells on a straight edge also count the k-th cell to each side along it, with the weight
        ``(1 - (d / reach)^2)^2`` at the distance d. They should have `along` rays to each side, and fewer
        where gradients differ in direction.
    """
    rows, columns = sums.shape[:2]
    rays = sums[..., 4].reshape(rows // 2, 2, columns // 2, 2).mean(axis=(1, 3))
    wide_slope, wide_fade, wide_steep = _ways(coarse, rays, along)
    slope, fade, steep = _by_four(wide_slope), _by_four(wide_fade), _by_four(wide_steep)
    steps = np.floor(1 / np.sqrt(fade)).astype(np.int64)
    row, column = np.indices((rows, columns))
    gathered = sums.copy()
    for step in range(1, int(steps.max(initial=0)) + 1):
        aside: Indices = np.floor(step * slope + 0.5).astype(np.int64)
        down, right = np.where(steep, step, aside), np.where(steep, aside, step)
        weight = np.where(step <= steps, (1 - step**2 * fade) ** 2, 0.0)[..., None]
        for sign in (-1, 1):
            there = np.clip(row + sign * down, 0, rows - 1), np.clip(column + sign * right, 0, columns - 1)
            gathered += weight * sums[there]
    return gathered


def _ways(coarse: Float64, rays: Float64, along: float) -> tuple[Float64, Float64, npt.NDArray[np.bool_]]:
    """Return which way edges run through cells, each (R, C).

    These are the cells that one step along an edge goes aside, the share of the squared reach that it covers,
    infinite without an edge, and whether steps go from row to row instead of from column to column.
    """
    opacity = coarse[..., 0]
    color = coarse[..., 1:].sum(axis=2)
    light = opacity * np.sign(color) * np.sqrt(np.abs(color))
    contrast = 1 / (_blurred(light**2) + _DARKEST)
    (opacity_x, opacity_y), (light_x, light_y) = _gradient(opacity), _gradient(light)
    xx, xy, yy = (
        _blurred(one) + contrast * _blurred(other)
        for one, other in (
            (opacity_x**2, light_x**2),
            (opacity_x * opacity_y, light_x * light_y),
            (opacity_y**2, light_y**2),
        )
    )
    oriented = np.hypot(xx - yy, 2 * xy)
    count = _blurred(rays)
    cells = np.divide(along, count, out=np.zeros_like(count), where=count > 0)
    reach = np.minimum(cells, _FARTHEST) * (oriented / (xx + yy + _UNSEEN_EDGE)) ** 2
    size = np.abs(xx - yy) + oriented
    slope = np.divide(-2 * xy, size, out=np.zeros_like(size), where=size > 0)
    fade = np.divide(1 + slope**2, reach**2, out=np.full_like(reach, np.inf), where=reach >= 1)
    return slope, fade, xx > yy


def _by_four(wide: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """Repeat each value of a map (R, C) for 2 x 2 cells."""
    return np.repeat(np.repeat(wide, 2, axis=0), 2, axis=1)


def _gradient(map_: Float64) -> tuple[Float64, Float64]:
    """Return the derivatives of a map by x and y, by Sobel's operator; beyond the border it is as on it."""
    padded = np.pad(map_, 1, "edge")
    smooth = [(a[:-2] + 2 * a[1:-1] + a[2:]) / 4 for a in (padded, padded.T)]
    across, down = (a[:, 2:] - a[:, :-2] for a in smooth)
    return across / 2, down.T / 2


def _blurred(map_: Float64) -> Float64:
    """Return means over 7 x 7 cells with binomial weights; beyond the border the map is as on it."""
    for _ in range(2):
        padded = np.pad(map_, ((0, 0), (3, 3)), "edge")
        map_ = np.lib.stride_tricks.sliding_window_view(padded, 7, axis=1) @ _BINOMIAL
        map_ = map_.T
    return map_
