"""Synthesis: rays of the light field are queried and blended (section 4.1).

A view's ray at pixel q that sees slope C began at ``q - C (u, v)`` in the image of the lens centre. There
its light is looked up between pixels, of which only those that show the same surface count; beyond the
image's border, its mirror image goes on. What lies in front without covering its pixel is composited over
what is behind. A ray whose pixels have nothing to show is left out; one of which a share is known counts by
that share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.sheet import Sheet

__all__ = ["composite", "look_up"]

Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]


def look_up(
    sheet: Sheet, number: Int64, cell: Int64, u: float, v: float, tolerance: float
) -> tuple[Float64, Float64]:
    """Interpolate the light that a view's rays carry.

    Parameters
    ----------
    sheet : Sheet
    number : ndarray of int64, (M,)
        Pixel of the sheet that each ray sees: row times width plus column.
    cell : ndarray of int64, (M,)
        Pixel of the view, alike.
    u, v : float
        Lens point.
    tolerance : float
        Slopes in pixels up to which pixels belong to the ray's surface.

    Returns
    -------
    light : ndarray of float64, (M, 4)
        Radiance and opacity, multiplied by coverage.
    coverage : ndarray of float64, (M,)
    """
    height, width = sheet.slope.shape
    slopes, light, coverage = sheet.slope.ravel(), sheet.light.reshape(-1, 4), sheet.coverage.ravel()
    slope = slopes[number].astype(float)
    row, column = np.divmod(cell, width)
    x, y = column - slope * u, row - slope * v
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    total, mean, covered = np.zeros(len(number)), np.zeros((len(number), 4)), np.zeros(len(number))
    for i, row_weight in ((top, top + 1 - y), (top + 1, y - top)):
        for j, column_weight in ((left, left + 1 - x), (left + 1, x - left)):
            tap = _mirrored(i, height) * width + _mirrored(j, width)
            same = (np.abs(slopes[tap] - slope) <= tolerance) & (coverage[tap] > 0)
            weight = np.where(same, row_weight * column_weight, 0.0)
            total += weight
            mean += weight[:, None] * light[tap]
            covered += weight * coverage[tap]
    alone = total <= 0
    total[alone] = 1
    mean[alone], covered[alone] = light[number[alone]], coverage[number[alone]]
    return mean / total[:, None], covered / total


def _mirrored(pixel: Int64, size: int) -> Int64:
    """Return the pixel that stands for one beyond the image: its mirror image about the outermost one."""
    inward = np.where(pixel < 0, -pixel, np.where(pixel >= size, 2 * (size - 1) - pixel, pixel))
    return np.clip(inward, 0, size - 1)


def composite(layers: Sequence[tuple[Float64, Float64, Float64]]) -> tuple[Float64, Float64]:
    """Put what a view's pixels see one over the other, front to back.

    Parameters
    ----------
    layers : sequence of (light (H, W, 4), coverage (H, W), order (H, W))
        Light multiplied by coverage; order is infinite where a layer has nothing.

    Returns
    -------
    light : ndarray of float64, (H, W, 4)
    coverage : ndarray of float64, (H, W)
    """
    by_order = np.argsort(np.stack([order for _, _, order in layers]), axis=0, kind="stable")
    lights = np.take_along_axis(np.stack([light for light, _, _ in layers]), by_order[..., None], axis=0)
    coverages = np.take_along_axis(np.stack([coverage for _, coverage, _ in layers]), by_order, axis=0)
    total, remaining = np.zeros(lights.shape[1:]), np.ones(coverages.shape[1:])
    for light, coverage in zip(lights, coverages, strict=True):
        total += remaining[..., None] * light
        remaining *= 1 - coverage
    return total, 1 - remaining
