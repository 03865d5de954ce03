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

__all__ = ["TAPS_REACH", "gaussian_taps", "tap_count"]

Float64 = npt.NDArray[np.float64]

TAPS_REACH = 3.0
"""Distance at which kernels are cut off, in standard deviations."""

_POINT_VARIANCE = 1e-9  # bins²; a kernel this close to the narrowest is the narrowest
_NEWTON_STEPS = 12


def tap_count(variance: float, first: float) -> int:
    """Return how many taps a kernel of that variance (bins²) has on each side.

    `first` is the distance of the nearest ones: 0 for a kernel around a bin, where the first tap is on both
    sides at once, 1/2 for one around the border of two.
    """
    if variance - first**2 < _POINT_VARIANCE:
        return 1
    return math.ceil(TAPS_REACH * math.sqrt(variance) - first) + 1


def gaussian_taps(variance: float, first: float, count: int) -> Float64:
    """Return the taps of a Gaussian of exactly that variance.

    Parameters
    ----------
    variance : float
        In bins²; at least ``first**2``, else the nearest taps are returned, and at most that of a box of
        `count` taps on each side, else the box is.
    first : float
        Distance of the nearest taps, 0 or 1/2 bin.
    count : int
        Taps on each side.

    Returns
    -------
    ndarray, (count,)
        Taps at the distances first, first + 1, …. A kernel has each twice, but that at 0, and then adds up
        to 1.
    """
    distance2 = (first + np.arange(count, dtype=np.float64)) ** 2
    twice = np.where(distance2 > 0, 2.0, 1.0)
    exponent = _exponent_of_variance(variance, distance2, twice) if count > 1 else 0.0
    taps = np.exp(-exponent * (distance2 - distance2[0]))
    return np.asarray(taps / (taps * twice).sum())


def _exponent_of_variance(variance: float, distance2: Float64, twice: Float64) -> float:
    """Find t for which the taps exp(-t d²) have the given variance, by Newton's method.

    Let e be d² less that of the nearest taps, and m its mean over the kernel. Then dm/dt is minus the
    variance of e, and 1 / m is convex in t: almost a straight line for wide kernels, and almost an
    exponential for narrow ones, in which only the nearest two distances matter. One of the two inverted is a
    start close enough.
    """
    excess, wanted = distance2 - distance2[0], variance - distance2[0]
    if wanted >= float((twice * excess).sum() / twice.sum()):
        return 0.0
    t = 1 / (2 * variance)
    if wanted <= 0.5:
        t = math.log(twice[1] / twice[0] * (excess[1] - wanted) / wanted) / excess[1]
    for _ in range(_NEWTON_STEPS):
        taps = twice * np.exp(-t * excess)
        total = taps.sum()
        mean = float((taps * excess).sum() / total)
        spread = float((taps * excess**2).sum() / total) - mean**2
        t = max(t - (1 / mean - 1 / wanted) * mean**2 / spread, 0.0)
    return t
