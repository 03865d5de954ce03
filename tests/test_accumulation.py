"""Brute-force accumulation: exact sums, and an honest noise estimate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import Lens, SampleBuffer, SampleError
from fewrays.baselines.accumulation import Accumulator, accumulate
from fewrays.pixel_filter import PixelFilter, PixelFilterShape
from fewrays.sources.patterns import sample_pattern

LENS = Lens(-10.0, 2.0, aperture="gaussian", sampling="square")
FILTERS: tuple[PixelFilterShape, ...] = ("gaussian", "box")


def batch(seed: int, color: Any = None, *, height: int = 9, width: int = 11, spp: int = 4) -> SampleBuffer:
    rng = np.random.default_rng(seed)
    xy, uv = sample_pattern(height, width, spp, seed=seed)
    radiance = rng.random((height, width, spp, 3)) if color is None else color(xy, uv, rng)
    return SampleBuffer(xy, uv, np.full(xy.shape[:3], 5.0), radiance, LENS)


def slow_sums(samples: SampleBuffer, pixel_filter: PixelFilter) -> npt.NDArray[np.float64]:
    """Every sample against every pixel."""
    xy, color = samples.xy.reshape(-1, 2).astype(float), samples.color.reshape(-1, 3).astype(float)
    lens = samples.lens.weights(samples.uv).reshape(-1).astype(float)
    image = np.zeros((samples.height, samples.width, 3))
    for row, column in np.ndindex(image.shape[:2]):
        offset = xy - (column + 0.5, row + 0.5)
        if pixel_filter.shape == "box":
            weight = (np.floor(xy) == (column, row)).all(axis=1).astype(float)
        else:
            radius = max(1.5, 3 * pixel_filter.sigma_pix)
            weight = np.exp(-0.5 * (offset**2).sum(axis=1) / pixel_filter.sigma_pix**2)
            weight *= (np.abs(offset) <= radius).all(axis=1)
        weight *= lens
        image[row, column] = weight @ color / weight.sum()
    return image


@pytest.mark.parametrize(
    "pixel_filter",
    [PixelFilter("gaussian"), PixelFilter("gaussian", 0.3), PixelFilter("gaussian", 1.1), PixelFilter("box")],
)
def test_equals_the_sum_over_all_pairs(pixel_filter: PixelFilter) -> None:
    accumulator = Accumulator(9, 11, pixel_filter)
    accumulator.add(batch(1))
    np.testing.assert_allclose(accumulator.image(), slow_sums(batch(1), pixel_filter), rtol=2e-6)


@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_position_counts_and_not_the_place_in_the_arrays(pixel_filter: PixelFilterShape) -> None:
    samples = batch(2)
    order = np.random.default_rng(0).permutation(samples.depth.size)

    def shuffled(array: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return array.reshape(samples.depth.size, -1)[order].reshape(array.shape)

    arrays = [shuffled(getattr(samples, name)) for name in ("xy", "uv", "depth", "color")]
    moved = SampleBuffer(arrays[0], arrays[1], arrays[2], arrays[3], LENS)
    images = []
    for each in (samples, moved):
        accumulator = Accumulator(9, 11, PixelFilter(pixel_filter))
        accumulator.add(each)
        images.append(accumulator.image())
    np.testing.assert_allclose(images[0], images[1], rtol=1e-6)


@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_a_constant_stays_constant(pixel_filter: PixelFilterShape) -> None:
    def constant(xy: Any, uv: Any, rng: Any) -> Any:
        del uv, rng
        return np.full((*xy.shape[:3], 3), 2.5)

    batches = (batch(seed, constant) for seed in range(2))
    image, noise = accumulate(batches, (9, 11), pixel_filter=pixel_filter)
    np.testing.assert_allclose(image, 2.5, rtol=1e-6)
    assert noise == math.inf


@pytest.mark.parametrize("sigma", [0.4, 0.5, 0.8])
def test_cosine_is_damped_by_the_filters_transfer(sigma: float) -> None:
    # A Gaussian damps cos(2π f x) by exp(-2 (π f σ)²); cutting it off at 3 σ changes that by under 1 %.
    frequency = 0.2

    def wave(xy: Any, uv: Any, rng: Any) -> Any:
        del uv, rng
        return np.repeat(1 + np.cos(2 * np.pi * frequency * xy[..., :1].astype(float)), 3, axis=-1)

    batches = (batch(seed, wave, height=16, width=40, spp=64) for seed in range(4))
    image, _ = accumulate(batches, (16, 40), sigma_pix=sigma)
    x = np.arange(40) + 0.5
    expected = 1 + math.exp(-2 * (math.pi * frequency * sigma) ** 2) * np.cos(2 * np.pi * frequency * x)
    np.testing.assert_allclose(image[8, 4:-4, 0], expected[4:-4], atol=0.015)


def test_aperture_weights_turn_square_samples_into_a_gaussian() -> None:
    # Radiance u² over a Gaussian lens cut off at 3 σ: its second moment.
    def square(xy: Any, uv: Any, rng: Any) -> Any:
        del xy, rng
        return np.repeat(uv[..., :1] ** 2, 3, axis=-1)

    batches = (batch(seed, square, spp=64) for seed in range(2))
    image, _ = accumulate(batches, (9, 11), pixel_filter="box")
    tail = 2 * 3 * math.exp(-4.5) / math.sqrt(2 * math.pi) / math.erf(3 / math.sqrt(2))
    np.testing.assert_allclose(image.mean(), (1 - tail) / 9, rtol=0.01)


@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_noise_estimate_equals_the_true_noise(pixel_filter: PixelFilterShape) -> None:
    def noise(xy: Any, uv: Any, rng: Any) -> Any:
        del uv
        return rng.uniform(0.2, 0.8, (*xy.shape[:3], 3))

    batches = (batch(seed, noise, height=60, width=60) for seed in range(8))
    image, estimate = accumulate(batches, (60, 60), pixel_filter=pixel_filter)
    true = -10 * math.log10(np.mean((image ** (1 / 2.2) - 0.5 ** (1 / 2.2)) ** 2))
    assert estimate == pytest.approx(true, abs=0.4)


def test_samples_off_the_image_are_guard_band() -> None:
    samples = batch(3)
    outside = SampleBuffer(samples.xy - 1, samples.uv, samples.depth, samples.color, LENS)
    accumulator = Accumulator(9, 11, PixelFilter("gaussian", 0.5))
    accumulator.add(outside)
    np.testing.assert_allclose(
        accumulator.image()[:-2, :-2], slow_sums(outside, PixelFilter("gaussian"))[:-2, :-2], rtol=2e-6
    )


def test_pixels_without_samples_are_black() -> None:
    samples = batch(4)
    away = SampleBuffer(samples.xy + 1000, samples.uv, samples.depth, samples.color, LENS)
    accumulator = Accumulator(9, 11)
    accumulator.add(away)
    assert not accumulator.image().any()


def test_bad_input_is_named() -> None:
    with pytest.raises(SampleError) as caught:
        PixelFilter("triangle")  # type: ignore[arg-type]
    assert caught.value.field == "pixel_filter"
    for sigma in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(SampleError) as caught:
            PixelFilter("gaussian", sigma)
        assert caught.value.field == "sigma_pix"
    with pytest.raises(SampleError, match="expected 5 x 4 pixels, got 11 x 9"):
        Accumulator(4, 5).add(batch(1))
    with pytest.raises(SampleError, match="two batches, got 1"):
        accumulate([batch(1)], (9, 11))
