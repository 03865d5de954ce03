"""What shading gets wrong on average is put right by what the samples' own light says.

The light that each sample got from its own light sample is noisy, but right on average. Light that is
reconstructed is not noisy, but may be wrong where blockers are finer than the samples lie: the bars of a
fence that is seen almost edge-on from the light close up to a wall. There the two differ over many samples on
one side. So their difference is averaged over the samples around that lie on the same surface, as a share of
the light that they would get if nothing were in between. It is reduced by the part of its square that noise
explains, as after James and Stein, and each sample gets that share of its own light.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.parallel import Execution, map_ranges
from fewrays.samples import SampleBuffer
from fewrays.temporal.refine import gaussian_blur
from fewrays.temporal.settle_reference import Around, mean_error

__all__ = ["settle"]

Float32 = npt.NDArray[np.float32]

_POOL = 2.0  # width of what is judged together, in widths of the correction
_DOUBT = 0.7  # share of noise that counts: an image averages what is left of it further, but not the error
_ROWS = 8  # of the image, worked on at once


def settle(samples: SampleBuffer, color: Float32, sigma: float, execution: Execution) -> Float32:
    """Return colours that agree on average with what the samples' own light samples brought.

    Parameters
    ----------
    samples : SampleBuffer
        With lighting, and with its own, noisy colours.
    color : ndarray of float32, (H, W, S, 3)
        Radiance with reconstructed light.
    sigma : float
        Standard deviation in pixels of the Gaussian that averages over samples.
    execution : Execution
        With the device ``"reference"`` in plain NumPy, otherwise on the processor.

    Returns
    -------
    ndarray of float32, (H, W, S, 3)
        Not below `Lighting.unlit` where `color` is not.
    """
    lighting = samples.lighting
    assert lighting is not None
    unblocked = np.zeros_like(color)
    for number in range(len(lighting.lights)):
        unblocked += lighting.direct(samples, number, occluded=False)
    light, difference = unblocked.sum(axis=-1), (samples.color - color).sum(axis=-1)
    around = Around.of_samples(samples)
    if execution.device == "reference":
        share, variance = mean_error(around, light, difference, sigma)
    else:
        share, variance = _mean_error(around, light, difference, sigma, execution)
    squared = np.stack([np.square(share), variance], axis=-1) * np.square(light)[..., None]
    blurred = gaussian_blur(squared.mean(axis=2).astype(np.float32), _POOL * sigma)
    square, noise = np.split(blurred, 2, axis=-1)
    doubt = np.divide(_DOUBT * noise, square, out=np.ones_like(square), where=square > 0)
    trust = np.maximum(1 - doubt, 0)
    settled = color + (trust * share)[..., None] * unblocked
    least = np.minimum(color, lighting.unlit)
    result: Float32 = np.maximum(settled, least).astype(np.float32, copy=False)
    return result


def _mean_error(
    around: Around, light: Float32, difference: Float32, sigma: float, execution: Execution
) -> tuple[Float32, Float32]:
    """Return what `mean_error` does, from native code."""
    share, variance = np.empty((2, *light.shape), np.float32)

    def rows(first: int, last: int) -> None:
        _native.settle_rows(
            around.xy,
            around.at_center,
            around.inverse_depth,
            around.inverse_gradient,
            around.normal,
            light,
            difference,
            sigma,
            around.pixel,
            first,
            last,
            share,
            variance,
        )

    map_ranges(rows, light.shape[0], execution, label="light: settle", chunk=_ROWS)
    return share, variance
