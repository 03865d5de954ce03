"""The layered method against images that are known."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fewrays import Lens, SampleBuffer
from fewrays import reconstruct as reconstruct_with
from fewrays.layered import reference as numpy_twin
from fewrays.layered.plan import Plan
from fewrays.lens import Sampling
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.parallel import Execution
from fewrays.sources.analytic import (
    Plane,
    Waves,
    constant,
    disc,
    exact_waves,
    grating,
    half_plane,
    reference,
    sample,
    smooth_noise,
)

reconstruct = partial(reconstruct_with, method="layered")

INNER = 64  # side of the square in the middle that is looked at: no samples lie outside the image
SLOPES = [-240.0, -60.0, -12.5, -5.0, -2.0, -1.0, 0.0, 0.7, 1.4, 1.6, 3.0, 6.0, 15.0, 60.0, 120.0]


def middle(image: Image) -> Image:
    row, column = ((side - INNER) // 2 for side in image.shape[:2])
    return image[row : row + INNER, column : column + INNER]


@pytest.mark.parametrize("device", ["cpu", "reference"])
def test_constant_image_stays_constant(device: str) -> None:
    """Whatever the depths: every layer has the same radiance, and missing opacity is made up for."""
    rng = np.random.default_rng(0)
    lens = Lens(-50.0, 10.0)
    samples = sample([Plane(5.0, constant(0.75, 0.5, 2.0))], lens, 40, 50, 2)
    depth = 5.0 * np.exp(rng.normal(0.0, 1.0, samples.depth.shape))
    samples = replace(samples, depth=depth.astype(np.float32))
    image = reconstruct(samples, device=device)
    np.testing.assert_allclose(image, np.broadcast_to([0.75, 0.5, 2.0], image.shape), rtol=1e-5)


class TestTexturedPlane:
    """A plane of any slope comes out as its exact blur: details of its texture grow with the blur."""

    @staticmethod
    def sampled(slope: float, lens: Lens) -> tuple[SampleBuffer, Waves]:
        radius = int(abs(slope))
        texture = smooth_noise(max(6.0, radius), waves=8, seed=3)
        side = INNER + 2 * radius + 16
        return sample([Plane(lens.depth(slope), texture)], lens, side, side, 8 if radius < 30 else 2), texture

    @pytest.mark.parametrize("slope", SLOPES)
    @pytest.mark.parametrize("sampling", ["square", "gaussian"])
    def test_gaussian_aperture(self, slope: float, sampling: Sampling) -> None:
        """The worst is 2 px, where the bins of a pixel are wide for the blur of a part."""
        lens = Lens(-2500.0, 500.0, "gaussian", sampling)
        samples, texture = self.sampled(slope, lens)
        exact = exact_waves(texture, lens.depth(slope), lens, samples.height, samples.width)
        assert psnr_display(middle(reconstruct(samples)), middle(exact)) > 50

    @pytest.mark.parametrize("slope", SLOPES)
    def test_disc_is_blurred_as_the_gaussian_of_equal_second_moment(self, slope: float) -> None:
        lens = Lens(-2500.0, 500.0, "disc", "disc")
        samples, texture = self.sampled(slope, lens)
        variance = 0.5**2 + slope**2 / 4
        attenuation = np.exp(-2 * np.pi**2 * variance * np.square(texture.frequency).sum(axis=-1))
        blurred = replace(texture, amplitude=texture.amplitude * attenuation[:, None])
        centers = np.moveaxis(np.indices((samples.height, samples.width), np.float64)[::-1], 0, -1) + 0.5
        exact = blurred(centers).astype(np.float32)
        assert psnr_display(middle(reconstruct(samples)), middle(exact)) > 50


class TestPinhole:
    """All slopes 0: nothing is left but the pixel filter."""

    lens = Lens(-500.0, 100.0).refocus(aperture_scale=0.0)
    texture: Waves = smooth_noise(3.0, seed=4)

    def test_equals_the_pixel_filtered_image(self) -> None:
        image = reconstruct(sample([Plane(2.0, self.texture)], self.lens, 80, 80, 16))
        exact = exact_waves(self.texture, 2.0, self.lens, 80, 80)
        assert psnr_display(middle(image), middle(exact)) > 55

    def test_does_not_depend_on_lens_positions(self) -> None:
        samples = sample([Plane(2.0, self.texture)], self.lens, 40, 40, 4)
        elsewhere = replace(samples, uv=-0.5 * samples.uv)
        np.testing.assert_array_equal(reconstruct(samples), reconstruct(elsewhere))

    @pytest.mark.parametrize("sigma_pix", [0.5, 1.0])
    def test_is_the_gaussian_mean_of_the_samples_at_hand(self, sigma_pix: float) -> None:
        """Of every sample as if in the middle of its bin; bins are a quarter of a pixel wide."""
        samples = sample([Plane(2.0, self.texture)], self.lens, 40, 40, 4)
        centers = np.arange(40) + 0.5
        binned = (np.floor(samples.xy.astype(np.float64) * 4) + 0.5) / 4
        distance = centers[:, None, None] - binned.reshape(-1, 2)
        variance = sigma_pix**2 - 1 / 12 / 16
        weights_x, weights_y = np.moveaxis(np.exp(-(distance**2) / (2 * variance)), 2, 0)
        color = samples.color.reshape(-1, 3).astype(np.float64)
        sums = np.einsum("is,js,sc->ijc", weights_y, weights_x, np.column_stack([color, np.ones(len(color))]))
        image = reconstruct(samples, sigma_pix=sigma_pix)
        # The method ends its kernel at three standard deviations and makes up for the variance.
        np.testing.assert_allclose(image, sums[..., :3] / sums[..., 3:], atol=0.01)


class TestTwoDiscs:
    """The paper's Figures 6 to 8: a disc in front of another, both out of focus, on black.

    At the discs' edges they are seen from exclusive parts of the lens. The published method's average
    opacities take away from the disc behind although nothing covers it there (Eq. 36 and 37).
    """

    size = 96
    lens = Lens(-500.0, 100.0, "gaussian", "square")

    @pytest.fixture(scope="class")
    @classmethod
    def losses(cls) -> dict[str, Image]:
        """Green that is missing where the rim of the front disc hides the rim of the other."""
        front = Plane(cls.lens.depth(-24.0), constant(1.0, 0.0, 0.0), disc((48, 48), 14))
        back = Plane(cls.lens.depth(24.0), constant(0.0, 1.0, 0.0), disc((48, 48), 14))
        black = Plane(cls.lens.depth(30.0), constant(0.0))
        planes = [front, back, black]
        samples = sample(planes, cls.lens, cls.size, cls.size, 16)
        truth = reference(planes, cls.lens, cls.size, cls.size, spp=512)
        radius = np.hypot(*(np.indices((cls.size, cls.size)) + 0.5 - 48))
        ring = (radius > 12) & (radius < 20)
        images = {
            "published": reconstruct_with(samples, "layered-published"),
            "layered": reconstruct(samples),
            "one part": reconstruct(samples, aperture_parts=1),
        }
        return {name: (truth - image)[..., 1][ring] for name, image in images.items()}

    def test_less_than_half_of_what_the_published_method_loses(self, losses: dict[str, Image]) -> None:
        published = losses["published"]
        assert published.max() > 0.1
        assert np.abs(losses["layered"]).max() < 0.5 * published.max()

    @pytest.mark.parametrize("name", ["layered", "one part"])
    def test_nothing_is_lost_on_average(self, losses: dict[str, Image], name: str) -> None:
        """Already the covariance over the whole lens sees to that."""
        assert losses["published"].mean() > 0.05
        assert abs(losses[name].mean()) < 0.25 * losses["published"].mean()

    def test_parts_of_the_aperture_help(self, losses: dict[str, Image]) -> None:
        assert np.square(losses["layered"]).mean() < 0.7 * np.square(losses["one part"]).mean()


class TestAnyBlurRadius:
    """Coarse bins take nothing away: slopes eight times as large, against the method on pixels."""

    lens = Lens(-600.0, 120.0, "gaussian", "square")
    size = 144
    planes = (
        Plane(lens.depth(-56.0), grating((0.02, 0.01)), disc((60, 70), 25)),
        Plane(lens.depth(8.0), grating((0.05, -0.03)), half_plane((72, 72), (1, 0.4))),
        Plane(lens.depth(80.0), grating((-0.01, 0.015), phase=1.0)),
    )

    @pytest.fixture(scope="class")
    @classmethod
    def truth(cls) -> Image:
        return reference(cls.planes, cls.lens, cls.size, cls.size, spp=160)

    @staticmethod
    def on_pixels(samples: SampleBuffer) -> Image:
        plan = Plan.for_samples(samples, sigma_pix=0.5, layer_spacing=0.16, aperture_parts=7, tile=144)
        assert plan.slabs.levels.max() >= 3
        slabs = replace(plan.slabs, levels=np.minimum(plan.slabs.levels, 0))
        image = np.zeros((samples.height, samples.width, 3), np.float32)
        counts = np.zeros(plan.tile_count, np.int32)
        numpy_twin.reconstruct_tiles(samples, replace(plan, slabs=slabs), image, counts, None, Execution())
        return image

    @pytest.mark.parametrize("spp", [2, 8])
    def test_is_as_good_as_without_coarse_bins(self, truth: Image, spp: int) -> None:
        samples = sample(self.planes, self.lens, self.size, self.size, spp)
        psnr = psnr_display(middle(reconstruct(samples)), middle(truth))
        without = psnr_display(middle(self.on_pixels(samples)), middle(truth))
        assert without > 30
        assert psnr > without - 0.5


class TestLights:
    """A light a thousand times as bright as the scene keeps its energy, in focus and far out of it."""

    @pytest.mark.parametrize("slope", [-20.0, -6.0, 0.0, 10.0])
    def test_radiance_is_conserved(self, slope: float) -> None:
        lens = Lens(-100.0, 20.0)
        ratios = []
        for seed in range(24):
            center = np.random.default_rng(seed).uniform(46, 50, 2)
            light = Plane(lens.depth(slope), constant(1000.0), disc((center[0], center[1]), 5.0))
            samples = sample([light, Plane(lens.depth(15.0), constant(0.1))], lens, 96, 96, 8, seed=seed)
            image = reconstruct(samples, threads=1)
            assert image.min() > 0.0999
            ratios.append(image[..., 0].sum(dtype=np.float64) / (1000 * np.pi * 25 + 0.1 * 96**2))
        assert np.std(ratios) < 0.1
        assert np.mean(ratios) == pytest.approx(1, abs=0.01)


class TestRefocusing:
    """Samples taken through one lens give the image of another."""

    lens = Lens(-40.0, 10.0, "gaussian", "square")  # focused at 4
    planes = (
        Plane(2.0, smooth_noise(4, waves=6, seed=1), disc((48, 48), 20)),
        Plane(6.0, smooth_noise(4, waves=6, seed=2)),
    )

    @pytest.mark.parametrize(
        ("focus_distance", "aperture_scale", "psnr"),
        [(2.0, 1.0, 40.0), (6.0, 1.0, 40.0), (None, 0.5, 40.0), (3.0, 0.5, 40.0), (None, 0.0, 33.0)],
    )
    def test_is_close_to_the_image_of_the_other_lens(
        self, focus_distance: float | None, aperture_scale: float, psnr: float
    ) -> None:
        """Without refocusing they would differ by 24 to 35 dB."""
        refocused = sample(self.planes, self.lens, 96, 96, 8).refocus(focus_distance, aperture_scale)
        truth = reference(self.planes, refocused.lens, 96, 96, spp=128)
        inner = np.s_[12:-12, 12:-12]
        assert psnr_display(reconstruct(refocused)[inner], truth[inner]) > psnr
