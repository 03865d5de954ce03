"""Scenes whose image is known: stacks of textured, masked planes parallel to the image plane.

A plane is painted as the lens centre sees it. The ray through image position ``xy`` and lens position
``(u, v)`` meets the plane of depth ``z`` where the lens centre sees it at ``xy - C(z) * (u, v)``, so the
plane's texture and mask are functions of a position in pixels and no geometry is left to trace. The nearest
plane whose mask holds that position gives the sample.

A plane may move, without turning, while the shutter is open. Each of its points then changes its
homogeneous screen position ``(x w, y w, w)``, ``w`` = depth, by the same amount, so that a ray at any time
can be followed back to where the lens centre saw its point as the shutter opened; that is where the plane is
painted (temporal, section 3, Equations 2 and 3).

`sample` makes the few samples per pixel that a method reconstructs from, `reference` the image that it
should arrive at. A texture made of `Waves` (a grating, smooth noise) filling the whole image also has an
exact image, `exact_waves`: the lens and the pixel filter only attenuate each wave, and motion averages over
where it has been.

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

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, require_option
from fewrays.lens import Lens
from fewrays.method import Image
from fewrays.samples import SampleBuffer
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

Floats = npt.NDArray[np.float64]
Texture = Callable[[Floats], npt.ArrayLike]
"""From positions ``(..., 2)`` in pixels, as the lens centre sees them, to radiance ``(..., 3)``."""
Mask = Callable[[Floats], npt.NDArray[np.bool_]]
"""From positions ``(..., 2)`` in pixels to whether the plane is there, ``(...)``."""
PixelFilter = Literal["gaussian", "box"]
Motion = tuple[float, float, float]
"""Change over the whole shutter of ``(x w, y w, w)``, ``w`` = depth, in pixels times depth units."""

_CHUNK = 2**17  # samples that are traced at once; a texture of 24 waves takes some 75 MB for them


@dataclass(frozen=True)
class Plane:
    """A plane parallel to the image plane, still or moving in a straight line.

    Parameters
    ----------
    depth : float
        Planar depth in scene units, positive and finite.
        A moving plane has it at t = 0.
    color : callable
        Radiance ``(..., 3)`` of positions ``(..., 2)`` in pixels as the lens centre sees them at t = 0.
    mask : callable, optional
        Whether the plane is there, ``(...)`` of bool, for the same positions; everywhere when omitted.
    motion : (float, float, float)
        Change over the whole shutter, t = 0 to 1, of every point's homogeneous screen position
        ``(x w, y w, w)`` as the lens centre sees it, with ``w`` = depth and x, y in pixels from the image's
        left upper corner: what `SampleBuffer.motion` stores. `motion_of` makes it from screen velocities.

    Raises
    ------
    SampleError
        For a depth that is not positive and finite, or a motion that is not finite or leaves the depth not
        positive when the shutter closes.
    """

    depth: float
    color: Texture
    mask: Mask | None = None
    motion: Motion = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.depth) and self.depth > 0):
            raise SampleError(f"expected a positive, finite number, got {self.depth!r}", field="plane.depth")
        if len(self.motion) != 3 or not all(math.isfinite(change) for change in self.motion):
            raise SampleError(f"expected three finite numbers, got {self.motion!r}", field="plane.motion")
        last_depth = self.depth + self.motion[2]
        if last_depth <= 0:
            raise SampleError(
                f"the depth falls from {self.depth:g} to {last_depth:g} while the shutter is open; the plane "
                "must stay in front of the camera",
                field="plane.motion",
            )

    @property
    def moves(self) -> bool:
        """Whether any part of the motion is not zero."""
        return any(self.motion)

    def depth_at(self, times: npt.ArrayLike) -> Floats:
        """Depth at times ``(...)`` (temporal, Equation 2)."""
        result: Floats = self.depth + np.asarray(times, np.float64) * self.motion[2]
        return result

    def at_start(self, seen: Floats, times: Floats) -> Floats:
        """Follow points back to the opening of the shutter.

        Solves ``seen * w(t) = start * w(0) + t * motion``, Equation 3 of *temporal* for the lens centre, for
        the start, in a form that adds exactly nothing to what is still.

        Parameters
        ----------
        seen : ndarray, (..., 2)
            Where the lens centre sees points of the plane, in pixels.
        times : ndarray, (...)
            When it sees them there, in ``[0, 1]`` over the shutter.

        Returns
        -------
        ndarray, (..., 2)
            Where the lens centre saw the same points at t = 0.
        """
        if not self.moves:
            return seen
        *along, away = self.motion
        moved: Floats = (times / self.depth)[..., None] * (np.asarray(along) - seen * away)
        return seen - moved


def motion_of(
    depth: float,
    velocity: tuple[float, float] = (0.0, 0.0),
    *,
    depth_change: float = 0.0,
    principal_point: tuple[float, float] | None = None,
) -> Motion:
    """Put a straight motion in space into the form that `Plane` and `SampleBuffer` store.

    A point that only changes its depth moves on the image along the line through the principal point, where
    the optical axis meets the image: away from it as it comes closer.

    Parameters
    ----------
    depth : float
        Planar depth at t = 0, in scene units.
    velocity : (float, float)
        Movement parallel to the image over the whole shutter, as the pixels in x and y that it would cover
        at `depth`.
    depth_change : float
        Depth at t = 1 less `depth`, in scene units; negative towards the camera.
    principal_point : (float, float), optional
        In pixels, as a rule ``(width / 2, height / 2)``. Needed if the depth changes.

    Returns
    -------
    (float, float, float)
        Change of ``(x w, y w, w)`` over the shutter.

    Raises
    ------
    SampleError
        When the depth changes and no principal point is given.

    Examples
    --------
    >>> motion_of(2.0, (10, 0), depth_change=0.5, principal_point=(32, 24))
    (36.0, 12.0, 0.5)
    """
    if principal_point is None:
        if depth_change:
            raise SampleError(
                "a change of depth moves points to or from it: give it, as a rule the image's centre",
                field="principal_point",
            )
        principal_point = (0.0, 0.0)
    x, y = (
        speed * depth + axis * depth_change for speed, axis in zip(velocity, principal_point, strict=True)
    )
    return x, y, depth_change


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
    _check_size(height=height, width=width, spp=spp)
    xy, uv = sample_pattern(height, width, spp, seed=seed, sampling=lens.sampling, sigma=lens.sigma)
    moving = any(plane.moves for plane in planes)
    time = sample_times(height, width, spp, seed=seed) if moving else None
    motions = np.array([plane.motion for plane in planes], np.float32)
    color = np.empty((height, width, spp, 3), np.float32)
    depth = np.empty((height, width, spp), np.float32)
    motion = np.empty_like(color) if moving else None
    for tile in _tiles(height, width, spp):
        color[tile], depth[tile], hit = _trace(
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
    _check_size(height=height, width=width, spp=spp)
    _check_filter(pixel_filter, sigma_pix)
    _check_shutter(shutter)
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


def trace(
    planes: Sequence[Plane], lens: Lens, xy: npt.ArrayLike, uv: npt.ArrayLike, times: npt.ArrayLike = 0.0
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Find what rays hit.

    Parameters
    ----------
    planes, lens
        As in `sample`.
    xy, uv : array_like, (..., 2)
        Image positions in pixels and lens positions.
    times : array_like, (...) or one for all
        In ``[0, 1]`` over the shutter.

    Returns
    -------
    color : ndarray, (..., 3)
        Radiance, float32.
    depth : ndarray, (...)
        Planar depth at the ray's time, float32.

    Raises
    ------
    SampleError
        When no plane, or the farthest one masked, is given, and for times outside ``[0, 1]``.
    """
    color, depth, _ = _trace(planes, lens, xy, uv, times)
    return color, depth


def _trace(
    planes: Sequence[Plane], lens: Lens, xy: npt.ArrayLike, uv: npt.ArrayLike, times: npt.ArrayLike
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.intp]]:
    """Trace rays as `trace` does; say also which of the planes each has hit, as an index ``(...)``."""
    swaps, stacks = _front_to_back(planes)
    xy = np.asarray(xy, np.float64)
    uv = np.asarray(uv, np.float64)
    shape = xy.shape[:-1]
    xy, uv = xy.reshape(-1, 2), uv.reshape(-1, 2)
    times = np.broadcast_to(np.asarray(times, np.float64), shape).ravel()
    on_shutter = (times >= 0) & (times <= 1)
    if not on_shutter.all():
        raise SampleError(
            f"times lie in [0, 1] over the shutter, got {times[~on_shutter][0]:g}", field="times"
        )

    color = np.empty((len(xy), 3), np.float32)
    depth = np.empty(len(xy), np.float32)
    which = np.empty(len(xy), np.intp)
    period = np.searchsorted(swaps, times, side="right")
    for number, stack in enumerate(stacks):
        rays = np.flatnonzero(period == number)
        for index in stack:
            plane, now = planes[index], times[rays]
            distance = plane.depth_at(now)
            seen = plane.at_start(xy[rays] - lens.slope(distance)[:, None] * uv[rays], now)
            hit = np.ones(len(seen), bool) if plane.mask is None else np.asarray(plane.mask(seen), bool)
            color[rays[hit]] = plane.color(seen[hit])
            depth[rays[hit]] = distance[hit]
            which[rays[hit]] = index
            rays = rays[~hit]
    return color.reshape(*shape, 3), depth.reshape(shape), which.reshape(shape)


def _front_to_back(planes: Sequence[Plane]) -> tuple[Floats, list[list[int]]]:
    """Order planes by depth at all times.

    Depths change linearly, so the order only changes when two planes pass through each other.

    Parameters
    ----------
    planes : sequence of Plane
        In any order.

    Returns
    -------
    swaps : ndarray, (N,)
        Times within the shutter at which planes pass through each other, ascending.
    stacks : list of N + 1 lists
        Indices into `planes`, near to far, before, between and after those times.

    Raises
    ------
    SampleError
        When the farthest plane is masked at any time, or when there is no plane.
    """
    depth = np.array([plane.depth for plane in planes])
    change = np.array([plane.motion[2] for plane in planes])
    first, second = np.nonzero(change[:, None] > change)
    meeting = (depth[second] - depth[first]) / (change[first] - change[second])
    swaps: Floats = np.unique(meeting[(meeting > 0) & (meeting < 1)])
    ends = [0.0, *swaps, 1.0]
    stacks = []
    for start, end in itertools.pairwise(ends):
        stack = np.argsort(depth + (start + end) / 2 * change, kind="stable").tolist()
        if not stack or planes[stack[-1]].mask is not None:
            raise SampleError(
                "the farthest plane must cover everything, at all times: add one without a mask behind the "
                "others",
                field="planes",
            )
        stacks.append(stack)
    return swaps, stacks


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
    motion: Motion = (0.0, 0.0, 0.0),
    shutter: tuple[float, float] = (0.0, 1.0),
    pixel_filter: PixelFilter = "gaussian",
    sigma_pix: float = 0.5,
) -> Image:
    """Exact image of an unmasked plane of waves.

    Integrating over a point-symmetric aperture and pixel filter leaves each wave's frequency and phase alone
    and multiplies its amplitude by the Fourier transforms of the two, the aperture's being taken at
    ``C(depth)`` times the frequency. At any moment a moving plane still shows waves, shifted and, where its
    depth changes, magnified; their mean over the shutter is a Gauss-Legendre quadrature, exact to rounding.

    Parameters
    ----------
    texture : Waves
        What the plane is painted with.
    depth : float
        Of the plane, at t = 0.
    lens, height, width, shutter, pixel_filter, sigma_pix
        As in `reference`.
    motion : (float, float, float)
        As in `Plane`.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32, without noise.

    Raises
    ------
    SampleError
        For a size that is not positive, an unknown pixel filter, a depth or a motion that `Plane` rejects
        and a shutter outside ``[0, 1]``.
    """
    _check_size(height=height, width=width)
    _check_filter(pixel_filter, sigma_pix)
    _check_shutter(shutter)
    plane = Plane(depth, texture, motion=motion)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    image = np.zeros((height, width, 3))
    for time, weight in zip(*_shutter_nodes(plane, texture, lens, (height, width), shutter), strict=True):
        seen = _snapshot(texture, plane, time)
        if pixel_filter == "gaussian":
            pixel = np.exp(-2 * (np.pi * sigma_pix) ** 2 * np.square(seen.frequency).sum(axis=-1))
        else:
            pixel = np.sinc(seen.frequency).prod(axis=-1)
        aperture = _aperture_transform(lens, float(lens.slope(plane.depth_at(time))) * seen.frequency)
        blurred = replace(seen, amplitude=(pixel * aperture)[:, None] * seen.amplitude)
        image += weight * blurred(np.stack([x, y], axis=-1))
    return image.astype(np.float32)


def _snapshot(texture: Waves, plane: Plane, time: float) -> Waves:
    """Waves that the lens centre sees at a time where `texture` is what it saw at t = 0."""
    along = np.asarray(plane.motion[:2])
    phase = texture.phase - 2 * np.pi * time / plane.depth * (texture.frequency @ along)
    magnified = texture.frequency * (plane.depth_at(time) / plane.depth)
    return replace(texture, frequency=magnified, phase=phase)


def _shutter_nodes(
    plane: Plane, texture: Waves, lens: Lens, size: tuple[int, int], shutter: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Choose times and weights of a quadrature over the shutter that resolves what passes by any pixel.

    A pixel's radiance is a sum of waves over time. Their frequencies are bounded by how fast the texture
    passes the pixel's centre, and, because the blur circle scaled back to t = 0 is linear in time, by how
    fast the rim of the lens and the pixel's edges sweep over the texture.
    """
    opens, closes = shutter
    if not plane.moves or opens == closes:
        return np.array([opens]), np.ones(1)
    height, width = size
    corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
    passing = np.abs((corners * plane.motion[2] - plane.motion[:2]) @ texture.frequency.T).max(initial=0)
    spread = (abs(lens.c1) + 1) * abs(plane.motion[2]) * np.hypot(*texture.frequency.T).max(initial=0)
    cycles = (closes - opens) * (passing + math.sqrt(2) * spread) / plane.depth
    nodes, weights = np.polynomial.legendre.leggauss(24 + 4 * math.ceil(cycles))
    return opens + (closes - opens) * (nodes + 1) / 2, weights / 2


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


def _check_shutter(shutter: tuple[float, float]) -> None:
    opens, closes = shutter
    require_option(
        "shutter", shutter, 0 <= opens <= closes <= 1, "(open, close) with 0 <= open <= close <= 1"
    )
