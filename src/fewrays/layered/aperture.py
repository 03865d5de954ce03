"""The aperture in parts, each a narrower Gaussian.

The paper averages opacity over the whole lens before it composites the layers (Eq. 34), which loses all
knowledge of *where* on the lens a layer covers another. Over a part of the lens less is lost. A Gaussian
aperture is split into narrower ones, all alike, whose centres lie on a hexagonal lattice: the densest there
is, and the one whose sum looks least like a lattice. Their weights fall off like a Gaussian, so that the sum
comes close to the aperture again, within 7 % of its peak, and exactly in its variance.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens

__all__ = ["ApertureParts", "aperture_variance"]

_SPACING = 2.3  # of neighbouring parts, in standard deviations of a part
_SPREAD = {1: 1.0, 7: 2.3, 13: 3.0, 19: 3.8}
"""Variance of the Gaussian that weighs the parts, in variances of a part, by the number of parts: that with
which the sum of all parts comes closest to a Gaussian, by the largest difference."""


@dataclass(frozen=True)
class ApertureParts:
    """Parts of an aperture: Gaussians that add up to one, on a hexagonal lattice around its centre.

    Parameters
    ----------
    parts : ndarray of float32, (count, 3)
        Centre (u, v) in lens units and weight; the weights add up to 1.
    sigma : float
        Standard deviation of a part along one axis, in lens units.
    central_weight : float
        Weight of the parts whose centre is at 0 along one axis, the mean of both axes.
    """

    parts: npt.NDArray[np.float32]
    sigma: float
    central_weight: float

    COUNTS: ClassVar[tuple[int, ...]] = tuple(_SPREAD)
    """How many parts there can be: one, and one, two or three rings of six around it."""

    @classmethod
    def split(cls, variance: float, count: int) -> ApertureParts:
        """Split a Gaussian aperture of the given variance (lens units²) into one of `COUNTS` parts."""
        centers = _hexagonal_lattice(count) * _SPACING  # for parts of variance 1
        weights = np.exp(-(centers**2).sum(axis=1) / (2 * _SPREAD[count]))
        weights /= weights.sum()
        sigma = math.sqrt(variance / (1 + 0.5 * (weights[:, None] * centers**2).sum()))
        central_weight = float((weights[:, None] * (centers == 0)).sum() / 2)
        return cls(np.column_stack([sigma * centers, weights]).astype(np.float32), sigma, central_weight)


def _hexagonal_lattice(count: int) -> npt.NDArray[np.float64]:
    """Return the points (count, 2) of a hexagonal lattice of spacing 1 that are closest to its centre, 0."""
    reach = range(-3, 4)
    # In units of half a spacing along u, and of half a spacing times √3 along v, points are whole numbers.
    points = np.array([(2 * i + j, j) for i, j in itertools.product(reach, reach)])
    distance2 = (points**2 * (1, 3)).sum(axis=1)
    nearest = np.argsort(distance2, kind="stable")[:count]
    return points[nearest] * (0.5, 0.5 * math.sqrt(3))


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
