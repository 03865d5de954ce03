"""Depth layers: thin slabs of slope, the bins that each is worth, and which slab a sample belongs to.

A layer's opacity and radiance are blurred with one width, that of its mean slope, so its slopes may differ by
no more than the blur can hide. What hides is the blur itself, of standard deviation ``|C| sigma`` (sigma:
that of the aperture), and near focus the pixel. Boundaries are therefore uniform in
``asinh(C sigma / scale)``: a constant step in slope near the focal plane, a constant ratio far from it, and
twice that ratio where the blur is wide. One layer is centred on the focal plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Slabs"]

_SCALE = 2.0  # pixels of blur where steps turn into ratios
_WIDE, _WIDE_STEP = 8.0, 2.0  # pixels of blur from which on ratios are larger, and how much
_COARSEST = 2**0.25  # side of the largest bins, in standard deviations of what blurs them
_FINE_BLUR = 0.8, 0.3  # pixels of blur below which bins are 1/2 and 1/4 of a pixel


@dataclass(frozen=True)
class Slabs:
    """The depth layers that a buffer's slopes fall into, front to back.

    Parameters
    ----------
    boundaries : ndarray of float32, (count - 1,)
        Slopes in pixels where one layer ends and the next begins, ascending.
    levels : ndarray of int32, (count,)
        Bins of ``2**level`` pixels. Below 0 a layer counts as near focus.
    reaches : ndarray of float32, (count,)
        Largest ``|C|`` that a sample of the layer may have, in pixels.
    """

    boundaries: npt.NDArray[np.float32]
    levels: npt.NDArray[np.int32]
    reaches: npt.NDArray[np.float32]

    @classmethod
    def covering(
        cls,
        c_min: float,
        c_max: float,
        *,
        spacing: float,
        sigma_pix: float,
        sigma_u: float,
        part_sigma: float,
    ) -> Slabs:
        """Lay out the layers that slopes from `c_min` to `c_max` need.

        Parameters
        ----------
        c_min, c_max : float
            Smallest and largest slope in pixels.
        spacing : float
            Of the boundaries, in ``asinh(C sigma_u / 2 px)``: far from focus, roughly the ratio of slopes;
            twice that beyond 8 px of blur.
        sigma_pix : float
            Standard deviation of the pixel filter in pixels.
        sigma_u : float
            Standard deviation of the aperture along one axis, in lens units.
        part_sigma : float
            The same of one part of the aperture; its blur decides how coarse bins may be.

        Returns
        -------
        Slabs
        """
        first, last = (round(_place(c * sigma_u) / spacing) for c in (c_min, c_max))
        steps = np.arange(first, last + 1)
        boundaries = (_blur((steps[:-1] + 0.5) * spacing) / sigma_u).astype(np.float32)
        ends = np.concatenate([[c_min], boundaries, [c_max]])
        reaches = np.maximum(np.abs(ends[:-1]), np.abs(ends[1:])).astype(np.float32)

        center = np.abs(_blur(steps * spacing) / sigma_u)
        blur = np.hypot(sigma_pix, center * part_sigma)
        levels = np.maximum(np.floor(np.log2(blur * _COARSEST)), 0).astype(np.int32)
        for level, limit in enumerate(_FINE_BLUR, start=1):
            levels[center * sigma_u < limit] = -level
        return cls(boundaries, levels, reaches)

    @property
    def count(self) -> int:
        """Number of layers."""
        return len(self.levels)

    def of_slope(self, slope: npt.NDArray[np.float32]) -> npt.NDArray[np.intp]:
        """Layer of each slope (float32, in pixels): an array of its shape, smaller numbers in front."""
        return np.searchsorted(self.boundaries, slope, side="right")


_WIDE_PLACE = math.asinh(_WIDE / _SCALE)


def _place(blur: float) -> float:
    """Where a blur (pixels, signed like the slope) lies on the axis along which boundaries are uniform."""
    place = math.asinh(abs(blur) / _SCALE)
    return math.copysign(min(place, _WIDE_PLACE + (place - _WIDE_PLACE) / _WIDE_STEP), blur)


def _blur(place: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Inverse of `_place`."""
    far = np.abs(place)
    far = np.maximum(far, _WIDE_PLACE + (far - _WIDE_PLACE) * _WIDE_STEP)
    blur: npt.NDArray[np.floating] = _SCALE * np.sinh(np.copysign(far, place))
    return blur
