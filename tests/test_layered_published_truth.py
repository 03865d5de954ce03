"""The published layered method against images that are known, as near as its filters come to them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fewrays import Lens
from fewrays import reconstruct as reconstruct_with
from fewrays.lens import LensAperture, Sampling
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.sources.analytic import (
    Plane,
    Waves,
    constant,
    disc,
    exact_waves,
    reference,
    sample,
    smooth_noise,
)

reconstruct = partial(reconstruct_with, method="layered-published")

SIZE = 96
BORDER = 24  # no samples lie outside the image, so its edge is no test of an unbounded plane


def lens_with(aperture: LensAperture = "gaussian", sampling: Sampling = "square") -> Lens:
    return Lens(-500.0, 100.0, aperture, sampling)


@pytest.mark.parametrize("method", ["layered-published", "layered-axis-aligned"])
@pytest.mark.parametrize("device", ["cpu", "reference"])
def test_constant_image_stays_constant(method: str, device: str) -> None:
    """Whatever the depths: every layer has the same radiance, and missing opacity is made up for."""
    rng = np.random.default_rng(0)
    lens = Lens(-50.0, 10.0, "gaussian", "square")
    samples = sample([Plane(5.0, constant(0.75, 0.5, 2.0))], lens, 40, 50, 2)
    depth = 5.0 * np.exp(rng.normal(0.0, 1.0, samples.depth.shape))
    samples = replace(samples, depth=depth.astype(np.float32))
    image = reconstruct_with(samples, method, device=device)
    np.testing.assert_allclose(image, np.broadcast_to([0.75, 0.5, 2.0], image.shape), rtol=1e-5)


@pytest.mark.parametrize("slope", [-30.0, -12.5, -5.0, -2.0, -1.0, 0.0, 0.7, 1.4, 1.6, 3.0, 6.0, 15.0, 60.0])
@pytest.mark.parametrize(("sampling", "psnr"), [("square", 45.0), ("disc", 45.0), ("gaussian", 43.3)])
def test_textured_plane_is_close_to_its_exact_blur(slope: float, sampling: Sampling, psnr: float) -> None:
    """The worst of these slopes is 1.6 px, or 15 px where importance samples are not weighted up."""
    lens = lens_with(sampling=sampling)
    depth = lens.depth(slope)
    texture = smooth_noise(6, seed=3)
    image = reconstruct(sample([Plane(depth, texture)], lens, SIZE, SIZE, 8))
    exact = exact_waves(texture, depth, lens, SIZE, SIZE)
    inner = slice(BORDER, -BORDER)
    assert psnr_display(image[inner, inner], exact[inner, inner]) > psnr


@pytest.mark.parametrize("slope", [-20.0, -4.0, 3.0, 25.0])
def test_disc_is_blurred_as_the_gaussian_of_equal_second_moment(slope: float) -> None:
    lens = lens_with("disc", "disc")
    texture = smooth_noise(6, seed=3)
    samples = sample([Plane(lens.depth(slope), texture)], lens, SIZE, SIZE, 8)
    variance = 0.5**2 + slope**2 / 4
    attenuation = np.exp(-2 * np.pi**2 * variance * np.square(texture.frequency).sum(axis=-1))
    blurred = replace(texture, amplitude=texture.amplitude * attenuation[:, None])
    centers = np.moveaxis(np.indices((SIZE, SIZE), np.float64)[::-1], 0, -1) + 0.5
    inner = slice(BORDER, -BORDER)
    assert psnr_display(reconstruct(samples)[inner, inner], blurred(centers)[inner, inner]) > 42.2


class TestPinhole:
    lens = lens_with().refocus(aperture_scale=0.0)
    texture: Waves = smooth_noise(3.0, seed=4)

    def test_equals_the_pixel_filtered_image(self) -> None:
        image = reconstruct(sample([Plane(2.0, self.texture)], self.lens, SIZE, SIZE, 16))
        exact = exact_waves(self.texture, 2.0, self.lens, SIZE, SIZE)
        inner = slice(BORDER, -BORDER)
        assert psnr_display(image[inner, inner], exact[inner, inner]) > 54.9

    def test_does_not_depend_on_lens_positions(self) -> None:
        samples = sample([Plane(2.0, self.texture)], self.lens, 40, 40, 4)
        elsewhere = replace(samples, uv=-0.5 * samples.uv)
        np.testing.assert_array_equal(reconstruct(samples), reconstruct(elsewhere))

    def test_is_the_gaussian_mean_of_the_samples_at_hand(self) -> None:
        """Every sample as if at its pixel's centre, as bins are a pixel wide."""
        samples = sample([Plane(2.0, self.texture)], self.lens, 40, 40, 4)
        centers = np.arange(40) + 0.5
        distance = centers[:, None, None] - (np.floor(samples.xy.astype(np.float64)) + 0.5).reshape(-1, 2)
        weights_x, weights_y = np.moveaxis(np.exp(-(distance**2) / (2 * 0.5**2)), 2, 0)
        color = samples.color.reshape(-1, 3).astype(np.float64)
        sums = np.einsum("is,js,sc->ijc", weights_y, weights_x, np.column_stack([color, np.ones(len(color))]))
        np.testing.assert_allclose(reconstruct(samples), sums[..., :3] / sums[..., 3:], atol=2e-6)


class TestTwoDiscs:
    """The paper's Figures 6 to 8: a disc in front of another, both out of focus, on black.

    At the discs' edges they are seen from exclusive parts of the lens. Average opacities take away from the
    disc behind although nothing covers it there (Eq. 36 and 37).
    """

    @pytest.fixture(scope="class")
    @classmethod
    def images(cls) -> dict[str, Image]:
        lens = lens_with()
        front = Plane(lens.depth(-24.0), constant(1.0, 0.0, 0.0), disc((48, 48), 14))
        back = Plane(lens.depth(24.0), constant(0.0, 1.0, 0.0), disc((48, 48), 14))
        black = Plane(lens.depth(30.0), constant(0.0))
        samples = sample([front, back, black], lens, SIZE, SIZE, 16)
        alone = [reference([plane, black], lens, SIZE, SIZE, spp=512) for plane in (front, back)]
        return {
            "published": reconstruct(samples),
            "truth": reference([front, back, black], lens, SIZE, SIZE, spp=512),
            # Eq. 37, from each disc's own exact image.
            "predicted": alone[0] + (1 - alone[0][..., :1]) * alone[1],
        }

    def test_front_disc_is_right(self, images: dict[str, Image]) -> None:
        assert np.abs(images["published"] - images["truth"])[..., 0].max() < 0.055

    def test_occlusion_is_over_estimated_at_the_edge(self, images: dict[str, Image]) -> None:
        """Where the discs are seen from exclusive parts of the lens, the one behind loses light."""
        ring = np.zeros((SIZE, SIZE), bool)
        radius = np.hypot(*(np.indices((SIZE, SIZE)) + 0.5 - 48))
        ring[(radius > 12) & (radius < 20)] = True
        loss = (images["truth"] - images["published"])[..., 1][ring]
        assert loss.min() > -0.02
        assert loss.max() > 0.1

    def test_back_disc_is_as_predicted(self, images: dict[str, Image]) -> None:
        assert np.abs(images["published"] - images["predicted"])[..., 1].max() < 0.045

    def test_nothing_worse(self, images: dict[str, Image]) -> None:
        """The error is that of averaging the opacity, Eq. 34, and noise of a few percent."""
        predicted_error = np.abs(images["predicted"] - images["truth"])
        assert (np.abs(images["published"] - images["truth"]) < predicted_error + 0.055).all()


class TestRefocusing:
    """Samples taken through one lens give the image of another."""

    lens = Lens(-40.0, 10.0, "gaussian", "square")  # focused at 4
    planes = (Plane(2.0, smooth_noise(4, seed=1), disc((48, 48), 20)), Plane(6.0, smooth_noise(4, seed=2)))

    @pytest.mark.parametrize(
        ("focus_distance", "aperture_scale", "psnr"),
        [(2.0, 1.0, 46.0), (6.0, 1.0, 44.4), (None, 0.5, 40.0), (3.0, 0.5, 40.4), (None, 0.0, 33.0)],
    )
    def test_is_close_to_the_image_of_the_other_lens(
        self, focus_distance: float | None, aperture_scale: float, psnr: float
    ) -> None:
        """Without refocusing they would differ by 24 to 35 dB."""
        samples = sample(self.planes, self.lens, SIZE, SIZE, 8)
        refocused = samples.refocus(focus_distance, aperture_scale)
        truth = reference(self.planes, refocused.lens, SIZE, SIZE, spp=256)
        inner = slice(12, -12)
        assert psnr_display(reconstruct(refocused)[inner, inner], truth[inner, inner]) > psnr
