"""The temporal method against images that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.lens import LensAperture
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.parallel import Execution
from fewrays.sources.analytic import (
    Motion,
    Plane,
    constant,
    disc,
    exact_waves,
    motion_of,
    reference,
    sample,
    smooth_noise,
)
from fewrays.temporal import TemporalOptions, kernel, make_plan
from fewrays.temporal.locations import Locations

LENS = Lens(-100.0, 20.0)
SIDE = 64
BORDER = 12  # beyond what samples outside the image would have shown of it


def middle(image: Image) -> Image:
    return image[BORDER:-BORDER, BORDER:-BORDER]


def root_mean_square(error: Image) -> float:
    return float(np.sqrt(np.square(error).mean()))


class TestTexturedPlane:
    """Defocus and motion of one plane only attenuate its waves: the image is known exactly."""

    texture = smooth_noise(12, waves=8)

    @pytest.mark.parametrize(
        ("slope", "aperture"),
        [(-10.0, "disc"), (0.0, "disc"), (12.0, "disc"), (6.0, "gaussian")],
    )
    def test_still(self, slope: float, aperture: LensAperture) -> None:
        lens = replace(LENS, aperture=aperture, sampling=aperture)
        depth = lens.depth(slope)
        image = reconstruct(sample([Plane(depth, self.texture)], lens, SIDE, SIDE, 8), "temporal")
        exact = exact_waves(self.texture, depth, lens, SIDE, SIDE, pixel_filter="box")
        assert psnr_display(middle(image), middle(exact)) > 56

    @pytest.mark.parametrize(
        ("slope", "approach", "shutter"),
        [
            (0.0, 0.0, (0.0, 1.0)),
            (6.0, 0.0, (0.3, 0.5)),
            (6.0, -0.3, (0.0, 1.0)),
            (0.0, -0.3, (0.3, 0.5)),
        ],
    )
    def test_moving(self, slope: float, approach: float, shutter: tuple[float, float]) -> None:
        depth = LENS.depth(slope)
        centre = (SIDE / 2, SIDE / 2)
        motion = motion_of(depth, (12, -7), depth_change=approach * depth, principal_point=centre)
        samples = sample([Plane(depth, self.texture, motion=motion)], LENS, SIDE, SIDE, 8)
        image = reconstruct(samples, "temporal", locations=64, shutter=shutter)
        exact = exact_waves(
            self.texture, depth, LENS, SIDE, SIDE, motion=motion, shutter=shutter, pixel_filter="box"
        )
        # With changing depth, samples at the edges are missing from farther away.
        assert psnr_display(middle(image), middle(exact)) > 48
        still = exact_waves(self.texture, depth, LENS, SIDE, SIDE, pixel_filter="box")
        assert root_mean_square(middle(image - exact)) < 0.1 * root_mean_square(middle(still - exact))


def occlusion(front: float, back: float, *, moving: bool) -> list[Plane]:
    """A disc in front of a wall, of given slopes, which move in different directions."""
    near, far = LENS.depth(front), LENS.depth(back)
    still: Motion = (0.0, 0.0, 0.0)
    return [
        Plane(
            near,
            smooth_noise(10, waves=8, seed=1, mean=(0.8, 0.6, 0.2)),
            disc((28, 33), 12.3),
            motion_of(near, (12, -7)) if moving else still,
        ),
        Plane(
            far,
            smooth_noise(10, waves=8, seed=2, mean=(0.1, 0.2, 0.5)),
            motion=motion_of(far, (-5, 3)) if moving else still,
        ),
    ]


@pytest.mark.parametrize(
    ("front", "back", "moving"),
    [(-8.0, -2.0, True), (0.0, 8.0, True), (-8.0, 8.0, False)],
)
def test_occlusion_out_of_focus(front: float, back: float, moving: bool) -> None:
    planes = occlusion(front, back, moving=moving)
    truth = reference(planes, LENS, SIDE, SIDE, spp=256, pixel_filter="box")
    samples = sample(planes, LENS, SIDE, SIDE, 8)
    image = reconstruct(samples, "temporal")
    assert psnr_display(middle(image), middle(truth)) > 39
    # The mean of the samples of each pixel, of which this makes more.
    plain = samples.color.mean(axis=2)
    assert root_mean_square(middle(image - truth)) < 0.45 * root_mean_square(middle(plain - truth))


def pinhole_view(samples: SampleBuffer, u: float, v: float, time: float) -> Image:
    """What is seen from one lens point at one time, in the mean over 4 x 4 places in each pixel."""
    places = (np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2) + 0.5) / 4 - 0.5
    count = len(places)
    columns = [np.broadcast_to([u, v], (count, 2)), np.full(count, time), places, np.full(count, 1 / count)]
    locations = Locations(*(column.astype(np.float32) for column in columns))
    plan = replace(make_plan(samples, TemporalOptions()), locations=locations)
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    kernel.reconstruct_tiles(samples, plan, bands, Execution())
    sums = bands.sum(axis=2)
    image: Image = sums[..., :3] / np.maximum(sums[..., 3:], 1e-6)
    return image


def moved(plane: Plane, offset: npt.NDArray[np.float64]) -> Plane:
    """Paint a still plane elsewhere, by an offset in pixels."""
    mask = plane.mask
    return replace(
        plane,
        color=lambda xy: plane.color(xy - offset),
        mask=None if mask is None else lambda xy: mask(xy - offset),
    )


class TestPinholeViews:
    """One lens point at one time shows a sharp picture, however blurred the samples' image is."""

    @pytest.mark.parametrize(
        ("front", "back", "time"), [(-8.0, 0.0, 0.0), (0.0, 8.0, 0.7), (-8.0, 8.0, 0.7), (-8.0, -2.0, 1.0)]
    )
    def test_from_the_lens_centre(self, front: float, back: float, time: float) -> None:
        planes = occlusion(front, back, moving=True)
        image = pinhole_view(sample(planes, LENS, SIDE, SIDE, 16), 0.0, 0.0, time)
        pinhole = LENS.refocus(aperture_scale=0.0)
        moment = (time, time)
        truth = reference(planes, pinhole, SIDE, SIDE, spp=64, pixel_filter="box", shutter=moment)
        assert psnr_display(middle(image), middle(truth)) > 37

    def test_from_the_rim(self) -> None:
        """There each plane is where its slope moves it."""
        planes = occlusion(-8.0, 4.0, moving=False)
        image = pinhole_view(sample(planes, LENS, SIDE, SIDE, 16), 0.6, -0.8, 0.0)
        lens_point = np.array([0.6, -0.8])
        there = [moved(plane, LENS.slope(plane.depth) * lens_point) for plane in planes]
        pinhole = LENS.refocus(aperture_scale=0.0)
        truth = reference(there, pinhole, SIDE, SIDE, spp=64, pixel_filter="box")
        assert psnr_display(middle(image), middle(truth)) > 37


class TestSilhouette:
    """Figure 5: discs neither grow nor shrink. Their radius is that of a disc of the area that is covered."""

    @staticmethod
    def discs(front: float, back: float, radius: float, spp: int, *, moving: bool) -> SampleBuffer:
        near, far = LENS.depth(front), LENS.depth(back)
        centre = (SIDE / 2 - 6, SIDE / 2 + 3.5) if moving else (SIDE / 2 + 0.3, SIDE / 2 - 0.2)
        motion = motion_of(near, (12, -7)) if moving else (0.0, 0.0, 0.0)
        planes = [Plane(near, constant(1), disc(centre, radius), motion), Plane(far, constant(0))]
        return sample(planes, LENS, SIDE, SIDE, spp)

    @staticmethod
    def radius(image: Image) -> float:
        return float(np.sqrt(image[..., 0].sum(dtype=np.float64) / np.pi))

    @pytest.mark.parametrize("moving", [False, True])
    @pytest.mark.parametrize(
        ("front", "back", "radius"),
        [(-8.0, 0.0, 6.3), (0.0, 8.0, 12.3), (-8.0, 8.0, 12.3), (-3.0, 10.0, 6.3), (0.0, 2.0, 6.3)],
    )
    def test_radius_at_16_spp(self, front: float, back: float, radius: float, moving: bool) -> None:
        samples = self.discs(front, back, radius, 16, moving=moving)
        mean_only = reconstruct(samples, "temporal", locations=16, smoothing=0.0, correction=0.0)
        assert self.radius(mean_only) == pytest.approx(radius, abs=0.07)
        assert self.radius(pinhole_view(samples, 0.0, 0.0, 0.4)) == pytest.approx(radius, abs=0.06)
        assert self.radius(reconstruct(samples, "temporal", locations=16)) == pytest.approx(radius, abs=0.07)

    @pytest.mark.parametrize(("front", "back"), [(-8.0, 0.0), (0.0, 8.0), (-8.0, 8.0), (-8.0, -2.0)])
    def test_radius_at_8_spp(self, front: float, back: float) -> None:
        samples = self.discs(front, back, 12.3, 8, moving=False)
        assert self.radius(reconstruct(samples, "temporal", locations=32)) == pytest.approx(12.3, abs=0.1)


def test_a_surface_too_thin_to_be_one_is_not_lost() -> None:
    """Of a bar half a pixel wide there are few samples near: it blends with what is behind."""
    bar = Plane(LENS.depth(0.0), constant(1), lambda xy: np.abs(xy[..., 0] - SIDE / 2) < 0.25)
    samples = sample([bar, Plane(LENS.depth(8.0), constant(0))], LENS, SIDE, SIDE, 8)
    image = middle(reconstruct(samples, "temporal", locations=32))
    assert float(image[..., 0].sum(axis=1).mean()) == pytest.approx(0.5, rel=0.25)
