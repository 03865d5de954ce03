"""Sheared filters for one depth layer (layered, section 3).

A layer holds slopes between ``c_min`` and ``c_max`` (pixels per lens unit; this project's sign: a sample at
image position x and lens position u belongs to ``x - c u`` at the lens centre, where the paper writes
``x + c u``). Its filter is a Gaussian over the lens times a Gaussian over the screen, sheared in x:

    w(x, u) = N(x - eta u; sigma_screen) · exp(-falloff |u|²)

so that it can be evaluated as a pre-integration (scatter every sample to ``x - eta u``) followed by a
separable blur (section 3.5). This module derives eta, sigma_screen and falloff in three cases:

- *small shear*, the layer's largest ``|c|`` below ``Ω_u / Ω_pix = sigma_pix / sigma_u``: Eq. 26 to 29;
- *sheared*: Eq. 12 to 16, with the axes transformed by Eq. 22;
- *axis-aligned*, when the layer spans the focal plane: Eq. 11.

**Matched widths.** The paper's filter bounds the spectrum by the pixel's or the aperture's band limit,
whichever is tighter, so a defocused point comes out narrower than pixel filter and aperture together make it.
Lens samples that end at the rim, bins of one pixel and a tile ring that cuts the kernel add errors of their
own. All of these are errors of the second moment, and the screen-space filter can absorb them: scattering a
plane of slope c leaves a residual shear ``c - eta`` over the lens, so the image of a point has the variance

    sigma_screen² + (c - eta)² · m(lens filter),    to equal    sigma_pix² + c² · m(aperture),

with m the second moment along one axis. ``screen_filter="matched"`` solves this at the layer's central slope;
``"paper"`` keeps the published widths.

**Bins.** Samples are rounded to bins before the blur. Bins of a pixel, as published, are too coarse for a
filter of half a pixel: it becomes a staircase, and edges in focus suffer. A matched filter uses bins finer
than its standard deviation, subtracts their variance from the blur, and ends the blur at four standard
deviations.

**Occluded layers.** A wide filter takes a surface point's radiance from rays through other parts of the lens
than the pixel's own. Where another layer covers part of the lens, those rays are not the ones that the pixel
sees, and their mean is the wrong one (the product of means in Eq. 34). A narrow ``sigma_x`` keeps to the
pixel's own rays, at the price of noise, so its limit falls from `max_sigma_x` to `occluded_sigma_x` as the
layer gets covered: see `FilterRule.sigma_x_limit`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens, Sampling

__all__ = [
    "FilterRule",
    "LayerFilter",
    "ScreenKernel",
    "axis_aligned_filter",
    "central_slope",
    "covering_share",
    "screen_taps",
    "sheared_filter",
]

Float64 = npt.NDArray[np.float64]

BIN_VARIANCE = 1.0 / 12.0
"""Second moment of the bin that a sample is rounded to, in bins²."""


@dataclass(frozen=True)
class LayerFilter:
    """The filter of one layer.

    Parameters
    ----------
    eta : float
        Shear: samples are scattered to ``xy - eta * uv``; pixels per lens unit.
    variance : float
        Second moment of the screen-space filter along one axis, in pixels².
    falloff : float
        A sample at lens radius r weighs ``exp(-falloff r²)``, sampling density already divided out.
    """

    eta: float
    variance: float
    falloff: float


@dataclass(frozen=True)
class ScreenKernel:
    """The discrete screen-space filter of one layer.

    Parameters
    ----------
    bins_per_pixel : int
        Odd, so that a pixel's centre is the centre of a bin.
    taps : ndarray, (radius + 1,)
        Weights of the bins at distances 0, 1, …, radius; a kernel uses each but the first twice.
    """

    bins_per_pixel: int
    taps: Float64

    @property
    def radius(self) -> int:
        """Distance of the farthest bin, in bins."""
        return len(self.taps) - 1


@dataclass(frozen=True)
class FilterRule:
    """What a layer's filter depends on besides its slopes.

    Parameters
    ----------
    family : {"paper", "matched", "axis-aligned"}
        The published sheared filters, the same with matched widths (see the module), or Mehta et al.'s
        axis-aligned filter.
    sigma_pix : float
        Standard deviation of the Gaussian pixel filter in pixels.
    sigma_u : float
        Standard deviation of the aperture along one axis, in lens units.
    max_sigma_x : float
        Largest screen-space extent of a sheared filter, in pixels.
    occluded_sigma_x : float
        The same for a layer that others cover, at most `max_sigma_x`.
    sampling : {"disc", "square", "gaussian"}
        Density of the lens positions.
    sampling_sigma : float
        Standard deviation of a Gaussian density.
    aperture_moment : float
        Second moment of the aperture along one axis, in lens units².
    k : float
        Divisor of the axis-aligned filter's width (section 7).
    """

    family: Literal["paper", "matched", "axis-aligned"]
    sigma_pix: float
    sigma_u: float
    max_sigma_x: float
    occluded_sigma_x: float
    sampling: Sampling
    sampling_sigma: float
    aperture_moment: float
    k: float = 2.0

    @classmethod
    def for_lens(
        cls,
        lens: Lens,
        family: Literal["paper", "matched", "axis-aligned"],
        *,
        sigma_pix: float,
        max_sigma_x: float,
        occluded_sigma_x: float | None = None,
        k: float = 2.0,
    ) -> FilterRule:
        """Collect a lens's numbers; a disc is replaced by the Gaussian of equal second moment."""
        sigma_u = lens.gaussian_sigma
        moment = lens_moment(1 / sigma_u**2, "square") if lens.aperture == "gaussian" else sigma_u**2
        occluded = max_sigma_x if occluded_sigma_x is None else min(occluded_sigma_x, max_sigma_x)
        return cls(family, sigma_pix, sigma_u, max_sigma_x, occluded, lens.sampling, lens.sigma, moment, k)

    @property
    def density_precision(self) -> float:
        """Reciprocal variance of a Gaussian sampling density, in lens units⁻²; 0 for a uniform one."""
        return 1 / self.sampling_sigma**2 if self.sampling == "gaussian" else 0.0

    def sigma_x_limit(self, occlusion: float) -> float:
        """Largest ``sigma_x`` in pixels of a layer of which others cover the share `occlusion`."""
        uncovered = max(0.0, 1 - occlusion / _FULLY_OCCLUDED)
        return self.occluded_sigma_x + (self.max_sigma_x - self.occluded_sigma_x) * uncovered

    def kernel(self, variance: float, ring: int) -> ScreenKernel:
        """Return the discrete filter of that variance (pixels²) which reaches at most `ring` pixels."""
        if self.family == "paper":
            return ScreenKernel(1, screen_taps(variance, ring, exact=False))
        sigma = math.sqrt(variance)
        bins = next(
            (count for count in _BINS_PER_PIXEL if count * sigma >= _BINS_PER_SIGMA), _BINS_PER_PIXEL[-1]
        )
        radius = min(math.ceil(_SIGMAS * sigma * bins), ring * bins)
        return ScreenKernel(bins, screen_taps(variance * bins**2 - BIN_VARIANCE, radius, exact=True))

    def filter(self, c_min: float, c_max: float, occlusion: float = 0.0) -> LayerFilter:
        """Return the filter of a layer with slopes from `c_min` to `c_max`, in pixels per lens unit."""
        if self.family == "axis-aligned":
            return axis_aligned_filter(c_min, c_max, self)
        return sheared_filter(c_min, c_max, self, self.sigma_x_limit(occlusion))


def sheared_filter(c_min: float, c_max: float, rule: FilterRule, sigma_x_limit: float) -> LayerFilter:
    """Derive the sheared filter of a layer (section 3.3, 3.4 and 3.6).

    Parameters
    ----------
    c_min, c_max : float
        The layer's slopes, ``c_min <= c_max``, in pixels per lens unit.
    rule : FilterRule
        Pixel filter, aperture and sampling.
    sigma_x_limit : float
        Largest screen-space extent, in pixels.

    Returns
    -------
    LayerFilter
    """
    sigma_u, sigma_pix = rule.sigma_u, rule.sigma_pix
    if max(-c_min, c_max) < sigma_pix / sigma_u:  # small shear, Eq. 27 to 29
        center = eta = 0.5 * (c_min + c_max)
        lens_precision = ((c_max - c_min) / (2 * sigma_pix)) ** 2
        sigma_screen = sigma_pix
    elif c_min < 0 < c_max:  # wide wedge, Eq. 11
        center = eta = 0.0
        lens_precision = 1 / sigma_u**2
        sigma_screen = sigma_pix
    else:
        # Eq. 12 and 16 give sigma_x = 1 / (π W) with W = |1/c_min - 1/c_max| / (2π sigma_u); written with the
        # product of the slopes it has no pole at the focal plane, and is infinite only for a single slope.
        product, spread = c_min * c_max, c_max - c_min
        unlimited = product >= sigma_x_limit * spread / (2 * sigma_u)
        sigma_x = sigma_x_limit if unlimited else 2 * sigma_u * product / spread
        center = central_slope(c_min, c_max)
        # Eq. 22, in terms of s = sigma_x / c_avg so that sigma_x = 0 needs no case of its own.
        s = sigma_x / center if center else 0.0
        gamma2 = sigma_u**2 + s**2
        eta = s * sigma_x / gamma2
        lens_precision = 1 / gamma2
        sigma_screen = max(sigma_x * sigma_u / math.sqrt(gamma2), sigma_pix)

    # Dividing by the density of importance samples would let the few samples near the rim outweigh all
    # others. The lens filter is therefore never made wider than the density.
    lens_precision = max(lens_precision, rule.density_precision)
    falloff = 0.5 * (lens_precision - rule.density_precision)

    if rule.family == "paper":
        return LayerFilter(eta, sigma_screen**2, falloff)
    residual = (center - eta) ** 2 * lens_moment(lens_precision, rule.sampling)
    variance = sigma_pix**2 + center**2 * rule.aperture_moment - residual
    return LayerFilter(eta, variance, falloff)


def axis_aligned_filter(c_min: float, c_max: float, rule: FilterRule) -> LayerFilter:
    """Derive the axis-aligned filter of a layer, after Mehta et al. 2012 (section 3.7 and 7).

    The samples are integrated over the aperture, then blurred by the counterpart of the band limit
    ``Ω_u / min|c|``, divided by ``k`` and no narrower than the pixel filter.
    """
    nearest = 0.0 if c_min <= 0 <= c_max else min(abs(c_min), abs(c_max))
    sigma = min(max(nearest * rule.sigma_u / rule.k, rule.sigma_pix), rule.max_sigma_x)
    falloff = 0.5 * max(1 / rule.sigma_u**2 - rule.density_precision, 0.0)
    return LayerFilter(0.0, sigma**2, falloff)


def central_slope(c_min: float, c_max: float) -> float:
    """Return the central slope of a layer (Eq. 13) in pixels; 0 where it spans the focal plane."""
    product = c_min * c_max
    return 2 * product / (c_min + c_max) if product > 0 else 0.0


def covering_share(front: float, center: float) -> float:
    """Return how much a sample of slope `front` counts as a cover of a layer of slope `center`, 0 to 1.

    Going from one lens point to another, the cover moves over the layer by ``|front - center|`` where the
    layer itself moves by ``|center|``: covers of about the same slope stay where they are, so that
    neighbouring layers of one slanted surface hardly count. From twice the layer's own motion on, they count
    in full.
    """
    return min(1.0, 0.5 * abs(front - center) / abs(center)) if center else 1.0


def lens_moment(precision: float, sampling: Sampling) -> float:
    """Second moment, along one axis, of a Gaussian over the lens that ends where the samples do.

    Parameters
    ----------
    precision : float
        Reciprocal variance of the unbounded Gaussian, >= 0, in lens units⁻².
    sampling : {"disc", "square", "gaussian"}
        The support: the unit disc, or the square ``[-1, 1]²``.

    Returns
    -------
    float
        In lens units²; 1/4 (disc) and 1/3 (square) for ``precision = 0``.
    """
    if sampling == "disc":
        # ∫ r³ exp(-b r²) dr / 2∫ r exp(-b r²) dr over [0, 1], with b = precision / 2.
        b = 0.5 * precision
        if b < 1e-2:
            return 0.25 - b / 24  # the closed form cancels here; the next term is b³ / 1440
        return 0.5 * (1 / b - 1 / math.expm1(b))
    if precision < 0.05:
        return 1 / 3 - 2 / 45 * precision + 2 / 945 * precision**2  # the closed form cancels here as well
    edge = (
        math.sqrt(2 * precision / math.pi) * math.exp(-0.5 * precision) / math.erf(math.sqrt(precision / 2))
    )
    return (1 - edge) / precision


def screen_taps(variance: float, radius: int, *, exact: bool) -> Float64:
    """Sample a Gaussian of the given variance, cut it off at `radius` bins and normalise it.

    Parameters
    ----------
    variance : float
        In bins²; nothing or less gives a single tap.
    radius : int
        Largest tap distance in bins.
    exact : bool
        Choose the Gaussian so that the *discrete, cut-off* kernel has this variance; otherwise sample the
        Gaussian of this variance.

    Returns
    -------
    ndarray, (radius + 1,)
        Taps at distances 0, 1, …, radius; a kernel uses each but the first twice.
    """
    distance2 = np.arange(radius + 1, dtype=np.float64) ** 2
    twice = np.where(distance2 > 0, 2.0, 1.0)
    if variance < _POINT_VARIANCE:
        return np.where(distance2 > 0, 0.0, 1.0)
    t = _exponent_of_variance(variance, distance2, twice) if exact else 1 / (2 * variance)
    taps = np.exp(-t * distance2)
    return np.asarray(taps / (taps * twice).sum())


def _exponent_of_variance(variance: float, distance2: Float64, twice: Float64) -> float:
    """Find t for which taps exp(-t d²) have the given variance, by Newton's method on its reciprocal.

    The reciprocal variance is convex and increasing in t: nearly 2 t for wide kernels, and for narrow ones,
    of three taps, exactly 1 + exp(t) / 2. One of the two roots starts close to the truth.
    """
    if variance >= float((twice * distance2).sum() / twice.sum()):
        return 0.0
    t = 1 / (2 * variance) if variance > 0.5 else min(1 / (2 * variance), math.log(2 / variance))
    for _ in range(_NEWTON_STEPS):
        taps = twice * np.exp(-t * distance2)
        total = taps.sum()
        second = float((taps * distance2).sum() / total)
        fourth = float((taps * distance2**2).sum() / total)
        slope = (fourth - second**2) / second**2
        t = max(t - (1 / second - 1 / variance) / slope, 0.0)
    return t


_NEWTON_STEPS = 12
_POINT_VARIANCE = 1e-9  # bins²; a kernel this narrow is a single tap
_BINS_PER_PIXEL = (1, 3, 5)
_BINS_PER_SIGMA = 1.6
_SIGMAS = 4.0
_FULLY_OCCLUDED = 0.3  # the share of covering samples from which a layer counts as covered
