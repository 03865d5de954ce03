"""Sample buffers made of random numbers."""

from __future__ import annotations

import numpy as np

from fewrays import Lens, SampleBuffer


def random_buffer(
    height: int,
    width: int,
    spp: int,
    lens: Lens,
    *,
    seed: int = 0,
    surfaces: int = 6,
    off_image: float = 0.0,
) -> SampleBuffer:
    """Make samples of `surfaces` depths around the focal plane, noisy in depth and radiance.

    The share `off_image` of the samples is moved up to 30 pixels, so that some leave their pixels and some
    the image.
    """
    rng = np.random.default_rng(seed)
    shape = (height, width, spp)
    corner = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)[:, :, None, :]
    xy = corner + rng.uniform(0.0, 0.999, (*shape, 2))
    xy += np.where(rng.random((*shape, 1)) < off_image, rng.uniform(-30, 30, (*shape, 2)), 0.0)
    uv = rng.uniform(-1.0, 1.0, (*shape, 2))
    if lens.sampling == "disc":
        uv /= np.maximum(np.hypot(uv[..., :1], uv[..., 1:]), 1.0)
    focus = lens.focus_distance if np.isfinite(lens.focus_distance) else 5.0
    depths = focus * np.exp(rng.uniform(-1.5, 3.0, surfaces))
    depth = rng.choice(depths, shape) * rng.uniform(0.98, 1.02, shape)
    return SampleBuffer(xy, uv, depth, rng.gamma(1.0, 1.0, (*shape, 3)), lens)
