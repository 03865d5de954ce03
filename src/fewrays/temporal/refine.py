"""What the locations' mean gains from two facts that the paper leaves unused.

**What is widely blurred is smooth.** A location stands for the part ``δ = 1 / √N`` of the lens, in which a
surface of slope C moves over ``δ |C|`` pixels of the image. Few locations leave noise of that size; wide blur
leaves no detail of that size. So what is seen is added up in bands of |C|, and the mean radiance of each band
is smoothed by δ times the least |C| in it, or a tenth of that if δ is more, while how much of each band a
pixel sees stays as it is: edges in focus stay sharp (`smooth_bands`).

**The samples' own mean is right on average.** It is noisy, but not in the mean over many pixels. Where the
image differs from it by more than its noise explains, because samples missed what is hidden at the image's
border, or a surface too thin to be one, the difference is added (`correct`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.aperture import Aperture
from fewrays.method import Image
from fewrays.pixel_filter import PixelFilter
from fewrays.samples import SampleBuffer
from fewrays.temporal.shutter import Shutter

__all__ = [
    "BEARABLE",
    "LEAST_LEFT",
    "LEAST_NOISE",
    "NEAR",
    "NOISE",
    "OWN_SHARE",
    "POOL",
    "SampleMean",
    "correct",
    "gaussian_blur",
    "gaussian_taps",
    "sample_mean",
    "smooth_bands",
    "smoothing_of_bands",
]

Float32 = npt.NDArray[np.float32]


POOL = 2.0
"""Width of what is judged together, in widths of the correction."""

LEAST_NOISE = 1.0
"""In units of the image's median: pixels of less noise weigh no more."""

BEARABLE = 0.15
"""Noise in shares of the radiance that is as bad as what it may correct."""

NOISE = 0.5
"""Share of its expected noise by which a difference is reduced."""

LEAST_LEFT = 0.5
"""Share of a radiance that a correction leaves."""

NEAR = 1.0
"""Standard deviation in pixels of the neighbourhood that tells the noise of single samples."""

OWN_SHARE = 1 - 2 / (2 * math.pi * NEAR**2) + 1 / (4 * math.pi * NEAR**2)
"""Variance of a pixel's difference from that neighbourhood, in units of its own: that holds some of it."""

_MOST_SMOOTHING = 0.1  # widths of smoothing in radii of the circle of confusion
_LEAST_SMOOTHING = 0.1  # pixels: less changes nothing
_TAPS = 3.0  # standard deviations that a Gaussian reaches
_CHUNK = 2**19  # samples that are averaged at a time


@dataclass(frozen=True)
class SampleMean:
    """The mean of the samples under the pixel filter, the aperture and the shutter.

    Parameters
    ----------
    mean : ndarray of float32, (H, W, 3)
        Radiance.
    variance : ndarray of float32, (H, W)
        Of the mean, summed over the channels.
    known : ndarray of float32, (H, W)
        1 where there are samples, else 0.
    """

    mean: Float32
    variance: Float32
    known: Float32


def smoothing_of_bands(starts: tuple[float, ...], along_lens: float) -> list[float]:
    """Return the standard deviations in pixels by which bands are smoothed; 0 for those that are not."""
    widths = (min(along_lens, _MOST_SMOOTHING) * start for start in starts)
    return [0.0 if width < _LEAST_SMOOTHING else width for width in widths]


def smooth_bands(bands: Float32, starts: tuple[float, ...], along_lens: float) -> Image:
    """Join bands of blur to an image, each smoothed by what it can bear.

    Parameters
    ----------
    bands : ndarray of float32, (H, W, bands, 4)
        Sums of radiance and of weights.
    starts : tuple of float
        Least |C| of each band, in pixels.
    along_lens : float
        δ, in lens units; 0 for no smoothing.

    Returns
    -------
    ndarray of float32, (H, W, 3)
        Radiance; 0 where no location found anything.
    """
    radiance = np.zeros((*bands.shape[:2], 3), np.float32)
    weight = np.zeros((*bands.shape[:2], 1), np.float32)
    for band, sigma in enumerate(smoothing_of_bands(starts, along_lens)):
        sums = bands[:, :, band]
        own = sums[..., 3:]
        weight += own
        if not sigma or not own.any():
            radiance += sums[..., :3]
            continue
        smooth = gaussian_blur(sums, sigma)
        around = smooth[..., 3:]
        mean = np.divide(smooth[..., :3], around, out=np.zeros_like(radiance), where=around > 0)
        radiance += mean * own
    image: Image = np.divide(radiance, weight, out=np.zeros_like(radiance), where=weight > 0)
    return image


def correct(image: Image, samples: SampleMean, sigma: float) -> Image:
    """Add what the samples' own mean differs by, smoothed, as far as its noise does not explain that.

    The difference is reduced after James and Stein: by the share of its square that noise is expected to
    make, both taken in the mean over the neighbourhood; and where that noise would be seen, by how much.

    Parameters
    ----------
    image : ndarray, (H, W, 3)
        Radiance.
    samples : SampleMean
    sigma : float
        Standard deviation of the Gaussian that smooths the difference, in pixels.

    Returns
    -------
    ndarray of float32, (H, W, 3)
        Not negative where `image` is not.
    """
    trust = _trust(samples, sigma)
    total = gaussian_blur(trust, sigma)
    reciprocal = np.divide(1, total, out=np.zeros_like(total), where=total > 0)
    difference = gaussian_blur(trust * (samples.mean - image), sigma) * reciprocal
    variance = samples.variance[..., None]
    noise = gaussian_blur(np.square(trust) * variance, sigma, squared=True) * np.square(reciprocal)
    energies = [np.square(each).sum(axis=-1, keepdims=True) for each in (difference, image)]
    pooled = gaussian_blur(np.concatenate([*energies, noise], axis=-1), POOL * sigma)
    square, light, expected = np.split(pooled, 3, axis=-1)
    share = 1 - NOISE * np.divide(expected, square, out=np.ones_like(square), where=square > 0)
    bearable = BEARABLE**2 * light
    share *= np.divide(bearable, bearable + expected, out=np.zeros_like(light), where=bearable > 0)
    corrected = image + np.maximum(share, 0) * difference
    # What spills over from a bright neighbour must not blacken what is dark.
    least = np.where(image > 0, LEAST_LEFT * image, image)
    result: Image = np.maximum(corrected, least).astype(np.float32)
    return result


def _trust(samples: SampleMean, sigma: float) -> Float32:
    """Weigh pixels (H, W, 1) by how little noise there is around them, lest lights spill over what is dark.

    A pixel's own variance would not do: it is large where a light happened to be hit, and pixels without a
    hit would outweigh it.
    """
    known = samples.known[..., None]
    noise = _pooled_variance(samples, sigma)
    least = LEAST_NOISE * float(np.median(noise[known > 0])) if known.any() else 0.0
    weight: Float32 = np.divide(known, noise + least, out=known.copy(), where=noise + least > 0)
    return weight / max(float(weight.max()), 1e-30)


def _pooled_variance(samples: SampleMean, sigma: float) -> Float32:
    """Average the variance (H, W, 1) over a neighbourhood: where chance spared a light, a pixel has none."""
    known = samples.known[..., None]
    around = gaussian_blur(known, sigma)
    total = gaussian_blur(known * samples.variance[..., None], sigma)
    return np.divide(total, around, out=np.zeros_like(around), where=around > 0)


def sample_mean(
    samples: SampleBuffer, aperture: Aperture, pixel_filter: PixelFilter, shutter: Shutter
) -> SampleMean:
    """Average the samples near every pixel, weighted by filter, aperture and shutter.

    A sample's weight is the density of what it stands for over that which it was drawn from. It counts for
    all pixels whose filter reaches it, wherever it lies in the arrays.

    Parameters
    ----------
    samples : SampleBuffer
    aperture : Aperture
        What the image integrates over.
    pixel_filter : PixelFilter
    shutter : Shutter
        Times are taken to be uniform over [0, 1].
    """
    size = samples.height * samples.width
    sums = np.zeros((6, size))  # weight, its square, weighted radiance, weighted square of radiance
    total = samples.depth.size
    flat = (samples.xy.reshape(-1, 2), samples.uv.reshape(-1, 2), samples.color.reshape(-1, 3))
    time = None if samples.time is None else samples.time.reshape(-1)
    for first in range(0, total, _CHUNK):
        part = slice(first, first + _CHUNK)
        xy, uv, color = (array[part].astype(np.float64) for array in flat)
        weight = aperture.density(uv) / samples.lens.sampling_density(uv)
        if time is not None:
            weight *= shutter.density(time[part])
        used = weight > 0
        _add(sums, xy[used], color[used], weight[used], samples, pixel_filter)
    return _finish(sums, (samples.height, samples.width))


def _add(
    sums: npt.NDArray[np.float64],
    xy: npt.NDArray[np.float64],
    color: npt.NDArray[np.float64],
    weight: npt.NDArray[np.float64],
    samples: SampleBuffer,
    pixel_filter: PixelFilter,
) -> None:
    """Add samples to the pixels around them."""
    own = np.floor(xy)
    reach = pixel_filter.reach
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            column, row = (own + np.array((right, down))).T
            inside = (column >= 0) & (column < samples.width) & (row >= 0) & (row < samples.height)
            distance = xy[inside] - np.stack([column[inside], row[inside]], axis=-1) - 0.5
            filtered = weight[inside] * pixel_filter.weight(distance).prod(axis=-1)
            pixel = row[inside].astype(np.intp) * samples.width + column[inside].astype(np.intp)
            values = color[inside]
            terms = [
                filtered,
                filtered**2,
                *(filtered[:, None] * values).T,
                filtered**2 * np.square(values).sum(axis=-1),
            ]
            for target, term in zip(sums, terms, strict=True):
                target += np.bincount(pixel, term, minlength=len(target))


def _finish(sums: npt.NDArray[np.float64], shape: tuple[int, int]) -> SampleMean:
    """Turn sums into means and the variances of these.

    The variance of a weighted mean is Σ w² (c - m)² / (Σ w)², times n / (n - 1) for a mean of n samples that
    is their own; n = (Σ w)² / Σ w² is how many samples of equal weight would serve as well. The squares of
    weights are taken not to depend on the radiance, so that Σ w² c = m Σ w². Where a pixel has but one
    sample, its neighbours tell the variance.
    """
    weight, square, *radiance, energy = sums
    count = np.divide(weight**2, square, out=np.zeros_like(weight), where=square > 0)
    known, several = weight > 0, (weight > 0) & (count > 1.5)
    reciprocal = np.divide(1, weight, out=np.zeros_like(weight), where=known)
    mean = (np.stack(radiance, axis=-1) * reciprocal[:, None]).reshape(*shape, 3).astype(np.float32)
    spread = np.maximum(energy - square * np.square(mean.reshape(-1, 3)).sum(axis=-1), 0)
    bias = np.divide(count, count - 1, out=np.ones_like(count), where=several)
    variance = (spread * reciprocal**2 * bias).reshape(shape).astype(np.float32)
    known, several = known.reshape(shape), several.reshape(shape)
    if not several.all():
        variance[~several] = _variance_among_neighbours(mean, known)[~several]
    return SampleMean(mean, variance, known.astype(np.float32))


def _variance_among_neighbours(mean: Float32, known: npt.NDArray[np.bool_]) -> Float32:
    """Estimate the variance (H, W) of pixels of one sample from how they differ from those around."""
    there = known[..., None].astype(np.float32)

    def average(values: Float32, sigma: float) -> Float32:
        around = gaussian_blur(there, sigma)
        return np.divide(
            gaussian_blur(there * values, sigma), around, out=np.zeros_like(values), where=around > 0
        )

    square = np.square(mean - average(mean, NEAR)).sum(axis=-1, keepdims=True)
    return average(square / np.float32(OWN_SHARE), 2 * NEAR)[..., 0]


def gaussian_blur(image: Float32, sigma: float, *, squared: bool = False) -> Float32:
    """Blur an image ``(H, W, C)`` with a Gaussian, taking nothing to be beyond its borders.

    Parameters
    ----------
    image : ndarray of float32, (H, W, C)
    sigma : float
        Standard deviation in pixels.
    squared : bool
        Use the squares of the taps, as for the variance of a blurred image of independent pixels.
    """
    taps = gaussian_taps(sigma, squared=squared)
    reach = len(taps) // 2
    for axis in (0, 1):
        blurred = np.zeros_like(image)
        for offset, tap in zip(range(-reach, reach + 1), taps, strict=True):
            length = image.shape[axis] - abs(offset)
            if length <= 0:
                continue
            to, start = max(-offset, 0), max(offset, 0)
            target = [slice(None)] * 3
            source = [slice(None)] * 3
            target[axis], source[axis] = slice(to, to + length), slice(start, start + length)
            blurred[tuple(target)] += tap * image[tuple(source)]
        image = blurred
    return image


def gaussian_taps(sigma: float, *, squared: bool = False) -> Float32:
    """Return the taps of that blur along one axis, an odd number of them."""
    reach = math.ceil(_TAPS * sigma)
    taps = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / sigma))
    taps /= taps.sum()
    return (np.square(taps) if squared else taps).astype(np.float32)
