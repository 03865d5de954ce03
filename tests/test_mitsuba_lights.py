"""Light samples from Mitsuba: against analytic geometry, Mitsuba's own rays, and its path tracer's mean."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import SampleBuffer, SampleError
from fewrays.area_light import AreaLight
from fewrays.lighting import Lighting
from fewrays.sources.mitsuba import render

EYE, TARGET, UP = [0.4, 1.6, -3.0], [0.1, 0.3, 0.4], [0.1, 1.0, 0.2]
WIDTH, HEIGHT, FOV = 40, 28, 45.0
ALBEDO = 0.5
LAMP, LIT = [0.9, 2.4, -0.6], [-0.1, 0.0, 0.3]  # where the lamp hangs, and where it shines

Array = npt.NDArray[np.float64]


def world(mi: ModuleType, **parts: Any) -> dict[str, Any]:
    """Return a scene with a matte floor, seen through a lens; parts that are None are left out."""
    to_world = mi.ScalarTransform4f
    content = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {
            "type": "thinlens",
            "fov": FOV,
            "aperture_radius": 0.08,
            "focus_distance": 3.2,
            "to_world": to_world().look_at(EYE, TARGET, UP),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
        },
        "floor": {
            "type": "rectangle",
            "to_world": to_world().rotate([1, 0, 0], -90).scale(8),
            "bsdf": {"type": "diffuse", "reflectance": ALBEDO},
        },
        "lamp": lamp(mi),
        **parts,
    }
    return {name: part for name, part in content.items() if part is not None}


def lamp(
    mi: ModuleType, kind: str = "rectangle", mirror: float = 1.0, radiance: Any = None
) -> dict[str, Any]:
    place = mi.ScalarTransform4f().look_at(LAMP, LIT, [0.0, 0.3, 1.0]).scale([mirror * 0.5, 0.3, 1])
    glow = {"type": "rgb", "value": [16.0, 12.0, 8.0]} if radiance is None else radiance
    return {"type": kind, "to_world": place, "emitter": {"type": "area", "radiance": glow}}


def ball(centre: tuple[float, float, float] = (0.1, 0.6, 0.2), radius: float = 0.35) -> dict[str, Any]:
    return {"type": "sphere", "center": list(centre), "radius": radius}


def trace(scene: Any, **options: Any) -> tuple[SampleBuffer, Lighting]:
    samples = render(scene, **{"spp": 8, "shading_spp": 1, "lighting": True, **options})
    assert samples.lighting is not None
    return samples, samples.lighting


def to_world(points: Array) -> Array:
    """Return camera-space points (..., 3) in the world, without Mitsuba."""
    return np.asarray(points @ camera_axes() + EYE)


def camera_axes() -> Array:
    """Return the picture's right, down and forward as rows (3, 3), without Mitsuba."""
    forward = np.subtract(TARGET, EYE) / np.linalg.norm(np.subtract(TARGET, EYE))
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def receivers(samples: SampleBuffer, lighting: Lighting, number: int = 0) -> Array:
    """Return the camera samples' own light-space depths (H, W, S)."""
    time = 0.0 if samples.time is None else samples.time
    area = lighting.lights[number].light
    return np.asarray(area.to_light_space(lighting.points(samples), time)[..., 2])


def hits(samples: SampleBuffer, lighting: Lighting, number: int = 0) -> Array:
    """Return what light samples hit first, in the world (H, W, S, 3)."""
    light = lighting.lights[number]
    time = 0.0 if samples.time is None else samples.time
    return to_world(light.light.hits(light.lxy, light.luv, light.depth, time))


def glossy(mi: ModuleType) -> dict[str, Any]:
    """Return things of many materials, and other lights: some sampled, some hit, one of no size."""
    place = mi.ScalarTransform4f
    leaf = {"type": "principledthin", "diff_trans": 1.4, "roughness": 0.4}
    leaf["base_color"] = {"type": "rgb", "value": [0.3, 0.6, 0.2]}
    return {
        "ball": {**ball(), "bsdf": {"type": "principled", "roughness": 0.3, "specular": 0.6}},
        "mirror": {
            "type": "rectangle",
            "to_world": place().translate([-1.1, 0.6, 1.2]).rotate([0, 1, 0], 160).scale(0.6),
            "bsdf": {"type": "twosided", "bsdf": {"type": "conductor"}},
        },
        "leaf": {
            "type": "rectangle",
            "to_world": place().translate([0.8, 0.7, 0.1]).rotate([1, 0, 0], 60).scale(0.35),
            "bsdf": leaf,
        },
        "tile": {
            "type": "cube",
            "to_world": place().translate([-0.7, 0.15, 0]).scale(0.15),
            "bsdf": {"type": "roughconductor", "alpha": 0.25},
        },
        "sky": {"type": "constant", "radiance": 0.15},
        "bulb": {**ball((-1.2, 0.5, -0.3), 0.15), "emitter": {"type": "area", "radiance": 3.0}},
        "spot": {"type": "point", "position": [1.5, 1.0, -0.5], "intensity": 0.4},
    }


@pytest.mark.parametrize("kind", ["rectangle", "disk"])
def test_the_mean_is_that_of_the_path_tracer(mi: ModuleType, kind: str) -> None:
    scene = mi.load_dict(world(mi, lamp=lamp(mi, kind), **glossy(mi)))
    batches = {
        lit: np.stack(
            [
                render(scene, spp=16, shading_spp=4, seed=seed + 100 * lit, lighting=lit).color.mean(axis=2)
                for seed in range(12)
            ]
        )
        for lit in (False, True)
    }
    (plain, plain_error), (lit, lit_error) = (
        (batch.mean(axis=0), batch.var(axis=0, ddof=1) / len(batch)) for batch in batches.values()
    )
    z = (lit - plain) / np.sqrt(plain_error + lit_error + 1e-8)
    assert np.mean(z**2) < 1.3  # 22 degrees of freedom: 1.1
    assert abs(z.mean()) < 0.12
    assert np.abs(z).max() < 7
    assert lit.mean() == pytest.approx(plain.mean(), rel=0.01)


def test_depths_of_what_nothing_is_in_front_of_are_exact(mi: ModuleType) -> None:
    samples, lighting = trace(world(mi))
    light = lighting.lights[0]
    aimed = light.density > 0
    assert aimed.mean() > 0.6
    np.testing.assert_array_equal(light.depth[aimed], receivers(samples, lighting)[aimed].astype(np.float32))
    assert not aimed[samples.depth > 100].any()
    assert aimed[(samples.depth < 100) & (receivers(samples, lighting) > 1e-3)].all()


def test_a_lamp_that_looks_away_has_no_light_samples(mi: ModuleType) -> None:
    away = mi.ScalarTransform4f().look_at(LAMP, (2 * np.array(LAMP) - LIT).tolist(), [0.0, 0.3, 1.0])
    samples, lighting = trace(world(mi, lamp={**lamp(mi), "to_world": away}))
    assert not lighting.lights[0].density.any()
    assert not samples.color.any()


def test_a_ball_shades_its_other_side_and_nothing_else_of_itself(mi: ModuleType) -> None:
    samples, lighting = trace(world(mi, floor=None, ball=ball()), spp=16)
    light, points = lighting.lights[0], to_world(lighting.points(samples))
    outward = (points - [0.1, 0.6, 0.2]) / 0.35
    towards = to_world(light.light.points(light.luv)) - points
    cosine = np.einsum("hwsc,hwsc->hws", outward, towards) / np.linalg.norm(towards, axis=-1)
    seen = light.density > 0
    arrives = lighting.arrives(samples, 0)
    assert min((seen & (cosine > 0.02)).sum(), (seen & (cosine < -0.02)).sum()) > 200
    assert arrives[seen & (cosine > 0.02)].all()
    assert not arrives[seen & (cosine < -0.02)].any()


def test_blocked_rays_end_where_a_sphere_is(mi: ModuleType) -> None:
    samples, lighting = trace(world(mi, ball=ball()))
    light = lighting.lights[0]
    floor = (light.density > 0) & (np.abs(to_world(lighting.points(samples))[..., 1]) < 1e-4)
    blocked = floor & ~lighting.arrives(samples, 0)
    start, end = to_world(light.light.points(light.luv)), to_world(lighting.points(samples))
    way = (end - start) / np.linalg.norm(end - start, axis=-1, keepdims=True)
    middle = np.einsum("hwsc,hwsc->hws", [0.1, 0.6, 0.2] - start, way)
    miss = np.linalg.norm(start + middle[..., None] * way - [0.1, 0.6, 0.2], axis=-1)
    clear = np.abs(miss - 0.35) > 1e-4
    np.testing.assert_array_equal(blocked[floor & clear], (miss < 0.35)[floor & clear])
    assert 0.03 < blocked[floor].mean() < 0.7
    np.testing.assert_allclose(
        np.linalg.norm(hits(samples, lighting)[blocked] - [0.1, 0.6, 0.2], axis=-1), 0.35, atol=1e-4
    )


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["rectangle", "disk"])
def test_rays_through_the_two_planes_hit_at_the_depth(mi: ModuleType, kind: str, mirror: float) -> None:
    parts = {
        "ball": ball(),
        "cube": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([-0.6, 0.2, 0.8]).scale(0.2)},
    }
    scene = mi.load_dict(world(mi, lamp=lamp(mi, kind, mirror), **parts))
    _, lighting = trace(scene, seed=3)
    light = lighting.lights[0]
    area = light.light
    normal = np.subtract(LIT, LAMP) / np.linalg.norm(np.subtract(LIT, LAMP))
    np.testing.assert_allclose(area.normal @ camera_axes(), normal, atol=1e-6)
    np.testing.assert_allclose(to_world(np.array(area.center)), LAMP, atol=1e-5)
    np.testing.assert_allclose(area.half_size, [0.5, 0.3], atol=1e-6)
    aimed = light.density > 0
    start = to_world(area.points(light.luv[aimed]))
    on_plane = to_world(area.hits(light.lxy, light.luv, np.full(light.depth.shape, area.plane_distance)))[
        aimed
    ]
    way = (on_plane - start) / np.linalg.norm(on_plane - start, axis=-1, keepdims=True)
    found = scene.ray_intersect(mi.Ray3f(mi.Point3f((start + 1e-3 * way).T), mi.Vector3f(way.T)))
    depth = (1e-3 + np.array(found.t)) * (way @ normal)
    close = np.isclose(depth, light.depth[aimed], rtol=2e-4)
    assert close.mean() > 0.995  # rays that graze an edge may fall on either side of it
    assert np.ptp(light.luv[aimed], axis=0).min() > 1.9


def test_light_points_are_uniform_and_differ_between_seeds_and_lights(mi: ModuleType) -> None:
    second = lamp(mi, "disk")
    second["to_world"] = mi.ScalarTransform4f().translate([-1.5, 0, 0.5]) @ second["to_world"]
    samples, lighting = trace(world(mi, second=second), spp=16)
    _, other = trace(world(mi, second=second), spp=16, seed=1)
    by_shape = {light.light.shape: light for light in lighting.lights}
    assert set(by_shape) == {"rectangle", "disc"}
    quarters = np.floor(2 * (by_shape["rectangle"].luv + 1)).clip(0, 3) @ [1, 4]
    np.testing.assert_array_equal(
        np.sort(quarters, axis=-1), np.broadcast_to(np.arange(16.0), quarters.shape)
    )
    radius = np.linalg.norm(by_shape["disc"].luv, axis=-1)
    assert radius.max() <= 1 + 1e-6
    np.testing.assert_allclose(np.quantile(radius**2, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.01)
    assert not np.array_equal(lighting.lights[0].luv, other.lights[0].luv)
    assert not np.array_equal(lighting.lights[0].luv, lighting.lights[1].luv)
    np.testing.assert_allclose(samples.color, lighting.color(samples), rtol=1e-6)


def floor_depth(lighting: Lighting, xy: Array) -> Array:
    """Return the depth at which the lens centre sees the floor at positions (N, 2)."""
    rays = lighting.projection.points(xy, np.ones(len(xy))) @ camera_axes()
    return np.asarray(-EYE[1] / rays[:, 1])


def test_shapes_of_files_need_no_names(mi: ModuleType, tmp_path: Path) -> None:
    del mi
    shapes = "".join(
        f'<shape type="{kind}"><transform name="to_world"><rotate x="1" angle="90"/>'
        f'<translate x="{x}" y="3"/></transform><emitter type="area"><rgb name="radiance" value="{x + 2}"/>'
        "</emitter></shape>"
        for kind, x in (("rectangle", -1), ("disk", 1))
    )
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"><float name="fov" '
        'value="45"/><transform name="to_world"><lookat origin="0,2,-4" target="0,0,0" up="0,1,0"/>'
        '</transform><film type="hdrfilm"><integer name="width" value="24"/><integer name="height" '
        'value="16"/></film>'
        '</sensor><shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale '
        f'value="4"/></transform></shape>{shapes}</scene>'
    )
    samples, lighting = trace(path)
    lights: dict[str, Any] = {light.light.shape: light for light in lighting.lights}
    assert set(lights) == {"rectangle", "disc"}
    for shape, radiance in (("rectangle", 1.0), ("disc", 3.0)):
        light = lights[shape]
        np.testing.assert_allclose(light.radiance[light.density > 0], radiance, rtol=1e-6)
        assert (light.density > 0).mean() > 0.5
    assert samples.color.mean() > 0


def test_normals_and_depth_gradients_are_those_of_the_plane(mi: ModuleType) -> None:
    for tilt in (0, 180):  # seen from either side
        floor = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90 + tilt).scale(8),
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}},
        }
        samples, lighting = trace(world(mi, floor=floor))
        hit = samples.depth < 100
        normal = lighting.normal[hit].astype(np.float64) @ camera_axes()
        np.testing.assert_allclose(normal, np.broadcast_to([0, 1, 0], normal.shape), atol=1e-6)
        seen = (samples.xy - samples.slope()[..., None] * samples.uv)[hit].astype(np.float64)

        np.testing.assert_allclose(floor_depth(lighting, seen), samples.depth[hit], rtol=1e-4)
        step = 1e-4
        for axis in range(2):
            shift = step * np.eye(2)[axis]
            rise = floor_depth(lighting, seen + shift) - floor_depth(lighting, seen - shift)
            slope = rise / (2 * step)
            np.testing.assert_allclose(lighting.depth_gradient[hit][:, axis], slope, rtol=2e-3, atol=1e-4)
    assert not lighting.depth_gradient[~hit].any()
    np.testing.assert_array_equal(
        lighting.normal[~hit], np.broadcast_to([0, 0, -1], lighting.normal[~hit].shape)
    )


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["rectangle", "disk"])
def test_textured_lights_emit_what_rays_find_there(mi: ModuleType, kind: str, mirror: float) -> None:
    pixels = np.random.default_rng(4).uniform(1, 9, (6, 8, 3)).astype(np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "filter_type": "bilinear"}
    scene = mi.load_dict(world(mi, lamp=lamp(mi, kind, mirror, texture)))
    samples, lighting = trace(scene, spp=2)
    light = lighting.lights[0]
    aimed = light.density > 0
    point = to_world(light.light.points(0.999 * light.luv[aimed]))  # not to miss at the rim
    back = to_world(lighting.points(samples)[aimed]) - point
    back /= np.linalg.norm(back, axis=-1, keepdims=True)
    there = scene.ray_intersect(mi.Ray3f(mi.Point3f((point + 0.01 * back).T), mi.Vector3f(-back.T)))
    found = np.array(there.emitter(scene).eval(there)).T
    near = np.isclose(light.radiance[aimed], found, rtol=0.05, atol=0.02).all(axis=-1)
    assert near.mean() > 0.97  # but for the seam of a disc's texture
    assert light.radiance[aimed].std() > 1


def test_reflectance_is_the_bsdf(mi: ModuleType) -> None:
    _, lighting = trace(world(mi))
    light = lighting.lights[0]
    np.testing.assert_allclose(light.reflectance[light.density > 0], ALBEDO / math.pi, rtol=1e-4)


def homogeneous(area: AreaLight, points: Array, time: npt.ArrayLike) -> Array:
    """Return (lx0 w, ly0 w, w) of camera-space points as the light's centre sees them."""
    lxy, depth = area.project(points, np.zeros(2), time)
    return np.concatenate([lxy * depth[..., None], depth[..., None]], axis=-1)


def test_first_hits_follow_their_motion_in_the_lights_frame(mi: ModuleType) -> None:
    centre, shift, drift = np.array([0.1, 0.6, 0.2]), np.array([0.3, -0.1, 0.2]), np.array([-0.2, 0.1, 0.3])
    ends = {name: np.eye(4) for name in ("ball", "lamp")}
    ends["ball"][:3, 3], ends["lamp"][:3, 3] = shift, drift
    samples, lighting = trace(world(mi, ball=ball()), motion=ends, time_slices=8, spp=16)
    light = lighting.lights[0]
    assert samples.time is not None and light.motion is not None
    np.testing.assert_allclose(np.array(light.light.motion) @ camera_axes(), drift, atol=1e-6)
    time = samples.time.astype(np.float64)
    first = hits(samples, lighting)
    from_ball = np.linalg.norm(first - (centre + time[..., None] * shift), axis=-1)
    on_ball = (light.density > 0) & (np.abs(from_ball - 0.35) < 1e-4)
    on_floor = (light.density > 0) & (np.abs(first[..., 1]) < 1e-4)
    assert (on_ball | on_floor)[light.density > 0].mean() > 0.999
    assert min(on_ball.sum(), on_floor.sum()) > 500

    now = homogeneous(light.light, light.light.hits(light.lxy, light.luv, light.depth, time), time)
    for later in (0.0, 0.4, 1.0):
        then = now + (later - time)[..., None] * light.motion
        at = light.light.hits(then[..., :2] / then[..., 2:], np.zeros(2), then[..., 2], later)
        expected = first + (later - time)[..., None] * np.where(on_ball[..., None], shift, 0)
        where = on_ball | on_floor
        np.testing.assert_allclose(to_world(at)[where], expected[where], atol=2e-4)
        apart = np.linalg.norm(to_world(at)[on_ball] - (centre + later * shift), axis=-1)
        np.testing.assert_allclose(apart, 0.35, atol=3e-4)


def test_each_slice_is_lit_as_a_still_scene(mi: ModuleType) -> None:
    shift = np.array([0.3, 0.1, 0.2])
    end = np.eye(4)
    end[:3, 3] = shift
    moving, moving_light = trace(world(mi, ball=ball()), motion={"ball": end}, time_slices=2)
    assert moving.time is not None
    for time in (0.25, 0.75):
        x, y, z = (np.array([0.1, 0.6, 0.2]) + time * shift).tolist()
        _, still_light = trace(world(mi, ball=ball((x, y, z))))
        now = np.abs(moving.time - time) < 1e-6
        a, b = moving_light.lights[0], still_light.lights[0]
        np.testing.assert_array_equal(a.luv, b.luv)
        close = np.isclose(a.depth, b.depth, rtol=1e-4)[now]
        assert now.mean() > 0.4
        assert close.mean() > 0.998
        assert np.isclose(a.depth, b.depth, rtol=1e-4)[~now].mean() < 0.99  # it is another picture


def test_without_lighting_nothing_but_colour_is_another(mi: ModuleType) -> None:
    scene = mi.load_dict(world(mi, ball=ball()))
    plain = render(scene, spp=2, shading_spp=4, seed=7)
    lit, _ = trace(scene, spp=2, shading_spp=4, seed=7)
    assert plain.lighting is None
    for name in ("xy", "uv", "depth"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(lit, name))


def test_light_paths_are_as_long_as_the_integrator_says(mi: ModuleType) -> None:
    scene = mi.load_dict(world(mi, ball=ball()))
    unlit = {depth: trace(scene, max_depth=depth, shading_spp=4)[1].unlit for depth in (2, 3)}
    longest = trace(scene, integrator={"type": "path"}, shading_spp=4)[1].unlit
    seen = trace(scene, integrator={"type": "direct"}, shading_spp=4)[1].unlit
    assert not unlit[2].any() and not seen.any()
    assert 0 < unlit[3].mean() < longest.mean()
    plain = {
        depth: np.mean([render(scene, max_depth=depth, shading_spp=4, seed=s).color.mean() for s in (1, 2)])
        for depth in (2, 3)
    }
    assert unlit[3].mean() == pytest.approx(plain[3] - plain[2], rel=0.15)


def test_leaves_keep_the_light_that_shines_through_them(mi: ModuleType) -> None:
    thin = {"type": "principledthin", "diff_trans": 1.2, "roughness": 0.5}
    place = mi.ScalarTransform4f().look_at([0.0, 0.3, 0.4], EYE, [0, 1, 0]).scale(0.8)
    behind = mi.ScalarTransform4f().look_at([-0.1, -0.05, 1.3], [0, 0.3, 0.4], [0, 1, 0]).scale(0.7)
    parts = {
        "floor": {"type": "rectangle", "to_world": place, "bsdf": thin},
        "lamp": {**lamp(mi), "to_world": behind},
        "sky": {"type": "constant", "radiance": 0.05},
    }
    scene = mi.load_dict(world(mi, **parts))
    samples, lighting = trace(scene, shading_spp=64)
    leaf = (samples.depth < 100) & (samples.color[..., 0] < 5)
    arrives = lighting.arrives(samples, 0) & leaf
    assert arrives.sum() > 500
    assert not lighting.direct(samples, 0)[leaf].any()
    plain = render(scene, spp=8, shading_spp=64)
    assert lighting.unlit[leaf].mean() == pytest.approx(plain.color[leaf].mean(), rel=0.01)
    assert lighting.unlit[leaf].mean() > 0.2


def test_mirrors_keep_the_light_that_shows_in_them(mi: ModuleType) -> None:
    floor = {**world(mi)["floor"], "bsdf": {"type": "conductor", "material": "none"}}
    place = mi.ScalarTransform4f().look_at([-0.3, 1.3, 4.0], [0.03, 0.0, 1.0], [0, 1, 0])
    scene = mi.load_dict(world(mi, floor=floor, lamp={**lamp(mi), "to_world": place}))
    samples, lighting = trace(scene)
    plain = render(scene, spp=8, shading_spp=1)
    assert not lighting.direct(samples, 0).any()
    np.testing.assert_allclose(lighting.unlit, plain.color, rtol=1e-4, atol=1e-5)
    assert lighting.unlit.max() > 10


def test_blocks_of_samples_change_nothing(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mi.load_dict(world(mi, ball=ball()))
    _, whole = trace(scene)
    monkeypatch.setattr("fewrays.sources.mitsuba_tracer._MAX_LIT", 1000)
    _, parts = trace(scene)
    for name in whole.lights[0].field_names():
        np.testing.assert_array_equal(getattr(whole.lights[0], name), getattr(parts.lights[0], name))
    np.testing.assert_array_equal(whole.depth_gradient, parts.depth_gradient)


def turning(mi: ModuleType) -> dict[str, Any]:
    place = mi.ScalarTransform4f().translate(LAMP).scale(1.2) @ mi.ScalarTransform4f().translate(
        [-x for x in LAMP]
    )
    return {"motion": {"lamp": place}}


def in_fog(mi: ModuleType) -> dict[str, Any]:
    fog = {"type": "homogeneous", "albedo": 0.5}
    return world(mi, cloud={**ball(), "bsdf": {"type": "null"}, "interior": fog})


@pytest.mark.parametrize(
    ("scene", "options", "field", "message"),
    [
        (lambda mi: world(mi, lamp=None), {}, "lighting", "no rectangle and no disc"),
        (
            lambda mi: world(mi, lamp={**ball(), "emitter": {"type": "area"}}),
            {},
            "lighting",
            "leave lighting out",
        ),
        (in_fog, {}, "lighting", "media"),
        (world, {"max_depth": 1}, "max_depth", "at least 2"),
        (world, {"integrator": {"type": "volpath"}}, "integrator", "'path'"),
        (world, {"integrator": {"type": "path", "hide_emitters": True}}, "integrator", "hide_emitters"),
        (world, turning, "motion['lamp']", "can only be shifted"),
    ],
)
def test_what_cannot_be_lit_is_named(
    mi: ModuleType, scene: Callable[[ModuleType], Any], options: Any, field: str, message: str
) -> None:
    given = options(mi) if callable(options) else options
    with pytest.raises(SampleError, match=message) as caught:
        trace(scene(mi), **given)
    assert caught.value.field == field
