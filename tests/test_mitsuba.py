"""Samples from Mitsuba: rays, depths and positions against analytic geometry, radiance against Mitsuba."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import Lens, SampleBuffer, SampleError
from fewrays.lens import Sampling
from fewrays.sources import mitsuba_tracer
from fewrays.sources.mitsuba import lens_of, render
from fewrays.sources.mitsuba_camera import Camera

EYE, TARGET, UP = [0.4, 0.9, -2.0], [0.1, 0.2, 1.0], [0.1, 1.0, 0.2]
WIDTH, HEIGHT = 40, 28


def sensor(mi: ModuleType, kind: str = "thinlens", **changes: Any) -> dict[str, Any]:
    lens = {"aperture_radius": 0.15, "focus_distance": 2.5} if kind == "thinlens" else {}
    return {
        "type": kind,
        "fov": 45,
        "to_world": mi.ScalarTransform4f().look_at(EYE, TARGET, UP),
        "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
        **lens,
        **changes,
    }


def world(mi: ModuleType, camera: dict[str, Any] | None = None, **parts: Any) -> Any:
    content = {"integrator": {"type": "path", "max_depth": 2}, "sensor": camera or sensor(mi), **parts}
    return mi.load_dict({"type": "scene", **content})


def spheres(mi: ModuleType) -> Any:
    """Glowing and lit spheres in front of, in and behind the focal plane, in front of a bright sky."""
    parts: dict[str, Any] = {"sky": {"type": "constant", "radiance": 0.3}}
    for i, (centre, radius) in enumerate(
        (([0.5, 0.5, -0.6], 0.15), ([0, 0.2, 0.6], 0.3), ([-0.5, 0, 2.5], 0.7))
    ):
        parts[f"sphere{i}"] = {"type": "sphere", "center": centre, "radius": radius}
    parts["sphere0"]["emitter"] = {"type": "area", "radiance": 2.0}
    return world(mi, **parts)


def soup_of_positions(mi: ModuleType) -> Any:
    """Slanted triangles that emit their own world position, plus 4, as colour."""
    rng = np.random.default_rng(8)
    corners = rng.uniform(-1, 1, (60, 1, 3)) * [1.5, 1.2, 1.5] + rng.normal(0, 0.6, (60, 3, 3))
    corners = corners[(corners[..., 2] > -1.2).all(axis=1) & (corners[..., 2] < 3).all(axis=1)]
    count = len(corners)
    properties = mi.Properties()
    properties["emitter"] = mi.load_dict(
        {"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_color"}}
    )
    properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse"}})
    mesh = mi.Mesh("soup", 3 * count, 2 * count, props=properties)
    mesh.add_attribute("vertex_color", 3, (corners + 4).astype(np.float32).ravel())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = corners.astype(np.float32).ravel()
    front = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
    parameters["faces"] = np.concatenate([front, front[:, ::-1]]).ravel()  # area lights glow on one side
    parameters.update()
    return world(mi, mesh=mesh)


def camera_frame() -> tuple[npt.NDArray[np.float64], ...]:
    """Return the unit vectors right, down and forward of the picture, without Mitsuba."""
    forward = np.subtract(TARGET, EYE)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, UP)
    right = right / np.linalg.norm(right)
    return right, np.cross(forward, right), forward


@pytest.mark.parametrize("fov_axis", ["x", "y", "diagonal", "smaller", "larger"])
@pytest.mark.parametrize("kind", ["thinlens", "perspective"])
@pytest.mark.parametrize("cropped", [False, True])
def test_rays_are_those_of_mitsubas_own_sensors(
    mi: ModuleType, kind: str, fov_axis: str, cropped: bool
) -> None:
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT}
    if cropped:
        film |= {"crop_offset_x": 7, "crop_offset_y": 3, "crop_width": 20, "crop_height": 12}
    changes: dict[str, Any] = {"fov_axis": fov_axis, "film": film, "near_clip": 0.3, "far_clip": 50.0}
    if kind == "perspective":
        changes |= {"principal_point_offset_x": 0.1, "principal_point_offset_y": -0.07}
    scene = world(mi, sensor(mi, kind, **changes))
    camera = Camera.of(mi, scene, 0, None, None, None, None)

    rng = np.random.default_rng(1)
    position, aperture = rng.random((2, 500, 2)).astype(np.float32)
    expected, _ = scene.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(position.T), mi.Point2f(aperture.T))
    lens = np.array(mi.warp.square_to_uniform_disk_concentric(mi.Point2f(aperture.T))).T
    uv = -lens if kind == "thinlens" else 0 * lens  # Mitsuba's camera space has x to the left and y up
    origin, direction = camera.rays((position * [camera.width, camera.height]).astype(np.float32), uv)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    np.testing.assert_allclose(origin, np.array(expected.o).T, atol=2e-6)
    np.testing.assert_allclose(unit, np.array(expected.d).T, atol=1e-6)


@pytest.mark.parametrize("focus", [1.2, 2.5, math.inf])
@pytest.mark.parametrize("sampling", ["disc", "square", "gaussian"])
def test_hits_project_to_where_the_convention_says(mi: ModuleType, sampling: Sampling, focus: float) -> None:
    samples = render(
        soup_of_positions(mi), spp=16, sampling=sampling, focus_distance=focus, shading_spp=1, max_depth=1
    )
    hit = samples.color[..., 0] > 0
    assert 0.3 < hit.mean() < 0.999
    position = samples.color[hit].astype(np.float64) - 4 - EYE
    x, y, depth = (position @ axis for axis in camera_frame())
    np.testing.assert_allclose(samples.depth[hit], depth, rtol=5e-6, atol=5e-6)

    pixels = 0.5 * WIDTH / math.tan(math.radians(45) / 2)
    pinhole = np.stack([pixels * x / depth + WIDTH / 2, pixels * y / depth + HEIGHT / 2], axis=-1)
    centre = samples.xy[hit] - samples.slope()[hit][:, None] * samples.uv[hit]
    assert np.abs(samples.slope()[hit]).max() > 2  # the lens matters: a wrong sign cannot pass
    np.testing.assert_allclose(centre, pinhole, atol=1e-3)
    assert samples.lens.sampling == sampling


def test_mean_of_samples_equals_mitsubas_image(mi: ModuleType) -> None:
    scene = spheres(mi)
    batches = [render(scene, spp=16, seed=seed, shading_spp=1).color.mean(axis=2) for seed in range(24)]
    mean, error = np.mean(batches, axis=0), np.std(batches, axis=0, ddof=1) / math.sqrt(len(batches))
    expected = [np.array(mi.render(scene, spp=256, seed=seed)) for seed in range(100, 108)]
    expected_error = np.std(expected, axis=0, ddof=1) / math.sqrt(len(expected))
    z = (mean - np.mean(expected, axis=0)) / np.sqrt(error**2 + expected_error**2 + 1e-6)
    assert np.mean(z**2) < 1.4
    assert np.abs(z).max() < 6
    assert abs(z.mean()) < 0.2
    assert np.std(np.mean(expected, axis=0)) > 0.1  # there is something to see


def test_background_is_finite_and_behind_everything(mi: ModuleType) -> None:
    scene = spheres(mi)
    samples = render(scene, spp=4, shading_spp=1)
    hit = samples.depth < 10
    assert 0.1 < hit.mean() < 0.9
    assert len(np.unique(samples.depth[~hit])) == 1
    np.testing.assert_allclose(samples.slope()[~hit], samples.lens.c1, rtol=2e-3)
    np.testing.assert_allclose(samples.color[~hit], 0.3, rtol=1e-5)

    nearer = render(scene, spp=4, shading_spp=1, background_depth=40.0)
    np.testing.assert_array_equal(nearer.depth, np.where(hit, samples.depth, np.float32(40)))


def test_shading_paths_are_averaged_along_the_same_ray(mi: ModuleType) -> None:
    scene = spheres(mi)
    noisy, calm = (render(scene, spp=8, shading_spp=n, seed=3) for n in (1, 36))
    for name in ("xy", "uv", "depth"):
        np.testing.assert_array_equal(getattr(noisy, name), getattr(calm, name))
    lit = (noisy.depth < 10) & (noisy.color[..., 0] < 1.9)
    difference = (noisy.color - calm.color)[lit][:, 0]
    assert abs(difference.mean()) < 4 * difference.std() / math.sqrt(difference.size)
    again = render(scene, spp=8, shading_spp=36, seed=4)
    assert np.var(calm.color[lit]) < np.var(noisy.color[lit])
    assert again.color.shape == calm.color.shape


def test_same_seed_same_samples(mi: ModuleType) -> None:
    scene = spheres(mi)
    first, again, other = (render(scene, spp=2, shading_spp=2, seed=seed) for seed in (5, 5, 6))
    for name in first.field_names():
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert np.mean(first.uv == other.uv) < 0.01
    assert not np.array_equal(first.color, other.color)


def test_batches_change_nothing_but_the_noise(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = spheres(mi)
    whole = render(scene, spp=4, shading_spp=4)
    monkeypatch.setattr(mitsuba_tracer, "_MAX_PATHS", 3000)
    parts = render(scene, spp=4, shading_spp=4)
    for name in ("xy", "uv", "depth"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    assert whole.color.mean() == pytest.approx(parts.color.mean(), rel=0.02)


def test_perspective_sensor_is_a_pinhole_until_it_gets_a_lens(mi: ModuleType) -> None:
    scene = world(mi, sensor(mi, "perspective"), ball={"type": "sphere"})
    assert not render(scene, spp=1, shading_spp=1).slope().any()
    lens = lens_of(
        scene, lens_radius=0.15, focus_distance=2.5, aperture="gaussian", sampling="square", sigma=0.4
    )
    expected = Lens.thin_lens(
        WIDTH, fov=45, lens_radius=0.15, focus_distance=2.5, aperture="gaussian", sampling="square", sigma=0.4
    )
    assert lens.c0 == pytest.approx(expected.c0)
    assert lens.c1 == pytest.approx(expected.c1)
    assert (lens.aperture, lens.sampling, lens.sigma) == ("gaussian", "square", 0.4)


def test_size_overrides(mi: ModuleType) -> None:
    scene = spheres(mi)
    samples = render(scene, width=2 * WIDTH, spp=1, shading_spp=1, lens_radius=0.3)
    assert (samples.width, samples.height) == (2 * WIDTH, 2 * HEIGHT)
    assert samples.lens.c1 == pytest.approx(4 * lens_of(scene).c1)
    assert render(scene, height=14, spp=1, shading_spp=1).width == 20
    assert render(scene, width=9, height=30, spp=1, shading_spp=1).depth.shape == (30, 9, 1)


def test_scenes_from_files_and_dictionaries(mi: ModuleType, tmp_path: Path) -> None:
    content = {
        "type": "scene",
        "integrator": {"type": "path"},
        "sensor": sensor(mi),
        "light": {"type": "constant"},
    }
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><integrator type="path"/><sensor type="thinlens">'
        '<float name="fov" value="45"/>'
        '<float name="aperture_radius" value="0.15"/><float name="focus_distance" value="2.5"/>'
        '<film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="28"/></film>'
        '</sensor><emitter type="constant"/></scene>'
    )
    for scene in (content, path, str(path)):
        samples = render(scene, spp=1, shading_spp=1)
        np.testing.assert_allclose(samples.color, 1, rtol=1e-5)
        assert samples.lens == lens_of(content)


def test_callers_variant_is_left_alone(mi: ModuleType) -> None:
    active = mi.variant()
    try:
        mi.set_variant("scalar_rgb")
        assert lens_of({"type": "scene", "sensor": {"type": "thinlens", "aperture_radius": 0.1}}).c0 < 0
        assert mi.variant() == "scalar_rgb"
        with pytest.raises(SampleError, match="loaded under scalar_rgb") as caught:
            render(mi.load_dict({"type": "scene", "sensor": {"type": "perspective"}}))
        assert caught.value.field == "scene"
        assert mi.variant() == "scalar_rgb"
    finally:
        mi.set_variant(active)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"spp": 0}, "spp"),
        ({"spp": 2**20, "width": 10_000}, "spp"),
        ({"width": 0}, "width"),
        ({"height": 2**20, "width": 8}, "height"),
        ({"shading_spp": 0}, "shading_spp"),
        ({"lens_radius": -1.0}, "lens_radius"),
        ({"focus_distance": 0.0}, "focus_distance"),
        ({"focus_distance": math.nan}, "focus_distance"),
        ({"aperture": "hexagon"}, "lens.aperture"),
        ({"sampling": "hexagon"}, "lens.sampling"),
        ({"sigma": 0.0}, "lens.sigma"),
        ({"seed": -1}, "seed"),
        ({"sensor": 1}, "sensor"),
        ({"max_depth": 0}, "max_depth"),
        ({"max_depth": 2, "integrator": {"type": "path"}}, "max_depth"),
        ({"integrator": {"type": "ptracer"}}, "integrator"),
        ({"integrator": {"type": "prb"}}, "integrator"),
        ({"integrator": {"type": "nonsense"}}, "integrator"),
        ({"background_depth": 0.1}, "background_depth"),
        ({"background_depth": math.inf}, "background_depth"),
        ({"variant": "scalar_rgb"}, "variant"),
    ],
)
def test_bad_parameters_are_named(mi: ModuleType, change: dict[str, Any], field: str) -> None:
    with pytest.raises(SampleError) as caught:
        render(spheres(mi), **change)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("make", "field", "message"),
    [
        (lambda mi: world(mi, {"type": "orthographic"}), "sensor", "use a 'perspective' or 'thinlens'"),
        (lambda mi: mi.load_dict({"type": "scene"}), "sensor", "0 sensors"),
        (lambda _: {"type": "scene", "shape": {"type": "nonsense"}}, "scene", "cannot load"),
        (lambda _: {"type": "sphere"}, "scene", "expected a scene"),
        (lambda _: 7, "scene", "got int"),
    ],
)
def test_scenes_that_cannot_be_used(
    mi: ModuleType, make: Callable[[ModuleType], Any], field: str, message: str
) -> None:
    with pytest.raises(SampleError, match=message) as caught:
        render(make(mi))
    assert caught.value.field == field


def test_files_that_cannot_be_used(mi: ModuleType, tmp_path: Path) -> None:
    del mi
    with pytest.raises(SampleError, match="no such file") as caught:
        render(tmp_path / "gone.xml")
    assert caught.value.file == str(tmp_path / "gone.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<scene version='3.0.0'><sphere")
    with pytest.raises(SampleError, match="cannot load") as caught:
        render(broken)
    assert caught.value.file == str(broken)


def test_crop_window_does_not_scale(mi: ModuleType) -> None:
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "crop_width": 8, "crop_height": 6}
    scene = world(mi, sensor(mi, film=film))
    samples = render(scene, spp=1, shading_spp=1)
    assert isinstance(samples, SampleBuffer)
    assert (samples.width, samples.height) == (8, 6)
    with pytest.raises(SampleError, match="crop window") as caught:
        render(scene, width=80)
    assert caught.value.field == "width"


def test_perspective_lens_needs_both_numbers(mi: ModuleType) -> None:
    scene = world(mi, sensor(mi, "perspective"))
    with pytest.raises(SampleError) as caught:
        render(scene, lens_radius=1.0)
    assert caught.value.field == "focus_distance"
    with pytest.raises(SampleError) as caught:
        render(scene, focus_distance=1.0)
    assert caught.value.field == "lens_radius"
