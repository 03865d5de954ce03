"""Blur that stands for the light between the views, within surfaces.

Few views sample a wide circle of confusion sparsely: the paper looks rays up in a mip pyramid (`mipmap`).
That mixes what is in front with what is behind, and its grid shows in the shape of small lights. Here every
pixel is blurred by a round kernel of its own width instead: binomial kernels of growing width are applied one
after the other, the narrow ones first, each along x and along y (the "algorithme à trous" [1]_). Only pixels
of one surface are averaged, as in [2]_: a kernel is cut off where the slope jumps. A pixel's light is taken
between the two levels whose variances enclose the one that it needs. Light is neither lost nor made where
the slope is the same all around.

References
----------
.. [1] M. Holschneider, R. Kronland-Martinet, J. Morlet, P. Tchamitchian. "A real-time algorithm for signal
   analysis with the help of the wavelet transform". Wavelets, Springer, 1990.
.. [2] H. Dammertz, D. Sewtz, J. Hanika, H. P. A. Lensch. "Edge-avoiding À-Trous wavelet transform for fast
   global illumination filtering". High Performance Graphics 2010.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.sheet import Sheet

__all__ = ["Blur", "level_count", "prefilter"]

Float32 = npt.NDArray[np.float32]

_MAX_LEVELS = 24
_KERNEL = (0.25, 0.5, 0.25)


@dataclass(frozen=True)
class Blur:
    """How wide a sheet is blurred, and what keeps its surfaces apart.

    Parameters
    ----------
    radius : float
        Standard deviation of the blur, in units of the slope.
    tolerance : float
        Slopes in pixels that neighbours of one surface may differ by.
    relative : float
        Share of its slope by which a surface may differ farther away, where it may be slanted.
    """

    radius: float
    tolerance: float
    relative: float = 0.25

    def variance(self, slope: Float32) -> Float32:
        """Return the variance in pixels² that slopes ask for."""
        variance: Float32 = np.square(np.float32(self.radius) * slope)
        return variance


def level_count(slope: npt.ArrayLike, blur: Blur) -> int:
    """Return how many kernels the widest blur of some slopes needs."""
    widest = float(blur.variance(np.abs(np.asarray(slope, np.float32)).max()))
    return next((level for level in range(_MAX_LEVELS) if widest <= _variance(level)), _MAX_LEVELS)


def prefilter(sheet: Sheet, blur: Blur) -> Sheet:
    """Blur a sheet's light.

    Parameters
    ----------
    sheet : Sheet
    blur : Blur

    Returns
    -------
    Sheet
        The same with other light. Its coverage is not blurred: silhouettes are for the views to blur.
    """
    wanted = blur.variance(sheet.slope)
    values = np.concatenate([sheet.light, sheet.coverage[..., None]], axis=-1)
    result = values
    for level in range(level_count(sheet.slope, blur)):
        narrow, wide = _variance(level), _variance(level + 1)
        # A pixel's neighbours on the same surface may need a level that it does not.
        needed = (wanted > np.float32(0.5 * narrow))[..., None]
        before = values
        for axis in (1, 0):
            values = np.where(needed, _smooth(values, sheet.slope, blur, level, axis), values)
        share = np.clip((wanted - narrow) / (wide - narrow), 0, 1)[..., None].astype(np.float32)
        result = np.where(share > 0, (1 - share) * before + share * values, result)
    covered = result[..., 4:]
    mean = result[..., :4] / np.where(covered > 0, covered, 1)
    light = np.where((wanted > 0)[..., None], mean * sheet.coverage[..., None], sheet.light)
    return replace(sheet, light=light)


def _variance(level: int) -> float:
    """Variance in pixels² of the kernels of the first levels together."""
    power = 4.0 ** (level // 2)
    return (power - 1) / 3 + (power / 2 if level % 2 else 0)


def _smooth(values: Float32, slope: Float32, blur: Blur, level: int, axis: int) -> Float32:
    """Average along an axis within surfaces; two kernels of one width follow each other."""
    step = 2 ** (level // 2)
    slanted = np.minimum(blur.tolerance * step, np.abs(slope) * np.float32(blur.relative))
    allowed = np.maximum(slanted, np.float32(blur.tolerance))
    size = slope.shape[axis]
    total, mean = np.zeros(slope.shape, np.float32), np.zeros(values.shape, np.float32)
    for tap, factor in enumerate(_KERNEL):
        place = np.arange(size) + (tap - 1) * step
        inside = np.expand_dims((place >= 0) & (place < size), 1 - axis)
        place = np.clip(place, 0, size - 1)
        same = inside & (np.abs(slope.take(place, axis=axis) - slope) <= allowed)
        weight = np.where(same, np.float32(factor), np.float32(0))
        total += weight
        mean += weight[..., None] * values.take(place, axis=axis)
    return mean / total[..., None]
