"""Scenes whose image is known: stacks of textured, masked planes parallel to the image plane.

A plane is painted as the lens centre sees it (`fewrays.sources.analytic_paint`), and may move while the
shutter is open; what rays hit follows from that without geometry (`fewrays.sources.analytic_planes`).

`sample` makes the few samples per pixel that a method reconstructs from, `reference` the image that it
should arrive at. A texture made of `Waves` (a grating, smooth noise) filling the whole image also has an
exact image, `exact_waves` (`fewrays.sources.analytic_waves`).

Examples
--------
>>> from fewrays.lens import Lens
>>> lens = Lens.thin_lens(64, focus_distance=2.0, lens_radius=0.05, fov=40.0)
>>> planes = [Plane(1.0, constant(0.8, 0.2, 0.1), disc((32, 24), 10)), Plane(4.0, checker(8))]
>>> sample(planes, lens, 48, 64, 8).color.shape
(48, 64, 8, 3)

The disc moves right by 12 pixels while the shutter is open, and comes closer:

>>> moving = motion_of(1.0, (12, 0), depth_change=-0.2, principal_point=(32, 24))
>>> planes[0] = Plane(1.0, constant(0.8, 0.2, 0.1), disc((32, 24), 10), moving)
>>> sample(planes, lens, 48, 64, 8).motion[24, 32, 0]
array([ 5.6, -4.8, -0.2], dtype=float32)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens
from fewrays.method import Image
from fewrays.samples import SampleBuffer
from fewrays.sources.analytic_options import PixelFilter, check_filter, check_shutter, check_size
from fewrays.sources.analytic_paint import (
    Mask,
    Texture,
    Waves,
    checker,
    constant,
    disc,
    grating,
    half_plane,
    smooth_noise,
    stripes,
)
from fewrays.sources.analytic_planes import Motion, Plane, hits_of, motion_of, trace
from fewrays.sources.analytic_waves import exact_waves
from fewrays.sources.patterns import sample_pattern, sample_times, warp_to_lens

__all__ = [
    "Mask",
    "Motion",
    "PixelFilter",
    "Plane",
    "Texture",
    "Waves",
    "checker",
    "constant",
    "disc",
    "exact_waves",
    "grating",
    "half_plane",
    "motion_of",
    "reference",
    "sample",
    "smooth_noise",
    "stripes",
    "trace",
]

_CHUNK = 2**17  # samples that are traced at once; a texture of 24 waves takes some 75 MB for them


def sample(
    planes: Sequence[Plane], lens: Lens, height: int, width: int, spp: int, *, seed: int = 0
) -> SampleBuffer:
    """Sample a stack of planes through a lens.

    Parameters
    ----------
    planes : sequence of Plane
        In any order. The farthest, at every time, must have no mask, so that every ray ends somewhere.
    lens : Lens
        Lens positions are drawn from ``lens.sampling``.
    height, width : int
        Image size in pixels. Sample a larger image and crop the result to test without image borders.
    spp : int
        Samples per pixel.
    seed : int
        The same seed gives the same samples.

    Returns
    -------
    SampleBuffer
        With times, uniform over the shutter, and motion when any plane moves.

    Raises
    ------
    SampleError
        When no plane, or the farthest one masked, is given, and for a size that is not positive.
    """
    check_size(height=height, width=width, spp=spp)
    xy, uv = sample_pattern(height, width, spp, seed=seed, sampling=lens.sampling, sigma=lens.sigma)
    moving = any(plane.moves for plane in planes)
    time = sample_times(height, width, spp, seed=seed) if moving else None
    motions = np.array([plane.motion for plane in planes], np.float32)
    color = np.empty((height, width, spp, 3), np.float32)
    depth = np.empty((height, width, spp), np.float32)
    motion = np.empty_like(color) if moving else None
    for tile in _tiles(height, width, spp):
        color[tile], depth[tile], hit = hits_of(
            planes, lens, xy[tile], uv[tile], 0.0 if time is None else time[tile]
        )
        if motion is not None:
            motion[tile] = motions[hit]
    return SampleBuffer(xy=xy, uv=uv, depth=depth, color=color, lens=lens, time=time, motion=motion)


def reference(
    planes: Sequence[Plane],
    lens: Lens,
    height: int,
    width: int,
    *,
    spp: int = 1024,
    pixel_filter: PixelFilter = "gaussian",
    sigma_pix: float = 0.5,
    shutter: tuple[float, float] = (0.0, 1.0),
    seed: int = 1,
) -> Image:
    """Integrate a stack of planes over aperture, shutter and pixel filter with many samples.

    Lens positions are drawn from ``lens.aperture`` and image positions from the pixel filter around each
    pixel's centre, so that all samples weigh the same. The image is made in tiles, so that memory is bounded
    whatever the size and `spp`.

    Parameters
    ----------
    planes, lens, height, width
        As in `sample`.
    spp : int
        Samples per pixel.
    pixel_filter : {"gaussian", "box"}
        A Gaussian of standard deviation `sigma_pix`, or the pixel's own area.
    sigma_pix : float
        In pixels.
    shutter : (float, float)
        When it opens and closes, ``0 <= open <= close <= 1``; twice the same time makes a snapshot.
    seed : int
        Differs from `sample`'s, so that the two have no sample in common.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32.

    Raises
    ------
    SampleError
        As in `sample`, for an unknown pixel filter and for a shutter outside ``[0, 1]``.
    """
    check_size(height=height, width=width, spp=spp)
    check_filter(pixel_filter, sigma_pix)
    check_shutter(shutter)
    opens, closes = shutter
    moving = any(plane.moves for plane in planes)
    image = np.empty((height, width, 3), np.float32)
    for index, (rows, columns) in enumerate(_tiles(height, width, spp)):
        tile_seed = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        size = (rows.stop - rows.start, columns.stop - columns.start)
        xy, uv = sample_pattern(*size, spp, seed=tile_seed, sampling=lens.aperture, sigma=lens.sigma)
        if pixel_filter == "gaussian":
            xy = _warp_to_gaussian(xy, sigma_pix)
        times = opens + (closes - opens) * sample_times(*size, spp, seed=tile_seed) if moving else 0.0
        color, _ = trace(planes, lens, xy + np.array([columns.start, rows.start], xy.dtype), uv, times)
        image[rows, columns] = color.mean(axis=2, dtype=np.float64)
    return image


def _warp_to_gaussian(xy: npt.NDArray[np.float32], sigma_pix: float) -> npt.NDArray[np.float32]:
    """Turn uniform positions within each pixel into normally distributed ones around its centre, up to 6σ."""
    pixel = np.stack(np.meshgrid(np.arange(xy.shape[1]), np.arange(xy.shape[0])), axis=-1)[:, :, None]
    offset = 6 * sigma_pix * warp_to_lens((xy - pixel).astype(np.float64), "gaussian", 1 / 6)
    return (pixel + 0.5 + offset).astype(np.float32)


def _tiles(height: int, width: int, spp: int) -> list[tuple[slice, slice]]:
    """Rectangles of pixels that hold about `_CHUNK` samples each."""
    side = max(1, math.isqrt(_CHUNK // spp))
    return [
        (slice(top, min(top + side, height)), slice(left, min(left + side, width)))
        for top in range(0, height, side)
        for left in range(0, width, side)
    ]
