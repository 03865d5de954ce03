"""Reprojection of samples to other lens points and times against geometry in space."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st

from buffers import random_buffer
from fewrays import Lens, SampleBuffer
from fewrays.sources.analytic import Plane, sample, trace
from fewrays.temporal.reprojection import NEAREST_SHARE, Paths, Sights

Float64 = npt.NDArray[np.float64]

LENS = Lens(-40.0, 8.0)

moderate = st.floats(-1, 1)
times = st.floats(0, 1)


def moving_buffer(seed: int = 0, depth_change: float = 0.8) -> SampleBuffer:
    samples = random_buffer(6, 7, 3, LENS, seed=seed)
    rng = np.random.default_rng(seed)
    motion = rng.normal(0.0, 10.0, (*samples.depth.shape, 3)) * samples.depth[..., None]
    motion[..., 2] = rng.uniform(-depth_change, depth_change, samples.depth.shape) * samples.depth
    time = rng.random(samples.depth.shape, np.float32)
    return replace(samples, time=time, motion=motion.astype(np.float32))


def position(point: Float64, lens: Lens, u: float, v: float) -> Float64:
    """Where a homogeneous point (x w, y w, w) is seen from a lens point."""
    x, y, w = point
    slope = lens.c0 / w + lens.c1
    return np.array([x / w + u * slope, y / w + v * slope])


def test_a_sample_is_seen_at_its_own_place_from_its_own_lens_point_at_its_own_time() -> None:
    samples = moving_buffer()
    assert samples.time is not None
    paths = Paths.of_samples(samples)
    for index in range(samples.depth.size):
        u, v = samples.uv.reshape(-1, 2)[index].astype(float)
        sights = paths.seen_from(u, v, float(samples.time.ravel()[index]))
        mine = sights.take(sights.sample == index)
        np.testing.assert_allclose(mine.xy[0], samples.xy.reshape(-1, 2)[index], rtol=1e-12, atol=1e-9)
        own_slope = samples.lens.slope(samples.depth.ravel()[index].astype(np.float64))
        np.testing.assert_allclose(mine.slope, own_slope, rtol=1e-12)


@given(
    point=st.tuples(moderate, moderate, st.floats(1, 5)),
    change=st.tuples(moderate, moderate, st.floats(-0.9, 3)),
    from_lens=st.tuples(moderate, moderate, times),
    to_lens=st.tuples(moderate, moderate, times),
)
def test_a_point_in_space_is_followed_through_a_thin_lens(
    point: tuple[float, float, float],
    change: tuple[float, float, float],
    from_lens: tuple[float, float, float],
    to_lens: tuple[float, float, float],
) -> None:
    """A camera at the origin looks along z; its image plane is scaled to lie in focus."""
    width, focus, radius, fov = 64, 2.5, 0.1, 50.0
    lens = Lens.thin_lens(width, focus_distance=focus, lens_radius=radius, fov=fov, sampling="square")
    pixels = width / 2 / math.tan(math.radians(fov / 2))  # per unit of tan(angle)

    def image_of(view: tuple[float, float, float]) -> tuple[Float64, float]:
        where = np.array(point) + view[2] * np.array(change)
        through = radius * np.array(view[:2])
        in_focus = through + (where[:2] - through) * focus / where[2]
        return width / 2 + pixels * in_focus / focus, float(where[2])

    (xy, depth), (expected, depth_then) = image_of(from_lens), image_of(to_lens)
    # (x w, y w, w) with x = width / 2 + pixels X / w
    motion = [pixels * change[axis] + width / 2 * change[2] for axis in (0, 1)] + [change[2]]
    one = (1, 1, 1)
    samples = SampleBuffer(
        xy=np.reshape(xy, (*one, 2)),
        uv=np.reshape(from_lens[:2], (*one, 2)),
        depth=np.reshape(depth, one),
        color=np.ones((*one, 3)),
        lens=lens,
        time=np.reshape(from_lens[2], one),
        motion=np.reshape(motion, (*one, 3)),
    )
    seen = Paths.of_samples(samples).seen_from(*to_lens)
    np.testing.assert_allclose(seen.xy[0], expected, atol=2e-3)  # float32 in, magnified by up to 50
    np.testing.assert_allclose(seen.slope, lens.slope(depth_then), atol=1e-4)


@given(u=moderate, v=moderate, t=times, depth_change=st.floats(-1.9, 4.0))
def test_samples_of_a_moving_plane_land_where_rays_hit_the_same_point(
    u: float, v: float, t: float, depth_change: float
) -> None:
    def painted(xy: Float64) -> Float64:
        return np.concatenate([xy, 0 * xy[..., :1]], axis=-1)

    plane = Plane(3.0, painted, motion=(30.0, -15.0, depth_change))
    samples = sample([plane], LENS, 4, 5, 2)
    sights = Paths.of_samples(samples).seen_from(u, v, t)
    assert sights.count == samples.depth.size
    color, _ = trace([plane], LENS, sights.xy, np.broadcast_to([u, v], sights.xy.shape), t)
    np.testing.assert_allclose(color, samples.color.reshape(-1, 3)[sights.sample], atol=2e-3)


@given(u=moderate, v=moderate, t=st.floats(0.01, 0.99), seed=st.integers(0, 5))
def test_speeds_and_slopes_are_the_derivatives_of_positions(u: float, v: float, t: float, seed: int) -> None:
    paths = Paths.of_samples(moving_buffer(seed))

    def at(u: float, v: float, t: float) -> Sights:
        return paths.seen_from(u, v, t)

    step = 1e-6
    here = at(u, v, t)
    speed = (at(u, v, t + step).xy - at(u, v, t - step).xy) / (2 * step)
    np.testing.assert_allclose(here.speed, speed, rtol=1e-4, atol=1e-3)
    slope = (at(u + step, v + step, t).xy - at(u - step, v - step, t).xy) / (2 * step)
    np.testing.assert_allclose(np.repeat(here.slope[:, None], 2, axis=1), slope, rtol=1e-5, atol=1e-5)


def test_homogeneous_positions_move_in_straight_lines() -> None:
    samples = moving_buffer()
    assert samples.motion is not None
    paths = Paths.of_samples(samples)
    for u, v, time in ((0.0, 0.0, 0.0), (0.3, -0.8, 0.4), (-1.0, 0.2, 1.0)):
        sights = paths.seen_from(u, v, time)
        for index in (0, 17, 125):
            point = paths.start[index] + time * samples.motion.reshape(-1, 3)[index].astype(np.float64)
            mine = sights.take(sights.sample == index)
            np.testing.assert_allclose(mine.xy[0], position(point, samples.lens, u, v), rtol=1e-12)


def test_what_has_come_too_near_is_not_seen() -> None:
    samples = moving_buffer(depth_change=3.0)
    assert samples.time is not None
    assert samples.motion is not None
    paths = Paths.of_samples(samples)
    counts = []
    for time in np.linspace(0.0, 1.0, 9):
        later = time - samples.time.ravel().astype(np.float64)
        depth = samples.depth.ravel() + later * samples.motion.reshape(-1, 3)[:, 2]
        sights = paths.seen_from(0.3, -0.2, float(time))
        np.testing.assert_array_equal(
            sights.sample, np.flatnonzero(depth >= NEAREST_SHARE * samples.depth.ravel())
        )
        assert np.isfinite(sights.xy).all()
        assert np.isfinite(sights.speed).all()
        counts.append(sights.count)
    assert samples.depth.size > max(counts) >= min(counts) > 0


def test_without_motion_times_do_not_matter() -> None:
    still = random_buffer(5, 6, 2, LENS)
    timed = replace(still, time=np.random.default_rng(0).random(still.depth.shape, np.float32))
    zero = replace(timed, motion=np.zeros((*still.depth.shape, 3), np.float32))
    expected = Paths.of_samples(still).seen_from(0.4, -0.6, 0.0)
    np.testing.assert_array_equal(expected.sample, np.arange(still.depth.size))
    assert not expected.speed.any()
    for samples in (still, timed, zero):
        sights = Paths.of_samples(samples).seen_from(0.4, -0.6, 0.9)
        np.testing.assert_array_equal(sights.xy, expected.xy)
        np.testing.assert_array_equal(sights.speed, expected.speed)
