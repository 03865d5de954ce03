"""Scenes whose image is known: stacks of textured, masked planes parallel to the image plane.

A plane is painted as the lens centre sees it. The ray through image position ``xy`` and lens position
``(u, v)`` meets the plane of depth ``z`` where the lens centre sees it at ``xy - C(z) * (u, v)``, so the
plane's texture and mask are functions of a position in pixels and no geometry is left to trace. The nearest
plane whose mask holds that position gives the sample.

`sample` makes the few samples per pixel that a method reconstructs from, `reference` the image that it
should arrive at. A texture made of `Waves` (a grating, smooth noise) filling the whole image also has an
exact image, `exact_waves`: the lens and the pixel filter only attenuate each wave.

Examples
--------
>>> from fewrays.lens import Lens
>>> lens = Lens.thin_lens(64, focus_distance=2.0, lens_radius=0.05, fov=40.0)
>>> planes = [Plane(1.0, constant(0.8, 0.2, 0.1), disc((32, 24), 10)), Plane(4.0, checker(8))]
>>> sample(planes, lens, 48, 64, 8).color.shape
(48, 64, 8, 3)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.lens import Lens
from fewrays.method import Image
from fewrays.samples import SampleBuffer
from fewrays.sources.patterns import sample_pattern, warp_to_lens

__all__ = [
    "Mask",
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
    "reference",
    "sample",
    "smooth_noise",
    "stripes",
    "trace",
]

Floats = npt.NDArray[np.float64]
Texture = Callable[[Floats], npt.ArrayLike]
"""From positions ``(..., 2)`` in pixels, as the lens centre sees them, to radiance ``(..., 3)``."""
Mask = Callable[[Floats], npt.NDArray[np.bool_]]
"""From positions ``(..., 2)`` in pixels to whether the plane is there, ``(...)``."""
PixelFilter = Literal["gaussian", "box"]

_CHUNK = 2**17  # samples that are traced at once; a texture of 24 waves takes some 75 MB for them


@dataclass(frozen=True)
class Plane:
    """A plane parallel to the image plane.

    Parameters
    ----------
    depth : float
        Planar depth in scene units, positive and finite.
    color : callable
        Radiance ``(..., 3)`` of positions ``(..., 2)`` in pixels as the lens centre sees them.
    mask : callable, optional
        Whether the plane is there, ``(...)`` of bool, for the same positions; everywhere when omitted.

    Raises
    ------
    SampleError
        For a depth that is not positive and finite.
    """

    depth: float
    color: Texture
    mask: Mask | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.depth) and self.depth > 0):
            raise SampleError(f"expected a positive, finite number, got {self.depth!r}", field="plane.depth")


def sample(
    planes: Sequence[Plane], lens: Lens, height: int, width: int, spp: int, *, seed: int = 0
) -> SampleBuffer:
    """Sample a stack of planes through a lens.

    Parameters
    ----------
    planes : sequence of Plane
        In any order. The farthest must have no mask, so that every ray ends somewhere.
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

    Raises
    ------
    SampleError
        When no plane, or the farthest one masked, is given, and for a size that is not positive.
    """
    _check_size(height=height, width=width, spp=spp)
    xy, uv = sample_pattern(height, width, spp, seed=seed, sampling=lens.sampling, sigma=lens.sigma)
    color = np.empty((height, width, spp, 3), np.float32)
    depth = np.empty((height, width, spp), np.float32)
    for tile in _tiles(height, width, spp):
        color[tile], depth[tile] = trace(planes, lens, xy[tile], uv[tile])
    return SampleBuffer(xy=xy, uv=uv, depth=depth, color=color, lens=lens)


def reference(
    planes: Sequence[Plane],
    lens: Lens,
    height: int,
    width: int,
    *,
    spp: int = 1024,
    pixel_filter: PixelFilter = "gaussian",
    sigma_pix: float = 0.5,
    seed: int = 1,
) -> Image:
    """Integrate a stack of planes over the aperture and the pixel filter with many samples.

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
    seed : int
        Differs from `sample`'s, so that the two have no sample in common.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32.

    Raises
    ------
    SampleError
        As in `sample`, and for an unknown pixel filter.
    """
    _check_size(height=height, width=width, spp=spp)
    _check_filter(pixel_filter, sigma_pix)
    image = np.empty((height, width, 3), np.float32)
    for index, (rows, columns) in enumerate(_tiles(height, width, spp)):
        tile_seed = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        size = (rows.stop - rows.start, columns.stop - columns.start)
        xy, uv = sample_pattern(*size, spp, seed=tile_seed, sampling=lens.aperture, sigma=lens.sigma)
        if pixel_filter == "gaussian":
            xy = _warp_to_gaussian(xy, sigma_pix)
        color, _ = trace(planes, lens, xy + np.array([columns.start, rows.start], xy.dtype), uv)
        image[rows, columns] = color.mean(axis=2, dtype=np.float64)
    return image


def trace(
    planes: Sequence[Plane], lens: Lens, xy: npt.ArrayLike, uv: npt.ArrayLike
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Find what rays hit.

    Parameters
    ----------
    planes, lens
        As in `sample`.
    xy, uv : array_like, (..., 2)
        Image positions in pixels and lens positions.

    Returns
    -------
    color : ndarray, (..., 3)
        Radiance, float32.
    depth : ndarray, (...)
        Planar depth, float32.

    Raises
    ------
    SampleError
        When no plane, or the farthest one masked, is given.
    """
    stack = sorted(planes, key=lambda plane: plane.depth)
    if not stack or stack[-1].mask is not None:
        raise SampleError(
            "the farthest plane must cover everything: add one without a mask behind the others",
            field="planes",
        )
    xy = np.asarray(xy, np.float64)
    uv = np.asarray(uv, np.float64)
    shape = xy.shape[:-1]
    xy, uv = xy.reshape(-1, 2), uv.reshape(-1, 2)

    color = np.empty((len(xy), 3), np.float32)
    depth = np.empty(len(xy), np.float32)
    open_rays = np.arange(len(xy))
    for plane in stack:
        seen = xy[open_rays] - float(lens.slope(plane.depth)) * uv[open_rays]
        hit = np.ones(len(seen), bool) if plane.mask is None else np.asarray(plane.mask(seen), bool)
        color[open_rays[hit]] = plane.color(seen[hit])
        depth[open_rays[hit]] = plane.depth
        open_rays = open_rays[~hit]
    return color.reshape(*shape, 3), depth.reshape(shape)


# Textures.


@dataclass(frozen=True, eq=False)
class Waves:
    """A texture that is a sum of sinusoids, ``mean + sum_n amplitude_n cos(2π frequency_n · xy + phase_n)``.

    Parameters
    ----------
    mean : ndarray, (3,)
        Mean radiance.
    amplitude : ndarray, (N, 3)
        Of each wave.
    frequency : ndarray, (N, 2)
        In cycles per pixel.
    phase : ndarray, (N,)
        In radians.
    """

    mean: Floats
    amplitude: Floats
    frequency: Floats
    phase: Floats

    def __call__(self, xy: Floats) -> Floats:
        """Radiance ``(..., 3)`` at positions ``(..., 2)``."""
        result: Floats = self.mean + np.cos(2 * np.pi * (xy @ self.frequency.T) + self.phase) @ self.amplitude
        return result


def constant(red: float, green: float | None = None, blue: float | None = None) -> Texture:
    """One radiance everywhere; grey when only one number is given."""
    color = np.array([red, red if green is None else green, red if blue is None else blue], np.float64)
    return lambda xy: np.broadcast_to(color, (*xy.shape[:-1], 3))


def checker(
    size: float,
    dark: Sequence[float] = (0.1, 0.1, 0.1),
    light: Sequence[float] = (0.9, 0.9, 0.9),
) -> Texture:
    """Squares of `size` pixels in two colours, one corner at the origin."""
    colors = np.array([light, dark], np.float64)
    return lambda xy: colors[np.floor(xy / size).astype(np.int64).sum(axis=-1) % 2]


def grating(
    frequency: tuple[float, float],
    *,
    mean: Sequence[float] = (0.5, 0.5, 0.5),
    amplitude: Sequence[float] = (0.4, 0.4, 0.4),
    phase: float = 0.0,
) -> Waves:
    """One sinusoid of `frequency` cycles per pixel along x and y."""
    return Waves(
        np.asarray(mean, np.float64),
        np.asarray([amplitude], np.float64),
        np.asarray([frequency], np.float64),
        np.asarray([phase], np.float64),
    )


def smooth_noise(
    period: float,
    *,
    mean: Sequence[float] = (0.5, 0.5, 0.5),
    contrast: float = 0.15,
    waves: int = 24,
    seed: int = 0,
) -> Waves:
    """Band-limited coloured noise.

    Parameters
    ----------
    period : float
        Shortest period in pixels; the longest is 8 times that.
    mean : sequence of 3 floats
        Mean radiance.
    contrast : float
        Standard deviation of each channel.
    waves : int
        Number of sinusoids.
    seed : int
        The same seed gives the same texture.

    Returns
    -------
    Waves
    """
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, np.pi, waves)
    frequency = 8 ** -rng.random(waves) / period
    amplitude = rng.normal(size=(waves, 3))
    amplitude *= contrast * math.sqrt(2) / np.linalg.norm(amplitude, axis=0)
    return Waves(
        np.asarray(mean, np.float64),
        amplitude,
        frequency[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1),
        rng.uniform(0, 2 * np.pi, waves),
    )


# Masks.


def disc(center: tuple[float, float], radius: float) -> Mask:
    """Inside a circle, in pixels."""
    return lambda xy: np.square(xy - np.asarray(center)).sum(axis=-1) < radius**2


def half_plane(point: tuple[float, float], normal: tuple[float, float]) -> Mask:
    """On the side of the line through `point` that `normal` points to."""
    return lambda xy: (xy - np.asarray(point)) @ np.asarray(normal, np.float64) > 0


def stripes(period: float, *, fill: float = 0.5, direction: tuple[float, float] = (1.0, 0.0)) -> Mask:
    """Bars across `direction`, one every `period` pixels, that fill the share `fill` of it."""
    axis = np.asarray(direction, np.float64) / np.hypot(*direction)
    return lambda xy: np.mod(xy @ axis / period, 1) < fill


# Exact images.


def exact_waves(
    texture: Waves,
    depth: float,
    lens: Lens,
    height: int,
    width: int,
    *,
    pixel_filter: PixelFilter = "gaussian",
    sigma_pix: float = 0.5,
) -> Image:
    """Exact image of an unmasked plane of waves.

    Integrating over a point-symmetric aperture and pixel filter leaves each wave's frequency and phase alone
    and multiplies its amplitude by the Fourier transforms of the two, the aperture's being taken at
    ``C(depth)`` times the frequency.

    Parameters
    ----------
    texture : Waves
        What the plane is painted with.
    depth : float
        Of the plane.
    lens, height, width, pixel_filter, sigma_pix
        As in `reference`.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32, without noise.

    Raises
    ------
    SampleError
        For a size that is not positive or an unknown pixel filter.
    """
    _check_size(height=height, width=width)
    _check_filter(pixel_filter, sigma_pix)
    if pixel_filter == "gaussian":
        pixel = np.exp(-2 * (np.pi * sigma_pix) ** 2 * np.square(texture.frequency).sum(axis=-1))
    else:
        pixel = np.sinc(texture.frequency).prod(axis=-1)
    aperture = _aperture_transform(lens, float(lens.slope(depth)) * texture.frequency)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    blurred = Waves(
        texture.mean, (pixel * aperture)[:, None] * texture.amplitude, texture.frequency, texture.phase
    )
    return blurred(np.stack([x, y], axis=-1)).astype(np.float32)


def _aperture_transform(lens: Lens, frequency: Floats) -> Floats:
    """Fourier transform of the aperture density at frequencies ``(N, 2)`` in cycles per unit of u.

    Both are quadratures, exact to rounding: a disc's transform (a jinc) is that of its marginal along the
    frequency, a semicircle, which is the weight function of Gauss-Chebyshev quadrature of the second kind; a
    Gaussian cut off at the square is a product of integrals over ``[-1, 1]``.
    """
    radius = np.hypot(frequency[:, 0], frequency[:, 1])
    nodes = 64 + 4 * math.ceil(radius.max(initial=0))
    if lens.aperture == "disc":
        angle = np.pi * np.arange(1, nodes + 1) / (nodes + 1)
        semicircle: Floats = 2 / (nodes + 1) * np.square(np.sin(angle))
        transform: Floats = np.cos(2 * np.pi * radius[:, None] * np.cos(angle)) @ semicircle
        return transform
    u, weights = np.polynomial.legendre.leggauss(nodes)
    u = u * min(1.0, 8 * lens.sigma)  # nothing of a Gaussian is left beyond 8σ
    weights = weights * np.exp(-np.square(u) / (2 * lens.sigma**2))
    per_axis = np.cos(2 * np.pi * frequency[..., None] * u) @ (weights / weights.sum())
    product: Floats = per_axis.prod(axis=-1)
    return product


# Helpers.


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


def _check_size(**sizes: int) -> None:
    for name, size in sizes.items():
        if size < 1:
            raise SampleError(f"expected at least 1, got {size!r}", field=name)


def _check_filter(pixel_filter: str, sigma_pix: float) -> None:
    if pixel_filter not in ("gaussian", "box"):
        raise SampleError(f"expected 'gaussian' or 'box', got {pixel_filter!r}", field="pixel_filter")
    if not (math.isfinite(sigma_pix) and sigma_pix >= 0):
        raise SampleError(f"expected a finite number >= 0, got {sigma_pix!r}", field="sigma_pix")
