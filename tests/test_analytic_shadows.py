"""Lit scenes against geometry: samples are where they say that they are, and their means are the truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fewrays import SampleBuffer, SampleError, reconstruct
from fewrays.sources.analytic_shadows import (
    Ball,
    Bars,
    Camera,
    Column,
    Disc,
    HalfPlane,
    Lamp,
    Scene,
    Sheet,
    aimed,
    box,
    render_lit,
    true_image,
    true_radiance,
)
from shadow_scenes import level

Floats = npt.NDArray[np.float64]

FLOOR = level(0, albedo=(0.8, 0.5, 0.2))
WALL = Sheet((0, 0, -1.5), (0, 0, 1), (1, 0, 0))
CAMERA = Camera(9, 12, position=(1, 3, 4), target=(0, 0.3, 0))
LAMP = aimed((-1, 3, 1), (0, 0, 0), (0.5, 0.3), radiance=(10.0, 8.0, 6.0))
ROUND = aimed((-1, 3, 1), (0, 0, 0), (0.5, 0.5), "disc", radiance=(10.0, 8.0, 6.0))
CROWD = [
    FLOOR,
    WALL,
    Ball((-0.7, 0.5, 0.2), 0.5),
    Column((1.0, 0, -0.6), (0, 1, 0), 0.2),
    *box((0.4, 0, 0.5), (0.3, 0.2), 0.6, turn=30),
    level(1.4, Bars(3, 0.4), seen=False),
]
MOVING = [
    FLOOR,
    replace(CROWD[2], motion=(0.6, 0.1, -0.2)),
    Sheet((0, 1.4, 0), (0.1, 1, 0), (1, -0.1, 0), Disc((0, 0), 0.4), motion=(0.3, 0, 0.3), seen=False),
]
SCENES = {
    "still": Scene(CAMERA, CROWD, [LAMP]),
    "two lamps": Scene(replace(CAMERA, lens_radius=0.2), CROWD, [ROUND, LAMP], unlit=(0.1, 0.0, 0.2)),
    "moving": Scene(CAMERA, MOVING, [LAMP]),
    "moving lamp": Scene(
        replace(CAMERA, lens_radius=0.1),
        MOVING,
        [aimed((-1, 3, 1), (0, 0, 0), (0.5, 0.5), "disc", motion=(0.6, 0, 0), radiance=(9, 9, 9))],
    ),
}


def seen_at(samples: SampleBuffer) -> Floats:
    """Where the lens centre sees samples, in pixels."""
    depth = samples.depth.astype(np.float64)
    return np.asarray(samples.xy - samples.lens.slope(depth)[..., None] * samples.uv)


def times_of(samples: SampleBuffer) -> Floats:
    shape = samples.depth.shape
    return np.zeros(shape) if samples.time is None else samples.time.astype(np.float64)


def points_of(scene: Scene, samples: SampleBuffer) -> Floats:
    """What samples have hit, in world space."""
    assert samples.lighting is not None
    at = samples.lighting.points(samples)
    return np.asarray(at @ scene.camera.axes + np.asarray(scene.camera.position))


def light_hits(scene: Scene, samples: SampleBuffer, lamp: int) -> Floats:
    """What light samples have hit, in world space."""
    assert samples.lighting is not None
    rays = samples.lighting.lights[lamp]
    at = rays.light.hits(rays.lxy, rays.luv, rays.depth, times_of(samples))
    return np.asarray(at @ scene.camera.axes + np.asarray(scene.camera.position))


def gap(scene: Scene, points: Floats, times: Floats) -> Floats:
    """Distance of points ``(..., 3)`` from the nearest surface, along its normal."""
    nearest = np.full(points.shape[:-1], np.inf)
    for shape in scene.shapes:
        normal = shape.normals(points, times)
        for way in (normal, -normal):
            start = points - 0.01 * way
            nearest = np.minimum(nearest, np.abs(shape.hit(start, way, times) - 0.01))
    return nearest


@pytest.mark.parametrize("name", SCENES)
def test_means_of_many_samples_tend_to_the_true_image(name: str) -> None:
    scene = SCENES[name]
    truth = true_image(scene, rays=32)
    mean = reconstruct(render_lit(scene, 512), "box", shadows=False)
    error = (mean - truth) / truth.max()
    assert np.sqrt(np.square(error).mean()) < 0.01
    assert abs(error.mean()) < 0.001
    assert truth.std() > 0.1 * truth.max()


@pytest.mark.parametrize("name", SCENES)
def test_samples_lie_on_the_shapes(name: str) -> None:
    scene = SCENES[name]
    samples = render_lit(scene, 16)
    points = points_of(scene, samples)
    on_shape = samples.depth < 100
    assert on_shape.mean() > 0.5
    assert gap(scene, points, times_of(samples))[on_shape].max() < 1e-5


@pytest.mark.parametrize("name", SCENES)
def test_light_samples_lie_on_the_shapes_on_their_way_to_the_camera_samples(name: str) -> None:
    scene = SCENES[name]
    samples = render_lit(scene, 16)
    assert samples.lighting is not None
    times, points = times_of(samples), points_of(scene, samples)
    for number, rays in enumerate(samples.lighting.lights):
        there = rays.density > 0
        hits = light_hits(scene, samples, number)
        assert gap(scene, hits, times)[there].max() < 1e-5
        start = scene.lamps[number].light.points(rays.luv, times)
        way, reach = hits - start, points - start
        along = (way * reach).sum(axis=-1) / np.square(reach).sum(axis=-1)
        np.testing.assert_allclose(way[there], (along[..., None] * reach)[there], atol=2e-5)
        assert along[there].max() < 1 + 1e-5
        blocked = along < 1 - 1e-4
        assert 0.05 < blocked[there].mean() < 0.95
        # Nothing is in front of the first hit.
        for shape in scene.shapes:
            assert shape.hit(start, way, times)[there].min() > 1 - 1e-4


@pytest.mark.parametrize("lamp", [LAMP, ROUND, replace(LAMP, light=replace(LAMP.light, motion=(1, 0, 0)))])
def test_without_occluders_depths_are_those_of_the_receivers(lamp: Lamp) -> None:
    scene = Scene(CAMERA, [FLOOR, WALL], [lamp])
    samples = render_lit(scene, 8)
    assert samples.lighting is not None
    (rays,) = samples.lighting.lights
    there = rays.density > 0
    assert there.mean() > 0.5
    local = rays.light.to_light_space(samples.lighting.points(samples), times_of(samples))
    np.testing.assert_allclose(rays.depth[there], local[there][:, 2], rtol=2e-6)
    assert samples.lighting.arrives(samples, 0)[there].all()


@pytest.mark.parametrize("name", ["still", "moving lamp"])
def test_densities_and_depth_gradients_are_finite_differences(name: str) -> None:
    """Follow rays of the lens centre beside each sample to the same shape and from there to the light."""
    scene = replace(SCENES[name], camera=replace(SCENES[name].camera, lens_radius=0.0))
    samples = render_lit(scene, 4)
    assert samples.lighting is not None
    (rays,), camera = samples.lighting.lights, scene.camera
    times, points, step = times_of(samples), points_of(scene, samples), 1e-4
    derivatives = np.full((*times.shape, 2, 3), np.nan)  # of lx, ly and depth along x and y
    for shape in scene.shapes:
        ends = []
        for offset in step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            origin, way = camera.rays(samples.xy + offset, np.zeros_like(samples.xy))
            depth = shape.hit(origin, way, times) if shape.seen else np.full_like(times, np.inf)
            with np.errstate(invalid="ignore"):
                hits = camera.to_camera(origin + depth[..., None] * way)
                lxy, _ = rays.light.project(hits, rays.luv, times)
            ends.append(np.concatenate([lxy, depth[..., None]], axis=-1))
        with np.errstate(invalid="ignore"):
            slopes = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=-2) / (2 * step)
            own = np.abs(0.25 * sum(end[..., 2] for end in ends) - samples.depth) < 1e-3
        derivatives[own] = slopes[own]
    known = np.isfinite(derivatives).all(axis=(-1, -2)) & (rays.density > 0)
    assert known.mean() > 0.6
    # Where round shapes turn away, differences of any size miss the curvature.
    facing = np.abs(
        (samples.lighting.normal * camera.turn(points - np.asarray(camera.position))).sum(axis=-1)
    )
    known &= facing > 0.3
    derivatives = derivatives[known]
    np.testing.assert_allclose(
        samples.lighting.depth_gradient[known], derivatives[..., 2], rtol=1e-3, atol=1e-5
    )
    area = np.abs(np.linalg.det(derivatives[..., :2]))
    np.testing.assert_allclose(rays.density[known], np.sqrt(area), rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("name", ["moving", "moving lamp"])
def test_hits_move_as_their_motion_says(name: str) -> None:
    scene = SCENES[name]
    samples = render_lit(scene, 8)
    assert samples.lighting is not None
    assert samples.motion is not None
    (rays,), camera = samples.lighting.lights, scene.camera
    assert rays.motion is not None
    times, later = times_of(samples), 0.9
    ahead = (later - times)[..., None]

    for hits, motion, seen in (
        (points_of(scene, samples), samples.motion, camera.projection.pixels),
        (light_hits(scene, samples, 0), rays.motion, None),
    ):
        there = (samples.depth < 100) & (rays.density > 0)
        # Which shape was hit: the one whose surface is there.
        moved = np.full_like(hits, np.nan)
        for shape in scene.shapes:
            own = gap(replace(scene, shapes=[shape]), hits, times) < 1e-5
            moved[own] = hits[own] + (ahead * np.asarray(shape.motion))[own]
        now, then = camera.to_camera(hits), camera.to_camera(moved)
        if seen is None:
            seen_now, w_now = rays.light.project(now, (0, 0), times)
            seen_then, w_then = rays.light.project(then, (0, 0), later)
        else:
            seen_now, w_now, seen_then, w_then = seen(now), now[..., 2], seen(then), then[..., 2]
        start = np.concatenate([seen_now * w_now[..., None], w_now[..., None]], axis=-1)
        expected = np.concatenate([seen_then * w_then[..., None], w_then[..., None]], axis=-1)
        assert np.isfinite(expected[there]).all()
        actual = start + ahead * motion
        np.testing.assert_allclose(actual[there], expected[there], rtol=1e-5, atol=1e-4)
        assert np.abs(motion[there]).max() > 0.1


@given(
    position=st.tuples(*[st.floats(-3, 3)] * 3),
    target=st.tuples(*[st.floats(-3, 3)] * 3),
    xy=st.tuples(st.floats(0, 12), st.floats(0, 9)),
    uv=st.tuples(*[st.floats(-0.7, 0.7)] * 2),
    depth=st.floats(0.2, 20),
    focus=st.floats(0.5, 10),
)
def test_rays_of_a_posed_lens(
    position: tuple[float, float, float],
    target: tuple[float, float, float],
    xy: tuple[float, float],
    uv: tuple[float, float],
    depth: float,
    focus: float,
) -> None:
    """A thin lens: rays of an image position meet in focus, and start where its radius says."""
    away = np.subtract(target, position)
    assume(math.hypot(away[0], away[2]) > 0.1)
    camera = Camera(9, 12, position, target, lens_radius=0.3, focus_distance=focus)
    origin, way = camera.rays(np.array(xy), np.array(uv))
    np.testing.assert_allclose(camera.to_camera(origin), [0.3 * uv[0], 0.3 * uv[1], 0], atol=1e-9)
    in_focus = camera.projection.points(xy, focus)
    np.testing.assert_allclose(camera.to_camera(origin + focus * way), in_focus, atol=1e-9)
    centre = np.array(xy) - camera.lens.slope(depth) * np.array(uv)
    seen = camera.projection.points(centre, depth)
    np.testing.assert_allclose(camera.to_camera(origin + depth * way), seen, atol=1e-8)


def test_cameras_and_lights_keep_the_hand_of_space() -> None:
    camera = Camera(9, 12, (0, 2, 5), (0, 2, 0))
    np.testing.assert_allclose(camera.axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-15)
    assert np.linalg.det(CAMERA.axes) == pytest.approx(1)
    seen = CAMERA.see_light(LAMP.light)
    np.testing.assert_allclose(seen.normal, CAMERA.turn(LAMP.light.normal), atol=1e-12)
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(
        seen.to_light_space(CAMERA.to_camera(points)), LAMP.light.to_light_space(points), atol=1e-12
    )
    np.testing.assert_allclose(LAMP.light.normal, np.array([1, -3, -1]) / math.sqrt(11), atol=1e-12)


def test_what_sees_no_light_has_no_light_sample() -> None:
    """The background, and what lies behind the lamp."""
    lamp = aimed((0, 1, 0), (-1, 1, 0), (0.2, 0.2))
    backdrop = Sheet((0, 0, -1), (0, 0, 1), (1, 0, 0), HalfPlane((0, 2), (0, -1)))
    scene = Scene(Camera(16, 16, (0, 1, 4), (0, 1.5, 0)), [backdrop], [lamp], unlit=(0.25, 0.5, 1.0))
    samples = render_lit(scene, 4)
    assert samples.lighting is not None
    (rays,) = samples.lighting.lights
    nothing = samples.depth > 100
    behind = (points_of(scene, samples)[..., 0] > 1e-6) & ~nothing
    assert 0.1 < nothing.mean() < 0.9
    assert behind.mean() > 0.1
    np.testing.assert_array_equal(rays.density == 0, nothing | behind)
    np.testing.assert_array_equal(samples.color[nothing | behind], samples.lighting.unlit[nothing | behind])
    np.testing.assert_array_equal(samples.lighting.normal[nothing], np.tile([0, 0, -1], (nothing.sum(), 1)))
    assert not samples.lighting.depth_gradient[nothing].any()
    assert (samples.color[~(nothing | behind)] > samples.lighting.unlit[~(nothing | behind)]).any()


def test_light_points_are_stratified_over_the_lamp_in_every_pixel() -> None:
    samples = render_lit(Scene(CAMERA, [FLOOR], [LAMP, LAMP]), 16)
    assert samples.lighting is not None
    first, second = (np.floor(2 * (rays.luv + 1)) for rays in samples.lighting.lights)
    for cells in (first, second):
        cell = cells[..., 0] * 4 + cells[..., 1]
        np.testing.assert_array_equal(np.sort(cell), np.broadcast_to(np.arange(16), cell.shape))
    assert (first != second).any()


def test_seeds() -> None:
    scene = SCENES["moving lamp"]
    first, again, other = (render_lit(scene, 2, seed=seed) for seed in (3, 3, 4))
    assert first.lighting is not None
    assert again.lighting is not None
    assert other.lighting is not None
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.lighting.lights[0].luv, again.lighting.lights[0].luv)
    assert (first.lighting.lights[0].luv != other.lighting.lights[0].luv).any()


def test_radiance_of_points_is_light_times_albedo() -> None:
    """Under a disc of radius R at height h: albedo times radiance times R² / (R² + h²), on its axis."""
    lamp = aimed((0, 2, 0), (0, 0, 0), (1, 1), "disc", radiance=(5, 10, 20))
    up, origin = np.array([[0.0, 1.0, 0.0]]), np.zeros((1, 3))
    lit = true_radiance(Scene(CAMERA, [FLOOR], [lamp]), origin, up, FLOOR.albedo)
    np.testing.assert_allclose(lit[0], np.array([5, 10, 20]) * FLOOR.albedo / 5, rtol=1e-4)


def test_bad_scenes() -> None:
    with pytest.raises(SampleError, match=r"^lamps: "):
        Scene(CAMERA, [FLOOR], [])
    with pytest.raises(SampleError, match=r"^shapes: "):
        Scene(CAMERA, [], [LAMP])
    with pytest.raises(SampleError, match=r"^up: .*optical axis"):
        Camera(4, 4, (0, 3, 0), (0, 0, 0))
    with pytest.raises(SampleError, match=r"^target: "):
        Camera(4, 4, (0, 3, 0), (0, 3, 0))
    with pytest.raises(SampleError, match=r"^tolerance: .*-1"):
        true_image(SCENES["still"], tolerance=-1.0)
