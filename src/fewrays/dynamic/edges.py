"""Antialiased edges: pixels that mix two surfaces, taken apart.

A renderer averages the colours of the surfaces that an edge's pixel shows, but gives one depth: that of the
front, that of the back, or a mean that belongs to neither. Warped as a whole, the pixel leaves a rim that is
as sharp as the wrong surface. With the colours F of the front and B of the back known from nearby, the
pixel's colour

    c = α F + (1 - α) B

tells how much of it the front covers: α is the projection of ``c - B`` on ``F - B``. The front keeps ``c -
(1 - α) B`` at its own slope, the back gets B at its own. Put together again without blur they give c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.fill import Background
from fewrays.dynamic.surfaces import front_slopes

__all__ = ["Split", "split_edges"]

Float32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]

_CONTRAST = 0.03  # of F and B relative to their size, below which a mixture cannot be told from either
_RESIDUAL = 0.4  # of the contrast, that a mixture may be off the line between F and B
_OPAQUE = 0.99  # opacity from which a background is one
_WHOLE = 0.06  # coverages so close to 0 or 1 are that


@dataclass(frozen=True, eq=False)
class Split:
    """An image whose mixed pixels have been, or may be, taken apart.

    Parameters
    ----------
    light : ndarray of float32, (H, W, 4)
        Of the surfaces in front, multiplied by coverage.
    coverage : ndarray of float32, (H, W)
        1 but for mixed pixels.
    slope : ndarray of float32, (H, W)
        In pixels.
    """

    light: Float32
    coverage: Float32
    slope: Float32


def split_edges(whole: Split, edge: Bool, back: Background, tolerance: float) -> Split:
    """Take the mixed pixels of an image apart.

    Parameters
    ----------
    whole : Split
        The image as it is.
    edge : ndarray of bool, (H, W)
        Opaque pixels beside another surface.
    back : Background
        What is behind the foremost surface near each pixel.
    tolerance : float
        Slopes that differ by no more are one surface.

    Returns
    -------
    Split
    """
    light, slope = whole.light, whole.slope
    nearest = front_slopes(slope)
    # An edge before nothing has its own alpha; what is not behind makes no mixture.
    apart = (back.slope - nearest > tolerance) & (back.light[..., 3] > _OPAQUE)
    row, column = np.nonzero(edge & back.known & apart)
    front_slope = nearest[row, column]
    own, own_slope = light[row, column].astype(np.float64), slope[row, column]
    behind, behind_slope = back.light[row, column].astype(np.float64), back.slope[row, column]
    front, has_front = _front_light(light, slope, edge, row, column, front_slope + tolerance)
    in_front = own_slope <= front_slope + tolerance
    by_depth = np.where(
        in_front, 1.0, np.clip((behind_slope - own_slope) / (behind_slope - front_slope), 0, 1)
    )
    by_depth[~in_front & (own_slope >= behind_slope - tolerance)] = 0

    contrast = front - behind
    size = np.square(contrast).sum(axis=-1)
    visible = size > (_CONTRAST**2) * (np.square(front) + np.square(behind)).sum(axis=-1)
    size[~visible] = 1
    by_color = ((own - behind) * contrast).sum(axis=-1) / size
    off_line = np.square(own - behind - by_color[:, None] * contrast).sum(axis=-1)
    trusted = has_front & visible & (off_line <= _RESIDUAL**2 * size)
    coverage = np.where(trusted, np.clip(by_color, 0, 1), by_depth)
    coverage[coverage < _WHOLE] = 0
    coverage[coverage > 1 - _WHOLE] = 1

    split = Split(light.copy(), whole.coverage.copy(), slope.copy())
    part = coverage > 0
    place = row[part], column[part]
    kept = np.maximum(own - (1 - coverage[:, None]) * behind, 0)[part]
    kept[:, 3] = np.minimum(kept[:, 3], coverage[part])
    split.light[place] = kept
    split.coverage[place] = coverage[part]
    split.slope[place] = np.where(in_front, own_slope, front_slope)[part]
    # What shows none of the front is wholly the back's, also where its depth is a mean.
    rest = ~part & (by_depth > 0)
    split.slope[row[rest], column[rest]] = behind_slope[rest]
    return split


def _front_light(
    light: Float32,
    slope: Float32,
    edge: Bool,
    row: npt.NDArray[np.intp],
    column: npt.NDArray[np.intp],
    nearest: Float32,
) -> tuple[npt.NDArray[np.float64], Bool]:
    """Mean light of the surface in front of edge pixels, from those within 2 pixels that are no edge."""
    height, width = slope.shape
    total, mean = np.zeros(len(row)), np.zeros((len(row), 4))
    for down in range(-2, 3):
        for right in range(-2, 3):
            i, j = row + down, column + right
            inside = (i >= 0) & (i < height) & (j >= 0) & (j < width)
            i, j = np.clip(i, 0, height - 1), np.clip(j, 0, width - 1)
            weight = (inside & ~edge[i, j] & (slope[i, j] <= nearest)) / (1.0 + down**2 + right**2)
            total += weight
            mean += weight[:, None] * light[i, j]
    found = total > 0
    return mean / np.where(found, total, 1)[:, None], found
