"""The paper's blur between the views: a Gaussian mip pyramid (section 4.2).

With N views, the disc whose area is a view's share of the aperture is ``2 |C| / √N`` pixels across, and its
logarithm to base 2 is the mip level (Eq. 8, with the aperture's diameter over N views taken along one axis).
A single view has the whole circle of confusion, which is the blur in image space that the paper's Figure 9
shows for it. Levels are made with 3x3 kernels and looked up trilinearly. The level depends on a pixel's
slope alone, so that this is done once per pixel, not once per ray.

A pyramid knows no surfaces: it mixes what is in front with what is behind (see `prefilter`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.sheet import Sheet

__all__ = ["MAX_LEVELS", "mip_level", "mipmap"]

Float32 = npt.NDArray[np.float32]

MAX_LEVELS = 12
"""Mip levels at most: the coarsest has one texel for 4096 pixels."""

_TAPS = ((-1, 0.25), (0, 0.5), (1, 0.25))  # of the 3x3 kernel, along one axis


def mip_level(slope: npt.ArrayLike, view_radius: float) -> Float32:
    """Return the mip level of Eq. 8 for slopes in pixels, 0 to `MAX_LEVELS`.

    Parameters
    ----------
    slope : array_like
        In pixels.
    view_radius : float
        Radius in lens units of the part of the aperture that one view stands for.
    """
    footprint = np.abs(np.asarray(slope, np.float32)) * np.float32(2 * view_radius)
    level: Float32 = np.log2(np.clip(footprint, 1, 2**MAX_LEVELS))
    return level


def mipmap(sheet: Sheet, view_radius: float) -> Sheet:
    """Look every pixel up at its mip level.

    Parameters
    ----------
    sheet : Sheet
    view_radius : float
        As in `mip_level`.

    Returns
    -------
    Sheet
        The same with other light. Its coverage is not blurred: silhouettes are for the views to blur.
    """
    level = mip_level(sheet.slope, view_radius)
    texels = np.concatenate([sheet.light, sheet.coverage[..., None]], axis=-1)
    fine, result = texels, texels.copy()
    for coarse in range(1, math.ceil(float(level.max())) + 1):
        texels = _halve(texels)
        blurry = _look_up(texels, sheet.slope.shape, coarse)
        share = np.clip(level - (coarse - 1), 0, 1)[..., None]
        result = np.where(share > 0, fine + share * (blurry - fine), result)
        fine = blurry
    covered = result[..., 4:]
    mean = result[..., :4] / np.where(covered > 0, covered, 1)
    light = np.where(level[..., None] > 0, mean * sheet.coverage[..., None], sheet.light)
    return replace(sheet, light=light)


def _halve(texels: Float32) -> Float32:
    """Make the next coarser level: every other texel, averaged with its eight neighbours."""
    height, width, values = texels.shape
    rows, columns = np.arange(0, height, 2), np.arange(0, width, 2)
    total = np.zeros((len(rows), len(columns), 1), np.float32)
    mean = np.zeros((len(rows), len(columns), values), np.float32)
    for down, row_weight in _TAPS:
        for right, column_weight in _TAPS:
            i, j = rows + down, columns + right
            inside = ((i >= 0) & (i < height))[:, None] & ((j >= 0) & (j < width))
            weight = np.where(inside, np.float32(row_weight * column_weight), np.float32(0))[..., None]
            total += weight
            mean += weight * texels[np.ix_(np.clip(i, 0, height - 1), np.clip(j, 0, width - 1))]
    return mean / total


def _look_up(texels: Float32, shape: tuple[int, int], level: int) -> Float32:
    """Interpolate a level bilinearly at every pixel of the image, (H, W, 5)."""
    rows, columns, values = texels.shape
    y, x = (np.arange(n, dtype=np.float32) / 2**level for n in shape)
    top, left = y.astype(int), x.astype(int)
    total, mean = np.zeros((*shape, 1), np.float32), np.zeros((*shape, values), np.float32)
    for i, row_weight in ((top, 1 - (y - top)), (top + 1, y - top)):
        for j, column_weight in ((left, 1 - (x - left)), (left + 1, x - left)):
            inside = (i < rows)[:, None] & (j < columns)
            weight = np.where(inside, row_weight[:, None] * column_weight, np.float32(0))[..., None]
            total += weight
            mean += weight * texels[np.ix_(np.minimum(i, rows - 1), np.minimum(j, columns - 1))]
    return mean / total
