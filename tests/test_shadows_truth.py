"""Soft shadows of the temporal method, from 4 samples per pixel, against scenes whose light is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import Lighting, LightSamples, SampleBuffer, reconstruct
from fewrays.method import Image
from fewrays.sources.analytic_shadows import (
    Ball,
    Bars,
    Camera,
    Column,
    Disc,
    HalfPlane,
    Lamp,
    Rectangle,
    Scene,
    Sheet,
    aimed,
    box,
    render_lit,
    true_image,
)
from fewrays.sources.opaque_shapes import Shape
from fewrays.sources.outlines import Outline
from shadow_scenes import FLOOR, aside, level

Floats = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
Method = Callable[[SampleBuffer], Image]

SPP = 4
BORDER = 4  # pixels that samples outside of the image would have helped with
ABOVE = Camera(40, 40, position=(0, 6, 0), target=(0, 0, 0), up=(0, 0, -1), fov=30)  # 12.4 pixels per unit
ASIDE = aside(40, 40)
HIGH = (0.0, 4.0, 0.0)
BRIGHT = (10.0, 10.0, 10.0)
SQUARE = aimed(HIGH, (0, 0, 0), (0.8, 0.8), radiance=BRIGHT)
ROUND = aimed(HIGH, (0, 0, 0), (0.8, 0.8), "disc", radiance=BRIGHT)
# So far away that it is as bright from everywhere on it, yet as large as the sun through haze.
DISTANT = aimed((-8, 16, 6), (0, 0, 0), (1.5, 1.5), "disc", radiance=(100, 100, 100))


def shaded(samples: SampleBuffer) -> Image:
    """The mean of samples whose own points are shaded."""
    image: Image = reconstruct(samples, "box")
    return image


def temporal(samples: SampleBuffer, **options: Any) -> Image:
    """With light where locations look, as published."""
    image: Image = reconstruct(samples, "temporal", light_at="locations", **options)
    return image


def middle(image: Image) -> Floats:
    return image[BORDER:-BORDER, BORDER:-BORDER, 0].astype(np.float64)


def truth(scene: Scene, rays: int = 4) -> Floats:
    return middle(true_image(scene, rays=rays, tolerance=1e-3))


def hidden(height: float, outline: Outline, *, tilt: float = 0.0, motion: Vector = (0.0, 0.0, 0.0)) -> Sheet:
    """An occluder above the floor that the camera does not see, level or tilted about the z-axis."""
    return Sheet((0, height, 0), (tilt, 1, 0), (1, -tilt, 0), outline, motion=motion, seen=False)


def shares(scene: Scene, method: Method = shaded) -> tuple[Floats, Floats]:
    """Shares of the light without hidden occluders: what is reconstructed, and the truth."""
    alone = truth(replace(scene, shapes=[shape for shape in scene.shapes if shape.seen]))
    return middle(method(render_lit(scene, SPP))) / alone, truth(scene) / alone


def profile_error(scene: Scene, method: Method = shaded) -> float:
    """Root-mean-square error of the penumbra's profile, as a share of the light.

    The profile is the mean over all pixels that truly get about the same light: columns where a straight edge
    casts the shadow, rings around a round one.
    """
    actual, exact = shares(scene, method)
    penumbra = (exact > 0.01) & (exact < 0.99)
    step = np.floor(10 * exact[penumbra]).astype(int)
    count = np.bincount(step, minlength=10)
    assert (count >= 16).sum() >= 8, f"a penumbra of {count} pixels has no profile"
    error = np.bincount(step, (actual - exact)[penumbra], minlength=10)[count >= 16] / count[count >= 16]
    return root_mean_square(error)


def root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.square(values).mean()))


class TestPenumbra:
    """From 4 samples per pixel, profiles are right to 1 % of the light."""

    @pytest.mark.parametrize("lamp", [SQUARE, ROUND])
    @pytest.mark.parametrize("tilt", [0.0, 0.4])
    def test_of_a_half_plane(self, lamp: Lamp, tilt: float) -> None:
        scene = Scene(ABOVE, [FLOOR, hidden(1.5, HalfPlane((0.02, 0), (1, 0)), tilt=tilt)], [lamp])
        assert profile_error(scene) < 0.009
        assert profile_error(scene, temporal) < 0.012

    @pytest.mark.parametrize("lamp", [SQUARE, ROUND])
    @pytest.mark.parametrize("tilt", [0.0, 0.4])
    def test_of_a_disc(self, lamp: Lamp, tilt: float) -> None:
        scene = Scene(ABOVE, [FLOOR, hidden(1.2, Disc((0.02, 0.05), 0.6), tilt=tilt)], [lamp])
        assert profile_error(scene) < 0.009
        assert profile_error(scene, temporal) < 0.012

    def test_seen_at_a_slant_on_a_slope(self) -> None:
        slope = Sheet((0, 0, 0), (0.3, 1, -0.2), (1, -0.3, 0))
        edge = hidden(1.5, HalfPlane((0, 0), (1, 0.4)))
        assert profile_error(Scene(ASIDE, [slope, edge], [SQUARE])) < 0.01

    def test_of_a_moving_occluder(self) -> None:
        disc = hidden(1.2, Disc((0, 0), 0.6), motion=(0.6, 0.0, 0.2))
        assert profile_error(Scene(ABOVE, [FLOOR, disc], [ROUND])) < 0.01

    def test_of_a_moving_lamp(self) -> None:
        lamp = replace(ROUND, light=replace(ROUND.light, motion=(0.8, 0, -0.3)))
        disc = hidden(1.2, Disc((0, 0), 0.6))
        assert profile_error(Scene(ABOVE, [FLOOR, disc], [lamp])) < 0.01

    def test_out_of_focus(self) -> None:
        camera = replace(ABOVE, lens_radius=0.2, focus_distance=5.0)
        disc = hidden(1.2, Disc((0, 0), 0.6))
        assert profile_error(Scene(camera, [FLOOR, disc], [ROUND])) < 0.01

    def test_of_everything_at_once(self) -> None:
        camera = replace(ABOVE, lens_radius=0.2, focus_distance=5.0)
        lamp = replace(ROUND, light=replace(ROUND.light, motion=(0.3, 0, 0.3)))
        disc = hidden(1.2, Disc((0, 0), 0.6), motion=(-0.3, 0.1, 0.2))
        assert profile_error(Scene(camera, [FLOOR, disc], [lamp])) < 0.01

    @pytest.mark.parametrize("height", [0.15, 0.3, 0.6])
    def test_edges_stay_where_they_are(self, height: float) -> None:
        """Shadows neither grow nor shrink, however narrow their penumbra: by a tenth of a pixel at most."""
        scene = Scene(ABOVE, [FLOOR, hidden(height, HalfPlane((0.02, 0), (1, 0)))], [SQUARE])
        actual, exact = shares(scene)
        assert abs(float((actual - exact).sum(axis=1).mean())) < 0.1

    def test_a_grating_lets_its_share_through(self) -> None:
        bars = hidden(0.8, Bars(5, 0.5, 0.5, (0, 0), (1, 0.2)))
        lamp = aimed(HIGH, (0, 0, 0), (0.3, 0.3), radiance=BRIGHT)
        actual, exact = shares(Scene(ABOVE, [FLOOR, bars], [lamp]))
        assert abs(float((actual - exact).mean())) < 0.03
        assert root_mean_square(actual - exact) < 0.5 * exact.std()


@pytest.mark.parametrize(
    "scene",
    [
        Scene(ABOVE, [FLOOR, hidden(1.2, Disc((0, 0), 0.6))], [ROUND]),
        Scene(ASIDE, [FLOOR, level(1, Disc((0, 0), 0.5))], [ROUND]),
        Scene(ASIDE, [FLOOR, Ball((-0.4, 0.6, 0), 0.5, motion=(0.8, 0, 0))], [SQUARE]),
        Scene(replace(ASIDE, lens_radius=0.3, focus_distance=3.2), [FLOOR, Ball((0, 0.6, 0), 0.5)], [SQUARE]),
    ],
    ids=["hidden disc", "disc in sight", "moving ball", "ball out of focus"],
)
def test_there_is_less_noise_than_in_the_mean_of_the_samples(scene: Scene) -> None:
    samples, exact = render_lit(scene, SPP), truth(scene, rays=16)
    averaged = middle(reconstruct(samples, "box", shadows=False))
    assert root_mean_square(middle(temporal(samples)) - exact) < 0.6 * root_mean_square(averaged - exact)


class TestFullLight:
    """Where nothing is in between, nothing is dark: no surface shadows itself."""

    @pytest.mark.parametrize(
        ("facing", "along", "lamp"),
        [
            ((0, 1, 0), (1, 0, 0), DISTANT),
            ((0.4, 1, 0.3), (1, -0.4, 0), DISTANT),
            ((1.5, 0.4, 0.9), (0.4, -1.5, 0), aimed((16, 6, 8), (0, 0, 0), (1.5, 1.5), radiance=(100,) * 3)),
        ],
        ids=["level", "slope", "steep"],
    )
    @pytest.mark.parametrize("lens_radius", [0.0, 0.3])
    def test_planes(self, facing: Vector, along: Vector, lamp: Lamp, lens_radius: float) -> None:
        camera = replace(ASIDE, lens_radius=lens_radius, focus_distance=4.0)
        scene = Scene(camera, [Sheet((0, 0, 0), facing, along)], [lamp])
        exact = truth(scene, rays=32 if lens_radius else 4)
        assert np.abs(middle(temporal(render_lit(scene, SPP))) / exact - 1).max() < 0.005

    def test_a_concave_corner(self) -> None:
        """Two walls and a floor. Where they meet, a shadow or a gap would be darker than both sides."""
        walls = [Sheet((-0.4, 0, 0), (1, 0, 0), (0, 0, 1)), Sheet((0, 0, -0.5), (0, 0, 1), (1, 0, 0))]
        lamp = aimed((8, 16, 10), (0, 0, 0), (1.5, 1.5), "disc", radiance=(100, 100, 100))
        scene = Scene(ASIDE, [FLOOR, *walls], [lamp])
        exact = truth(scene, rays=16)
        image = middle(shaded(render_lit(scene, SPP)))
        away = ~near(np.hypot(*np.gradient(exact)) > 0.015 * exact.max(), 2)
        assert away.mean() > 0.3
        assert np.abs(image / exact - 1)[away].max() < 0.005
        darkest, brightest = (extreme(exact, 2, of) for of in (np.min, np.max))
        assert (image > 0.99 * darkest).all()
        assert (image < 1.01 * brightest).all()

    @pytest.mark.parametrize("shape", [Ball((0, 0, 0), 1.4), Column((0, 0, 0), (1, 0.2, 0), 1.2)])
    def test_round_shapes(self, shape: Shape) -> None:
        """They fill the image and turn away from the light, but are all in it."""
        camera = Camera(40, 40, position=(0, 4, 3), target=(0, 0.9, 0.6), fov=16)
        scene = Scene(
            camera, [shape], [aimed((1, 16, 12), (0, 0, 0), (1.5, 1.5), "disc", radiance=(100,) * 3)]
        )
        exact = truth(scene)
        assert exact.min() > 0.5 * exact.max()
        assert np.abs(middle(temporal(render_lit(scene, SPP))) / exact - 1).max() < 0.01

    def test_constant_light_gives_the_plain_reconstruction(self) -> None:
        """From afar all of a small lamp is as bright: each sample then has the light of all of it."""
        lamp = aimed((-8, 16, 6), (0, 0, 0), (0.1, 0.1), radiance=(2e4,) * 3)
        scene = Scene(ASIDE, [FLOOR], [lamp], unlit=(0.02, 0.05, 0.1))
        samples = render_lit(scene, SPP)
        plain = reconstruct(samples, "temporal", shadows=False, correction=0)
        assert plain.min() > 0.2
        np.testing.assert_allclose(middle(temporal(samples)), middle(plain), rtol=0.005)


class TestDarkness:
    """Where no light gets to, there is none."""

    def test_under_a_roof(self) -> None:
        scene = Scene(ABOVE, [FLOOR, hidden(1.5, Rectangle((0, 0), (3, 3)))], [SQUARE])
        assert temporal(render_lit(scene, SPP)).max() == 0

    def test_behind_a_wall(self) -> None:
        """Next to the foot of a wall without thickness, whose other side is in the light."""
        wall = Sheet((0, 0.6, 0), (0, 0, 1), (1, 0, 0), Rectangle((0, 0), (3, 0.6)))
        lamp = aimed((0, 2, -3), (0, 0, 0), (0.4, 0.4), radiance=(30, 30, 30))
        scene = Scene(ASIDE, [FLOOR, wall], [lamp])
        exact = truth(scene, rays=8)
        dark = ~near(exact > 0, 2)
        assert dark.mean() > 0.4
        assert middle(shaded(render_lit(scene, SPP)))[dark].max() < 0.05 * exact.max()

    @pytest.mark.parametrize("turn", [0.0, 35.0])
    def test_at_the_foot_of_a_box(self, turn: float) -> None:
        """Its shadow begins where it stands: no gap of light, and none under it."""
        lamp = aimed((-1, 4, -4), (0, 0, 0), (0.4, 0.4), radiance=(30, 30, 30))
        scene = Scene(ASIDE, [FLOOR, *box((0, 0, 0), (0.5, 0.4), 0.7, turn=turn)], [lamp])
        exact = truth(scene, rays=8)
        image = middle(temporal(render_lit(scene, SPP)))
        dark = (exact < 1e-6 * exact.max()) & ~near(exact > 0.02 * exact.max(), 2)
        assert dark.mean() > 0.05
        assert image[dark].max() < 0.03 * exact.max()

    @pytest.mark.parametrize("shape", [Ball((0, 0, 0), 1.0), Column((0, 0, 0), (1, 0.2, 0), 1.0)])
    def test_on_the_side_that_is_turned_away(self, shape: Shape) -> None:
        camera = Camera(40, 40, position=(0, 4, 3), target=(0, 0.5, 0.4), fov=16)
        scene = Scene(camera, [shape], [aimed((0, -16, -12), (0, 0, 0), (1.5, 1.5), "disc")])
        assert temporal(render_lit(scene, SPP)).max() == 0


def near(mask: npt.NDArray[np.bool_], distance: int) -> npt.NDArray[np.bool_]:
    """Pixels within a distance, along both axes, of those in a mask."""
    return extreme(mask.astype(np.float64), distance, np.max) > 0


def extreme(image: Floats, distance: int, of: Callable[..., Floats]) -> Floats:
    """The least or greatest value within a distance, along both axes, of each pixel."""
    side = 2 * distance + 1
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(image, distance, mode="edge"), (side, side))
    return of(windows, axis=(-1, -2))


def rearranged(samples: SampleBuffer, order: npt.NDArray[np.intp]) -> SampleBuffer:
    """Put the samples of each pixel into another order ``(H, W, S)``."""

    def moved(array: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        index = order.reshape(*order.shape, *(1,) * (array.ndim - 3))
        return np.take_along_axis(array, index, axis=2)

    def all_moved(part: SampleBuffer | Lighting | LightSamples) -> dict[str, Any]:
        return {name: moved(getattr(part, name)) for name in part.field_names()}

    assert samples.lighting is not None
    lights = [LightSamples(rays.light, **all_moved(rays)) for rays in samples.lighting.lights]
    lighting = Lighting(samples.lighting.projection, **all_moved(samples.lighting), lights=lights)
    return SampleBuffer(lens=samples.lens, lighting=lighting, **all_moved(samples))


class TestInvariants:
    scene = Scene(
        replace(ASIDE, lens_radius=0.2, height=24, width=24),
        [FLOOR, Ball((-0.2, 0.5, 0), 0.5, motion=(0.4, 0, 0))],
        [SQUARE, aimed((2, 3, 1), (0, 0, 0), (0.3, 0.5), "disc", radiance=(4, 8, 2))],
        unlit=(0.01, 0.02, 0.03),
    )

    def test_the_order_of_the_samples(self) -> None:
        samples = render_lit(self.scene, SPP)
        order = np.random.default_rng(0).permuted(
            np.broadcast_to(np.arange(SPP), samples.depth.shape), axis=2
        )
        other = rearranged(samples, order)
        assert (other.xy != samples.xy).any()
        np.testing.assert_allclose(temporal(other), temporal(samples), rtol=1e-4, atol=1e-5)

    def test_the_number_of_threads(self) -> None:
        samples = render_lit(self.scene, SPP)
        np.testing.assert_array_equal(temporal(samples, threads=1), temporal(samples, threads=3))

    def test_two_lights_add_up(self) -> None:
        samples = render_lit(self.scene, SPP)
        lighting = samples.lighting
        assert lighting is not None
        dark = np.zeros_like(lighting.unlit)
        parts = []
        for number, unlit in enumerate((lighting.unlit, dark)):
            one = Lighting(
                lighting.projection,
                lighting.normal,
                lighting.depth_gradient,
                unlit,
                [lighting.lights[number]],
            )
            alone = replace(samples, lighting=one)
            parts.append(temporal(replace(alone, color=one.color(alone))))
        both = temporal(samples)
        error = parts[0] + parts[1] - both
        assert np.sqrt(np.square(error).mean()) < 0.01 * both.max()
        assert abs(error.mean()) < 0.002 * both.max()
