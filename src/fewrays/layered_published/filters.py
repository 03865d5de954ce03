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

Two things differ from the paper. It has a Gaussian lens only: a disc becomes the Gaussian of equal second
moment, which changes a blurred point's shape but not its size. And importance samples are never weighted up,
because dividing by their density would let the few samples near the rim outweigh all others: the lens filter
is made no wider than the density.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens, Sampling

__all__ = ["FilterFamily", "FilterRule", "LayerFilter", "axis_aligned_filter", "layer_taps", "sheared_filter"]

FilterFamily = Literal["sheared", "axis-aligned"]
"""The paper's sheared filters, or Mehta et al.'s axis-aligned ones."""


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
class FilterRule:
    """What a layer's filter depends on besides its slopes.

    Parameters
    ----------
    family : {"sheared", "axis-aligned"}
        The paper's filters, or Mehta et al.'s.
    sigma_pix : float
        Standard deviation of the Gaussian pixel filter in pixels.
    sigma_u : float
        Standard deviation of the aperture along one axis, in lens units.
    max_sigma_x : float
        Largest screen-space extent of a filter, in pixels.
    sampling : {"disc", "square", "gaussian"}
        Density of the lens positions.
    sampling_sigma : float
        Standard deviation of a Gaussian density.
    k : float
        Divisor of the axis-aligned filter's width (section 7).
    """

    family: FilterFamily
    sigma_pix: float
    sigma_u: float
    max_sigma_x: float
    sampling: Sampling
    sampling_sigma: float
    k: float = 2.0

    @classmethod
    def for_lens(
        cls, lens: Lens, family: FilterFamily, *, sigma_pix: float, max_sigma_x: float, k: float = 2.0
    ) -> FilterRule:
        """Collect a lens's numbers; a disc is replaced by the Gaussian of equal second moment."""
        return cls(family, sigma_pix, lens.gaussian_sigma, max_sigma_x, lens.sampling, lens.sigma, k)

    @property
    def density_precision(self) -> float:
        """Reciprocal variance of a Gaussian sampling density, in lens units⁻²; 0 for a uniform one."""
        return 1 / self.sampling_sigma**2 if self.sampling == "gaussian" else 0.0

    def filter(self, c_min: float, c_max: float) -> LayerFilter:
        """Return the filter of a layer with slopes from `c_min` to `c_max`, in pixels per lens unit."""
        make = axis_aligned_filter if self.family == "axis-aligned" else sheared_filter
        return make(c_min, c_max, self)


def sheared_filter(c_min: float, c_max: float, rule: FilterRule) -> LayerFilter:
    """Derive the sheared filter of a layer (section 3.3, 3.4 and 3.6).

    Parameters
    ----------
    c_min, c_max : float
        The layer's slopes, ``c_min <= c_max``, in pixels per lens unit.
    rule : FilterRule
        Pixel filter, aperture and sampling.

    Returns
    -------
    LayerFilter
    """
    sigma_u, sigma_pix = rule.sigma_u, rule.sigma_pix
    if max(-c_min, c_max) < sigma_pix / sigma_u:  # small shear, Eq. 27 to 29
        eta = 0.5 * (c_min + c_max)
        lens_precision = ((c_max - c_min) / (2 * sigma_pix)) ** 2
        sigma_screen = sigma_pix
    elif c_min * c_max <= 0:  # wide wedge, Eq. 11
        eta = 0.0
        lens_precision = 1 / sigma_u**2
        sigma_screen = sigma_pix
    else:
        # Eq. 12 and 16 give sigma_x = 1 / (π W) with W = |1/c_min - 1/c_max| / (2π sigma_u); written with the
        # product of the slopes it is infinite only for a single slope.
        product, spread = c_min * c_max, c_max - c_min
        unlimited = product >= rule.max_sigma_x * spread / (2 * sigma_u)
        sigma_x = rule.max_sigma_x if unlimited else 2 * sigma_u * product / spread
        # Eq. 22, in terms of s = sigma_x / c_avg with c_avg of Eq. 13.
        s = sigma_x * (c_min + c_max) / (2 * product)
        gamma2 = sigma_u**2 + s**2
        eta = s * sigma_x / gamma2
        lens_precision = 1 / gamma2
        sigma_screen = max(sigma_x * sigma_u / math.sqrt(gamma2), sigma_pix)

    lens_precision = max(lens_precision, rule.density_precision)
    return LayerFilter(eta, sigma_screen**2, 0.5 * (lens_precision - rule.density_precision))


def axis_aligned_filter(c_min: float, c_max: float, rule: FilterRule) -> LayerFilter:
    """Derive the axis-aligned filter of a layer, after Mehta et al. 2012 (section 3.7 and 7).

    The samples are integrated over the aperture, then blurred by the counterpart of the band limit
    ``Ω_u / min|c|``, divided by ``k`` and no narrower than the pixel filter.
    """
    nearest = 0.0 if c_min <= 0 <= c_max else min(abs(c_min), abs(c_max))
    sigma = min(max(nearest * rule.sigma_u / rule.k, rule.sigma_pix), rule.max_sigma_x)
    falloff = 0.5 * max(1 / rule.sigma_u**2 - rule.density_precision, 0.0)
    return LayerFilter(0.0, sigma**2, falloff)


def layer_taps(variance: float, radius: int) -> npt.NDArray[np.float64]:
    """Sample the screen-space Gaussian of a layer at whole pixels, cut it off and normalise it.

    Parameters
    ----------
    variance : float
        In pixels², above 0.
    radius : int
        Largest tap distance in pixels.

    Returns
    -------
    ndarray, (radius + 1,)
        Taps at distances 0, 1, …, radius; a kernel uses each but the first twice.
    """
    taps = np.exp(-(np.arange(radius + 1, dtype=np.float64) ** 2) / (2 * variance))
    return np.asarray(taps / (taps[0] + 2 * taps[1:].sum()))
