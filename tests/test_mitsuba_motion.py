"""Moving Mitsuba scenes: motion vectors against analytic geometry, slices of time against still scenes."""

from __future__ import annotations

import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import SampleBuffer, SampleError
from fewrays.sources.mitsuba import render
from fewrays.sources.mitsuba_camera import Camera
from fewrays.sources.mitsuba_tracer import Tracer

EYE, TARGET, UP = [0.4, 0.9, -2.0], [0.1, 0.2, 1.0], [0.1, 1.0, 0.2]
WIDTH, HEIGHT, FOV = 40, 28, 45.0
OFFSET = (0.1, -0.07)  # of the principal point, in widths and heights, towards the upper left

Array = npt.NDArray[np.float64]


def world(mi: ModuleType, **parts: Any) -> dict[str, Any]:
    """Return a scene under one distant light, whose direct light is free of noise."""
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": {
            "type": "perspective",
            "fov": FOV,
            "principal_point_offset_x": OFFSET[0],
            "principal_point_offset_y": OFFSET[1],
            "to_world": mi.ScalarTransform4f().look_at(EYE, TARGET, UP),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
        },
        "sun": {"type": "directional", "direction": [0.3, -0.5, 1.0]},
        **parts,
    }


def trace(scene: Any, **options: Any) -> SampleBuffer:
    lens = {"lens_radius": 0.15, "focus_distance": 2.5}
    return render(scene, **{"spp": 8, "shading_spp": 1, "time_slices": 4, **lens, **options})


def affine(shift: tuple[float, float, float] = (0, 0, 0), degrees: float = 0.0, scale: float = 1.0) -> Array:
    """Return the transform that turns about z, scales and shifts."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    result = np.eye(4)
    result[:3, :3] = scale * np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    result[:3, 3] = shift
    return result


def between(end: Array, time: float) -> Array:
    """Return the map that every point undergoes by a time, when all travel straight."""
    return np.asarray((1 - time) * np.eye(4) + time * end)


def homogeneous(points: Array) -> Array:
    """Return (x w, y w, w) of world positions (N, 3) as the lens centre sees them, without Mitsuba."""
    forward = np.subtract(TARGET, EYE) / np.linalg.norm(np.subtract(TARGET, EYE))
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    x, y, w = ((points - EYE) @ axis for axis in (right, np.cross(forward, right), forward))
    pixels = 0.5 * WIDTH / math.tan(math.radians(FOV) / 2)
    middle = [WIDTH * (0.5 - OFFSET[0]), HEIGHT * (0.5 - OFFSET[1])]
    return np.stack([pixels * x + middle[0] * w, pixels * y + middle[1] * w, w], axis=-1)


def seen_from_centre(samples: SampleBuffer, where: npt.NDArray[np.bool_]) -> Array:
    """Return (x w, y w, w) of samples at their own times."""
    depth = samples.depth[where].astype(np.float64)[:, None]
    centre = samples.xy[where] - samples.slope()[where][:, None] * samples.uv[where]
    return np.concatenate([centre * depth, depth], axis=-1)


def soup_of_positions(mi: ModuleType) -> tuple[Any, Array]:
    """Slanted triangles that glow in the colour of their world position plus 4, and their vertices."""
    rng = np.random.default_rng(8)
    corners = rng.uniform(-0.8, 0.8, (50, 1, 3)) + rng.normal(0, 0.4, (50, 3, 3))
    corners = np.concatenate([corners, corners[:, ::-1]])  # area lights glow on one side
    properties = mi.Properties()
    properties["emitter"] = mi.load_dict(
        {"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_color"}}
    )
    mesh = mi.Mesh("soup", 3 * len(corners), len(corners), props=properties)
    mesh.add_attribute("vertex_color", 3, (corners + 4).astype(np.float32).ravel())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.astype(np.float32).ravel()
    parameters["faces"] = np.arange(3 * len(corners), dtype=np.uint32)
    parameters.update()
    return mesh, corners.reshape(-1, 3)


@pytest.mark.parametrize("form", ["transform", "Mitsuba's transform", "vertices"])
def test_motion_is_the_change_of_the_homogeneous_position(mi: ModuleType, form: str) -> None:
    mesh, vertices = soup_of_positions(mi)
    turn = affine((0.3, -0.2, 0.4), degrees=25, scale=1.1)
    ends: dict[str, Any] = {
        "transform": turn,
        "Mitsuba's transform": mi.ScalarTransform4f(turn),
        "vertices": vertices @ turn[:3, :3].T + turn[:3, 3],
    }
    samples = trace(world(mi, soup=mesh), motion={"soup": ends[form]}, spp=16, max_depth=1)
    assert samples.time is not None and samples.motion is not None
    hit = samples.color[..., 0] > 0
    assert 0.2 < hit.mean() < 0.999

    first = samples.color[hit].astype(np.float64) - 4  # the colour sticks to the point
    start, end = homogeneous(first), homogeneous(first @ turn[:3, :3].T + turn[:3, 3])
    np.testing.assert_allclose(samples.motion[hit], end - start, atol=2e-3)
    assert np.abs(samples.motion[hit] / samples.depth[hit][:, None]).max() > 5  # pixels
    now = start + samples.time[hit][:, None] * (end - start)
    np.testing.assert_allclose(samples.depth[hit], now[:, 2], rtol=1e-5)
    np.testing.assert_allclose(seen_from_centre(samples, hit), now, atol=4e-3)
    assert np.all(samples.motion[samples.depth > 100] == 0)


def test_reprojected_samples_lie_on_the_object_as_traced_at_that_time(mi: ModuleType) -> None:
    shift = (0.35, 0.2, -0.3)
    centre = np.array([0.0, 0.2, 0.6])
    ball = {"type": "sphere", "center": centre.tolist(), "radius": 0.5}
    samples = trace(world(mi, ball=ball), motion={"ball": affine(shift)})
    assert samples.time is not None and samples.motion is not None
    hit = samples.depth < 10
    assert hit.mean() > 0.05
    rest = np.asarray(1 - samples.time[hit], np.float64)[:, None]
    end = seen_from_centre(samples, hit) + rest * samples.motion[hit]

    moved = {**ball, "center": (centre + shift).tolist()}
    scene = mi.load_dict(world(mi, ball=moved))
    camera = Camera.of(mi, scene, 0, None, None, 0.15, 2.5)
    xy = (end[:, :2] / end[:, 2:]).astype(np.float32)
    origin, direction = camera.rays(xy, np.zeros_like(xy))
    found = scene.ray_intersect(mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(direction.T)))
    depth = camera.near + np.array(found.t)
    cosine = -np.einsum("ck,kc->k", np.array(found.n), direction / np.linalg.norm(direction, axis=1)[:, None])
    front = np.isfinite(depth) & (cosine > 0.15)  # other points may have gone round the edge by then
    assert front.mean() > 0.8
    np.testing.assert_allclose(end[front, 2], depth[front], rtol=2e-3)
    assert np.abs(depth[front] - samples.depth[hit][front]).mean() > 0.05


SHIFT = affine((0.3, 0.1, -0.2))
ENDS = {
    "sphere": affine((0.3, 0, 0.1), scale=1.2),
    "disk": SHIFT,
    "rectangle": SHIFT,
    "cube": affine((0.2, 0, 0), degrees=40, scale=0.9),
    "instance": affine((0.2, 0.1, 0), degrees=30),
}


def things(mi: ModuleType, time: float) -> dict[str, Any]:
    """Return a shape of each kind, at a time of their motion, and an instance that rests."""
    to_world = mi.ScalarTransform4f
    parts: dict[str, Any] = {"group": {"type": "shapegroup", "cube": {"type": "cube"}}}
    group = {"type": "ref", "id": "group"}
    for i, (kind, end) in enumerate(ENDS.items()):
        place = to_world().translate([0.9 - 0.45 * i, 0.3 * (-1) ** i, 0.7]).rotate([1, 2, 0], 30).scale(0.35)
        pose = to_world(between(end, time) @ np.array(place.matrix))
        parts[kind] = {"type": kind, "to_world": pose, **({"of": group} if kind == "instance" else {})}
    parts["rests"] = {"type": "instance", "to_world": to_world().translate([0, 0, 4]), "of": group}
    return parts


def test_each_slice_shows_the_scene_as_it_is_at_that_time(mi: ModuleType) -> None:
    moving = trace(world(mi, **things(mi, 0)), motion=ENDS, time_slices=3, background_depth=1e3)
    assert moving.time is not None and moving.motion is not None
    for time in (1 / 6, 1 / 2, 5 / 6):
        still = trace(world(mi, **things(mi, time)), background_depth=1e3)
        now = np.abs(moving.time - time) < 1e-6
        assert now.mean() > 0.2
        # Rays that graze an edge may fall on either side of it.
        same = np.isclose(moving.depth, still.depth, rtol=1e-4) & now
        assert same.sum() > 0.998 * now.sum()
        np.testing.assert_allclose(moving.color[same], still.color[same], rtol=5e-3, atol=2e-4)
        assert np.mean(moving.depth[~now] == still.depth[~now]) < 0.9  # it is another picture
    depth = moving.depth
    assert np.all(moving.motion[(depth > 100) | (depth > 4.5)] == 0)
    assert np.all(moving.motion[depth < 3.7].any(axis=-1))


def test_without_motion_nothing_changes(mi: ModuleType) -> None:
    parts = {"ball": {"type": "sphere"}, "cube": {"type": "cube"}}
    still = trace(world(mi, **parts), seed=3)
    empty = trace(world(mi, **parts), seed=3, motion={})
    assert still.field_names() == empty.field_names() == ("xy", "uv", "depth", "color")
    for name in still.field_names():
        np.testing.assert_array_equal(getattr(still, name), getattr(empty, name))

    rests = trace(world(mi, **parts), seed=3, motion={"ball": np.eye(4), "cube": np.eye(4)})
    assert rests.motion is not None and not rests.motion.any()
    for name in ("xy", "uv", "depth"):
        np.testing.assert_array_equal(getattr(still, name), getattr(rests, name))
    np.testing.assert_allclose(rests.color, still.color, rtol=1e-4, atol=1e-5)


def test_times_are_middles_of_slices_and_spread_over_every_pixel(mi: ModuleType) -> None:
    ball = {"type": "sphere"}
    samples = trace(world(mi, ball=ball), motion={"ball": SHIFT}, time_slices=8)
    assert samples.time is not None
    middles = np.tile((np.arange(8) + 0.5) / 8, (HEIGHT, WIDTH, 1))
    np.testing.assert_allclose(np.sort(samples.time, axis=-1), middles, rtol=1e-6)
    assert np.mean(samples.time[:, 1:] == samples.time[:, :-1]) < 0.3  # no pixel is like its neighbour

    finer = trace(world(mi, ball=ball), motion={"ball": SHIFT}, spp=4, time_slices=64)
    assert finer.time is not None
    slices = finer.time * 64 - 0.5
    np.testing.assert_allclose(slices, np.round(slices), atol=1e-4)
    assert len(np.unique(slices)) == 64
    np.testing.assert_array_equal(np.sort(finer.time * 4 // 1, axis=-1)[0, 0], [0, 1, 2, 3])


def test_the_scene_is_left_as_it_was(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = {"ball": {"type": "sphere", "center": [1, 0, 2]}, "cube": {"type": "cube"}}
    scene = mi.load_dict(world(mi, **parts), optimize=False)
    before = trace(scene)
    motion = {"ball": SHIFT, "cube": affine((0.5, 0, 0), 30)}
    first, again = (trace(scene, motion=motion, seed=2, time_slices=4) for _ in range(2))
    for name in first.field_names():
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))

    def fail(*_: Any) -> Any:
        raise RuntimeError("no more")

    with monkeypatch.context() as patch, pytest.raises(RuntimeError, match="no more"):
        patch.setattr(Tracer, "_trace_batch", fail)
        trace(scene, motion=motion)
    after = trace(scene)
    for name in before.field_names():
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


def test_background_stays_behind_what_moves_away(mi: ModuleType) -> None:
    ball = {"type": "sphere", "radius": 0.3}
    samples = trace(world(mi, ball=ball), motion={"ball": affine((0, 0, 500))}, time_slices=2)
    assert samples.motion is not None
    background = samples.depth[~samples.motion.any(axis=-1)]
    assert len(np.unique(background)) == 1
    assert background[0] > 1e5
    with pytest.raises(SampleError, match="where the scene ends"):
        trace(world(mi, ball=ball), motion={"ball": affine((0, 0, 500))}, background_depth=100.0)


def test_meshes_of_one_material_keep_their_names(mi: ModuleType, tmp_path: Path) -> None:
    cubes = "".join(
        f'<shape type="cube" id="{name}"><transform name="to_world"><scale value="0.3"/>'
        f'<translate x="{x}"/></transform><ref id="matte"/></shape>'
        for name, x in (("left", 0.5), ("right", -0.5))
    )
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"><float name="fov" '
        'value="45"/><transform name="to_world"><translate z="-3"/></transform><film type="hdrfilm"><integer '
        'name="width" value="24"/><integer name="height" value="16"/></film></sensor><emitter type="constant"'
        f'/><bsdf type="diffuse" id="matte"/>{cubes}</scene>'
    )
    samples = trace(path, motion={"left": SHIFT})
    assert samples.motion is not None
    hit, moves = samples.depth < 10, np.abs(samples.motion).max(axis=-1) > 0
    x = samples.xy[..., 0]  # to the right, unlike Mitsuba's
    assert np.mean(moves[hit & (x < 11)]) > 0.9
    assert not np.any(moves[x > 13])
    with pytest.raises(SampleError, match="optimize=False") as caught:
        trace(mi.load_file(str(path)), motion={"left": SHIFT})
    assert caught.value.field == "motion['left']"


@pytest.mark.parametrize(
    ("name", "end", "message"),
    [
        ("nothing", np.eye(4), "no such shape; it has ball, cube"),
        ("cube", np.eye(3)[:2], "24 vertices, got positions of shape"),
        ("cube", np.eye(4)[:, :2], "expected a 4 x 4 transform or positions"),
        ("cube", "left", "expected a 4 x 4 transform"),
        ("cube", np.full((4, 4), np.nan), "finite"),
        ("cube", np.ones((4, 4)), "affine"),
        ("cube", np.diag([1.0, 1, 0, 1]), "flattens"),
        ("ball", np.zeros((8, 3)), "Sphere has no vertices"),
        ("ball", affine(degrees=30), "shifted or scaled evenly"),
    ],
)
def test_motions_that_cannot_be_used(mi: ModuleType, name: str, end: Any, message: str) -> None:
    parts = {"ball": {"type": "sphere"}, "cube": {"type": "cube"}}
    with pytest.raises(SampleError, match=message) as caught:
        trace(world(mi, **parts), motion={name: end})
    assert caught.value.field == f"motion[{name!r}]"


@pytest.mark.parametrize("slices", [0, 2**17])
def test_bad_time_slices_are_named(mi: ModuleType, slices: int) -> None:
    with pytest.raises(SampleError) as caught:
        trace(world(mi), time_slices=slices)
    assert caught.value.field == "time_slices"
