"""The temporal method in plain NumPy, float64: the definition of what the native engines compute.

A pixel's radiance is the mean of the light field over the pixel filter, the lens and the shutter, and that is
the mean of its values at N locations (x, y, u, v, t) (Eq. 1)::

    L(pixel) = Σ P_j RECONSTRUCT(x_j, y_j, u_j, v_j, t_j) / Σ P_j

with weights P_j of the pixel filter. For each location RECONSTRUCT does four things:

1. See the samples from the lens point (u, v) at the time t (`reprojection`), and pick those near (x, y)
   (`View.look`).
2. Tell them apart into surfaces, front to back (`surfaces.group_into_surfaces`).
3. Find out which of these covers the location (`surfaces.find_surface`).
4. Average its samples' radiance under a tent (`View.radiance`); or, where they come with area lights, shade
   the point with light that is reconstructed in the same way (`shadows`).

The sums are kept apart by how blurred what a location sees is, for `refine`. The native engine does the same
for tiles of pixels; here one location comes after the other.
"""

from __future__ import annotations

from collections import Counter
from functools import partial

import numpy as np
import numpy.typing as npt

from fewrays.parallel import Execution, progress_bar
from fewrays.samples import SampleBuffer
from fewrays.temporal.plan import Plan
from fewrays.temporal.shadows import Lights
from fewrays.temporal.statistics import Statistics
from fewrays.temporal.surfaces import find_surface
from fewrays.temporal.view import ViewedField

__all__ = ["reconstruct_tiles"]

Bands = npt.NDArray[np.float32]


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
    seen = ViewedField(samples)
    sums = np.zeros(bands.shape)
    tally: Counter[str] = Counter()
    where = plan.locations
    lights = None if plan.lighting is None else Lights(samples, plan.lighting, plan.rule, where.t)
    with progress_bar(where.count, "temporal", show=execution.progress, unit="view") as bar:
        for k in range(where.count):
            view = seen.view(where.uv[k], float(where.t[k]))
            if lights is not None:
                lights.shine(k)
            for row, column in np.ndindex(plan.height, plan.width):
                x, y = np.array([column + 0.5, row + 0.5]) + where.offset[k]
                surface = find_surface(partial(view.look, x, y), plan.rule, tally)
                if surface is not None:
                    band = np.searchsorted(plan.band_starts, abs(surface.slope), side="right") - 1
                    radiance = (
                        view.radiance(surface) if lights is None else lights.radiance(view, surface, x, y)
                    )
                    sums[row, column, band] += float(where.weight[k]) * np.append(radiance, 1.0)
            bar.update()
    bands += sums.astype(np.float32)
    return Statistics(**tally)
