"""What shading gets wrong on average is put right by what the samples' own light says.

The light that each sample got from its own light sample is noisy, but right on average. Light that is
reconstructed is not noisy, but may be wrong where blockers are finer than the samples lie: the bars of a
fence that is seen almost edge-on from the light close up to a wall. There the two differ over many samples on
one side. So their difference is averaged over the pixels around, reduced by the share of its square that
noise explains, as after James and Stein, and added to the samples of a pixel in proportion to the light that
each would get if nothing were in between.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays.lighting import Lighting
from fewrays.samples import SampleBuffer
from fewrays.temporal.refine import gaussian_blur

__all__ = ["settle"]

Float32 = npt.NDArray[np.float32]

_POOL = 2.0  # width of what is judged together, in widths of the correction


def settle(samples: SampleBuffer, lighting: Lighting, color: Float32, sigma: float) -> Float32:
    """Return colours that agree on average with what the samples' own light samples brought.

    Parameters
    ----------
    samples : SampleBuffer
        With its own, noisy colours.
    lighting : Lighting
        That of the samples.
    color : ndarray of float32, (H, W, S, 3)
        Radiance with reconstructed light.
    sigma : float
        Standard deviation of the Gaussian that averages over pixels.

    Returns
    -------
    ndarray of float32, (H, W, S, 3)
        Not below `lighting.unlit` where `color` is not.
    """
    share = _shares(samples, lighting)
    difference = samples.color - color
    mean = difference.mean(axis=2)
    if samples.spp > 1:
        variance = difference.var(axis=2, ddof=1).sum(axis=-1, keepdims=True) / samples.spp
    else:
        variance = np.square(mean).sum(axis=-1, keepdims=True)
    there = np.ones((*mean.shape[:2], 1), np.float32)
    around = gaussian_blur(there, sigma)
    smooth = gaussian_blur(mean, sigma) / around
    noise = gaussian_blur(variance, sigma, squared=True) / np.square(around)
    energy = np.square(smooth).sum(axis=-1, keepdims=True)
    square, expected = np.split(
        gaussian_blur(np.concatenate([energy, noise], axis=-1), _POOL * sigma), 2, axis=-1
    )
    trust = np.maximum(1 - np.divide(expected, square, out=np.ones_like(square), where=square > 0), 0)
    settled = color + share * (trust * smooth)[:, :, None]
    least = np.minimum(color, lighting.unlit)
    result: Float32 = np.maximum(settled, least).astype(np.float32, copy=False)
    return result


def _shares(samples: SampleBuffer, lighting: Lighting) -> Float32:
    """Return what part of the light of its pixel each sample ``(H, W, S, 1)`` would get; the mean is 1."""
    light = np.zeros(samples.depth.shape, np.float32)
    for number in range(len(lighting.lights)):
        light += lighting.direct(samples, number, occluded=False).sum(axis=-1)
    mean = light.mean(axis=2, keepdims=True)
    share: Float32 = np.divide(light, mean, out=np.zeros_like(light), where=mean > 0)
    return share[..., None]
