"""Sheared reconstruction for defocus and motion, after Egan et al. 2009: one direction per pixel, or none.

Egan et al. (*Frequency Analysis and Sheared Reconstruction for Rendering Motion Blur*) show that where
everything moves alike the spectrum of the moving image is a thin sheared wedge, and give every pixel one
linear filter that is sheared along the motion, so that samples of many pixels and all times serve it. Where
neighbouring velocities differ no such filter exists and theirs falls back to an ordinary axis-aligned one.
*Temporal* (section 6.1, Figures 16 and 17) does the same for defocus, with slopes in the place of velocities,
and finds that about 30 % of the pixels of a defocused scene can be sheared. From the 2009 paper this module
takes just that: bounds of the velocity per pixel, a shear along the first-order direction, Gaussian shutter
and lens, and the fall-back. The details below are our own.

*The filter.* Where all samples share a slope C and a screen velocity V, a sample at image position x, lens
position u and time t is the surface's point ``y = x - C u - V (t - 1/2)``. The blurred pixel p is the texture
seen through a Gaussian of the covariance

    Σ = (σ_pix² + C² σ_u²) I + σ_t² V Vᵀ        [pixels²]

around p: pixel filter, lens and shutter together, which is as wide as the bandwidth that the blur leaves
allows. So a sample weighs ``N(p - y; Σ)``, whatever its lens position and time are. This is the limit of the
wedge filters as the wedge closes. It needs no samples beyond the lens and the shutter, which wider wedges
do. A disc lens and a box shutter are replaced by Gaussians of equal second moments, as the model demands:
the paper names this as a source of error, and it stays one here.

*Where it is used.* A pixel takes the middle of its own samples' slopes and velocities. All samples that the
filter may touch must then be alike: Σ computed from any of their C and V may differ by no more than
`tolerance` times itself, along the motion and across it. Otherwise, and where a footprint is larger than
`max_radius`, the pixel is the plain average under the pixel filter and the true aperture. A sample that comes
from behind the lens during the shutter, or whose radiance holds for less than a lens radius (`bandwidth`),
is alike to none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from fewrays.baselines.accumulation import Accumulator
from fewrays.baselines.box import divide_and_fill
from fewrays.errors import require_option
from fewrays.method import Image, Method, Reconstruction
from fewrays.parallel import Execution, map_ranges
from fewrays.pixel_filter import PixelFilter
from fewrays.samples import SampleBuffer

__all__ = ["METHOD", "ShearedOptions"]

Float32 = npt.NDArray[np.float32]

_SIGMA_T = math.sqrt(1 / 12)  # standard deviation of a box shutter, in shutter lengths
_REACH = 3.0  # standard deviations at which the Gaussian is cut off
_LEAST_BANDWIDTH = 1.0  # lens radii
_BLOCK = 8  # pixels a side that look for their samples together
_PAIRS = 2**20  # of pixels and samples that are weighed at once, so that temporary arrays stay in cache


@dataclass(frozen=True)
class ShearedOptions:
    """Options of the sheared filter.

    Parameters
    ----------
    sigma_pix : float
        Standard deviation of the pixel filter in pixels.
    tolerance : float
        Largest relative error of the variance of a pixel's blur, were all its samples those whose slope and
        velocity differ most; beyond it the pixel is filtered axis-aligned. Few samples differ that much: on
        renders with defocus 0.5 costs no accuracy, and shears the paper's share of the pixels.
    max_radius : int
        Largest distance in pixels that a sample may come from; bounds the cost.
    """

    sigma_pix: float = 0.5
    tolerance: float = 0.5
    max_radius: int = 64

    def __post_init__(self) -> None:
        require_option("sigma_pix", self.sigma_pix, 0 < self.sigma_pix < 100, "above 0 and below 100 px")
        require_option("tolerance", self.tolerance, 0 <= self.tolerance <= 1, "from 0 to 1")
        require_option("max_radius", self.max_radius, 1 <= self.max_radius <= 1024, "from 1 to 1024 px")


def run(samples: SampleBuffer, options: ShearedOptions, execution: Execution) -> Reconstruction:
    """Filter every pixel along its shear where it has one; see the module's documentation."""
    image = _axis_aligned(samples, options)
    rays = _Rays.of(samples)
    shears = _Shears.of(rays.bounds, samples.lens.gaussian_sigma, options)
    radius = np.where(shears.radius <= options.max_radius, shears.radius, -1).astype(np.int64)
    sheared = (radius >= 0) & shears.hold(_window_bounds(rays.bounds, radius), options.tolerance)
    blocks = [
        (row, column)
        for row in range(0, samples.height, _BLOCK)
        for column in range(0, samples.width, _BLOCK)
        if sheared[row : row + _BLOCK, column : column + _BLOCK].any()
    ]

    def kernel(first: int, last: int) -> None:
        for row, column in blocks[first:last]:
            rows, columns = np.nonzero(sheared[row : row + _BLOCK, column : column + _BLOCK])
            pixels = (rows + row, columns + column)
            image[pixels] = _gather(rays, shears, pixels, int(radius[pixels].max()), image[pixels])

    map_ranges(kernel, len(blocks), execution, label="sheared")
    return Reconstruction(image, {"sheared": sheared.astype(np.float32)} if execution.aovs else {})


METHOD = Method(
    "sheared",
    "one sheared filter per pixel, axis-aligned where slopes or velocities differ (Egan et al. 2009)",
    ShearedOptions,
    ("cpu",),
    run,
)


@dataclass(frozen=True)
class _Rays:
    """The samples that lie in the image, sorted by pixel.

    Parameters
    ----------
    values : ndarray, (8, N)
        x and y in pixels, u, v, time from the middle of the shutter, and radiance.
    start : ndarray, (H W + 1,)
        Where each pixel's samples start.
    bounds : ndarray, (6, H, W)
        Least slope in pixels and least velocities along x and y in pixels per shutter of each pixel's samples
        over the shutter, then minus the largest ones; infinite where there are no samples.
    """

    values: Float32
    start: npt.NDArray[np.int64]
    bounds: Float32

    @classmethod
    def of(cls, samples: SampleBuffer) -> _Rays:
        """Sort a buffer's samples."""
        height, width = samples.height, samples.width
        place = np.floor(samples.xy.reshape(-1, 2))
        inside = ((place >= 0) & (place < (width, height))).all(axis=-1)
        column, row = place[inside].T.astype(np.int64)
        order = np.argsort(row * width + column, kind="stable")
        pixel = (row * width + column)[order]
        chosen = np.flatnonzero(inside)[order]

        time = (
            np.full(len(chosen), 0.5, np.float32)
            if samples.time is None
            else samples.time.reshape(-1)[chosen]
        )
        rays = np.concatenate([samples.xy, samples.uv], axis=-1).reshape(-1, 4)[chosen].T
        color = samples.color.reshape(-1, 3)[chosen].T
        values = np.concatenate([rays, time[None] - np.float32(0.5), color])

        bounds = np.full((6, height * width), np.inf, np.float32)
        ranges = _ranges(samples, chosen)
        first = np.flatnonzero(np.diff(pixel, prepend=-1))
        if len(first):
            bounds[:, pixel[first]] = np.minimum.reduceat(ranges, first, axis=1)
        start = np.searchsorted(pixel, np.arange(height * width + 1))
        return cls(values, start, bounds.reshape(6, height, width))


def _ranges(samples: SampleBuffer, chosen: npt.NDArray[np.int64]) -> Float32:
    """Return `_Rays.bounds` of single samples, (6, N); minus infinity for those that are alike to none."""
    depth = samples.depth.reshape(-1)[chosen]
    slope = samples.lens.slope(depth)
    ends = np.zeros((2, 3, len(chosen)), np.float32)  # slope and velocity at shutter open and close
    ends[:, 0] = slope
    alike = np.ones(len(chosen), bool)
    if samples.motion is not None:
        time = cast(Float32, samples.time).reshape(-1)[chosen]
        motion = samples.motion.reshape(-1, 3)[chosen].T
        centre = samples.xy.reshape(-1, 2)[chosen].T - slope * samples.uv.reshape(-1, 2)[chosen].T
        with np.errstate(all="ignore"):  # what passes the lens is sorted out below
            for end in (0, 1):
                w = depth + (end - time) * motion[2]
                position = (centre * depth + (end - time) * motion[:2]) / w
                ends[end, 0] = samples.lens.slope(w)
                # The derivative of the homogeneous position: d(p/w)/dt = (dp/dt - (p/w) dw/dt) / w.
                ends[end, 1:] = (motion[:2] - position * motion[2]) / w
                alike &= (w > 0) & np.isfinite(ends[end]).all(axis=0)
    if samples.bandwidth is not None:
        alike &= samples.bandwidth.reshape(-1)[chosen] >= _LEAST_BANDWIDTH
    ranges = np.concatenate([ends.min(axis=0), -ends.max(axis=0)])
    ranges[:, ~alike] = -np.inf
    return ranges


@dataclass(frozen=True)
class _Shears:
    """The filter that each pixel would have, were all samples around it alike; arrays are ``(H, W)``.

    Parameters
    ----------
    slope : ndarray
        Middle of the pixel's slopes, in pixels.
    velocity : ndarray, (2, H, W)
        Middle of its velocities, in pixels per shutter.
    across, along : ndarray
        Variances of the blur across and along the velocity, in pixels².
    radius : ndarray
        How many pixels away samples may lie that the filter touches; infinite where there is no filter.
    sigma_u : float
        Standard deviation of the aperture, in lens units.
    """

    slope: Float32
    velocity: Float32
    across: Float32
    along: Float32
    radius: Float32
    sigma_u: float

    @classmethod
    def of(cls, bounds: Float32, sigma_u: float, options: ShearedOptions) -> _Shears:
        """Derive the filters from the bounds of each pixel's samples."""
        alike = np.isfinite(bounds).all(axis=0)
        middle = np.where(alike, 0.5 * (bounds[:3] - np.where(alike, bounds[3:], 0)), 0)
        slope, velocity = middle[0], middle[1:]
        across = options.sigma_pix**2 + np.square(sigma_u * slope)
        along = across + _SIGMA_T**2 * np.square(velocity).sum(axis=0)
        reach = _REACH * np.sqrt(along) + np.abs(slope) + 0.5 * np.abs(velocity).max(axis=0)
        radius = np.where(alike, np.floor(reach + 0.5), np.inf)
        return cls(slope, velocity, across, along, radius, sigma_u)

    def hold(self, bounds: Float32, tolerance: float) -> npt.NDArray[np.bool_]:
        """Whether each filter is right, within the tolerance, for all samples with these bounds."""
        middle = np.concatenate([self.slope[None], self.velocity])
        with np.errstate(invalid="ignore"):
            spread = np.maximum(middle - bounds[:3], -bounds[3:] - middle)
            speed = np.hypot(*self.velocity)
            nx, ny = np.where(
                speed > 0, np.abs(self.velocity) / np.where(speed > 0, speed, 1), [[[1]], [[0]]]
            )
            lens = self.sigma_u**2 * spread[0] * (2 * np.abs(self.slope) + spread[0])
            across = spread[1] * ny + spread[2] * nx
            along = spread[1] * nx + spread[2] * ny
            # The change of Σ, bounded: C² and V Vᵀ to second order, seen from both directions.
            errors = (
                (lens + np.square(_SIGMA_T * across)) / self.across,
                (lens + _SIGMA_T**2 * along * (2 * speed + along)) / self.along,
            )
            result: npt.NDArray[np.bool_] = np.maximum(*errors) <= tolerance
        return result


def _window_bounds(bounds: Float32, radius: npt.NDArray[np.int64]) -> Float32:
    """Return the least bounds over a square of pixels around each, cut off at the image's borders.

    A square is the union of four whose side is a power of two; the minima over those are built by doubling.

    Parameters
    ----------
    bounds : ndarray, (6, H, W)
        Of each pixel.
    radius : ndarray, (H, W)
        Distance from a pixel to the sides of its square, in pixels; negative for no square.

    Returns
    -------
    ndarray, (6, H, W)
        Minus infinity where there is no square.
    """
    margin = int(max(radius.max(initial=0), 0))
    table = np.pad(bounds, ((0, 0), (margin, margin), (margin, margin)), constant_values=np.inf)
    result = np.full_like(bounds, -np.inf)
    side = 1
    while side <= 2 * margin + 1:
        rows, columns = np.nonzero((radius >= 0) & (side <= 2 * radius + 1) & (2 * radius + 1 < 2 * side))
        low, high = margin - radius[rows, columns], margin + radius[rows, columns] + 1 - side
        corners = [table[:, rows + i, columns + j] for i in (low, high) for j in (low, high)]
        result[:, rows, columns] = np.minimum.reduce(corners)
        table = np.minimum(table[:, :-side], table[:, side:])
        table = np.minimum(table[:, :, :-side], table[:, :, side:])
        side *= 2
    return result


def _gather(
    rays: _Rays,
    shears: _Shears,
    pixels: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
    radius: int,
    fallback: Image,
) -> Image:
    """Filter some pixels of one block.

    Parameters
    ----------
    rays, shears
        The samples and the filters.
    pixels : (ndarray, ndarray)
        Rows and columns of the n pixels.
    radius : int
        The largest of their filters'.
    fallback : ndarray, (n, 3)
        What a pixel is that no sample is near enough to.

    Returns
    -------
    ndarray, (n, 3)
    """
    height, width = shears.slope.shape
    rows, columns = pixels
    left, right = max(columns.min() - radius, 0), min(columns.max() + radius + 1, width)
    lines = range(max(rows.min() - radius, 0), min(rows.max() + radius + 1, height))
    spans = [slice(rays.start[line * width + left], rays.start[line * width + right]) for line in lines]
    near = np.concatenate([rays.values[:, span] for span in spans], axis=1)
    corner = np.array([columns.min(), rows.min()], np.float32)  # small numbers, for float32's sake
    near[:2] -= corner[:, None]
    color = np.ascontiguousarray(near[5:].T)
    result = fallback.copy()
    step = max(1, _PAIRS // max(1, near.shape[1]))
    for first in range(0, len(rows), step):
        part = (rows[first : first + step], columns[first : first + step])
        weight = _weights(near, shears, part, corner)
        total = weight.sum(axis=1)
        seen = total > 0
        result[first : first + step][seen] = (weight @ color)[seen] / total[seen, None]
    return result


def _weights(
    near: Float32,
    shears: _Shears,
    pixels: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
    corner: Float32,
) -> Float32:
    """Weigh samples (8, N) for pixels (n,): ``(n, N)``, the Gaussian of Σ at ``p - y``."""
    rows, columns = pixels
    slope, velocity = shears.slope[pixels], shears.velocity[:, pixels[0], pixels[1]]
    ones = np.ones_like(slope)
    centres = (columns + np.float32(0.5) - corner[0], rows + np.float32(0.5) - corner[1])
    dx, dy = (
        np.stack([centres[axis], -ones, slope, velocity[axis]], axis=1).astype(np.float32)
        @ np.stack([np.ones_like(near[0]), near[axis], near[2 + axis], near[4]])
        for axis in (0, 1)
    )
    # Σ⁻¹ = (I - σ_t² V Vᵀ / along) / across.
    across, along = shears.across[pixels][:, None], shears.along[pixels][:, None]
    motion = velocity[0][:, None] * dx + velocity[1][:, None] * dy
    squared = (dx * dx + dy * dy - np.float32(_SIGMA_T**2) / along * motion * motion) / across
    weight: Float32 = np.exp(np.float32(-0.5) * squared)
    weight[squared > _REACH**2] = 0
    return weight


def _axis_aligned(samples: SampleBuffer, options: ShearedOptions) -> Image:
    """Average samples under the pixel filter and the aperture; pixels without any are filled."""
    pixel_filter = PixelFilter("gaussian", options.sigma_pix)
    accumulator = Accumulator(samples.height, samples.width, pixel_filter)
    accumulator.add(samples)
    image = accumulator.image()
    if image.any(axis=-1).all():
        return image
    coverage = Accumulator(samples.height, samples.width, pixel_filter)
    coverage.add(replace(samples, color=np.ones_like(samples.color)))
    return divide_and_fill(image, coverage.image()[..., 0])
