"""The reference by brute force: many samples, splatted under a pixel filter and averaged.

Every reconstruction estimates the same integral: radiance times the aperture's density over the lens, times
the pixel filter over the image. With enough samples the weighted mean of what falls near a pixel gets there
without any assumption. How near it got is measured as well: successive batches go to two halves in turn, and
half the difference between the halves has the noise of their mean.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from fewrays.color import gamma_encode
from fewrays.errors import SampleError
from fewrays.method import Image
from fewrays.pixel_filter import PixelFilter, PixelFilterShape
from fewrays.samples import SampleBuffer

__all__ = ["Accumulator", "accumulate"]

Float64 = npt.NDArray[np.float64]


class Accumulator:
    """Sums of filtered samples, in memory that does not grow with their number.

    Parameters
    ----------
    height, width : int
        Image size in pixels.
    pixel_filter : PixelFilter, optional
        What a pixel averages over, a Gaussian when omitted; use one accumulator for each filter.
    """

    def __init__(self, height: int, width: int, pixel_filter: PixelFilter | None = None) -> None:
        self.pixel_filter = pixel_filter or PixelFilter("gaussian")
        self.batches = 0
        self._halves = np.zeros((2, height, width, 4))  # weighted RGB, weight

    def add(self, samples: SampleBuffer) -> None:
        """Add samples; successive calls go to the two halves in turn, so add batches of equal size.

        Raises
        ------
        SampleError
            When the samples' image has another size.
        """
        height, width = self._halves.shape[1:3]
        if (samples.height, samples.width) != (height, width):
            raise SampleError(
                f"expected {width} x {height} pixels, got {samples.width} x {samples.height}", field="samples"
            )
        half = self._halves[self.batches % 2]
        for row in range(0, height, 64):
            part = slice(row, row + 64)
            xy = samples.xy[part].reshape(-1, 2).astype(np.float64)
            weights = samples.lens.weights(samples.uv[part]).reshape(-1).astype(np.float64)
            values = np.empty((4, len(xy)))
            values[:3] = samples.color[part].reshape(-1, 3).T * weights
            values[3] = weights
            _splat(half, xy, values, self.pixel_filter)
        self.batches += 1

    def image(self) -> Image:
        """Return the mean of all samples, (H, W, 3) float32; pixels without any are 0."""
        return _normalise(self._halves.sum(axis=0)).astype(np.float32)

    def noise_psnr(self, gamma: float = 2.2) -> float:
        """Estimate the PSNR in dB of `image` against its limit, after clipping to [0, 1] and gamma.

        Raises
        ------
        SampleError
            With less than two batches.
        """
        if self.batches < 2:
            raise SampleError(f"the noise estimate needs two batches, got {self.batches}", field="batches")
        first, second = (gamma_encode(_normalise(half), gamma) for half in self._halves)
        error = float(np.mean(np.square((first - second) / 2)))
        return math.inf if error == 0 else -10 * math.log10(error)


def accumulate(
    batches: Iterable[SampleBuffer],
    shape: tuple[int, int],
    *,
    pixel_filter: PixelFilterShape = "gaussian",
    sigma_pix: float = 0.5,
) -> tuple[Image, float]:
    """Average batches of samples into an image.

    Parameters
    ----------
    batches : iterable of SampleBuffer
        Independent batches of equal size, at least two; only one is held at a time.
    shape : (int, int)
        Height and width of the image in pixels.
    pixel_filter : {"gaussian", "box", "blackman-harris", "mitchell"}
        See `fewrays.pixel_filter.PixelFilter`.
    sigma_pix : float
        Standard deviation of the Gaussian in pixels.

    Returns
    -------
    image : ndarray, (H, W, 3)
        Linear radiance, float32.
    noise_psnr : float
        Estimated PSNR in dB of the image against its limit, after clipping to [0, 1] and gamma 2.2.

    Raises
    ------
    SampleError
        For an unknown filter, batches of another size, and less than two batches.
    """
    accumulator = Accumulator(*shape, PixelFilter(pixel_filter, sigma_pix))
    for samples in batches:
        accumulator.add(samples)
    return accumulator.image(), accumulator.noise_psnr()


def _splat(sums: Float64, xy: Float64, values: Float64, pixel_filter: PixelFilter) -> None:
    """Add values (4, N) at positions (N, 2) to all pixels of `sums` (H, W, 4) that the filter reaches."""
    height, width = sums.shape[:2]
    home = np.floor(xy)
    steps = range(-pixel_filter.reach, pixel_filter.reach + 1)
    for dy in steps:
        row = home[:, 1] + dy
        row_weight = pixel_filter.weight(row + 0.5 - xy[:, 1])
        for dx in steps:
            column = home[:, 0] + dx
            weight = row_weight * pixel_filter.weight(column + 0.5 - xy[:, 0])
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width) & (weight != 0)
            pixel = (row * width + column)[inside].astype(np.int64)
            for channel in range(4):
                total = np.bincount(pixel, (values[channel] * weight)[inside], height * width)
                sums[..., channel] += total.reshape(height, width)


def _normalise(sums: Float64) -> Float64:
    return sums[..., :3] / np.where(sums[..., 3:] > 0, sums[..., 3:], 1)
