"""Moving planes against world-space geometry, reprojection and closed forms of motion blur."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fewrays import Lens, SampleBuffer, SampleError
from fewrays.lens import LensAperture
from fewrays.sources.analytic import (
    Motion,
    PixelFilter,
    Plane,
    Waves,
    checker,
    constant,
    disc,
    exact_waves,
    grating,
    half_plane,
    motion_of,
    reference,
    sample,
    smooth_noise,
    stripes,
    trace,
)

Floats = npt.NDArray[np.float64]

WIDE = Lens(-30.0, 12.0)
PINHOLE = Lens(0.0, 0.0)


def start_position(xy: Floats) -> Floats:
    """Colour that tells where the lens centre saw the point at t = 0."""
    return np.concatenate([xy, 0 * xy[..., :1]], axis=-1)


def reproject(samples: SampleBuffer, u: float, v: float, t: float) -> tuple[Floats, Floats]:
    """Depths (...) and image positions (..., 2) of samples at another lens point and time.

    Equations 2 to 4 of *temporal*, spelt out.
    """
    assert samples.time is not None
    assert samples.motion is not None
    xy, uv, z, motion = (
        a.astype(np.float64) for a in (samples.xy, samples.uv, samples.depth, samples.motion)
    )
    later = t - samples.time.astype(np.float64)

    def slope(depth: Floats) -> Floats:
        return samples.lens.c0 / depth + samples.lens.c1

    z_new = z + later * motion[..., 2]
    x = ((xy[..., 0] - uv[..., 0] * slope(z)) * z + later * motion[..., 0]) / z_new + u * slope(z_new)
    y = ((xy[..., 1] - uv[..., 1] * slope(z)) * z + later * motion[..., 1]) / z_new + v * slope(z_new)
    return z_new, np.stack([x, y], axis=-1)


moderate = st.floats(-1, 1)
times = st.floats(0, 1)


@given(
    point=st.tuples(moderate, moderate, st.floats(1, 5)),
    change=st.tuples(moderate, moderate, st.floats(-0.9, 3)),
    lens_point=st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)),
    time=times,
)
def test_rays_land_where_geometry_in_space_says(
    point: tuple[float, float, float],
    change: tuple[float, float, float],
    lens_point: tuple[float, float],
    time: float,
) -> None:
    # A thin-lens camera at the origin that looks along z, its image plane scaled to lie in focus.
    width, height, focus, radius, fov = 64, 48, 2.5, 0.1, 50.0
    lens = Lens.thin_lens(width, focus_distance=focus, lens_radius=radius, fov=fov)
    pixels = width / 2 / math.tan(math.radians(fov / 2))  # per unit of tan(angle)
    axis = np.array([width / 2, height / 2])
    p0, move = np.array(point), np.array(change)
    p = p0 + time * move
    from_lens = radius * np.array(lens_point)
    in_focus = from_lens + (p[:2] - from_lens) * focus / p[2]
    xy = axis + pixels * in_focus / focus

    z = point[2]
    velocity = (float(pixels * move[0] / z), float(pixels * move[1] / z))
    motion = motion_of(z, velocity, depth_change=change[2], principal_point=(width / 2, height / 2))
    color, depth = trace([Plane(z, start_position, motion=motion)], lens, xy, lens_point, time)
    np.testing.assert_allclose(depth, p[2], rtol=1e-6)
    np.testing.assert_allclose(color[:2], axis + pixels * p0[:2] / z, rtol=1e-6, atol=1e-4)


@settings(max_examples=50)
@given(
    u=moderate,
    v=moderate,
    t=times,
    dx=st.floats(-200, 200),
    dy=st.floats(-200, 200),
    dz=st.floats(-1.9, 4),
    seed=st.integers(0, 9),
)
def test_reprojected_samples_land_where_rays_find_their_points(
    u: float, v: float, t: float, dx: float, dy: float, dz: float, seed: int
) -> None:
    assume(any((dx, dy, dz)))
    plane = Plane(3.0, start_position, motion=(dx, dy, dz))
    samples = sample([plane], WIDE, 3, 4, 2, seed=seed)
    depth, xy = reproject(samples, u, v, t)
    seen, traced = trace([plane], WIDE, xy, np.broadcast_to([u, v], xy.shape), t)
    np.testing.assert_allclose(seen, samples.color, atol=2e-3)
    np.testing.assert_allclose(traced, depth, rtol=1e-5)


def test_buffers_hold_the_motion_of_what_each_sample_hit() -> None:
    planes = [
        Plane(2.0, smooth_noise(9, seed=1), disc((20, 16), 7), motion_of(2.0, (9, -4))),
        Plane(9.0, smooth_noise(7, seed=2), motion=(40.0, 20.0, 2.0)),
        Plane(1.0, smooth_noise(5, seed=3), stripes(16, fill=0.3)),
    ]
    samples = sample(planes, WIDE, 32, 40, 4, seed=3)
    assert samples.time is not None
    assert samples.motion is not None
    motions = np.array([plane.motion for plane in planes], np.float32)
    which = (samples.motion[..., None, :] == motions).all(axis=-1)
    assert (which.sum(axis=-1) == 1).all()
    hit = which.argmax(axis=-1)
    assert (np.bincount(hit.ravel()) > 300).all()
    # The lens centre sees each sample's point at t = 0 where its plane is painted.
    depth, start = reproject(samples, 0.0, 0.0, 0.0)
    for number, plane in enumerate(planes):
        mine = hit == number
        np.testing.assert_allclose(depth[mine], plane.depth, rtol=1e-5)
        np.testing.assert_allclose(samples.color[mine], np.asarray(plane.color(start[mine])), atol=1e-3)
    strata = np.sort((samples.time * 4).astype(int), axis=-1)
    np.testing.assert_array_equal(strata, np.broadcast_to(np.arange(4), strata.shape))


def test_no_motion_changes_nothing() -> None:
    still = [Plane(1.0, checker(3), disc((10, 8), 5)), Plane(4.0, smooth_noise(6))]
    zero = [replace(plane, motion=(0.0, 0.0, 0.0)) for plane in still]
    buffer, same = sample(still, WIDE, 16, 20, 4), sample(zero, WIDE, 16, 20, 4)
    assert same.time is None
    assert same.motion is None
    for name in ("xy", "uv", "depth", "color"):
        np.testing.assert_array_equal(getattr(buffer, name), getattr(same, name))
    np.testing.assert_array_equal(
        reference(still, WIDE, 8, 8, spp=64), reference(zero, WIDE, 8, 8, spp=64, shutter=(0.3, 0.3))
    )
    # A plane that moves behind a still one leaves what is seen of that alone.
    moving = sample([still[0], replace(still[1], motion=(30.0, 0.0, 1.0))], WIDE, 16, 20, 4)
    assert moving.motion is not None
    near = moving.depth == 1
    assert 100 < near.sum() < near.size - 100
    np.testing.assert_array_equal(near, buffer.depth == 1)
    np.testing.assert_array_equal(moving.color[near], buffer.color[near])
    assert not moving.motion[near].any()
    assert (moving.color[~near] != buffer.color[~near]).any()


@pytest.mark.parametrize("change", [-0.9, 3.0])
def test_a_change_of_depth_moves_points_along_lines_through_the_principal_point(change: float) -> None:
    centre = np.array([20.0, 15.0])
    motion = motion_of(1.5, depth_change=change, principal_point=(20, 15))
    plane = Plane(1.5, start_position, motion=motion)
    time = np.linspace(0, 1, 5)
    offset = np.array([6.0, -3.0])
    start = np.repeat([centre, centre + offset], 5, axis=0)
    seen = np.concatenate(
        [np.repeat([centre], 5, axis=0), centre + offset * (1.5 / (1.5 + change * time))[:, None]]
    )
    color, depth = trace([plane], WIDE, seen, np.zeros((10, 2)), np.tile(time, 2))
    np.testing.assert_allclose(color[:, :2], start, rtol=1e-6)
    np.testing.assert_allclose(depth, np.tile(1.5 + change * time, 2), rtol=1e-6)


def test_a_moving_edge_ramps_over_the_distance_it_covers() -> None:
    wall = Plane(9.0, constant(0))
    edge = Plane(2.0, constant(1), half_plane((10, 0), (-1, 0)), motion_of(2.0, (12, 0)))
    x = np.arange(40) + 0.5
    for opens, closes in ((0.0, 1.0), (0.25, 0.75)):
        image = reference([edge, wall], PINHOLE, 3, 40, spp=256, sigma_pix=0, shutter=(opens, closes))
        ramp = np.clip((closes - (x - 10) / 12) / (closes - opens), 0, 1)
        np.testing.assert_allclose(image, np.broadcast_to(ramp[:, None], image.shape), atol=1e-2)


def test_a_snapshot_shows_one_moment() -> None:
    ball = Plane(2.0, checker(3), disc((9, 8), 6), motion_of(2.0, (8, 4)))
    wall = Plane(9.0, smooth_noise(5))
    shot = reference([ball, wall], WIDE, 16, 24, spp=64, shutter=(0.5, 0.5))
    moved = Plane(2.0, lambda xy: checker(3)(xy - [4, 2]), disc((13, 10), 6))
    np.testing.assert_allclose(shot, reference([moved, wall], WIDE, 16, 24, spp=64), atol=1e-6)


@pytest.mark.parametrize("shutter", [(0.0, 1.0), (0.2, 0.65), (0.4, 0.4)])
def test_a_steady_motion_attenuates_a_grating_by_a_sinc(shutter: tuple[float, float]) -> None:
    frequency, velocity = (0.05, -0.02), (17.0, 6.0)
    cycles = frequency[0] * velocity[0] + frequency[1] * velocity[1]
    opens, closes = shutter
    image = exact_waves(
        grating(frequency), 3.0, PINHOLE, 6, 9, motion=motion_of(3.0, velocity), shutter=shutter, sigma_pix=0
    )
    y, x = np.mgrid[:6, :9] + 0.5
    phase = frequency[0] * x + frequency[1] * y - cycles * (opens + closes) / 2
    expected = 0.5 + 0.4 * np.sinc(cycles * (closes - opens)) * np.cos(2 * np.pi * phase)
    np.testing.assert_allclose(image, np.broadcast_to(expected[..., None], image.shape), atol=1e-6)


@pytest.mark.parametrize("pixel_filter", ["gaussian", "box"])
@pytest.mark.parametrize(
    ("depth_change", "far_blur", "aperture"),
    [(-1.9, 24.0, "disc"), (6.0, 24.0, "gaussian"), (6.0, 150.0, "disc")],
)
def test_exact_images_of_receding_waves_are_means_of_still_ones(
    depth_change: float, far_blur: float, aperture: LensAperture, pixel_filter: PixelFilter
) -> None:
    # The plane passes through the focal plane, at depth 2.5. At a time t it is a still one whose texture is
    # scaled about the principal point by its depth then and moved.
    lens = Lens(-2.5 * far_blur, far_blur, aperture=aperture)
    depth = 3.0 if depth_change < 0 else 1.8
    texture = smooth_noise(5, waves=6, seed=2)
    velocity, centre = np.array([10.0, -7.0]), np.array([5.0, 4.0])
    motion = motion_of(depth, (10, -7), depth_change=depth_change, principal_point=(5, 4))
    image = exact_waves(texture, depth, lens, 8, 11, motion=motion, pixel_filter=pixel_filter)

    moments = (np.arange(300) + 0.5) / 300
    mean = np.zeros(image.shape)
    for t in moments:
        away = depth + t * depth_change
        scale = away / depth
        shift = texture.frequency @ (centre - centre * scale - velocity * t)
        still = Waves(
            texture.mean, texture.amplitude, texture.frequency * scale, texture.phase + 2 * np.pi * shift
        )
        mean += exact_waves(still, away, lens, 8, 11, pixel_filter=pixel_filter) / len(moments)
    np.testing.assert_allclose(image, mean, atol=1e-5)
    assert image.std() > 4e-4


@pytest.mark.parametrize("motion", [motion_of(3.0, (14, -9)), (100.0, 40.0, 4.0), (-80.0, 20.0, -1.5)])
def test_references_tend_to_the_exact_image_of_a_moving_plane(motion: Motion) -> None:
    lens = Lens(-40.0, 16.0)
    texture = smooth_noise(12, seed=3)
    image = reference([Plane(3.0, texture, motion=motion)], lens, 20, 30, spp=256, shutter=(0.1, 0.9))
    exact = exact_waves(texture, 3.0, lens, 20, 30, motion=motion, shutter=(0.1, 0.9))
    # Plain random samples would leave 0.15 / √256 = 9e-3.
    assert np.sqrt(np.square(image - exact).mean()) < 4e-3
    assert exact.std() > 0.01


def test_the_nearest_plane_at_each_moment_wins() -> None:
    rng = np.random.default_rng(4)
    planes = [
        Plane(
            float(z),
            constant(number),
            disc((float(x), float(y)), 12),
            motion_of(float(z), (float(x) - 20, 5), depth_change=float(dz), principal_point=(20, 20)),
        )
        for number, (z, dz, x, y) in enumerate(
            zip(rng.uniform(2, 8, 12), rng.uniform(-1.9, 4, 12), *rng.uniform(5, 35, (2, 12)), strict=True)
        )
    ]
    planes.append(Plane(50.0, constant(12)))
    xy, uv = rng.uniform(0, 40, (3000, 2)), rng.uniform(-0.7, 0.7, (3000, 2))
    time = rng.random(3000)
    color, depth = trace(planes, WIDE, xy, uv, time)

    alone = np.full((3000, 13), np.inf)
    for number, plane in enumerate(planes):
        behind = Plane(1e6, constant(99))
        seen, distance = trace([plane, behind], WIDE, xy, uv, time)
        alone[seen[:, 0] == number, number] = distance[seen[:, 0] == number]
    np.testing.assert_array_equal(depth, alone.min(axis=1).astype(np.float32))
    np.testing.assert_array_equal(color[:, 0], alone.argmin(axis=1))
    # Sorting once, as the shutter opens, would not do.
    at_start = np.where(np.isfinite(alone), [plane.depth for plane in planes], np.inf)
    assert (at_start.argmin(axis=1) != alone.argmin(axis=1)).sum() > 100


def test_planes_that_pass_through_each_other_swap_in_that_moment() -> None:
    approaching = Plane(6.0, constant(1), disc((0, 0), 9), motion=(0.0, 0.0, -4.0))
    receding = Plane(3.0, constant(2), disc((0, 0), 9), motion=(0.0, 0.0, 2.0))
    planes = [approaching, receding, Plane(90.0, constant(3))]
    time = [0.0, 0.2, 0.49, 0.51, 0.8, 1.0]
    color, depth = trace(planes, WIDE, np.zeros((6, 2)), np.zeros((6, 2)), time)
    np.testing.assert_array_equal(color[:, 0], [2, 2, 2, 1, 1, 1])
    np.testing.assert_allclose(depth, [3, 3.4, 3.98, 3.96, 2.8, 2], rtol=1e-6)


@pytest.mark.parametrize(
    ("motion", "problem"),
    [
        ((0.0, 0.0), "three finite numbers"),
        ((math.nan, 0.0, 0.0), "three finite numbers"),
        ((0.0, math.inf, 0.0), "three finite numbers"),
        ((0.0, 0.0, -2.0), "from 2 to 0 "),
        ((0.0, 0.0, -5.0), "from 2 to -3 "),
    ],
)
def test_motions_that_no_plane_can_have(motion: Motion, problem: str) -> None:
    with pytest.raises(SampleError, match=rf"^plane\.motion: .*{problem}"):
        Plane(2.0, constant(1), motion=motion)


def test_every_ray_must_end_somewhere_at_all_times() -> None:
    wall = Plane(5.0, constant(1))
    passing = Plane(4.0, constant(1), disc((0, 0), 1), (0.0, 0.0, 2.0))
    with pytest.raises(SampleError, match=r"^planes: .*at all times"):
        sample([wall, passing], WIDE, 4, 4, 1)


def test_bad_times_and_shutters() -> None:
    planes = [Plane(2.0, constant(1), motion=(1.0, 0.0, 0.0))]
    for time in (-0.1, 1.5, math.nan):
        with pytest.raises(SampleError, match=rf"^times: .*{time}"):
            trace(planes, WIDE, [[1.0, 1.0]], [[0.0, 0.0]], [time])
    for shutter in ((-0.1, 1.0), (0.0, 1.1), (0.6, 0.5), (math.nan, 1.0)):
        with pytest.raises(SampleError, match=r"^shutter: "):
            reference(planes, WIDE, 4, 4, shutter=shutter)
        with pytest.raises(SampleError, match=r"^shutter: "):
            exact_waves(grating((0.1, 0)), 2.0, WIDE, 4, 4, shutter=shutter)
    with pytest.raises(SampleError, match=r"^principal_point: "):
        motion_of(2.0, (1, 0), depth_change=1.0)
