"""Where on the lens the views are: the cameras of the light field.

The paper draws them from a Halton sequence (section 4.2). A Vogel spiral spreads a known number of points
more evenly. Every view is weighted by cos⁴φ (Eq. 6), φ being the angle between its ray and the sensor's
normal: the ray's direction is ``(s, t, 1)`` with (s, t) in units of the distance from lens to sensor, so that
``cos⁴φ = 1 / (s² + t² + 1)²``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fewrays.aperture import Aperture

__all__ = ["LensPoints", "Views", "cosine_falloff", "halton_points"]

Float64 = npt.NDArray[np.float64]
LensPoints = Literal["vogel", "halton"]

_BATCH = 4096  # points of the square that are tried at once


@dataclass(frozen=True)
class Views:
    """The views of a light field.

    Parameters
    ----------
    uv : ndarray, (N, 2)
        Lens positions.
    weight : ndarray, (N,)
        What each view counts in the mean; > 0.
    radius : float
        Radius in lens units of the disc whose area is one view's share of the aperture.
    """

    uv: Float64
    weight: Float64
    radius: float

    @classmethod
    def of_aperture(
        cls, aperture: Aperture, count: int, points: LensPoints, falloff_f_number: float = math.inf
    ) -> Views:
        """Spread views over an aperture.

        Parameters
        ----------
        aperture : Aperture
        count : int
            Number of views, 1 to `fewrays.aperture.MAX_POINTS`.
        points : {"vogel", "halton"}
            Which sequence their positions come from.
        falloff_f_number : float
            Focal length over aperture diameter, for cos⁴φ; infinite for equal weights.

        Returns
        -------
        Views
        """
        if points == "halton":
            uv = halton_points(aperture, count)
            weight = aperture.density(uv)
        else:
            uv = aperture.points(count)
            weight = np.ones(count)
        if count == 1:
            uv = np.zeros((1, 2))  # the lens centre stands for the whole lens
        weight = weight * cosine_falloff(uv, falloff_f_number)
        return cls(uv, weight / weight.max(), math.sqrt(aperture.area / (math.pi * count)))


def cosine_falloff(uv: Float64, f_number: float) -> Float64:
    """Return cos⁴φ of rays from lens positions (N, 2) at an f-number: the rim is at ``1 / (2 f_number)``."""
    tangent2 = np.square(uv).sum(axis=-1) / (2 * f_number) ** 2
    falloff: Float64 = (1 + tangent2) ** -2.0
    return falloff


def halton_points(aperture: Aperture, count: int) -> Float64:
    """Return the first points of the Halton sequence (bases 2, 3) over ``[-1, 1]²`` that pass an aperture.

    Parameters
    ----------
    aperture : Aperture
    count : int

    Returns
    -------
    ndarray, (count, 2)
        Uniform over the area that lets light pass: weigh them by the density.
    """
    found: list[Float64] = []
    first = 1  # number 0 is the corner
    while sum(map(len, found)) < count:
        numbers = np.arange(first, first + _BATCH)
        square = 2 * np.stack([_radical_inverse(numbers, base) for base in (2, 3)], axis=-1) - 1
        found.append(square[aperture.contains(square)])
        first += _BATCH
    return np.concatenate(found)[:count]


def _radical_inverse(numbers: npt.NDArray[np.int64], base: int) -> Float64:
    """Mirror the digits of whole numbers at the point: the van der Corput sequence."""
    value, scale = np.zeros(len(numbers)), 1.0
    rest = numbers
    while rest.any():
        scale /= base
        rest, digit = np.divmod(rest, base)
        value += scale * digit
    return value
