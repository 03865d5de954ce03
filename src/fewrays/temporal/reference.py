"""The temporal method in plain NumPy, float64: the definition of what the native engines compute.

A pixel's radiance is the mean of the light field over the pixel filter, the lens and the shutter, and that is
the mean of its values at N locations (x, y, u, v, t) (Eq. 1)::

    L(pixel) = Σ P_j RECONSTRUCT(x_j, y_j, u_j, v_j, t_j) / Σ P_j

with weights P_j of the pixel filter. For each location RECONSTRUCT does four things:

1. See the samples from the lens point (u, v) at the time t (`reprojection`), and pick those near (x, y)
   (`_View.look`).
2. Tell them apart into surfaces, front to back (`surfaces.group_into_surfaces`).
3. Find out which of these covers the location (`surfaces.find_surface`).
4. Average its samples' radiance under a tent (`_View.radiance`).

The sums are kept apart by how blurred what a location sees is, for `refine`. The native engine does the same
for tiles of pixels; here one location comes after the other.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from fewrays.parallel import Execution, progress_bar
from fewrays.samples import SampleBuffer
from fewrays.temporal.plan import MOST_SAMPLES, Plan
from fewrays.temporal.reprojection import Paths, Sights
from fewrays.temporal.statistics import Statistics
from fewrays.temporal.surfaces import Surface, find_surface, tent_weights

__all__ = ["LEAST_WEIGHT", "reconstruct_tiles"]

Bands = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

LEAST_WEIGHT = 1e-6
"""Weight of a sample however far it is from its own lens point: where there are no others, it counts."""


def reconstruct_tiles(samples: SampleBuffer, plan: Plan, bands: Bands, execution: Execution) -> Statistics:
    """Add up what all pixels see, as `fewrays.temporal.kernel.reconstruct_tiles` does.

    Parameters
    ----------
    samples : SampleBuffer
    plan : Plan
        Its tiles are of no account here.
    bands : ndarray of float32, (H, W, bands, 4)
        The two sums of Eq. 1 are added to it, of radiance and of weights, over the locations that find a
        sample. Each location's go to the band of the blur that it sees.
    execution : Execution
        For its progress bar.

    Returns
    -------
    Statistics
        How the locations were resolved.
    """
    paths = Paths.of_samples(samples)
    color = samples.color.reshape(-1, 3).astype(np.float64)
    sums = np.zeros(bands.shape)
    tally: Counter[str] = Counter()
    where = plan.locations
    with progress_bar(where.count, "temporal", show=execution.progress, unit="view") as bar:
        for k in range(where.count):
            view = _View.of_samples(samples, paths, where.uv[k].astype(np.float64), float(where.t[k]))
            for row, column in np.ndindex(plan.height, plan.width):
                x, y = np.array([column + 0.5, row + 0.5]) + where.offset[k]
                surface = find_surface(partial(view.look, x, y), plan.rule, tally)
                if surface is not None:
                    band = np.searchsorted(plan.band_starts, abs(surface.slope), side="right") - 1
                    seen = np.append(view.radiance(surface, color), 1.0)
                    sums[row, column, band] += float(where.weight[k]) * seen
            bar.update()
    bands += sums.astype(np.float32)
    return Statistics(**tally)


@dataclass(frozen=True)
class _View:
    """All samples as seen from one lens point at one time.

    Parameters
    ----------
    sights : Sights
        In order of x.
    weight : ndarray, (H W S,), or None
        Of each sample in the buffer, by how far it is from its own lens point; None where all are matte.
    """

    sights: Sights
    weight: Float64 | None

    @classmethod
    def of_samples(cls, samples: SampleBuffer, paths: Paths, uv: Float64, time: float) -> _View:
        sights = paths.seen_from(float(uv[0]), float(uv[1]), time)
        sights = sights.take(np.argsort(sights.xy[:, 0]))
        return cls(sights, None if samples.bandwidth is None else _gloss_weights(samples, uv))

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

    def radiance(self, surface: Surface, color: Float64) -> Float64:
        """Average the radiance (3,) of a surface's samples under its tent."""
        sample = surface.sights.sample
        weights = tent_weights(surface.sights.xy, surface.tent)
        if self.weight is not None:
            weights = weights * self.weight[sample]
        mean: Float64 = weights @ color[sample] / weights.sum()
        return mean


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
