"""Area lights, their samples and the light they bring, against geometry and radiometry in closed form."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fewrays import (
    AreaLight,
    Lens,
    Lighting,
    LightSamples,
    Projection,
    SampleBuffer,
    SampleError,
    reconstruct,
)
from fewrays.samples import OFF_IMAGE
from lit_buffers import LIGHTS, draw_on_light, lighting_of, lit_buffer

Floats = npt.NDArray[np.float64]

SHAPE = (3, 4, 2)
DOWN = AreaLight((0.0, -2.0, 3.0), (1.0, 0.0, 0.0), (0.0, 0.0, -0.5))
"""A light above what the camera looks at: its normal is +y, down."""


class TestProjection:
    def test_points_are_seen_where_they_came_from(self) -> None:
        projection = Projection((300.0, 280.0), (64.0, 40.0))
        rng = np.random.default_rng(1)
        xy, depth = rng.uniform(0, 100, (5, 6, 2)), rng.uniform(0.1, 90, (5, 6))
        points = projection.points(xy, depth)
        np.testing.assert_array_equal(points[..., 2], depth)
        np.testing.assert_allclose(projection.pixels(points), xy, rtol=1e-13)

    def test_x_is_right_and_y_is_down(self) -> None:
        projection = Projection.from_fov(200, 100, 90.0)
        np.testing.assert_allclose(projection.points([200.0, 100.0], 2.0), [2.0, 1.0, 2.0], rtol=1e-15)

    def test_depth_gradient_is_that_of_the_plane(self) -> None:
        projection = Projection((300.0, 280.0), (64.0, 40.0))
        normal, offset = np.array([0.3, -0.8, 0.4]), 2.5

        def depth(xy: Floats) -> Floats:
            return np.asarray(offset / (projection.points(xy, np.ones(len(xy))) @ normal))

        steps = np.add([10.0, -20.0], [[0.0, 0], [1e-3, 0], [-1e-3, 0], [0, 1e-3], [0, -1e-3]])
        z = depth(steps)
        expected = np.array([z[1] - z[2], z[3] - z[4]]) / 2e-3
        np.testing.assert_allclose(
            projection.depth_gradient(steps[0], z[0], -3 * normal), expected, rtol=1e-6
        )

    @pytest.mark.parametrize(
        ("focal", "center", "field"),
        [
            ((0.0, 1.0), (0.0, 0.0), "projection.focal"),
            ((1.0, -1.0), (0.0, 0.0), "projection.focal"),
            ((1.0, 1.0), (np.nan, 0.0), "projection.center"),
            ((1.0, 1.0, 1.0), (0.0, 0.0), "projection.focal"),
            ((1.0, 1.0), "middle", "projection.center"),
            ((np.inf, 1.0), (0.0, 0.0), "projection.focal"),
        ],
    )
    def test_numbers_that_are_no_camera(self, focal: Any, center: Any, field: str) -> None:
        with pytest.raises(SampleError) as caught:
            Projection(focal, center)
        assert caught.value.field == field

    @pytest.mark.parametrize("fov", [0.0, 180.0, np.nan])
    def test_angles_that_are_none(self, fov: float) -> None:
        with pytest.raises(SampleError, match="between 0 and 180"):
            Projection.from_fov(4, 3, fov)


@st.composite
def lights(draw: st.DrawFn) -> AreaLight:
    def vector(low: float = -3, high: float = 3) -> Floats:
        return np.array([draw(st.floats(low, high)) for _ in range(3)])

    u, other = vector(-1, 1), vector(-1, 1)
    v = np.cross(u, other)
    assume(min(np.linalg.norm(u), np.linalg.norm(v)) > 0.1)
    shape = draw(st.sampled_from(["rectangle", "disc"]))
    return AreaLight(vector(), u, v, shape, vector(), draw(st.floats(0.2, 5)))  # type: ignore[arg-type]


unit_numbers = st.floats(-1, 1)


class TestAreaLight:
    def test_normal_and_area(self) -> None:
        np.testing.assert_allclose(DOWN.normal, [0, 1, 0], atol=1e-15)
        assert DOWN.area == pytest.approx(4 * 0.5)
        assert replace(DOWN, shape="disc").area == pytest.approx(0.5 * math.pi)

    @given(light=lights())
    def test_axes_are_a_rotation(self, light: AreaLight) -> None:
        np.testing.assert_allclose(light.axes @ light.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(light.axes) == pytest.approx(1)
        np.testing.assert_allclose(light.axes[0] * light.half_size[0], light.half_u, atol=1e-12)
        np.testing.assert_allclose(light.axes[1] * light.half_size[1], light.half_v, atol=1e-12)

    @given(light=lights(), lu=unit_numbers, lv=unit_numbers, time=st.floats(0, 1))
    def test_points_lie_in_its_plane(self, light: AreaLight, lu: float, lv: float, time: float) -> None:
        local = light.to_light_space(light.points([lu, lv], time), time)
        np.testing.assert_allclose(local, [*(light.half_size * [lu, lv]), 0], atol=1e-12)

    @given(light=lights(), luv=st.tuples(unit_numbers, unit_numbers), time=st.floats(0, 1))
    def test_all_points_of_a_ray_meet_the_plane_in_one(
        self, light: AreaLight, luv: tuple[float, float], time: float
    ) -> None:
        start = light.points(luv, time)
        direction = light.normal + 0.7 * light.axes[0] - 1.3 * light.axes[1]
        along = np.array([0.3, 1.0, 4.0, 20.0])
        lxy, depth = light.project(start + along[:, None] * direction, luv, time)
        np.testing.assert_allclose(depth, along, rtol=1e-9)
        # The truth: the ray's own point at the distance of Π.
        met = light.to_light_space(start + light.plane_distance * direction, time)[:2]
        np.testing.assert_allclose(lxy, np.broadcast_to(met, (4, 2)), atol=1e-9)

    @given(light=lights(), luv=st.tuples(unit_numbers, unit_numbers), depth=st.floats(0.1, 30))
    def test_one_point_moves_by_its_slope(
        self, light: AreaLight, luv: tuple[float, float], depth: float
    ) -> None:
        """As the camera's samples do: ``lx = lx0 + C(w) lu`` with ``c0 = -a d`` and ``c1 = a``."""
        point = np.array(light.center) + [0.4, -0.2, depth] @ light.axes
        from_center, w = light.project(point, (0.0, 0.0))
        assert float(w) == pytest.approx(depth, rel=1e-9)
        np.testing.assert_allclose(from_center, np.array([0.4, -0.2]) * light.plane_distance / w, rtol=1e-6)
        slope = -light.half_size * light.plane_distance / w + light.half_size
        np.testing.assert_allclose(light.slope(w), slope, atol=1e-9)
        np.testing.assert_allclose(light.project(point, luv)[0], from_center + slope * luv, atol=1e-8)

    @given(light=lights(), time=st.floats(0, 1), depth=st.floats(0.1, 30))
    def test_hits_undo_project(self, light: AreaLight, time: float, depth: float) -> None:
        points = light.centers(time) + np.array([[0.4, -0.2, depth], [-5, 2, 3]]) @ light.axes
        luv = np.array([[0.3, -0.9], [0.0, 0.5]])
        lxy, w = light.project(points, luv, time)
        np.testing.assert_allclose(light.hits(lxy, luv, w, time), points, atol=1e-7)

    @given(light=lights(), time=st.floats(0, 1))
    def test_a_moving_light_is_a_still_one_elsewhere(self, light: AreaLight, time: float) -> None:
        (x, y, z), (dx, dy, dz) = light.center, light.motion
        there = (x + time * dx, y + time * dy, z + time * dz)
        elsewhere = replace(light, center=there, motion=(0, 0, 0))
        point, luv = [1.0, -2.0, 9.0], [0.3, 0.4]
        np.testing.assert_allclose(light.points(luv, time), elsewhere.points(luv), atol=1e-12)
        np.testing.assert_allclose(
            light.to_light_space(point, time), elsewhere.to_light_space(point), atol=1e-12
        )

    def test_points_in_its_plane_and_behind_raise_nothing(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            lxy, depth = DOWN.project([[0.0, -2.0, 3.0], [0.5, -2.0, 3.0], [0.0, -4.0, 3.0]], (0.0, 0.0))
        assert depth.tolist() == [0, 0, -2]
        assert not np.isfinite(lxy[:2]).all()

    def test_lights_compare_by_value(self) -> None:
        again = AreaLight(np.array([0, -2, 3]), [1, 0, 0], (0, 0, -0.5))  # type: ignore[arg-type]
        assert again == DOWN
        assert hash(again) == hash(DOWN)

    @pytest.mark.parametrize(
        ("change", "field", "words"),
        [
            ({"center": (0, np.inf, 0)}, "light.center", "finite"),
            ({"center": (0, 0)}, "light.center", "3 finite numbers"),
            ({"half_u": (0, 0, 0)}, "light.half_u", "length"),
            ({"half_v": (1, 0, -1)}, "light.half_v", "45 degrees"),
            ({"shape": "hexagon"}, "light.shape", "'hexagon'"),
            ({"motion": (np.nan, 0, 0)}, "light.motion", "finite"),
            ({"plane_distance": 0.0}, "light.plane_distance", "positive"),
            ({"plane_distance": -1.0}, "light.plane_distance", "positive"),
            ({"plane_distance": "far"}, "light.plane_distance", "numbers"),
        ],
    )
    def test_what_is_no_light(self, change: dict[str, Any], field: str, words: str) -> None:
        with pytest.raises(SampleError, match=words) as caught:
            replace(DOWN, **change)
        assert caught.value.field == field


def light_fields(**changes: Any) -> dict[str, Any]:
    rng = np.random.default_rng(8)
    fields: dict[str, Any] = {
        "lxy": rng.normal(size=(*SHAPE, 2)),
        "luv": rng.uniform(-0.7, 0.7, (*SHAPE, 2)),
        "depth": rng.uniform(1, 9, SHAPE),
        "radiance": rng.random((*SHAPE, 3)),
        "density": rng.random(SHAPE),
        "reflectance": rng.random((*SHAPE, 3)),
        "motion": rng.normal(size=(*SHAPE, 3)),
    }
    return {"light": DOWN} | {k: v.astype(np.float32) for k, v in fields.items()} | changes


class TestLightSamples:
    def test_arrays_are_shared_and_counted(self) -> None:
        fields = light_fields()
        samples = LightSamples(**fields)
        assert np.shares_memory(samples.lxy, fields["lxy"])
        assert samples.nbytes == 24 * 4 * (2 + 2 + 1 + 3 + 1 + 3 + 3)
        assert samples.shape == SHAPE
        assert repr(samples) == "LightSamples(4 x 3 pixels, 2 spp, rectangle of area 2, moving)"
        still = LightSamples(**light_fields(motion=None))
        assert still.nbytes == 24 * 4 * (2 + 2 + 1 + 3 + 1 + 3)
        assert not still.moves
        assert replace(still, light=LIGHTS[1]).moves

    @pytest.mark.parametrize(
        ("name", "value", "words"),
        [
            ("depth", 0.0, "positive"),
            ("depth", 1e-39, "overflows"),
            ("density", -1.0, "positive, or 0"),
            ("luv", 1.5, "half sizes"),
        ],
    )
    def test_values_out_of_range_are_named(self, name: str, value: float, words: str) -> None:
        fields = light_fields()
        fields[name].reshape(-1)[-1] = value
        with pytest.raises(SampleError, match=words) as caught:
            LightSamples(**fields)
        assert caught.value.field == name
        assert f"value {np.float32(value)} at {[size - 1 for size in fields[name].shape]} (1 such)" in str(
            caught.value
        )

    def test_the_corners_of_a_disc_are_not_on_it(self) -> None:
        luv = np.full((*SHAPE, 2), 0.8)
        LightSamples(**light_fields(luv=luv))
        with pytest.raises(SampleError, match="unit disc"):
            LightSamples(**light_fields(luv=luv, light=replace(DOWN, shape="disc")))

    @pytest.mark.parametrize("name", [*LightSamples.CHANNELS])
    def test_shapes_must_agree_and_values_be_finite(self, name: str) -> None:
        fields = light_fields()
        with pytest.raises(SampleError) as caught:
            LightSamples(**{**fields, name: fields[name][:-1]})
        assert caught.value.field == ("lxy" if name == "depth" else name)
        fields[name][1, 2, 0] = np.inf
        with pytest.raises(SampleError, match=r"inf; mend") as caught:
            LightSamples(**fields)
        assert caught.value.field == name
        with pytest.warns(UserWarning, match="dropped 1 of 24 light samples"):
            dropped = LightSamples(**fields, nan="drop")
        expected = np.zeros(SHAPE, bool)
        expected[1, 2, 0] = True
        np.testing.assert_array_equal(dropped.dropped(), expected)
        assert dropped.density[1, 2, 0] == 0
        for each in dropped.field_names():
            assert np.isfinite(getattr(dropped, each)).all()
            np.testing.assert_array_equal(getattr(dropped, each)[~expected], fields[each][~expected])
        assert np.isinf(fields[name][1, 2, 0]).any()

    @pytest.mark.parametrize(
        ("changes", "field"),
        [
            ({"light": "sun"}, "light"),
            ({"depth": np.ones((3, 4))}, "depth"),
            ({"nan": "keep"}, "nan"),
            ({"radiance": np.full((*SHAPE, 3), "red")}, "radiance"),
        ],
    )
    def test_what_is_no_sample(self, changes: dict[str, Any], field: str) -> None:
        with pytest.raises(SampleError) as caught:
            LightSamples(**light_fields(**changes))
        assert caught.value.field == field


def lit_point(
    light: AreaLight, point: Floats, normal: Floats, luv: Floats, *, ends: float | None = None
) -> tuple[SampleBuffer, Lighting]:
    """One point that all samples see, lit from as many light points; white, and of white light.

    `ends` is the light-space depth at which the rays end, when that is not the point.
    """
    shape = (1, 1, len(luv))
    projection = Projection((100.0, 100.0), (0.5, 0.5))
    xy = projection.pixels(point)
    samples = SampleBuffer(
        np.broadcast_to(xy, (*shape, 2)),
        np.zeros((*shape, 2)),
        np.full(shape, point[2]),
        np.zeros((*shape, 3)),
        Lens(-1.0, 0.2),
    )
    lxy, depth = light.project(np.broadcast_to(point, (*shape, 3)), luv.reshape(*shape, 2))
    rays = LightSamples(
        light,
        lxy,
        luv.reshape(*shape, 2),
        depth if ends is None else np.full(shape, ends),
        np.ones((*shape, 3)),
        np.ones(shape),
        np.full((*shape, 3), 1 / np.pi),
    )
    lighting = Lighting(
        projection,
        np.broadcast_to(normal, (*shape, 3)),
        np.zeros((*shape, 2)),
        np.zeros((*shape, 3)),
        [rays],
    )
    return samples, lighting


def grid(count: int) -> Floats:
    """Middles of the cells of a square, ``(count², 2)``: their mean is the midpoint rule."""
    axis = (np.arange(count) + 0.5) / count * 2 - 1
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


class TestDirect:
    def test_the_irradiance_of_a_rectangle(self) -> None:
        """A floor below the middle of a parallel rectangle: four times what one of its quarters gives."""
        samples, lighting = lit_point(DOWN, np.array([0.0, 0.0, 3.0]), np.array([0.0, -1.0, 0.0]), grid(60))
        a, b = 1.0 / 2.0, 0.5 / 2.0  # half sizes over the height
        s, t = math.hypot(1, a), math.hypot(1, b)
        quarter = 0.5 * (a / s * math.atan(b / s) + b / t * math.atan(a / t))
        direct = lighting.direct(samples, 0)
        assert direct.dtype == np.float32
        np.testing.assert_allclose(direct.mean(axis=(0, 1, 2)), 4 * quarter / np.pi, rtol=1e-4)

    def test_the_irradiance_of_a_disc(self) -> None:
        """On the axis of a parallel disc it is π sin² of the angle that the disc's radius takes."""
        light = replace(DOWN, half_v=(0.0, 0.0, -1.0), shape="disc")
        ring = np.sqrt((np.arange(200) + 0.5) / 200)  # equal areas
        luv = np.stack([ring * np.cos(ring * 999), ring * np.sin(ring * 999)], axis=-1)
        samples, lighting = lit_point(light, np.array([0.0, 0.0, 3.0]), np.array([0.0, -1.0, 0.0]), luv)
        np.testing.assert_allclose(lighting.direct(samples, 0).mean(axis=(0, 1, 2)), 1 / 5, rtol=1e-4)

    def test_a_tilted_surface_takes_the_cosine(self) -> None:
        """A tiny light: radiance times area times both cosines over the squared distance."""
        light = AreaLight((0.0, -2.0, 3.0), (1e-3, 0.0, 0.0), (0.0, 0.0, -1e-3))
        point = np.array([1.0, 0.0, 3.5])
        normal = np.array([0.6, -0.8, 0.0])
        samples, lighting = lit_point(light, point, normal, grid(1))
        towards = (np.array(light.center) - point) / math.sqrt(5.25)
        expected = 4e-6 / np.pi * (towards @ normal) * -(towards @ light.normal) / 5.25
        np.testing.assert_allclose(lighting.direct(samples, 0)[0, 0, 0], expected, rtol=1e-5)

    @pytest.mark.parametrize(
        ("point", "normal"),
        [
            ((0.0, 0.0, 3.0), (0.0, 1.0, 0.0)),  # turned away from the light
            ((0.0, -4.0, 3.0), (0.0, 1.0, 0.0)),  # on the light's dark side
        ],
    )
    def test_no_light_from_behind(self, point: Any, normal: Any) -> None:
        samples, lighting = lit_point(DOWN, np.array(point), np.array(normal), grid(4), ends=2.0)
        assert not lighting.direct(samples, 0).any()

    @pytest.mark.parametrize(
        ("ends", "arrives"), [(1.9, False), (1.9999, False), (1.999999, True), (3, True)]
    )
    def test_rays_arrive_unless_they_end_before(self, ends: float, arrives: bool) -> None:
        point, normal = np.array([0.0, 0.0, 3.0]), np.array([0.0, -1.0, 0.0])
        samples, lighting = lit_point(DOWN, point, normal, grid(2), ends=ends)
        assert (lighting.arrives(samples, 0) == arrives).all()
        assert (lighting.direct(samples, 0) > 0).all() == arrives

    @pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
    def test_rounding_to_float32_hides_no_light(self, scale: float) -> None:
        """Everything in the buffer is float32; in whatever unit the scene is."""
        lights = tuple(
            AreaLight(
                tuple(scale * np.array(light.center)),
                tuple(scale * np.array(light.half_u)),
                tuple(scale * np.array(light.half_v)),
                light.shape,
                tuple(scale * np.array(light.motion)),
                scale,
            )
            for light in LIGHTS
        )
        samples = lit_buffer((40, 40, 4), lights=LIGHTS, blocked=0.0)
        scaled = _scaled(samples, scale, lights)
        for number in range(2):
            light = lighting_of(scaled).lights[number]
            np.testing.assert_array_equal(lighting_of(scaled).arrives(scaled, number), light.density > 0)

    def test_color_is_the_sum_and_does_not_depend_on_blocks(self, monkeypatch: pytest.MonkeyPatch) -> None:
        samples = lit_buffer((9, 5, 3))
        lighting = lighting_of(samples)
        whole = lighting.unlit + lighting.direct(samples, 0) + lighting.direct(samples, 1)
        np.testing.assert_allclose(samples.color, whole, rtol=1e-6)
        monkeypatch.setattr("fewrays.lighting._BLOCK", 30)
        np.testing.assert_array_equal(lighting.color(samples), samples.color)

    def test_hits_lie_on_the_rays(self) -> None:
        """A light sample that arrives ends at its camera sample's point."""
        samples = lit_buffer((6, 5, 3))
        lighting = lighting_of(samples)
        assert samples.time is not None
        for number, each in enumerate(lighting.lights):
            hits = each.light.hits(each.lxy, each.luv, each.depth, samples.time)
            at = lighting.arrives(samples, number)
            assert 0 < at.mean() < 1
            np.testing.assert_allclose(hits[at], lighting.points(samples)[at], atol=2e-5)

    def test_the_lens_does_not_matter(self) -> None:
        samples = lit_buffer()
        other = samples.refocus(2.5, 0.3)
        assert other.lighting is samples.lighting
        lighting = lighting_of(samples)
        np.testing.assert_allclose(lighting.points(other), lighting.points(samples), atol=1e-5)
        np.testing.assert_allclose(lighting.direct(other, 1), lighting.direct(samples, 1), rtol=1e-4)


def _scaled(samples: SampleBuffer, scale: float, lights: tuple[AreaLight, ...]) -> SampleBuffer:
    """The same scene in another unit."""
    lighting = lighting_of(samples)
    rays = [
        LightSamples(
            light,
            each.lxy * scale / old.plane_distance,
            each.luv,
            each.depth * scale,
            each.radiance,
            each.density,
            each.reflectance,
        )
        for light, old, each in zip(lights, LIGHTS, lighting.lights, strict=True)
    ]
    gradient = lighting.depth_gradient * np.float32(scale)
    scaled = Lighting(lighting.projection, lighting.normal, gradient, lighting.unlit, rays)
    lens = Lens(samples.lens.c0 * scale, samples.lens.c1, sampling="square")
    return replace(samples, depth=samples.depth * np.float32(scale), lens=lens, lighting=scaled)


class TestLighting:
    def test_sizes(self) -> None:
        samples = lit_buffer(SHAPE)
        lighting = lighting_of(samples)
        per_light = 4 * (2 + 2 + 1 + 3 + 1 + 3 + 3)
        assert lighting.nbytes == 24 * (4 * (3 + 2 + 3) + 2 * per_light)
        assert samples.nbytes == 24 * 4 * (2 + 2 + 1 + 3 + 1) + lighting.nbytes
        assert repr(lighting) == "Lighting(4 x 3 pixels, 2 spp, 2 lights)"
        assert repr(samples).endswith("still, 2 lights)")
        assert repr(lit_buffer(lights=LIGHTS[:1])).endswith("still, 1 light)")
        assert "lighting" not in samples.field_names()

    def test_methods_take_the_colour_where_shadows_are_not_wanted(self) -> None:
        samples = lit_buffer((6, 7, 2))
        for method in ("box", "layered", "multiplane"):
            np.testing.assert_array_equal(
                reconstruct(samples, method, shadows=False),
                reconstruct(replace(samples, lighting=None), method),
            )

    @pytest.mark.parametrize("name", ["normal", "depth_gradient", "unlit"])
    def test_shapes_must_agree_and_values_be_finite(self, name: str) -> None:
        lighting = lighting_of(lit_buffer(SHAPE))
        with pytest.raises(SampleError, match="to go with depth's") as caught:
            replace(lighting, **{name: getattr(lighting, name)[:-1]})
        assert caught.value.field == name
        values = getattr(lighting, name).copy()
        values[0, 3, 1, 1] = np.nan
        with pytest.raises(SampleError, match=r"first at \[0, 3, 1, 1\]") as caught:
            replace(lighting, **{name: values})
        assert caught.value.field == name

    @pytest.mark.parametrize(
        ("changes", "field", "words"),
        [
            ({"projection": (1, 2)}, "projection", "got tuple"),
            ({"lights": ()}, "lights", "1 to 64 lights, got 0"),
            ({"lights": 3}, "lights", "sequence"),
            ({"lights": (DOWN,)}, "lights", "AreaLight"),
            ({"normal": np.ones((*SHAPE, 3))}, "normal", r"value 1\.73.* length"),
            ({"nan": "keep"}, "nan", "'keep'"),
        ],
    )
    def test_what_is_no_lighting(self, changes: dict[str, Any], field: str, words: str) -> None:
        lighting = lighting_of(lit_buffer(SHAPE))
        fields = {name: getattr(lighting, name) for name in ("projection", "lights", *lighting.field_names())}
        with pytest.raises(SampleError, match=words) as caught:
            Lighting(**{**fields, **changes})
        assert caught.value.field == field

    def test_lights_are_of_one_size(self) -> None:
        lighting, other = lighting_of(lit_buffer(SHAPE)), lighting_of(lit_buffer((3, 4, 1)))
        with pytest.raises(SampleError, match=r"^lights\[1\]: .*\(3, 4, 1\)"):
            replace(lighting, lights=(lighting.lights[0], other.lights[0]))

    def test_buffers_take_only_their_own(self) -> None:
        samples = lit_buffer(SHAPE)
        with pytest.raises(SampleError, match=r"^lighting: .*\(3, 4, 1\)"):
            replace(samples, lighting=lit_buffer((3, 4, 1)).lighting)
        with pytest.raises(SampleError, match=r"^lighting: .*LightSamples"):
            replace(samples, lighting=lighting_of(samples).lights[0])  # type: ignore[arg-type]
        for parts in ({"lights": LIGHTS[:1]}, {"lights": LIGHTS[1:], "moving": False}):
            moving = lit_buffer(SHAPE, **parts)
            with pytest.raises(SampleError, match=r"^lighting: .*give time"):
                replace(moving, time=None)
        still = lit_buffer(SHAPE, lights=LIGHTS[:1], moving=False)
        assert replace(still, time=None).lighting is still.lighting


class TestDropping:
    """What goes missing goes missing everywhere, so that no pixel is too dark for it."""

    def check(self, samples: SampleBuffer, clean: SampleBuffer, at: tuple[int, ...]) -> None:
        gone = np.zeros(SHAPE, bool)
        gone[at] = True
        np.testing.assert_array_equal((samples.xy == OFF_IMAGE).all(axis=-1), gone)
        lighting, before = lighting_of(samples), lighting_of(clean)
        np.testing.assert_array_equal(lighting.dropped(), gone)
        for name in lighting.field_names():
            np.testing.assert_array_equal(getattr(lighting, name)[~gone], getattr(before, name)[~gone])
        for light, old in zip(lighting.lights, before.lights, strict=True):
            assert not light.density[gone].any()
            np.testing.assert_array_equal(light.dropped(), gone)
            np.testing.assert_array_equal(light.lxy[~gone], old.lxy[~gone])
        np.testing.assert_array_equal(samples.color[~gone], clean.color[~gone])
        assert not samples.color[gone].any()
        np.testing.assert_allclose(lighting.color(samples), samples.color, rtol=1e-6)

    def test_a_camera_sample_takes_its_light_samples_along(self) -> None:
        clean = lit_buffer(SHAPE)
        color = clean.color.copy()
        color[2, 1, 0, 0] = np.nan
        with pytest.warns(UserWarning, match="dropped 1 of 24 samples"):
            samples = SampleBuffer(
                clean.xy,
                clean.uv,
                clean.depth,
                color,
                clean.lens,
                clean.time,
                lighting=clean.lighting,
                nan="drop",
            )
        self.check(samples, clean, (2, 1, 0))

    def test_a_light_sample_takes_its_camera_sample_along(self) -> None:
        clean = lit_buffer(SHAPE)
        lighting = lighting_of(clean)
        first = lighting.lights[0]
        fields = {name: getattr(first, name) for name in first.field_names()}
        fields["radiance"] = fields["radiance"].copy()
        fields["radiance"][1, 3, 1, 2] = np.inf
        with pytest.warns(UserWarning, match="dropped 1 of 24 light samples"):
            first = LightSamples(first.light, **fields, nan="drop")
        lighting = replace(lighting, lights=(first, lighting.lights[1]))
        with pytest.warns(UserWarning, match="dropped 1 of 24 samples"):
            samples = replace(clean, lighting=lighting)
        self.check(samples, clean, (1, 3, 1))

    def test_a_normal_takes_both_along(self) -> None:
        clean = lit_buffer(SHAPE)
        lighting = lighting_of(clean)
        normal = lighting.normal.copy()
        normal[0, 0, 1] = np.nan
        fields = {"depth_gradient": lighting.depth_gradient, "unlit": lighting.unlit}
        with pytest.warns(UserWarning, match="dropped 1 of 24 samples whose normal"):
            lighting = Lighting(lighting.projection, normal, **fields, lights=lighting.lights, nan="drop")
        with pytest.warns(UserWarning, match="dropped 1 of 24 samples"):
            samples = replace(clean, lighting=lighting)
        self.check(samples, clean, (0, 0, 1))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            again = samples.refocus(3.0)  # what is dropped already is no news
        assert again.lighting is samples.lighting


def test_light_points_are_uniform() -> None:
    """The support for these tests: half of a disc's points lie within the radius sqrt(1/2)."""
    luv = draw_on_light(LIGHTS[1], (20_000,), np.random.default_rng(1))
    assert float((np.hypot(*luv.T) < math.sqrt(0.5)).mean()) == pytest.approx(0.5, abs=0.02)
