"""What temporal's GPU kernels make of samples and of the mean of locations, as phases, against NumPy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from buffers import random_buffer
from fewrays import Lens, SampleBuffer
from fewrays.aperture import Aperture, ApertureImage
from fewrays.cuda.samples import DeviceSamples
from fewrays.pixel_filter import PixelFilter, PixelFilterShape
from fewrays.samples import OFF_IMAGE
from fewrays.temporal import cuda_refine, refine
from fewrays.temporal.cuda_dispersion import dispersion_on_card
from fewrays.temporal.cuda_mean import DeviceMean, sample_mean_on_card
from fewrays.temporal.dispersion import dispersion, published_radius
from fewrays.temporal.refine import SampleMean, gaussian_blur, sample_mean
from fewrays.temporal.shutter import Shutter, ShutterResponse
from phases import ORDERS, PhasesMachine

Float32 = npt.NDArray[np.float32]

BOX = PixelFilter()
WHOLE = Shutter()
RING = ApertureImage(np.hypot(*(np.indices((9, 9)) - 4)) // 2 % 2)


def samples_of(height: int, width: int, spp: int, *, timed: bool = False, **options: Any) -> SampleBuffer:
    lens = Lens(-40.0, 8.0, **options)
    samples = random_buffer(height, width, spp, lens, off_image=0.05)
    if not timed:
        return samples
    time = np.random.default_rng(7).random(samples.depth.shape, np.float32)
    return replace(samples, time=time, motion=np.ones_like(samples.color))


class TestDispersion:
    def on_card(self, samples: SampleBuffer, order: int = 0) -> float:
        machine = PhasesMachine(order)
        timed = samples.motion is not None
        return dispersion_on_card(machine, DeviceSamples.of_buffer(machine, samples), timed=timed)

    @pytest.mark.parametrize("timed", [False, True])
    @pytest.mark.parametrize("spp", [1, 5])
    def test_it_is_the_host_s(self, spp: int, timed: bool) -> None:
        samples = samples_of(36, 41, spp, timed=timed)
        expected = dispersion(samples)
        assert expected != published_radius(spp)
        for order in ORDERS:
            assert self.on_card(samples, order) == pytest.approx(expected, rel=1e-12)

    def test_a_pinhole_s_lens_points_do_not_count(self) -> None:
        samples = replace(samples_of(34, 33, 2), lens=Lens(0.0, 0.0))
        assert self.on_card(samples) == pytest.approx(dispersion(samples), rel=1e-12)

    def test_more_samples_than_are_listed_at_once(self) -> None:
        """Repeated samples leave the same holes."""
        samples = samples_of(33, 34, 2)
        xy, uv, depth, color = (
            np.repeat(array, 12, axis=2) for array in (samples.xy, samples.uv, samples.depth, samples.color)
        )
        crowded = SampleBuffer(xy, uv, depth, color, samples.lens)
        assert self.on_card(crowded) == self.on_card(samples)

    def test_without_a_pattern_it_is_the_published_one(self) -> None:
        small = samples_of(31, 60, 4)
        gone = samples_of(33, 34, 4)
        gone = replace(gone, xy=np.full_like(gone.xy, OFF_IMAGE))
        assert self.on_card(small) == self.on_card(gone) == published_radius(4)


def mean_of(
    samples: SampleBuffer,
    aperture: Aperture | None = None,
    pixel_filter: PixelFilter = BOX,
    shutter: Shutter = WHOLE,
    order: int = 0,
) -> DeviceMean:
    machine = PhasesMachine(order)
    aperture = aperture or Aperture.of_lens(samples.lens)
    on_card = DeviceSamples.of_buffer(machine, samples)
    return sample_mean_on_card(machine, on_card, aperture, pixel_filter, shutter)


def assert_same_mean(actual: DeviceMean, expected: SampleMean) -> None:
    np.testing.assert_array_equal(actual.mean[..., 3], expected.known)
    np.testing.assert_allclose(actual.mean[..., :3], expected.mean, rtol=1e-6)
    several = actual.several > 0
    assert several.any()
    # A difference of sums: of equal samples nothing but rounding is left.
    energy = np.square(expected.mean).sum(axis=-1)[several]
    difference = np.abs(actual.variance - expected.variance)[several]
    assert (difference <= 1e-6 * (expected.variance[several] + energy)).all()


class TestSampleMean:
    @pytest.mark.parametrize(
        "aperture",
        [
            Aperture(),
            Aperture("gaussian", sigma=0.4),
            Aperture("polygon", blades=5, rotation=17.0),
            Aperture("polygon", blades=3, roundness=0.6, squeeze=1.5),
            Aperture("image", image=RING, squeeze=0.7),
        ],
        ids=lambda each: f"{each.shape}-{each.blades}",
    )
    @pytest.mark.parametrize("sampling", ["disc", "square", "gaussian"])
    def test_apertures_and_samplings(self, aperture: Aperture, sampling: str) -> None:
        samples = samples_of(11, 14, 9, sampling=sampling)
        actual = mean_of(samples, aperture)
        assert_same_mean(actual, sample_mean(samples, aperture, BOX, WHOLE))

    @pytest.mark.parametrize("shape", ["box", "gaussian", "blackman-harris", "mitchell"])
    def test_pixel_filters(self, shape: PixelFilterShape) -> None:
        samples = samples_of(11, 14, 4)
        pixel_filter = PixelFilter(shape, 0.7)
        expected = sample_mean(samples, Aperture(), pixel_filter, WHOLE)
        assert_same_mean(mean_of(samples, pixel_filter=pixel_filter), expected)

    @pytest.mark.parametrize("response", ["box", "trapezoid", "triangle", "gaussian"])
    def test_shutters(self, response: ShutterResponse) -> None:
        samples = samples_of(11, 14, 9, timed=True)
        shutter = Shutter(0.2, 0.9, response)
        assert_same_mean(mean_of(samples, shutter=shutter), sample_mean(samples, Aperture(), BOX, shutter))

    def test_an_instant_is_hit_by_no_sample(self) -> None:
        assert not mean_of(samples_of(5, 6, 9, timed=True), shutter=Shutter(0.5, 0.5)).mean.any()

    def test_samples_that_are_not_in_their_pixels_places(self) -> None:
        samples = samples_of(9, 12, 4)
        order = np.random.default_rng(0).permutation(samples.depth.size)
        fields = {name: getattr(samples, name) for name in samples.field_names()}
        shuffled = {
            name: array.reshape(order.size, -1)[order].reshape(array.shape) for name, array in fields.items()
        }
        expected = sample_mean(samples, Aperture(), PixelFilter("gaussian"), WHOLE)
        mixed = SampleBuffer(**shuffled, lens=samples.lens)
        assert_same_mean(mean_of(mixed, pixel_filter=PixelFilter("gaussian")), expected)

    def test_order_of_threads_does_not_matter(self) -> None:
        samples = samples_of(9, 12, 6)
        means = [mean_of(samples, pixel_filter=PixelFilter("mitchell"), order=order) for order in ORDERS]
        for other in means[1:]:
            np.testing.assert_array_equal(other.mean, means[0].mean)
            np.testing.assert_array_equal(other.variance, means[0].variance)


class TestBlur:
    @pytest.mark.parametrize("sigma", [0.4, 2.7, 32.0])
    @pytest.mark.parametrize("squared", [False, True])
    def test_it_is_the_host_s_bit_by_bit(self, sigma: float, squared: bool) -> None:
        image = np.random.default_rng(1).random((17, 9, 3), np.float32)
        blurred = cuda_refine.blur(PhasesMachine(), image, sigma, squared=squared)
        np.testing.assert_array_equal(blurred, gaussian_blur(image, sigma, squared=squared))

    def test_some_channels(self) -> None:
        image = np.random.default_rng(1).random((17, 9, 2, 3), np.float32)
        blurred = cuda_refine.blur(PhasesMachine(), image, 1.5, channels=(3, 3))
        np.testing.assert_array_equal(blurred, gaussian_blur(image[:, :, 1], 1.5))


class TestBands:
    STARTS = (0.0, 4.0, 8.0, 16.0)

    @pytest.mark.parametrize("along_lens", [0.0, 0.02, 0.3])
    def test_they_are_joined_as_on_the_host(self, along_lens: float) -> None:
        rng = np.random.default_rng(3)
        bands = rng.uniform(0, 1, (14, 19, 4, 4)).astype(np.float32)
        bands[rng.random((14, 19, 4)) < 0.4] = 0
        bands[:4] = 0
        bands[:, :, 2] *= 0  # nothing at all in one band
        image = cuda_refine.smooth_bands(PhasesMachine(), bands, self.STARTS, along_lens)
        np.testing.assert_array_equal(image, refine.smooth_bands(bands, self.STARTS, along_lens))


def pixels_of(kind: str, height: int = 21, width: int = 26) -> tuple[Float32, SampleBuffer]:
    """Return an image, and samples that know it better in places."""
    spp = 1 if kind == "single" else 3
    samples = samples_of(height, width, spp)
    image = np.random.default_rng(2).gamma(2.0, 0.5, (height, width, 3)).astype(np.float32)
    if kind == "lights":
        image[:, :10] = 0
        bright = np.where(np.random.default_rng(4).random(samples.depth.shape) < 0.03, 1e4, 1.0)
        samples = replace(samples, color=(samples.color * bright[..., None]).astype(np.float32))
    if kind == "gaps":
        xy = samples.xy.copy()
        xy[4:12, 3:] = OFF_IMAGE
        samples = replace(samples, xy=xy)
    if kind == "none":
        samples = replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))
    if kind == "noiseless":
        samples = replace(samples, color=np.ones_like(samples.color))
    return image, samples


class TestCorrection:
    @pytest.mark.parametrize("sigma", [0.5, 1.8, 16.0])
    @pytest.mark.parametrize("kind", ["several", "single", "lights", "gaps", "noiseless", "none"])
    def test_it_is_the_host_s(self, kind: str, sigma: float) -> None:
        image, samples = pixels_of(kind)
        expected = refine.correct(image, sample_mean(samples, Aperture(), BOX, WHOLE), sigma)
        actual = cuda_refine.correct(PhasesMachine(), image, mean_of(samples), sigma)
        np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-6)
        assert kind == "none" or not np.allclose(expected, image, rtol=1e-3)

    def test_order_of_threads_does_not_matter(self) -> None:
        image, samples = pixels_of("single")
        mean = mean_of(samples)
        images = [cuda_refine.correct(PhasesMachine(order), image, mean, 1.8) for order in ORDERS]
        np.testing.assert_array_equal(images[1], images[0])
        np.testing.assert_array_equal(images[2], images[0])

    @pytest.mark.parametrize("size", [(1, 1), (1, 2), (1, 7), (3, 300)])
    def test_images_of_few_pixels(self, size: tuple[int, int]) -> None:
        """The median of one variance, of two, and of odd and even numbers of them."""
        image, samples = pixels_of("several", *size)
        expected = refine.correct(image, sample_mean(samples, Aperture(), BOX, WHOLE), 1.8)
        actual = cuda_refine.correct(PhasesMachine(), image, mean_of(samples), 1.8)
        np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-6)
