"""What the temporal method makes of its locations' mean: smoothed bands, and the samples' own mean."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from buffers import random_buffer
from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.aperture import Aperture
from fewrays.baselines.accumulation import Accumulator
from fewrays.metrics import psnr_display
from fewrays.pixel_filter import PixelFilter
from fewrays.sources.analytic import Plane, checker, reference, sample, smooth_noise, stripes
from fewrays.temporal.refine import SampleMean, correct, gaussian_blur, sample_mean, smooth_bands
from fewrays.temporal.shutter import Shutter

Float32 = npt.NDArray[np.float32]
STARTS = (0.0, 4.0, 8.0)
WHOLE = Shutter()


def mean_of(image: npt.ArrayLike, variance: float = 0.0) -> SampleMean:
    image = np.asarray(image, np.float32)
    known = np.ones(image.shape[:2], np.float32)
    return SampleMean(image, variance * known, known)


class TestBlur:
    @pytest.mark.parametrize("sigma", [0.4, 1.0, 3.0])
    def test_an_impulse_becomes_a_gaussian(self, sigma: float) -> None:
        image = np.zeros((41, 41, 1), np.float32)
        image[20, 20] = 1
        blurred = gaussian_blur(image, sigma)[..., 0].astype(np.float64)
        assert blurred.sum() == pytest.approx(1, abs=1e-5)
        row, column = np.indices(blurred.shape) - 20
        if sigma >= 1:
            assert (blurred * row**2).sum() == pytest.approx(sigma**2, rel=0.03)
            assert (blurred * column**2).sum() == pytest.approx(sigma**2, rel=0.03)

    def test_squared_taps_are_the_variance_of_blurred_noise(self) -> None:
        noise = np.random.default_rng(0).normal(size=(200, 200, 1)).astype(np.float32)
        expected = gaussian_blur(np.ones_like(noise), 1.5, squared=True)[100, 100, 0]
        assert gaussian_blur(noise, 1.5)[10:-10, 10:-10].var() == pytest.approx(expected, rel=0.05)

    def test_images_smaller_than_the_blur(self) -> None:
        blurred = gaussian_blur(np.ones((1, 2, 3), np.float32), 5.0)
        assert blurred.shape == (1, 2, 3)
        assert (blurred > 0).all()


class TestBands:
    def bands(self, height: int = 24, width: int = 30) -> Float32:
        return np.random.default_rng(3).uniform(0, 1, (height, width, 3, 4)).astype(np.float32)

    def test_without_smoothing_it_is_the_mean(self) -> None:
        bands = self.bands()
        total = bands.sum(axis=2)
        np.testing.assert_allclose(
            smooth_bands(bands, STARTS, 0.0), total[..., :3] / total[..., 3:], rtol=1e-5
        )

    def test_what_is_sharp_stays(self) -> None:
        bands = self.bands()
        bands[:, :, 1:] = 0
        np.testing.assert_array_equal(smooth_bands(bands, STARTS, 0.1), smooth_bands(bands, STARTS, 0.0))

    def test_edges_of_what_is_sharp_stay_before_wide_blur(self) -> None:
        bands = np.zeros((20, 20, 3, 4), np.float32)
        bands[:, :10, 0] = 1, 0, 0, 1
        bands[:, 10:, 2] = 0, 0, 1, 1
        image = smooth_bands(bands, STARTS, 0.2)
        np.testing.assert_allclose(image[:, :10], np.broadcast_to([1, 0, 0], (20, 10, 3)), atol=1e-6)
        np.testing.assert_allclose(image[:, 10:], np.broadcast_to([0, 0, 1], (20, 10, 3)), atol=1e-6)

    def test_noise_of_wide_blur_shrinks(self) -> None:
        bands = np.zeros((60, 60, 3, 4), np.float32)
        bands[:, :, 2, :3] = 0.5 + np.random.default_rng(0).normal(0, 0.1, (60, 60, 3))
        bands[:, :, 2, 3] = 1
        noisy, smooth = (
            smooth_bands(bands, STARTS, along_lens)[5:-5, 5:-5].std() for along_lens in (0.0, 0.1)
        )
        assert smooth == pytest.approx(noisy / np.sqrt(4 * np.pi * 0.8**2), rel=0.15)
        assert smooth_bands(bands, STARTS, 0.5).std() > 0.5 * smooth  # wide blur bears no more

    def test_pixels_that_saw_nothing_are_black(self) -> None:
        assert not smooth_bands(np.zeros((5, 6, 3, 4), np.float32), STARTS, 0.1).any()


class TestCorrection:
    def test_a_right_image_stays_within_its_noise(self) -> None:
        rng = np.random.default_rng(1)
        truth = np.full((80, 80, 3), 0.5, np.float32)
        noisy = mean_of(truth + rng.normal(0, 0.2, truth.shape), variance=3 * 0.2**2)
        corrected = correct(truth, noisy, 1.8)
        plain = gaussian_blur(noisy.mean - truth, 1.8)
        assert np.square(corrected - truth).mean() < 0.35 * np.square(plain).mean()

    def test_bias_beyond_the_noise_goes(self) -> None:
        rng = np.random.default_rng(1)
        truth = np.full((80, 80, 3), 0.5, np.float32)
        noisy = mean_of(truth + rng.normal(0, 0.1, truth.shape), variance=3 * 0.1**2)
        biased = truth.copy()
        biased[20:60, 20:60] += 0.2
        before, after = biased - truth, correct(biased, noisy, 1.8) - truth
        assert np.square(after[28:52, 28:52]).mean() < 0.02 * np.square(before[28:52, 28:52]).mean()

    def test_nothing_turns_negative(self) -> None:
        image = np.zeros((30, 30, 3), np.float32)
        image[15, 15] = 100.0
        assert (correct(image, mean_of(np.zeros_like(image)), 1.8) >= 0).all()

    def test_nothing_is_known(self) -> None:
        image = np.random.default_rng(0).random((9, 9, 3), np.float32)
        nothing = SampleMean(np.zeros_like(image), *np.zeros((2, 9, 9), np.float32))
        np.testing.assert_array_equal(correct(image, nothing, 1.8), image)

    def test_lights_leave_no_blotches(self) -> None:
        """A few samples of a light a thousand times as bright say little about the pixels around."""
        rng = np.random.default_rng(2)
        hits = rng.binomial(8, 0.002, (60, 60, 1)) / 8
        image = np.full((60, 60, 3), 2.0, np.float32)
        samples = mean_of(np.broadcast_to(1000 * hits, (60, 60, 3)), variance=3 * 1e6 * 0.002 / 8)
        corrected = correct(image, samples, 1.8)
        plain = gaussian_blur(samples.mean - image, 1.8)
        assert np.square(corrected - image).mean() < 0.5 * np.square(plain).mean()


class TestSampleMean:
    @pytest.mark.parametrize("shape", ["box", "gaussian"])
    def test_it_is_what_accumulation_gives(self, shape: str) -> None:
        samples = random_buffer(17, 23, 6, Lens(-40.0, 8.0, "gaussian", "square"), seed=4)
        mean = sample_mean(samples, Aperture.of_lens(samples.lens), PixelFilter(shape), WHOLE)  # type: ignore[arg-type]
        accumulator = Accumulator(17, 23, PixelFilter(shape, 0.5))  # type: ignore[arg-type]
        accumulator.add(samples)
        known = mean.known > 0
        assert known.mean() > 0.9
        np.testing.assert_allclose(mean.mean[known], accumulator.image()[known], rtol=2e-3, atol=2e-3)

    def test_variance_is_that_of_means(self) -> None:
        rng = np.random.default_rng(0)
        shape = (60, 60, 8)
        pixels = np.stack(np.meshgrid(np.arange(60), np.arange(60)), axis=-1)[:, :, None]
        samples = SampleBuffer(
            pixels + rng.random((*shape, 2)),
            np.zeros((*shape, 2)),
            np.ones(shape),
            np.abs(rng.normal(5, 1, (*shape, 3))),
            Lens(-1.0, 1.0),
        )
        mean = sample_mean(samples, Aperture(), PixelFilter(), WHOLE)
        assert mean.variance.mean() == pytest.approx(mean.mean.var(axis=(0, 1)).sum(), rel=0.1)

    def test_neighbours_tell_the_variance_of_single_samples(self) -> None:
        rng = np.random.default_rng(0)
        shape = (80, 80, 1)
        pixels = np.stack(np.meshgrid(np.arange(80), np.arange(80)), axis=-1)[:, :, None]
        color = np.abs(rng.normal(5, 1, (*shape, 3)))
        samples = SampleBuffer(
            pixels + rng.random((*shape, 2)), np.zeros((*shape, 2)), np.ones(shape), color, Lens(-1.0, 1.0)
        )
        variance = sample_mean(samples, Aperture(), PixelFilter(), WHOLE).variance
        assert variance[5:-5, 5:-5].mean() == pytest.approx(3, rel=0.1)

    def test_only_what_the_aperture_and_the_shutter_let_pass_counts(self) -> None:
        samples = random_buffer(12, 12, 16, Lens(-40.0, 8.0), seed=1)
        time = np.random.default_rng(0).random(samples.depth.shape)
        samples = replace(samples, time=time.astype(np.float32))
        shutter, aperture = Shutter(0.25, 0.75), Aperture("polygon", blades=3)
        used = aperture.contains(samples.uv) & (time >= 0.25) & (time <= 0.75)
        bright = np.where(used[..., None], samples.color, np.float32(1e6))
        mean = sample_mean(replace(samples, color=bright), aperture, PixelFilter(), shutter)
        assert 0 < mean.mean[mean.known > 0].max() < 100
        instant = sample_mean(samples, aperture, PixelFilter(), Shutter(0.5, 0.5))
        assert not instant.known.any()


class TestWholeMethod:
    def test_both_bring_a_blurred_scene_closer_to_the_truth(self) -> None:
        lens = Lens(-80.0, 16.0)
        planes = [
            Plane(lens.focus_distance, smooth_noise(3.0, seed=1), stripes(40.0, fill=0.3)),
            Plane(lens.depth(-12.0), checker(6, (0.1, 0.6, 0.1), (0.2, 0.9, 0.2)), stripes(9.0, fill=0.4)),
            Plane(lens.depth(12.0), checker(9, (0.0, 0.0, 0.1), (0.9, 0.9, 1.0))),
        ]
        samples = sample(planes, lens, 64, 80, 8)
        truth = reference(planes, lens, 64, 80, spp=1024, pixel_filter="box")
        settings: list[dict[str, Any]] = [{"smoothing": 0, "correction": 0}, {"correction": 0}, {}]
        scores = [
            psnr_display(reconstruct(samples, "temporal", locations=64, **options), truth)
            for options in settings
        ]
        assert scores[1] > scores[0] + 0.2
        assert scores[2] > scores[1] + 0.5
