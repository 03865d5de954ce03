"""Shading of camera samples in plain NumPy, float64: the definition of what the native kernel computes.

Each camera sample is a receiver of its own: its point at the time of a view, lit from the light points of
that view (`fewrays.temporal.shadows`), with its own reflectance and normal. Its radiance is the mean over the
views that it gets.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays.lighting import Lighting
from fewrays.parallel import Execution, progress_bar
from fewrays.samples import SampleBuffer
from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.shadows import Lights

__all__ = ["shade_samples"]

Float32 = npt.NDArray[np.float32]


def shade_samples(
    samples: SampleBuffer,
    lighting: Lighting,
    rule: SurfaceRule,
    times: Float32,
    views: npt.NDArray[np.integer],
    execution: Execution,
) -> Float32:
    """Light every camera sample from the light points of some views.

    Parameters
    ----------
    samples : SampleBuffer
        N of them.
    lighting : Lighting
        That of the samples.
    rule : SurfaceRule
        That of the camera samples.
    times : ndarray of float32, (V,)
        Of the views, in [0, 1] over the shutter.
    views : ndarray of int, (N, share)
        Which views each sample gets, all different.
    execution : Execution
        For its progress bar.

    Returns
    -------
    ndarray of float32, (H, W, S, 3)
        Linear radiance.
    """
    lights = Lights(samples, lighting, rule, times)
    sums = np.zeros((samples.depth.size, 3))
    with progress_bar(len(times), "light", show=execution.progress, unit="view") as bar:
        for view, time in enumerate(times):
            lights.shine(view)
            for sample in np.flatnonzero((views == view).any(axis=1)):
                sums[sample] += lights.reflected_by(lights.own_point(int(sample), float(time)))
            bar.update()
    mean: Float32 = (sums / views.shape[1]).astype(np.float32)
    return mean.reshape(samples.color.shape)
