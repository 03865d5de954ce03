"""Axis-aligned filtering (Mehta et al. 2012) for defocus, without layers: *layered*, sections 3.7 and 7.

In the frequency domain the light field around a pixel reaches up to ``Ω_u / min|C|`` along the image axes,
``Ω_u = 1 / (2π σ_u)`` being the lens's own limit: the lens blurs the rest away. So samples may be integrated
over the lens within each pixel first, and what noise is left may be smoothed by a Gaussian in the image with

    σ = max(σ_pix, min|C| σ_u / k)        [pixels]

whose spectrum covers that band; `k` above 1 keeps more of the tail that the Gaussian lens leaves. The band is
the bounding box of a thin sheared spectrum, so the filter is narrower, and noisier, than a sheared one.

``min|C|`` is taken over the samples of a pixel. One pixel beside a focused edge may hold no focused sample
and yet have a wide filter that gathers the edge's other side; σ is therefore limited to grow by at most 1/3
per pixel of distance from any sharper pixel, which keeps the filter's 3σ reach off it.

The filter runs as a pass along rows and one along columns, each with the width at the pixel that it writes.
Its cost is proportional to the largest σ in a band of rows, which `max_sigma` bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.baselines.box import divide_and_fill, pixel_sums
from fewrays.errors import SampleError
from fewrays.method import Method, Reconstruction
from fewrays.parallel import Execution, map_ranges
from fewrays.samples import SampleBuffer

__all__ = ["METHOD", "AxisAlignedOptions"]

Float32 = npt.NDArray[np.float32]

_REACH = 3.0  # standard deviations at which the Gaussian is cut off
_BAND = 16  # rows that one task filters


@dataclass(frozen=True)
class AxisAlignedOptions:
    """Options of the axis-aligned filter.

    Parameters
    ----------
    sigma_pix : float
        Standard deviation of the pixel filter in pixels, which is the smallest filter used.
    k : float
        The filter is narrowed by 1/k to preserve the tail of the lens's spectrum; the paper uses 2.
    max_sigma : float
        Largest standard deviation in pixels; bounds the cost.
    """

    sigma_pix: float = 0.5
    k: float = 2.0
    max_sigma: float = 32.0

    def __post_init__(self) -> None:
        for name in ("sigma_pix", "k", "max_sigma"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise SampleError(f"expected a positive, finite number, got {value!r}", field=name)
        if self.max_sigma < self.sigma_pix:
            raise SampleError(
                f"{self.max_sigma:g} is less than sigma_pix = {self.sigma_pix:g}", field="max_sigma"
            )


def run(samples: SampleBuffer, options: AxisAlignedOptions, execution: Execution) -> Reconstruction:
    """Integrate over the lens, then filter in the image; see the module's documentation."""
    sums = pixel_sums(samples)
    sigma = _filter_width(sums.min_blur, samples.lens.gaussian_sigma, options)
    # Channels first, so that a shift along either image axis leaves rows contiguous.
    planes = np.concatenate([np.moveaxis(sums.radiance, -1, 0), sums.weight[None]])
    planes = _filter_rows(planes, sigma, execution)
    planes = _filter_columns(planes, sigma, execution)
    radiance = np.ascontiguousarray(np.moveaxis(planes[:3], 0, -1))
    image = divide_and_fill(radiance, planes[3])
    return Reconstruction(image, {"filter_sigma": sigma} if execution.aovs else {})


METHOD = Method(
    "axis-aligned",
    "Gaussian as wide as the sharpest sample in a pixel allows (Mehta et al. 2012)",
    AxisAlignedOptions,
    ("cpu",),
    run,
)


def _filter_width(min_blur: Float32, sigma_u: float, options: AxisAlignedOptions) -> Float32:
    """Return the standard deviation ``(H, W)`` of each pixel's filter, in pixels."""
    sigma = np.clip(min_blur * np.float32(sigma_u / options.k), options.sigma_pix, options.max_sigma)
    # min over q of σ(q) + |p - q|₁ / 3, one axis and one direction at a time.
    for axis, flip in ((0, False), (0, True), (1, False), (1, True)):
        ramp = np.arange(sigma.shape[axis]) / _REACH
        ramp = ramp[:, None] if axis == 0 else ramp
        ordered = np.flip(sigma, axis) if flip else sigma
        limited = np.minimum(ordered, np.minimum.accumulate(ordered - ramp, axis=axis) + ramp)
        sigma = np.flip(limited, axis) if flip else limited
    return np.ascontiguousarray(np.maximum(sigma, np.float32(options.sigma_pix)), np.float32)


def _filter_rows(planes: Float32, sigma: Float32, execution: Execution) -> Float32:
    result = np.empty_like(planes)
    width = planes.shape[2]

    def band(first: int, last: int) -> None:
        source, local = planes[:, first:last], sigma[first:last]
        total = source.copy()
        for offset in range(1, min(_radius(local), width - 1) + 1):
            gain = _gaussian(offset, local)
            total[:, :, offset:] += gain[:, offset:] * source[:, :, :-offset]
            total[:, :, :-offset] += gain[:, :-offset] * source[:, :, offset:]
        result[:, first:last] = total

    map_ranges(band, planes.shape[1], execution, label="axis-aligned, rows", chunk=_BAND)
    return result


def _filter_columns(planes: Float32, sigma: Float32, execution: Execution) -> Float32:
    result = np.empty_like(planes)
    height = planes.shape[1]

    def band(first: int, last: int) -> None:
        local = sigma[first:last]
        total = planes[:, first:last].copy()
        for offset in range(1, _radius(local) + 1):
            gain = _gaussian(offset, local)
            for shift in (-offset, offset):
                top, bottom = max(first, -shift), min(last, height - shift)
                if top < bottom:
                    rows = slice(top - first, bottom - first)
                    total[:, rows] += gain[rows] * planes[:, top + shift : bottom + shift]
        result[:, first:last] = total

    map_ranges(band, height, execution, label="axis-aligned, columns", chunk=_BAND)
    return result


def _radius(sigma: Float32) -> int:
    return math.ceil(_REACH * float(sigma.max()))


def _gaussian(offset: int, sigma: Float32) -> Float32:
    gain: Float32 = np.exp(np.float32(-0.5 * offset * offset) / np.square(sigma))
    gain[offset > np.ceil(np.float32(_REACH) * sigma)] = 0  # the cut-off must not depend on the band's widest
    return gain
