"""A light field as seen from one lens point at one time, for the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.samples import SampleBuffer
from fewrays.temporal.plan import MOST_SAMPLES
from fewrays.temporal.reprojection import Paths, Sights
from fewrays.temporal.surfaces import Surface, tent_weights

__all__ = ["LEAST_WEIGHT", "View", "ViewedField"]

Float64 = npt.NDArray[np.float64]

LEAST_WEIGHT = 1e-6
"""Weight of a sample however far it is from its own lens point: where there are no others, it counts."""


class ViewedField:
    """Samples, to be seen from any lens point at any time.

    Parameters
    ----------
    samples : SampleBuffer
    """

    def __init__(self, samples: SampleBuffer) -> None:
        self.samples = samples
        self.paths = Paths.of_samples(samples)
        self.color = samples.color.reshape(-1, 3).astype(np.float64)

    def view(self, uv: npt.ArrayLike, time: float) -> View:
        """See the samples from a lens point ``(2,)`` at a time."""
        uv = np.asarray(uv, np.float64)
        sights = self.paths.seen_from(float(uv[0]), float(uv[1]), time)
        sights = sights.take(np.argsort(sights.xy[:, 0]))
        weight = None if self.samples.bandwidth is None else _gloss_weights(self.samples, uv)
        return View(sights, self.color, weight, uv, time)


@dataclass(frozen=True)
class View:
    """All samples as seen from one lens point at one time.

    Parameters
    ----------
    sights : Sights
        In order of x.
    color : ndarray, (N, 3)
        Radiance of each sample.
    weight : ndarray, (N,), or None
        Of each sample in the buffer, by how far it is from its own lens point; None where all are matte.
    uv : ndarray, (2,)
        The lens point.
    time : float
    """

    sights: Sights
    color: Float64
    weight: Float64 | None
    uv: Float64
    time: float

    def look(self, x: float, y: float, radius: float) -> Sights:
        """Find the samples within a radius of a place; their positions become relative to it.

        Where very many crowd, as on what recedes fast, the nearest say enough.
        """
        first, end = np.searchsorted(self.sights.xy[:, 0], [x - radius, x + radius])
        beside = self.sights.take(slice(first, end)).relative_to(x, y)
        beside = beside.take(np.square(beside.xy).sum(axis=-1) <= radius**2)
        if beside.count <= MOST_SAMPLES:
            return beside
        x_away, y_away = beside.xy.T
        return beside.take(np.lexsort([y_away, x_away, x_away**2 + y_away**2])[:MOST_SAMPLES])

    def shares(self, surface: Surface) -> Float64:
        """Return how much each of a surface's samples ``(n,)`` counts; they sum to 1."""
        weights = tent_weights(surface.sights.xy, surface.tent)
        if self.weight is not None:
            weights = weights * self.weight[surface.sights.sample]
        return np.asarray(weights / weights.sum())

    def radiance(self, surface: Surface) -> Float64:
        """Average the radiance (3,) of a surface's samples under its tent."""
        return np.asarray(self.shares(surface) @ self.color[surface.sights.sample])


def _gloss_weights(samples: SampleBuffer, uv: Float64) -> Float64:
    """How much each sample of the buffer counts from a lens point: section 6, Figure 14.

    A glossy surface's radiance holds around the lens point that it was traced through, over a Gaussian of the
    sample's bandwidth.
    """
    assert samples.bandwidth is not None
    away2 = np.square(samples.uv.reshape(-1, 2) - uv).sum(axis=-1)
    with np.errstate(over="ignore"):
        exponent = -0.5 * away2 / np.square(samples.bandwidth.astype(np.float64)).ravel()
    weights: Float64 = np.maximum(np.exp(exponent), LEAST_WEIGHT)
    return weights
