"""The aperture in parts, each a narrower Gaussian.

The paper averages opacity over the whole lens before it composites the layers (Eq. 34), which loses all
knowledge of *where* on the lens a layer covers another. Over a part of the lens less is lost. A Gaussian
aperture of standard deviation s is split, along each axis, into n Gaussians of standard deviation r s with
binomial weights, spaced by 2 r s so that their sum comes close to the Gaussian again (within 7 % of its
peak for n = 3); the spacing's variance and r² add up to 1:

    r² = 1 / n.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens

__all__ = ["ApertureParts", "aperture_variance"]

_SPACING = 2.0  # of the parts, in standard deviations of a part


@dataclass(frozen=True)
class ApertureParts:
    """Parts of an aperture.

    Parameters
    ----------
    parts : ndarray of float32, (n * n, 3)
        Centre (u, v) in lens units and weight; the weights add up to 1.
    sigma : float
        Standard deviation of a part along one axis, in lens units.
    central_weight : float
        Weight, along one axis, of parts whose centre is at 0.
    """

    parts: npt.NDArray[np.float32]
    sigma: float
    central_weight: float

    @classmethod
    def split(cls, variance: float, per_axis: int) -> ApertureParts:
        """Split a Gaussian aperture of the given variance (lens units²) into ``per_axis²`` parts."""
        sigma = math.sqrt(variance / (1 + 0.25 * _SPACING**2 * (per_axis - 1)))
        offsets = _SPACING * sigma * (np.arange(per_axis) - (per_axis - 1) / 2)
        weights = np.array([math.comb(per_axis - 1, i) for i in range(per_axis)]) / 2.0 ** (per_axis - 1)
        axis = list(zip(offsets, weights, strict=True))
        parts = np.array([(u, v, p * q) for (v, q), (u, p) in itertools.product(axis, axis)], np.float32)
        return cls(parts, sigma, float(weights[per_axis // 2]) if per_axis % 2 else 0.0)


def aperture_variance(lens: Lens) -> float:
    """Second moment of a lens's aperture along one axis, in lens units².

    A disc is replaced by the Gaussian of the same moment. A Gaussian aperture ends where lens samples do, at
    the square ``[-1, 1]²``.
    """
    sigma = lens.gaussian_sigma
    if lens.aperture != "gaussian":
        return sigma**2
    edge = math.sqrt(2 / math.pi) / sigma * math.exp(-0.5 / sigma**2) / math.erf(1 / (sigma * math.sqrt(2)))
    return sigma**2 * (1 - edge)
