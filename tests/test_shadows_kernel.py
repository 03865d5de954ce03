"""Light and shadow by native code against their definition in NumPy; the parts of both; and who uses them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from fewrays import (
    METHODS,
    AreaLight,
    Lens,
    Lighting,
    LightSamples,
    Multiplane,
    SampleBuffer,
    SampleError,
    load_image,
    reconstruct,
    save,
    shade,
)
from fewrays.cli import main
from fewrays.parallel import Execution
from fewrays.sources.analytic_shadows import (
    Ball,
    Bars,
    Rectangle,
    Scene,
    box,
    render_lit,
)
from fewrays.temporal import TemporalOptions, kernel, make_plan, reference, shadows
from fewrays.temporal.lamps import Lamp, facing_normals, make_lamps
from fewrays.temporal.locations import Locations
from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.reprojection import Paths, Sights
from fewrays.temporal.surfaces import any_covers, obviously_covers, surrounds
from lit_buffers import LIGHTS, light_with, lighting_of, lit_buffer
from shadow_scenes import FLOOR, GREEN, WARM, aside, level

Floats = npt.NDArray[np.float64]

SQUARE = AreaLight((0.3, -3.0, 4.0), (0.5, 0.0, 0.0), (0.0, 0.0, -0.5), plane_distance=3.0)
OBLONG = replace(LIGHTS[0], half_u=(1.6, 0.0, 0.4))
DISC = replace(LIGHTS[1], motion=(0.0, 0.0, 0.0), half_u=(0.3, -0.3, 0.0), half_v=(0.0, 0.0, -0.5))
MOVING = replace(SQUARE, motion=(1.2, 0.3, -0.8))


def with_lights(samples: SampleBuffer, *, unlit: npt.ArrayLike, dark: tuple[int, ...] = ()) -> SampleBuffer:
    """Change the light that is not the lamps', and take the light samples of some lamps away."""
    old = lighting_of(samples)
    lights = [
        light_with(light, density=np.zeros_like(light.density)) if number in dark else light
        for number, light in enumerate(old.lights)
    ]
    unlit = np.broadcast_to(np.asarray(unlit, np.float32), old.unlit.shape)
    return replace(samples, lighting=Lighting(old.projection, old.normal, old.depth_gradient, unlit, lights))


def random_lit(kind: str, shape: tuple[int, int, int] = (4, 5, 3), seed: int = 0) -> SampleBuffer:
    """Samples of rough surfaces under textured lights, a tenth without light samples. All else is dark."""
    lights = {"two lights": LIGHTS, "oblong": (OBLONG,), "disc": (DISC,), "moving light": (MOVING,)}
    samples = lit_buffer(
        shape,
        lights=lights.get(kind, (SQUARE,)),
        moving=kind in ("two lights", "moving"),
        seed=seed,
    )
    samples = with_lights(samples, unlit=0)
    rng = np.random.default_rng(seed)
    if kind == "pinhole":
        return samples.refocus(aperture_scale=0.0)
    if kind == "still":
        return replace(samples, time=None)
    if kind == "moving":
        return replace(samples, motion=rng.normal(size=samples.color.shape).astype(np.float32))
    if kind == "glossy":
        return replace(samples, bandwidth=rng.uniform(0.02, 1.0, samples.depth.shape).astype(np.float32))
    return samples


KINDS = ("pinhole", "still", "moving", "moving light", "oblong", "disc", "two lights", "glossy")


def seen_lit(kind: str, size: int = 10, spp: int = 2) -> SampleBuffer:
    """Samples of scenes with edges of shadows, contact, self-shadowing and gratings."""
    shapes: dict[str, list[Any]] = {
        "ball": [Ball((-0.2, 0.5, 0), 0.5)],
        "moving ball": [Ball((-0.2, 0.5, 0), 0.5, motion=(0.4, 0.1, 0))],
        "box": [*box((0, 0, 0), (0.5, 0.4), 0.7, turn=30.0)],
        "roof": [level(1.5, Rectangle((0, 0), (3, 3)), seen=False)],
        "half a roof": [level(0.5, Rectangle((-2, 0), (2, 3)), seen=False)],
        "bars": [level(0.8, Bars(5, 0.5, 0.5, (0, 0), (1, 0.2)), seen=False)],
    }
    lamps = [WARM, GREEN] if kind == "moving ball" else [WARM]
    return render_lit(Scene(aside(size, size, lens_radius=0.2), [FLOOR, *shapes[kind]], lamps), spp)


SCENES = ("ball", "moving ball", "box", "roof", "half a roof", "bars")


def assert_twins(actual: npt.ArrayLike, expected: npt.ArrayLike, *, flips: float = 0.0) -> None:
    """Assert equality to rounding, relative to the mean.

    Flips are pixels or samples where float32 decides otherwise: a light sample at the rim of a radius, or as
    high over a tangent plane as rounding may put it, is counted by one twin alone, and that may turn light
    into shadow. There was none among 14 000 of random buffers, whose largest difference was 7e-6.
    """
    actual, expected = np.asarray(actual, np.float64), np.asarray(expected, np.float64)
    scale = float(expected.mean()) or 1.0
    height = expected.shape[0]
    assert_agree(
        actual.reshape(height, -1, 3) / scale,
        expected.reshape(height, -1, 3) / scale,
        tolerance=1e-5,
        flips=flips,
    )


def at_locations(
    samples: SampleBuffer, engine: Any, *, locations: int = 4, **options: Any
) -> npt.NDArray[np.float32]:
    """Mean over some of 128 locations, which tell surfaces apart as finely as 128 do."""
    plan = make_plan(samples, TemporalOptions(light_at="locations", **options))
    where, some = plan.locations, slice(None, None, plan.locations.count // locations)
    few = Locations(where.uv[some], where.t[some], where.offset[some], where.weight[some])
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    engine.reconstruct_tiles(samples, replace(plan, locations=few), bands, Execution(threads=1))
    sums = bands.sum(axis=2)
    mean: npt.NDArray[np.float32] = sums[..., :3] / sums[..., 3:]
    return mean


def both_at_locations(samples: SampleBuffer, **options: Any) -> tuple[Any, Any]:
    return at_locations(samples, kernel, **options), at_locations(samples, reference, **options)


def both_shaded(samples: SampleBuffer, **options: Any) -> tuple[Any, Any]:
    options = {"light_points": 4 * samples.spp, "correction": 0.0, **options}
    return (
        shade(samples, device="cpu", **options).color,
        shade(samples, device="reference", **options).color,
    )


BOTH = pytest.mark.parametrize("both", [both_at_locations, both_shaded])
Both = Callable[..., tuple[Any, Any]]


class TestAgainstTheReference:
    @BOTH
    @pytest.mark.parametrize("kind", KINDS)
    def test_random_buffers(self, kind: str, both: Both) -> None:
        actual, expected = both(random_lit(kind))
        assert (expected > 0).mean() > 0.5
        assert_twins(actual, expected)

    @BOTH
    @pytest.mark.parametrize("kind", SCENES)
    def test_scenes(self, kind: str, both: Both) -> None:
        actual, expected = both(seen_lit(kind))
        assert_twins(actual, expected)

    @BOTH
    @pytest.mark.parametrize("radius_scale", [0.3, 4.0])
    @pytest.mark.parametrize("kind", ["moving ball", "bars", "half a roof"])
    def test_radii(self, kind: str, radius_scale: float, both: Both) -> None:
        actual, expected = both(seen_lit(kind, 7), radius_scale=radius_scale)
        assert_twins(actual, expected)

    def test_tents(self) -> None:
        """Light is filtered by the tent of the options, or by the whole of R where they have none."""
        for tent_scale in (0.0, 0.5):
            actual, expected = both_at_locations(seen_lit("ball", 8), tent_scale=tent_scale)
            assert_twins(actual, expected)

    @pytest.mark.parametrize("spp", [1, 3, 4, 16])
    @pytest.mark.parametrize("kind", ["still", "moving"])
    def test_samples_per_pixel(self, spp: int, kind: str) -> None:
        actual, expected = both_shaded(random_lit(kind, (3, 3, spp)), light_points=max(16 // spp, 1) * spp)
        assert_twins(actual, expected)

    def test_fewer_light_points_than_samples(self) -> None:
        """Each sample gets one, as if there were as many."""
        samples = random_lit("two lights", (3, 3, 4))
        actual, expected = both_shaded(samples, light_points=1, radius_scale=2.0)
        assert (expected > 0).mean() > 0.5
        assert_twins(actual, expected)

    @BOTH
    def test_what_comes_to_the_camera_and_passes_it(self, both: Both) -> None:
        samples = random_lit("moving")
        motion = np.zeros_like(samples.color)
        motion[::2, ..., 2] = -2.5 * samples.depth[::2]
        actual, expected = both(replace(samples, motion=motion))
        assert_twins(actual, expected)

    @pytest.mark.parametrize("seed", [0, 1])
    def test_light_far_off_in_the_dark(self, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
        samples = lit_buffer((6, 6, 1), lights=(SQUARE,), moving=False, blocked=0.95, seed=seed)
        samples = with_lights(samples, unlit=0)
        actual, expected = both_shaded(samples, light_points=8, radius_scale=0.25)
        assert_twins(actual, expected)
        monkeypatch.setattr(shadows, "_WIDEST", 8.0)
        _, nearer = both_shaded(samples, light_points=8, radius_scale=0.25)
        assert np.abs(nearer - expected).max() > 1e-3 * expected.max()

    @settings(max_examples=15)
    @given(
        height=st.integers(1, 4),
        width=st.integers(1, 4),
        spp=st.integers(1, 4),
        lights=st.lists(st.sampled_from([*LIGHTS, SQUARE, OBLONG, DISC, MOVING]), min_size=1, max_size=3),
        blocked=st.sampled_from([0.0, 0.3, 0.9, 1.0]),
        moving=st.booleans(),
        radius_scale=st.sampled_from([0.4, 1.7, 4.0]),
        seed=st.integers(0, 1000),
    )
    def test_any_buffer(
        self,
        height: int,
        width: int,
        spp: int,
        lights: list[AreaLight],
        blocked: float,
        moving: bool,
        radius_scale: float,
        seed: int,
    ) -> None:
        samples = lit_buffer(
            (height, width, spp), lights=tuple(lights), blocked=blocked, moving=moving, seed=seed
        )
        for both in (both_shaded, both_at_locations):
            actual, expected = both(with_lights(samples, unlit=0), radius_scale=radius_scale)
            # One flip is a large share of a tiny image.
            assert_twins(actual, expected, flips=0.15 if height * width > 7 else 1.0)
            assert np.median(np.abs(actual - expected)) <= 1e-5 * expected.max()

    def test_those_buffers_meet_every_case(self, monkeypatch: pytest.MonkeyPatch) -> None:
        tally: Counter[str] = Counter()

        def count(owner: object, name: str, case: Callable[..., str]) -> None:
            function = getattr(owner, name)

            def counted(*arguments: Any) -> Any:
                result = function(*arguments)
                tally[case(result, *arguments)] += 1
                return result

            monkeypatch.setattr(owner, name, counted)

        count(shadows.Lights, "radiance_from", lambda *_: "receivers")
        count(shadows, "obviously_covers", lambda yes, *_: f"obvious {yes}")
        count(shadows, "surrounds", lambda yes, *_: f"surrounded {yes}")
        count(shadows, "any_covers", lambda yes, *_: f"covered {yes}")
        count(shadows.Lights, "_around", lambda _, *given: f"within {given[-1]:g} R")
        for samples in [random_lit("moving"), *(seen_lit(kind) for kind in SCENES)]:
            at_locations(samples, reference, locations=2)
        at_locations(seen_lit("half a roof", 7), reference, radius_scale=0.3)
        shade(lit_buffer((1, 2, 1), blocked=1.0), light_points=16, device="reference")
        cases = {f"{name} {yes}" for name in ("obvious", "surrounded", "covered") for yes in (True, False)}
        cases |= {f"within {spread} R" for spread in (1, 2, 4, 8, 12)}
        for case in cases:
            assert tally[case] >= 3, (case, tally)


class TestNoLight:
    """Lamps without a sample, some or all of them, and what they do not light."""

    @BOTH
    def test_one_lamp_of_two(self, both: Both) -> None:
        samples = random_lit("two lights")
        actual, expected = both(with_lights(samples, unlit=0, dark=(0,)))
        assert_twins(actual, expected)
        assert (expected > 0).mean() > 0.5
        assert np.abs(expected - both(samples)[1]).max() > 0.1 * expected.max()

    @pytest.mark.parametrize("device", ["cpu", "reference"])
    def test_no_lamp_at_all(self, device: Any) -> None:
        """Nothing but the unlit radiance is left: the samples' own, bit for bit, and its reconstruction."""
        unlit = np.random.default_rng(0).gamma(1.0, 1.0, (4, 5, 3, 3)).astype(np.float32)
        samples = with_lights(random_lit("two lights"), unlit=unlit, dark=(0, 1))
        shaded = shade(samples, light_points=8, device=device)
        np.testing.assert_allclose(shaded.color, unlit, rtol=1e-6)
        plain = replace(samples, color=unlit, lighting=None)
        options: dict[str, Any] = {"locations": 4, "smoothing": 0.0, "device": device}
        np.testing.assert_allclose(
            reconstruct(samples, "temporal", light_at="locations", **options),
            reconstruct(plain, "temporal", correction=0.0, **options),
            rtol=1e-5,
        )

    @BOTH
    def test_unlit_radiance_is_added(self, both: Both) -> None:
        samples = random_lit("still")
        lit = both(samples)[1]
        more = both(with_lights(samples, unlit=[0.5, 1.0, 3.0]))
        np.testing.assert_allclose(more[1], lit + np.array([0.5, 1.0, 3.0]), rtol=1e-6)
        assert_twins(*more)


SLIGHTLY_UNEVEN = np.array([1, 1 + 1e-5], np.float32)[:, None]
"""Factors for the radiance of two samples per pixel."""


class TestShade:
    def test_only_the_radiance_changes(self) -> None:
        samples = random_lit("moving")
        shaded = shade(samples, light_points=8)
        assert shaded.lighting is None
        assert shaded.lens == samples.lens
        assert shaded.field_names() == samples.field_names()
        for name in samples.field_names():
            if name != "color":
                np.testing.assert_array_equal(getattr(shaded, name), getattr(samples, name))
        assert np.abs(shaded.color - samples.color).max() > 0

    @pytest.mark.parametrize("kind", SCENES)
    def test_lamps_of_even_radiance_are_lamps_like_others(self, kind: str) -> None:
        """For these alone, samples that all light points shine on are found at once."""
        even = seen_lit(kind, 14)
        lighting = lighting_of(even)
        lights = [light_with(light, radiance=light.radiance * SLIGHTLY_UNEVEN) for light in lighting.lights]
        uneven = replace(even, lighting=replace(lighting, lights=tuple(lights)))
        assert all(lamp.uniform_radiance is not None for lamp in make_lamps(even, lighting))
        assert all(lamp.uniform_radiance is None for lamp in make_lamps(uneven, lighting_of(uneven)))
        np.testing.assert_allclose(shade(even).color, shade(uneven).color, rtol=1e-4, atol=1e-6)

    def test_threads_do_not_change_a_bit(self) -> None:
        samples = lit_buffer((34, 40, 1))
        one, three = (shade(samples, light_points=2, threads=threads).color for threads in (1, 3))
        np.testing.assert_array_equal(one, three)

    @pytest.mark.parametrize("kind", ["still", "two lights"])
    def test_order_of_samples_within_a_pixel(self, kind: str) -> None:
        samples = random_lit(kind, (8, 9, 4))
        shaded = shade(samples, light_points=16).color
        assert_twins(shade(turned(samples), light_points=16).color[:, :, ::-1], shaded)

    @pytest.mark.parametrize("kind", ["still", "disc", "oblong"])
    def test_samples_of_a_pixel_at_rest_share_its_light_points(self, kind: str) -> None:
        """Four samples of one point, each with its part of the light: on average, all light points."""
        samples = alike(unblocked(random_lit(kind, (1, 1, 4))))
        lighting = lighting_of(samples)
        lamp = make_lamps(samples, lighting)[0]
        light_points = lamp.light.points(lamp.points(16) * lamp.lens_unit / lamp.light.half_size)
        to_light = light_points - lighting.points(samples)[0, 0, 0]
        distance = np.linalg.norm(to_light, axis=-1)
        falling = np.maximum(to_light @ lighting.normal[0, 0, 0], 0) / distance
        gain = falling * -(to_light @ lamp.light.normal) / distance**3 * lamp.light.area
        color = shade(samples, light_points=16, correction=0.0).color[0, 0]
        np.testing.assert_allclose(
            color.mean(axis=0), gain.mean() * lighting.lights[0].reflectance[0, 0, 0], rtol=1e-5
        )
        assert len(np.unique(color[:, 0])) == 4

    @pytest.mark.parametrize(
        ("options", "field"),
        [
            ({"light_points": 0}, "light_points"),
            ({"light_points": 65537}, "light_points"),
            ({"radius_scale": 0.2}, "radius_scale"),
            ({"radius_scale": float("nan")}, "radius_scale"),
            ({"device": "gpu"}, "device"),
            ({"threads": 0}, "threads"),
        ],
    )
    def test_options_out_of_range(self, options: dict[str, Any], field: str) -> None:
        with pytest.raises(SampleError) as error:
            shade(random_lit("still"), **options)
        assert error.value.field == field

    def test_samples_without_lights(self) -> None:
        with pytest.raises(SampleError, match="lighting: these samples come without area lights"):
            shade(replace(random_lit("still"), lighting=None))


def turned(samples: SampleBuffer) -> SampleBuffer:
    """Put the samples of all pixels into the opposite order."""
    return chosen(samples, slice(None, None, -1))


def alike(samples: SampleBuffer) -> SampleBuffer:
    """Make all samples of a pixel the first."""
    return chosen(samples, [0] * samples.spp)


def chosen(samples: SampleBuffer, which: slice | list[int]) -> SampleBuffer:
    """Put some of each pixel's samples in the place of all."""

    def arrays(part: SampleBuffer | Lighting | LightSamples) -> dict[str, Any]:
        return {name: getattr(part, name)[:, :, which] for name in part.field_names()}

    old = lighting_of(samples)
    lights = [LightSamples(light.light, **arrays(light)) for light in old.lights]
    lighting = Lighting(old.projection, **arrays(old), lights=lights)
    return SampleBuffer(lens=samples.lens, lighting=lighting, **arrays(samples))


def unblocked(samples: SampleBuffer) -> SampleBuffer:
    """Let all light samples arrive, of lights of radiance 1."""
    old = lighting_of(samples)
    lights = []
    for light in old.lights:
        lxy, depth = light.light.project(old.points(samples), light.luv)
        ones = np.ones_like(light.radiance)
        density = np.where(light.density > 0, light.density, light.density.max())
        rays = LightSamples(light.light, lxy, light.luv, depth, ones, density, light.reflectance)
        lights.append(rays)
    lighting = Lighting(old.projection, old.normal, old.depth_gradient, old.unlit, lights)
    return replace(samples, lighting=lighting)


RULE = SurfaceRule(radius=1.0, along_lens=0.1, along_time=0.05)
FRONT, BACK = -40.0, 40.0  # slopes that cross within any distance here


def sights_of(xy: npt.ArrayLike, slope: npt.ArrayLike = 0.0, speed: npt.ArrayLike = 0.0) -> Sights:
    xy = np.reshape(np.asarray(xy, np.float64), (-1, 2))
    count = len(xy)
    return Sights(
        np.arange(count),
        xy,
        np.broadcast_to(np.asarray(slope, np.float64), count),
        np.broadcast_to(np.asarray(speed, np.float64), (count, 2)),
    )


CROSS = [(0.5, 0.1), (-0.1, 0.5), (-0.5, -0.1), (0.1, -0.5)]  # one in each quadrant
HALF = [(0.5, 0.1), (0.3, 0.5), (0.4, -0.4), (0.2, -0.1), (0.6, 0.6)]  # all on one side


class TestBlockers:
    """Whether blocking samples around a receiver cover it."""

    def test_one_surface_all_around_covers(self) -> None:
        assert any_covers(sights_of(CROSS), RULE)
        assert obviously_covers(sights_of(CROSS), RULE)
        assert surrounds(np.array(CROSS), RULE)

    def test_nothing_covers_nothing(self) -> None:
        none = sights_of([])
        assert not any_covers(none, RULE)
        assert not obviously_covers(none, RULE)
        assert not surrounds(none.xy, RULE)

    def test_three_tell_nothing(self) -> None:
        three = sights_of([(0.5, 0.1), (-0.4, 0.4), (-0.4, -0.5)])
        assert surrounds(three.xy, RULE)
        assert not any_covers(three, RULE)
        assert not obviously_covers(three, RULE)

    def test_one_side_does_not_cover(self) -> None:
        assert not any_covers(sights_of(HALF), RULE)
        assert not obviously_covers(sights_of(HALF), RULE)
        assert not surrounds(np.array(HALF), RULE)

    def test_one_side_reaches_out_by_the_overhang(self) -> None:
        beside = np.array([(0.05, 0.3), (0.05, -0.3), (0.3, 0.2), (0.3, -0.2)])
        generous = replace(RULE, overhang=0.1)
        assert not surrounds(beside, RULE)
        assert surrounds(beside, generous)
        assert not any_covers(sights_of(beside), RULE)
        assert any_covers(sights_of(beside), generous)

    def test_two_surfaces_cover_only_if_one_does(self) -> None:
        two_halves = sights_of([*HALF, *(-np.array(HALF))], [FRONT] * 5 + [BACK] * 5)
        assert surrounds(two_halves.xy, RULE)
        assert not any_covers(two_halves, RULE)
        assert not obviously_covers(two_halves, RULE)
        half_and_whole = sights_of([*HALF, *CROSS], [FRONT] * 5 + [BACK] * 4)
        assert any_covers(half_and_whole, RULE)
        assert not obviously_covers(half_and_whole, RULE)  # it takes a closer look

    def test_few_samples_blend_with_the_next_surface_behind(self) -> None:
        mixed = sights_of([*CROSS[:2], *CROSS[2:]], [FRONT, FRONT, BACK, BACK])
        assert any_covers(mixed, RULE)
        # The last are too few, and nothing is behind them.
        assert not any_covers(sights_of([*HALF, *CROSS[:3]], [FRONT] * 5 + [BACK] * 3), RULE)

    def test_what_all_of_them_leave_open_none_covers(self) -> None:
        """Some alone reach out in a direction of their own."""
        left = np.array([(0.05, 0.3), (0.05, -0.3), (0.3, 0.2), (0.3, -0.2)])
        generous = replace(RULE, overhang=0.1)
        above = np.array([(0.06 + 0.001 * x, 0.6) for x in range(29)])
        both = sights_of([*left, *above], [FRONT] * 4 + [BACK] * 29)
        assert any_covers(sights_of(left), generous)
        assert not surrounds(both.xy, generous)
        assert not any_covers(both, generous)

    def test_holes_wider_than_the_radius_are_holes(self) -> None:
        wide = 2.5 * np.array(CROSS)
        assert any_covers(sights_of(wide), RULE.scaled(2.5))
        assert not any_covers(sights_of(wide), RULE)
        assert surrounds(wide, RULE)
        assert surrounds(1e3 * wide, RULE)

    @pytest.mark.parametrize(("spread", "obvious"), [(0.09, True), (0.11, False)])
    def test_slopes_and_speeds_that_differ_are_not_obviously_one_surface(
        self, spread: float, obvious: bool
    ) -> None:
        part = np.array([0.0, 0.2, 0.5, 1.0])
        assert obviously_covers(sights_of(CROSS, spread / 0.1 * part), RULE) == obvious
        for axis in (0, 1):
            speed = np.zeros((4, 2))
            speed[:, axis] = spread / 0.05 * part
            assert obviously_covers(sights_of(CROSS, 0.0, speed), RULE) == obvious
        both = obviously_covers(sights_of(CROSS, spread / 0.2 * part, spread / 0.1 * part[:, None]), RULE)
        assert both == obvious

    def test_a_quadrant_without_samples_is_not_obvious(self) -> None:
        assert not obviously_covers(sights_of([*CROSS[:3], (0.6, 0.2)]), RULE)

    def test_two_on_opposite_sides_surround(self) -> None:
        line = np.array([(0.5, 0.25), (-0.5, -0.25)])
        assert surrounds(line, RULE)
        assert not surrounds(line + np.array([0.0, 0.01]), RULE)


def lamp_of(light: AreaLight, shape: tuple[int, int, int] = (4, 5, 2)) -> tuple[SampleBuffer, Lamp]:
    samples = lit_buffer(shape, lights=(light,))
    return samples, make_lamps(samples, lighting_of(samples))[0]


class TestLamps:
    @pytest.mark.parametrize("light", [SQUARE, OBLONG])
    @pytest.mark.parametrize("count", [1, 7, 128])
    def test_points_fall_one_into_each_part_along_both_axes(self, light: AreaLight, count: int) -> None:
        _, lamp = lamp_of(light)
        luv = lamp.points(count) * lamp.lens_unit / light.half_size
        strata = (2 * np.arange(count) + 1) / count - 1
        np.testing.assert_allclose(np.sort(luv, axis=0), np.stack([strata, strata], axis=-1), atol=1e-12)

    def test_points_of_a_disc_are_uniform_within_its_rim(self) -> None:
        _, lamp = lamp_of(LIGHTS[1])
        luv = lamp.points(1024) * lamp.lens_unit / lamp.light.half_size
        radius = np.hypot(*luv.T)
        assert radius.max() <= 1
        part, step = np.sort(radius) ** 2, (np.arange(1024) + 0.5) / 1024
        assert np.abs(part - step).max() < 0.01
        angle = np.sort(np.arctan2(*luv.T[::-1])) / (2 * np.pi) + 0.5
        assert np.abs(angle - step).max() < 0.02
        assert np.abs(luv.mean(axis=0)).max() < 0.01

    @pytest.mark.parametrize("light", [*LIGHTS, OBLONG, MOVING])
    @pytest.mark.parametrize("time", [0.0, 0.6])
    def test_rays_hit_the_same_wherever_the_plane_is(self, light: AreaLight, time: float) -> None:
        samples, lamp = lamp_of(light)
        (rays,) = lighting_of(samples).lights
        assert rays.motion is not None
        assert samples.time is not None
        there = rays.density > 0
        assert lamp.light.plane_distance != light.plane_distance
        np.testing.assert_array_equal(lamp.arrives, lighting_of(samples).arrives(samples, 0).ravel())
        own = light.hits(rays.lxy, rays.luv, rays.depth, samples.time)
        luv = lamp.field.uv * lamp.lens_unit / light.half_size
        hits = lamp.light.hits(lamp.field.xy, luv, lamp.field.depth, samples.time)
        np.testing.assert_allclose(hits[there], own[there], atol=2e-5)
        # And as they move, seen from the centre of the light.
        start = rays.luv * light.half_size * (1 - light.plane_distance / rays.depth[..., None])
        depth = rays.depth[..., None].astype(np.float64)
        moved = np.concatenate([(rays.lxy - start) * depth, depth], axis=-1)
        moved += (time - samples.time[..., None]) * rays.motion
        seen = there & (moved[..., 2] > 0.05)
        expected = light.hits(moved[..., :2] / moved[..., 2:], (0, 0), moved[..., 2], time)
        sights = Paths.of_samples(lamp.field).seen_from(0.0, 0.0, time)
        where = np.zeros((samples.depth.size, 2))
        where[sights.sample] = sights.xy
        actual = lamp.light.hits(where.reshape(*there.shape, 2), (0, 0), moved[..., 2], time)
        assert seen.mean() > 0.5
        np.testing.assert_allclose(actual[seen], expected[seen], atol=2e-4)

    def test_what_has_no_light_sample_is_out_of_reach(self) -> None:
        samples, lamp = lamp_of(SQUARE)
        gone = lighting_of(samples).lights[0].density == 0
        assert 0 < gone.sum() < gone.size
        assert (lamp.field.xy[gone] == lamp.field.xy[gone][0]).all()
        assert np.hypot(*lamp.field.xy[gone][0]) > 1e5
        assert not lamp.density[gone.ravel()].any()
        assert not lamp.arrives[gone.ravel()].any()

    def test_facing_normals_are_those_that_gradients_were_made_of(self) -> None:
        samples = lit_buffer((4, 5, 3))
        lighting = lighting_of(samples)
        normal = np.random.default_rng(2).normal(size=lighting.normal.shape)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        points = lighting.points(samples)
        rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
        away = (normal * rays).sum(axis=-1)
        normal[np.abs(away) < 0.05] = rays[np.abs(away) < 0.05]  # seen edge-on there is no gradient
        gradient = lighting.projection.depth_gradient(
            lighting.projection.pixels(points), samples.depth, normal
        )
        lighting = Lighting(
            lighting.projection, lighting.normal, gradient, lighting.unlit, list(lighting.lights)
        )
        facing = facing_normals(samples, lighting).reshape(normal.shape)
        expected = normal * np.copysign(1, (normal * rays).sum(axis=-1))[..., None]
        np.testing.assert_allclose(facing, expected, atol=1e-4)


@pytest.fixture
def lit() -> SampleBuffer:
    """Samples at rest that every method takes."""
    samples = lit_buffer((10, 12, 4), lights=(SQUARE, DISC), moving=False)
    lens = Lens(samples.lens.c0, samples.lens.c1, aperture="gaussian", sampling="square")
    return replace(samples, lens=lens, time=None)


class TestMethods:
    """Every method takes the light of area lights from `shade`, or reads light samples itself."""

    @pytest.mark.parametrize("method", METHODS)
    def test_takes_shaded_samples(self, method: str, lit: SampleBuffer) -> None:
        image = reconstruct(lit, method)
        np.testing.assert_array_equal(image, reconstruct(shade(lit), method))
        assert np.abs(image - reconstruct(lit, method, shadows=False)).max() > 0.01 * image.max()

    @pytest.mark.parametrize(
        ("method", "options"),
        [*((method, {}) for method in METHODS), ("temporal", {"light_at": "locations"})],
    )
    def test_takes_samples_as_they_are_without_shadows(
        self, method: str, options: dict[str, Any], lit: SampleBuffer
    ) -> None:
        actual = reconstruct(lit, method, shadows=False, **options)
        np.testing.assert_array_equal(actual, reconstruct(replace(lit, lighting=None), method, **options))

    def test_the_reference_of_a_method_takes_the_reference_of_shading(self) -> None:
        samples = lit_buffer((2, 2, 1), lights=(SQUARE,))
        actual = reconstruct(samples, "temporal", device="reference", locations=2)
        shaded = shade(samples, device="reference")
        assert (shaded.color != shade(samples).color).any()
        np.testing.assert_array_equal(
            actual, reconstruct(shaded, "temporal", device="reference", locations=2)
        )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lit: SampleBuffer) -> Path:
    """Where the command runs: a directory that holds lit.npz."""
    save(tmp_path / "lit.npz", lit)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fewrays(command: str) -> None:
    assert main(command.split()) == 0


@pytest.mark.usefixtures("folder")
class TestCommandLine:
    @pytest.mark.parametrize("method", ["multiplane", "box"])
    def test_reconstruct(self, method: str, lit: SampleBuffer) -> None:
        fewrays(f"reconstruct lit.npz --out shadows.npy --method {method}")
        fewrays(f"reconstruct lit.npz --out grain.npy --method {method} --no-shadows")
        np.testing.assert_array_equal(load_image("shadows.npy"), reconstruct(shade(lit), method))
        np.testing.assert_array_equal(
            load_image("grain.npy"), reconstruct(replace(lit, lighting=None), method)
        )

    def test_temporal_at_locations(self, lit: SampleBuffer) -> None:
        fewrays("reconstruct lit.npz --out i.npy --method temporal --light-at locations --locations 8")
        expected = reconstruct(lit, "temporal", light_at="locations", locations=8)
        np.testing.assert_array_equal(load_image("i.npy"), expected)

    @pytest.mark.parametrize("flag", ["", "--no-shadows"])
    def test_planes(self, flag: str, lit: SampleBuffer) -> None:
        fewrays(f"planes lit.npz --out lit.planes {flag}")
        expected = Multiplane.build(replace(lit, lighting=None) if flag else shade(lit))
        np.testing.assert_array_equal(Multiplane.load("lit.planes").maps.halves, expected.maps.halves)

    @pytest.mark.parametrize("flag", ["", "--no-shadows"])
    def test_refocus(self, flag: str, lit: SampleBuffer) -> None:
        samples = replace(lit, lighting=None) if flag else shade(lit)
        fewrays(f"refocus lit.npz --from 3 --to 5 --frames 2 --out planes.npy {flag}")
        fewrays(f"refocus lit.npz --from 3 --to 5 --frames 2 --out layers.npy --method layered {flag}")
        for number, distance in ((1, 3.0), (2, 5.0)):
            refocused = samples.refocus(distance)
            expected = Multiplane.build(samples).render(refocused.lens)
            np.testing.assert_array_equal(load_image(f"planes.{number:04}.npy"), expected)
            np.testing.assert_array_equal(
                load_image(f"layers.{number:04}.npy"), reconstruct(refocused, "layered")
            )
