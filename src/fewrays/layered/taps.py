"""Taps of a Gaussian blur that has, discrete and cut off, exactly the variance asked for.

Sampling a Gaussian at bins and cutting it off changes its variance: by a lot where it is narrower than a bin,
and by some percent at any width because of the tails. Blurs here are meant to add up with the aperture's
other spreads, so the variance is what must be right. Of all kernels ``exp(-t d²)`` the one is taken whose
taps have that variance; Newton's method finds its t. Twin of ``native/math/blur_taps.h``.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

__all__ = ["TAPS_REACH", "gaussian_taps", "taps_radius"]

Float64 = npt.NDArray[np.float64]

TAPS_REACH = 3.0
"""Distance at which kernels are cut off, in standard deviations."""

_POINT_VARIANCE = 1e-9  # bins²; a kernel this narrow is a single tap
_NEWTON_STEPS = 12


def taps_radius(variance: float) -> int:
    """Return the distance in bins of the farthest tap of a kernel of that variance (bins²)."""
    return 0 if variance < _POINT_VARIANCE else math.ceil(TAPS_REACH * math.sqrt(variance))


def gaussian_taps(variance: float, radius: int) -> Float64:
    """Return the taps of a Gaussian of exactly that variance.

    Parameters
    ----------
    variance : float
        In bins², as wide as a box of the radius at most; beyond that the box is returned.
    radius : int
        Distance of the farthest tap in bins; 0 gives a single tap.

    Returns
    -------
    ndarray, (radius + 1,)
        Taps at distances 0, 1, …, radius. A kernel has each but the first twice, and then adds up to 1.
    """
    distance2 = np.arange(radius + 1, dtype=np.float64) ** 2
    twice = np.where(distance2 > 0, 2.0, 1.0)
    taps = np.exp(-_exponent_of_variance(variance, distance2, twice) * distance2)
    return np.asarray(taps / (taps * twice).sum())


def _exponent_of_variance(variance: float, distance2: Float64, twice: Float64) -> float:
    """Find t for which the taps exp(-t d²) have the given variance, by Newton's method on its reciprocal.

    With m₂ and m₄ the kernel's moments, dm₂/dt = m₂² - m₄, so the reciprocal of the variance grows at
    (m₄ - m₂²) / m₂². It is convex in t and almost a straight line: 2 t for wide kernels, and for narrow ones,
    which have three taps that matter, 1 + exp(t) / 2. One of the two inverted is a start close enough for
    Newton's method.
    """
    if variance >= float((twice * distance2).sum() / twice.sum()):
        return 0.0
    t = 1 / (2 * variance)
    if variance <= 0.5:
        t = min(t, math.log(2 / variance))
    for _ in range(_NEWTON_STEPS):
        taps = twice * np.exp(-t * distance2)
        total = taps.sum()
        second = float((taps * distance2).sum() / total)
        fourth = float((taps * distance2**2).sum() / total)
        slope = (fourth - second**2) / second**2
        t = max(t - (1 / second - 1 / variance) / slope, 0.0)
    return t
