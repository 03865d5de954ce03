"""The multiplane method against images that are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fewrays import Lens, Multiplane, SampleBuffer, reconstruct
from fewrays.lens import LensAperture
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.sources.analytic import (
    Motion,
    Plane,
    constant,
    disc,
    exact_waves,
    half_plane,
    motion_of,
    reference,
    sample,
    smooth_noise,
    trace,
)

LENS = Lens(-100.0, 20.0)
SIDE = 64
BORDER = 12  # beyond what samples outside the image would have shown of it
STILL: Motion = (0.0, 0.0, 0.0)


def middle(image: Image) -> Image:
    return image[BORDER:-BORDER, BORDER:-BORDER]


def root_mean_square(error: Image) -> float:
    return float(np.sqrt(np.square(error).mean()))


class TestConstantImage:
    """Whatever the depths, the motion and the number of samples: there is one radiance to be seen."""

    radiance = (0.75, 0.5, 2.0)

    @pytest.mark.parametrize("device", ["cpu", "reference"])
    @pytest.mark.parametrize("spread", [0.0, 0.05, 1.0])
    @pytest.mark.parametrize("spp", [1, 4])
    def test_stays_constant(self, device: str, spread: float, spp: int) -> None:
        lens = Lens(-50.0, 10.0)
        samples = sample([Plane(5.0, constant(*self.radiance))], lens, 30, 41, spp)
        depth = 5.0 * np.exp(np.random.default_rng(0).normal(0.0, spread, samples.depth.shape))
        samples = replace(samples, depth=depth.astype(np.float32))
        image = reconstruct(samples, "multiplane", device=device, threads=1, views=16)
        # Half precision has 11 bits.
        np.testing.assert_allclose(image, np.broadcast_to(self.radiance, image.shape), rtol=2e-3)

    def test_moving(self) -> None:
        planes = [
            Plane(
                LENS.depth(-6.0),
                constant(*self.radiance),
                disc((20, 15), 9),
                motion_of(LENS.depth(-6), (9, 4)),
            ),
            Plane(LENS.depth(3.0), constant(*self.radiance), motion=motion_of(LENS.depth(3.0), (-5, 3))),
        ]
        image = reconstruct(sample(planes, LENS, 30, 41, 2), "multiplane", threads=1, views=16)
        np.testing.assert_allclose(image, np.broadcast_to(self.radiance, image.shape), rtol=2e-3)


class TestTexturedPlane:
    """Defocus and motion of one plane only attenuate its waves: the image is known exactly."""

    texture = smooth_noise(12, waves=8)

    @pytest.mark.parametrize(
        ("slope", "aperture"),
        [(-10.0, "disc"), (-3.0, "disc"), (-1.0, "disc"), (0.0, "disc"), (2.0, "disc"), (6.0, "gaussian")],
    )
    def test_still(self, slope: float, aperture: LensAperture) -> None:
        """Most is lost at -10 px, where planes are smoothed the most."""
        lens = replace(LENS, aperture=aperture, sampling=aperture)
        depth = lens.depth(slope)
        image = reconstruct(sample([Plane(depth, self.texture)], lens, SIDE, SIDE, 8), "multiplane")
        exact = exact_waves(self.texture, depth, lens, SIDE, SIDE, pixel_filter="box")
        assert psnr_display(middle(image), middle(exact)) > (52 if abs(slope) > 2.5 else 60)

    @pytest.mark.parametrize("period", [3.0, 12.0])
    def test_pinhole(self, period: float) -> None:
        """What is left is the pixel filter."""
        texture = smooth_noise(period, seed=4)
        lens = LENS.refocus(aperture_scale=0.0)
        samples = sample([Plane(2.0, texture)], lens, SIDE, SIDE, 16)
        exact = exact_waves(texture, 2.0, lens, SIDE, SIDE, pixel_filter="box")
        assert psnr_display(middle(reconstruct(samples, "multiplane")), middle(exact)) > 60
        elsewhere = replace(samples, uv=-0.5 * samples.uv)
        np.testing.assert_array_equal(
            reconstruct(samples, "multiplane", views=16), reconstruct(elsewhere, "multiplane", views=16)
        )

    @pytest.mark.parametrize(
        ("slope", "approach", "shutter", "error"),
        [
            (0.0, 0.0, (0.0, 1.0), 0.04),
            (6.0, 0.0, (0.3, 0.5), 0.05),
            # A plane keeps its slope while the shutter is open, and moves as a whole.
            (6.0, -0.3, (0.0, 1.0), 0.2),
            (0.0, -0.3, (0.3, 0.5), 0.12),
        ],
    )
    def test_moving(self, slope: float, approach: float, shutter: tuple[float, float], error: float) -> None:
        depth = LENS.depth(slope)
        centre = (SIDE / 2, SIDE / 2)
        motion = motion_of(depth, (12, -7), depth_change=approach * depth, principal_point=centre)
        samples = sample([Plane(depth, self.texture, motion=motion)], LENS, SIDE, SIDE, 8)
        image = reconstruct(samples, "multiplane", shutter=shutter)
        exact = exact_waves(
            self.texture, depth, LENS, SIDE, SIDE, motion=motion, shutter=shutter, pixel_filter="box"
        )
        still = exact_waves(self.texture, depth, LENS, SIDE, SIDE, pixel_filter="box")
        assert root_mean_square(middle(image - exact)) < error * root_mean_square(middle(still - exact))


@pytest.mark.parametrize(
    ("front", "back", "moving", "psnr"),
    [
        (-8.0, -2.0, True, 38.5),
        (0.0, 8.0, True, 39.5),
        (-8.0, 8.0, False, 45.5),
        (-8.0, 0.0, False, 45.0),
        (0.0, 8.0, False, 41.0),
    ],
)
def test_occlusion_out_of_focus(front: float, back: float, moving: bool, psnr: float) -> None:
    """A disc in front of a wall, which move in different directions. Averaging comes to 25 to 32 dB."""
    near, far = LENS.depth(front), LENS.depth(back)
    planes = [
        Plane(
            near,
            smooth_noise(10, waves=8, seed=1, mean=(0.8, 0.6, 0.2)),
            disc((28, 33), 12.3),
            motion_of(near, (12, -7)) if moving else STILL,
        ),
        Plane(
            far,
            smooth_noise(10, waves=8, seed=2, mean=(0.1, 0.2, 0.5)),
            motion=motion_of(far, (-5, 3)) if moving else STILL,
        ),
    ]
    truth = reference(planes, LENS, SIDE, SIDE, spp=256, pixel_filter="box")
    image = reconstruct(sample(planes, LENS, SIDE, SIDE, 8), "multiplane")
    assert psnr_display(middle(image), middle(truth)) > psnr


class TestSilhouette:
    """Discs neither grow nor shrink. Their radius is that of a disc of the area that is covered."""

    @pytest.mark.parametrize("moving", [False, True])
    @pytest.mark.parametrize(
        ("front", "back", "radius"),
        [(-8.0, 0.0, 6.3), (0.0, 8.0, 12.3), (-8.0, 8.0, 12.3), (-3.0, 10.0, 6.3), (0.0, 2.0, 6.3)],
    )
    def test_radius(self, front: float, back: float, radius: float, moving: bool) -> None:
        near, far = LENS.depth(front), LENS.depth(back)
        centre = (SIDE / 2 - 6, SIDE / 2 + 3.5) if moving else (SIDE / 2 + 0.3, SIDE / 2 - 0.2)
        motion = motion_of(near, (12, -7)) if moving else STILL
        planes = [Plane(near, constant(1), disc(centre, radius), motion), Plane(far, constant(0))]
        image = reconstruct(sample(planes, LENS, SIDE, SIDE, 16), "multiplane", views=64)
        covered = float(np.sqrt(image[..., 0].sum(dtype=np.float64) / np.pi))
        assert covered == pytest.approx(radius, abs=0.06)


class TestExclusiveVisibility:
    """The layered paper's Figures 6 to 8: two things that no lens point sees at once.

    Opacities that are averaged over the lens before compositing (Eq. 34) let one take light from the other.
    """

    size = 96
    lens = Lens(-500.0, 100.0, "gaussian", "square")
    black = Plane(lens.depth(30.0), constant(0.0))

    def test_a_disc_in_front_of_another(self) -> None:
        front = Plane(self.lens.depth(-24.0), constant(1.0, 0.0, 0.0), disc((48, 48), 14))
        back = Plane(self.lens.depth(24.0), constant(0.0, 1.0, 0.0), disc((48, 48), 14))
        planes = [front, back, self.black]
        samples = sample(planes, self.lens, self.size, self.size, 16)
        truth = reference(planes, self.lens, self.size, self.size, spp=256, pixel_filter="box")
        radius = np.hypot(*(np.indices((self.size, self.size)) + 0.5 - 48))
        ring = (radius > 12) & (radius < 20)
        published = (truth - reconstruct(samples, "layered-published"))[..., 1][ring]
        missing = (truth - reconstruct(samples, "multiplane"))[..., 1][ring]
        assert published.mean() > 0.05
        assert abs(missing.mean()) < 0.1 * published.mean()
        assert np.abs(missing).max() < 0.3 * published.max()

    def test_two_halves_that_hide_everything(self) -> None:
        """In front one half plane, far behind its edge the other half: nothing shines through.

        Of opposite C, the second is hit from just those lens points that pass the first. Averaged opacities
        of one half each would let a quarter of the light through.
        """
        lens = Lens(-500.0, 100.0)
        planes = [
            Plane(lens.depth(-16.0), constant(0.0), half_plane((48, 48), (1, 0))),
            Plane(lens.depth(16.0), constant(0.0), half_plane((48, 48), (1, 0))),
            Plane(lens.depth(17.0), constant(1.0)),
        ]
        samples = sample(planes, lens, self.size, self.size, 16)
        truth = exact_columns(planes, lens, self.size)
        multiplane, published = (
            np.abs(columns_of(reconstruct(samples, name)) - truth).max()
            for name in ("multiplane", "layered-published")
        )
        assert published > 0.08
        assert multiplane < 0.015

    @pytest.mark.parametrize("aperture", ["disc", "gaussian"])
    @pytest.mark.parametrize(
        ("options", "error"), [({}, 0.04), ({"views": 512}, 0.02)], ids=["default", "fine"]
    )
    def test_a_slit(self, aperture: LensAperture, options: dict[str, Any], error: float) -> None:
        """Through a slit that is narrower than its blur, each pixel sees a part of the lens alone.

        The number of views is what the rest of the error is made of.
        """
        lens = Lens(-500.0, 100.0, aperture, "disc" if aperture == "disc" else "square")
        left, right = half_plane((45, 48), (-1, 0)), half_plane((51, 48), (1, 0))
        planes = [
            Plane(lens.depth(-16.0), constant(0.2, 0.0, 0.0), lambda xy: left(xy) | right(xy)),
            Plane(lens.depth(20.0), constant(0.0, 1.0, 0.0), half_plane((48, 48), (1, 0))),
            Plane(lens.depth(24.0), constant(0.0, 0.0, 1.0)),
        ]
        samples = sample(planes, lens, self.size, self.size, 16)
        missing = columns_of(reconstruct(samples, "multiplane", **options)) - exact_columns(
            planes, lens, self.size
        )
        assert np.abs(missing).max() < error


def columns_of(image: Image) -> Image:
    """Mean of a column's pixels (W, 3) in an image all of whose rows are alike, far from its borders."""
    mean: Image = image[24:-24, 24:-24].mean(axis=0)
    return mean


def exact_columns(planes: list[Plane], lens: Lens, width: int) -> Image:
    """Integrate planes that do not change along y over x and u, for comparison with `columns_of`."""
    u = (np.arange(400) + 0.5) / 200 - 1
    weight = np.sqrt(1 - u**2) if lens.aperture == "disc" else np.exp(-0.5 * (u / lens.sigma) ** 2)
    x = np.arange(width)[:, None, None] + (np.arange(16)[:, None] + 0.5) / 16
    x, u = np.broadcast_arrays(x, u)
    color, _ = trace(planes, lens, np.stack([x, 0 * x], axis=-1), np.stack([u, 0 * u], axis=-1))
    exact: Image = np.average(color.mean(axis=1), axis=1, weights=weight)[24:-24]
    return exact


@pytest.mark.parametrize(("built", "wanted"), [(12.0, 0.0), (-10.0, 2.0), (0.0, 12.0)])
def test_refocused_planes(built: float, wanted: float) -> None:
    """Planes that were blurred are sharp in focus, and those in focus have no grain when they are blurred."""
    texture = smooth_noise(8, waves=8)
    depth = LENS.depth(built)
    lens = replace(LENS, c1=LENS.c1 + wanted - built)
    planes = Multiplane.build(sample([Plane(depth, texture)], LENS, SIDE, SIDE, 8), threads=1)
    exact = exact_waves(texture, depth, lens, SIDE, SIDE, pixel_filter="box")
    assert psnr_display(middle(planes.render(lens)), middle(exact)) > 52


class TestLights:
    """A light a thousand times as bright as the scene keeps its energy, in focus and far out of it."""

    @pytest.mark.parametrize("slope", [-20.0, -6.0, 0.0, 10.0])
    def test_radiance_is_conserved(self, slope: float) -> None:
        ratios = []
        for seed in range(16):
            center = np.random.default_rng(seed).uniform(46, 50, 2)
            light = Plane(LENS.depth(slope), constant(1000.0), disc((center[0], center[1]), 5.0))
            samples = sample([light, Plane(LENS.depth(15.0), constant(0.1))], LENS, 96, 96, 8, seed=seed)
            image = reconstruct(samples, "multiplane", threads=1, views=32)
            assert image.min() > 0.099
            ratios.append(image[..., 0].sum(dtype=np.float64) / (1000 * np.pi * 25 + 0.1 * 96**2))
        assert np.std(ratios) < 0.05
        assert np.mean(ratios) == pytest.approx(1, abs=0.01)


class TestRefocusing:
    """Planes made of samples of one lens give the image of another."""

    lens = Lens(-40.0, 10.0, "gaussian", "square")  # focused at 4
    planes = (
        Plane(2.0, smooth_noise(4, waves=6, seed=1), disc((48, 48), 20)),
        Plane(6.0, smooth_noise(4, waves=6, seed=2)),
    )

    @pytest.fixture(scope="class")
    @classmethod
    def samples(cls) -> SampleBuffer:
        return sample(cls.planes, cls.lens, 96, 96, 8)

    @pytest.fixture(scope="class")
    @classmethod
    def built(cls, samples: SampleBuffer) -> Multiplane:
        return Multiplane.build(samples)

    @pytest.mark.parametrize(
        ("focus_distance", "aperture_scale", "psnr"),
        [(None, 1.0, 40.0), (2.0, 1.0, 40.0), (6.0, 1.0, 40.0), (None, 0.5, 40.0), (3.0, 0.5, 40.0)],
    )
    def test_is_close_to_the_image_of_the_other_lens(
        self,
        samples: SampleBuffer,
        built: Multiplane,
        focus_distance: float | None,
        aperture_scale: float,
        psnr: float,
    ) -> None:
        """Without refocusing they would differ by 24 to 35 dB."""
        lens = self.lens.refocus(focus_distance, aperture_scale)
        truth = reference(self.planes, lens, 96, 96, spp=128, pixel_filter="box")
        image = built.render(lens)
        assert psnr_display(middle(image), middle(truth)) > psnr
        rebuilt = Multiplane.build(samples.refocus(focus_distance, aperture_scale)).render()
        assert psnr_display(middle(image), middle(rebuilt)) > 42

    def test_one_plane_seen_sharp_and_blurred(self) -> None:
        """Of waves that one plane shows, the image through any lens is known exactly."""
        texture = smooth_noise(12, waves=8)
        depth = LENS.depth(6.0)
        built = Multiplane.build(sample([Plane(depth, texture)], LENS, SIDE, SIDE, 8))
        for lens in (LENS, LENS.refocus(depth), LENS.refocus(LENS.depth(8.0)), LENS.refocus(None, 0.4)):
            exact = exact_waves(texture, depth, lens, SIDE, SIDE, pixel_filter="box")
            assert psnr_display(middle(built.render(lens)), middle(exact)) > 52, lens

    def test_another_aperture(self, built: Multiplane) -> None:
        """The Gaussian of a third of the lens gives way to a disc of the whole of it."""
        image = built.render(replace(self.lens, aperture="disc"))
        lens = replace(self.lens, aperture="disc", sampling="disc")
        truth = reference(self.planes, lens, 96, 96, spp=128, pixel_filter="box")
        assert psnr_display(middle(image), middle(truth)) > 40
