"""Pixel filters: what a pixel averages over, and where to look for it.

All are separable. A filter is used in two ways: as a *weight*, where samples lie where they lie, and by its
*offsets*, where the caller may choose the positions: drawn in proportion to the filter's absolute value they
need no weight but a sign (importance sampling). That leaves evenly spread positions evenly spread.

References
----------
.. [1] F. J. Harris. "On the use of windows for harmonic analysis with the discrete Fourier transform".
   Proceedings of the IEEE 66 (1), 1978. DOI:10.1109/PROC.1978.10837
.. [2] D. P. Mitchell, A. N. Netravali. "Reconstruction filters in computer graphics". SIGGRAPH 1988.
   DOI:10.1145/54852.378514
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import require_option

__all__ = ["PixelFilter", "PixelFilterShape"]

PixelFilterShape = Literal["box", "gaussian", "blackman-harris", "mitchell"]
Float64 = npt.NDArray[np.float64]

_KNOTS = 4096  # of the distribution of offsets; linear between them
_TAIL = 8.0  # standard deviations beyond which a Gaussian holds nothing


@dataclass(frozen=True)
class PixelFilter:
    """A separable pixel filter; the factor along one axis.

    Parameters
    ----------
    shape : {"box", "gaussian", "blackman-harris", "mitchell"}
        The pixel's own square; a Gaussian cut off at 3 sigma (1.5 px at least); the four-term Blackman-Harris
        window, 4 px wide [1]_; or the cubic of Mitchell and Netravali with B = C = 1/3, 4 px wide, whose
        negative lobes sharpen [2]_.
    sigma_pix : float
        Standard deviation of the Gaussian in pixels, 0.01 to 4.

    Raises
    ------
    SampleError
        For an unknown shape or a sigma out of range.
    """

    shape: PixelFilterShape = "box"
    sigma_pix: float = 0.5

    def __post_init__(self) -> None:
        shapes = get_args(PixelFilterShape)
        require_option("pixel_filter", self.shape, self.shape in shapes, f"out of {', '.join(shapes)}")
        require_option("sigma_pix", self.sigma_pix, 0.01 <= self.sigma_pix <= 4.0, "from 0.01 to 4 px")

    @property
    def radius(self) -> float:
        """Distance from the pixel's centre beyond which the filter is 0, in pixels."""
        if self.shape == "gaussian":
            return max(1.5, 3 * self.sigma_pix)
        return 0.5 if self.shape == "box" else 2.0

    @property
    def reach(self) -> int:
        """How many pixels to each side of its own a sample can touch."""
        return math.ceil(self.radius - 0.5)

    def weight(self, x: npt.ArrayLike) -> Float64:
        """Return the filter's factor along one axis.

        Parameters
        ----------
        x : array_like
            Distances from the pixel's centre in pixels, of any sign.

        Returns
        -------
        ndarray
            Factors with the shape of `x`, up to a scale that depends on the filter only; 0 beyond `radius`.
        """
        x = np.abs(np.asarray(x, np.float64))
        if self.shape == "box":
            value = np.ones_like(x)
        elif self.shape == "gaussian":
            value = np.exp(-0.5 * (x / self.sigma_pix) ** 2)
        elif self.shape == "blackman-harris":
            value = _blackman_harris(np.minimum(x, 2.0) / 2)
        else:
            value = _mitchell_netravali(np.minimum(x, 2.0))
        return np.where(x <= self.radius, value, 0.0)

    def offsets(self, xi: npt.ArrayLike) -> tuple[Float64, Float64]:
        """Turn uniform numbers into positions along one axis, by the distribution of the filter's magnitude.

        Parameters
        ----------
        xi : array_like
            Numbers in [0, 1). The order is kept: larger numbers lie further right.

        Returns
        -------
        offset : ndarray
            Distances from the pixel's centre in pixels, with the shape of `xi`.
        weight : ndarray
            Weights of the same shape: the filter's sign, scaled such that the mean over uniform numbers is 1.
            The mean of weight times f(offset) tends to the filtered f. 1 throughout for filters without
            negative lobes.
        """
        shares, positions, scale = self._distribution
        offset = np.interp(np.asarray(xi, np.float64), shares, positions)
        return offset, np.copysign(scale, self.weight(offset))

    @cached_property
    def _distribution(self) -> tuple[Float64, Float64, float]:
        """Shares of the magnitude to the left of positions, these, and magnitude over signed integral."""
        end = min(self.radius, _TAIL * self.sigma_pix) if self.shape == "gaussian" else self.radius
        positions = np.linspace(-end, end, 2 * _KNOTS + 1)
        weight = self.weight(positions)

        def simpson(values: Float64) -> Float64:
            return values[:-2:2] + 4 * values[1::2] + values[2::2]

        magnitude = np.cumsum(simpson(np.abs(weight)))
        shares = np.concatenate([[0], magnitude]) / magnitude[-1]
        scale = magnitude[-1] / simpson(weight).sum() if weight.min() < 0 else 1.0
        return shares, positions[::2], float(scale)


def _blackman_harris(x: Float64) -> Float64:
    """Four-term window with side lobes below -92 dB, 1 at x = 0 and almost 0 at x = 1."""
    terms = np.cos(np.multiply.outer(x, math.pi * np.arange(4)))
    window: Float64 = terms @ np.array([0.35875, 0.48829, 0.14128, 0.01168])
    return window


def _mitchell_netravali(x: Float64) -> Float64:
    """Piecewise cubic with B = C = 1/3, over |x| up to 2 px; its integral is 1."""
    inner = (7 / 6) * x**3 - 2 * x**2 + 8 / 9
    outer = -(7 / 18) * x**3 + 2 * x**2 - (10 / 3) * x + 16 / 9
    return np.where(x < 1, inner, outer)
