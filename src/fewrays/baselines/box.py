"""The box image: what a renderer shows without reconstruction.

Every pixel is the mean of the samples that lie in it, weighted by the aperture density over the sampling
density of their lens positions. It is unbiased for a box pixel filter, and as noisy as samples are few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.method import Image, Method, Reconstruction
from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer

__all__ = ["METHOD", "BoxOptions", "PixelSums", "divide_and_fill", "pixel_sums"]

Float32 = npt.NDArray[np.float32]

_CHUNK = 2**17  # samples that are read at once, so that temporary arrays stay in cache


@dataclass(frozen=True)
class BoxOptions:
    """The box image has no options."""


@dataclass(frozen=True)
class PixelSums:
    """Integrals of the samples over each pixel and the lens.

    Parameters
    ----------
    radiance : ndarray, (H, W, 3)
        Sum of lens weight times radiance.
    weight : ndarray, (H, W)
        Sum of lens weights.
    min_blur : ndarray, (H, W)
        Smallest circle-of-confusion radius ``|C|`` in pixels of the samples with any weight; ``inf`` where
        there are none.
    """

    radiance: Float32
    weight: Float32
    min_blur: Float32


def run(samples: SampleBuffer, options: BoxOptions, execution: Execution) -> Reconstruction:  # noqa: ARG001
    """Average each pixel's samples; see the module's documentation."""
    sums = pixel_sums(samples)
    return Reconstruction(divide_and_fill(sums.radiance, sums.weight))


METHOD = Method("box", "aperture-weighted mean of each pixel's samples", BoxOptions, ("cpu",), run)


def pixel_sums(samples: SampleBuffer) -> PixelSums:
    """Sum the samples of each pixel.

    A sample counts for the pixel that its ``xy`` lies in, whatever its place in the arrays; samples off the
    image count for none.
    """
    shape = (samples.height, samples.width)
    sums = PixelSums(
        np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
    )
    rows = max(1, _CHUNK // (samples.width * samples.spp))
    for top in range(0, samples.height, rows):
        _add_rows(sums, samples, slice(top, min(top + rows, samples.height)))
    return sums


def divide_and_fill(radiance: Float32, weight: Float32) -> Image:
    """Divide sums of radiance ``(H, W, 3)`` by sums of weights ``(H, W)``.

    A pixel without weight holds no data, which is common at 1 spp when the samples cover a square and the
    aperture is a disc. Black there would be a darker image than the scene's, so it gets the weighted mean of
    the smallest block of 2 x 2, 4 x 4, … pixels around it that has some. An image without any is black.
    """
    filled = weight > 0
    image = np.zeros_like(radiance)
    np.divide(radiance, weight[..., None], out=image, where=filled[..., None])
    if filled.any() and not filled.all():
        coarse = divide_and_fill(_halve(radiance), _halve(weight))
        rows, columns = np.nonzero(~filled)
        image[rows, columns] = coarse[rows // 2, columns // 2]
    return image


def _halve(sums: Float32) -> Float32:
    """Add up blocks of 2 x 2 pixels; those on an odd border are smaller."""
    height, width = sums.shape[:2]
    rows = np.add.reduceat(sums, np.arange(0, height, 2), axis=0)
    result: Float32 = np.add.reduceat(rows, np.arange(0, width, 2), axis=1)
    return result


def _add_rows(sums: PixelSums, samples: SampleBuffer, rows: slice) -> None:
    """Add the samples that are stored in some rows of the arrays."""
    x, y = samples.xy[rows, ..., 0], samples.xy[rows, ..., 1]
    color = samples.color[rows]
    weight = samples.lens.weights(samples.uv[rows]).astype(np.float32, copy=False)
    blur = np.where(weight > 0, np.abs(samples.lens.slope(samples.depth[rows])), np.float32(np.inf))

    column, row = np.floor(x), np.floor(y)
    own_column = np.arange(samples.width, dtype=np.float32)[:, None]
    own_row = np.arange(rows.start, rows.stop, dtype=np.float32)[:, None, None]
    if (column == own_column).all() and (row == own_row).all():
        sums.radiance[rows] += np.einsum("hwsc,hws->hwc", color, weight)
        sums.weight[rows] += weight.sum(axis=-1)
        sums.min_blur[rows] = np.minimum(sums.min_blur[rows], blur.min(axis=-1))
        return

    inside = (column >= 0) & (column < samples.width) & (row >= 0) & (row < samples.height)
    first, last = _row_span(row[inside])
    pixel = (row[inside].astype(np.int64) - first) * samples.width + column[inside].astype(np.int64)
    shape = (last - first, samples.width)
    size = shape[0] * shape[1]
    weight = weight[inside]
    sums.weight[first:last] += np.bincount(pixel, weight, size).reshape(shape).astype(np.float32)
    for channel in range(3):
        total = np.bincount(pixel, weight * color[inside][:, channel], size)
        sums.radiance[first:last, :, channel] += total.reshape(shape).astype(np.float32)
    np.minimum.at(sums.min_blur[first:last].reshape(-1), pixel, blur[inside])


def _row_span(row: Float32) -> tuple[int, int]:
    return (int(row.min()), int(row.max()) + 1) if row.size else (0, 0)
