"""The hierarchy's queries against a search through all samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from buffers import random_buffer
from fewrays import Lens, SampleBuffer
from fewrays.samples import OFF_IMAGE
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.reprojection import NEAREST_SHARE, Paths

Float64 = npt.NDArray[np.float64]

RULE = SurfaceRule(radius=1.0, along_lens=0.1, along_time=0.05)
EPSILON = float(np.finfo(np.float32).eps)


def scattered(
    count: int, lens: Lens, *, motion: float | None, depth_change: float = 0.0, seed: int = 0
) -> SampleBuffer:
    """Samples at any depth from 0.01 to 1000, each of which moves in its own way."""
    rng = np.random.default_rng(seed)
    shape = (count, 1, 1)
    depth = 10 ** rng.uniform(-2, 3, shape)
    samples = SampleBuffer(
        xy=rng.uniform(0, 20, (*shape, 2)),
        uv=rng.uniform(-1, 1, (*shape, 2)),
        depth=depth,
        color=np.ones((*shape, 3)),
        lens=replace(lens, sampling="square"),
    )
    if motion is None:
        return samples
    change = rng.normal(0, motion, (*shape, 3))
    change[..., 2] = rng.uniform(-depth_change, depth_change, shape)
    motions = (change * depth[..., None]).astype(np.float32)
    return replace(samples, time=rng.random(shape, np.float32), motion=motions)


def random_views(count: int, seed: int = 0) -> Float64:
    """Lens points and times, (count, 3), a third of them at the ends of their ranges."""
    rng = np.random.default_rng(seed)
    views = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.random(count)])
    views[::3] = np.column_stack([rng.choice([-1, 1], (count, 2)), rng.integers(0, 2, count)])[::3]
    return views.astype(np.float32).astype(np.float64)


def assert_finds_what_is_near(samples: SampleBuffer, queries: int, *, seed: int = 0) -> int:
    """Query around samples and compare with a search through all; return how many samples were to be found.

    Samples as close to the radius as rounding moves them may be found or not.
    """
    hierarchy, paths = Hierarchy(samples, RULE), Paths.of_samples(samples)
    rng = np.random.default_rng(seed)
    to_find = 0
    for view in random_views(queries, seed):
        u, v, time = view.tolist()
        sights = paths.seen_from(u, v, time)
        assert sights.count > 0
        radius = float(np.float32(10 ** rng.uniform(-1, 1)))
        aim = sights.xy[rng.integers(sights.count)] + 0.7 * rng.uniform(-radius, radius, 2)
        x, y = (float(position) for position in aim.astype(np.float32))
        distance = np.hypot(*(sights.xy - (x, y)).T)
        found = np.zeros(samples.depth.size, bool)
        number = hierarchy.query(x, y, u, v, time, radius)
        found[number] = True
        assert np.count_nonzero(found) == len(number)  # each once

        doubt = rounding(paths, samples, view)
        surely = sights.sample[distance <= radius - doubt[sights.sample]]
        maybe = sights.sample[distance <= radius + doubt[sights.sample]]
        assert found[surely].all()
        assert not np.delete(found, maybe).any()
        to_find += len(surely)
    return to_find


def rounding(paths: Paths, samples: SampleBuffer, view: Float64) -> Float64:
    """Pixels by which float32 may move what is seen in a view.

    Errors of the paths, which are sums of terms that may cancel, are divided by a depth that may be small.
    """
    assert samples.time is not None or samples.motion is None
    time = np.zeros(samples.depth.size) if samples.time is None else samples.time.ravel().astype(float)
    own = paths.start + time[:, None] * paths.change
    depth = np.maximum(np.abs(paths.start[:, 2] + view[2] * paths.change[:, 2]), paths.nearest)
    slope = abs(paths.c0) / own[:, 2] + abs(paths.c1)
    scale = np.abs(samples.xy.reshape(-1, 2)).max(axis=-1) + slope
    terms = scale * own[:, 2] + 2 * np.abs(paths.change).max(axis=-1)
    seen_slope = abs(paths.c0) / depth + abs(paths.c1)
    in_depth = (own[:, 2] + 2 * np.abs(paths.change[:, 2])) / depth
    result: Float64 = 16 * EPSILON * (terms / depth + seen_slope) * (1 + in_depth)
    return result


LENSES = {"pinhole": Lens(0.0, 0.0), "usual": Lens(-40.0, 8.0), "huge": Lens(-3000.0, 600.0)}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
@pytest.mark.parametrize(
    ("motion", "depth_change"), [(None, 0.0), (0.0, 0.0), (10.0, 0.0), (300.0, 0.0), (10.0, 0.9)]
)
def test_finds_exactly_what_is_near(lens: Lens, motion: float | None, depth_change: float) -> None:
    samples = scattered(400, lens, motion=motion, depth_change=depth_change)
    assert assert_finds_what_is_near(samples, 100) > 60


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_points_that_pass_the_camera_are_found_while_they_are_in_front(lens: Lens) -> None:
    samples = scattered(400, lens, motion=10.0, depth_change=3.0)
    assert samples.time is not None
    paths = Paths.of_samples(samples)
    ends = paths.start[:, 2], paths.start[:, 2] + paths.change[:, 2]
    assert sum(np.count_nonzero(end < 0) for end in ends) > 100
    assert assert_finds_what_is_near(samples, 100) > 60


def test_points_are_found_until_they_are_too_near() -> None:
    """One that comes straight at the lens centre stays where it is seen."""
    depth, change = 2.0, -4.0
    samples = scattered(1, Lens(0.0, 0.0), motion=0.0)
    x, y = samples.xy[0, 0, 0].tolist()
    samples = replace(
        samples,
        depth=np.full((1, 1, 1), depth, np.float32),
        time=np.zeros((1, 1, 1), np.float32),
        motion=np.array([[[[x * change, y * change, change]]]], np.float32),
    )
    hierarchy = Hierarchy(samples, RULE)
    for share, found in ((0.5, True), (2 * NEAREST_SHARE, True), (0.5 * NEAREST_SHARE, False), (-0.5, False)):
        time = (share - 1) * depth / change
        assert (hierarchy.query(x, y, 0.0, 0.0, time, 0.5).size == 1) == found


@settings(max_examples=30)
@given(
    count=st.integers(1, 120),
    c0=st.floats(-1e4, 0.0),
    c1=st.floats(-10.0, 1e3),
    motion=st.sampled_from([None, 0.1, 30.0]),
    depth_change=st.sampled_from([0.0, 0.5, 2.0]),
    seed=st.integers(0, 1000),
)
def test_any_samples(
    count: int, c0: float, c1: float, motion: float | None, depth_change: float, seed: int
) -> None:
    samples = scattered(count, Lens(c0, c1), motion=motion, depth_change=depth_change, seed=seed)
    # A view may have nothing in front of the camera.
    if all(Paths.of_samples(samples).seen_from(*view).count for view in random_views(8, seed)):
        assert_finds_what_is_near(samples, 8, seed=seed)


def test_images_of_surfaces() -> None:
    """Many leaves, of many samples each."""
    samples = random_buffer(40, 50, 4, Lens(-40.0, 8.0), off_image=0.05)
    assert Hierarchy(samples, RULE).leaf_count > 100
    assert assert_finds_what_is_near(samples, 40) > 1000
    rng = np.random.default_rng(0)
    motion = rng.normal(0.0, 5.0, (*samples.depth.shape, 3)) * samples.depth[..., None]
    time = rng.random(samples.depth.shape, np.float32)
    moving = replace(samples, time=time, motion=motion.astype(np.float32))
    assert assert_finds_what_is_near(moving, 40) > 1000


def test_leaves_hold_one_surface() -> None:
    """Samples that might cross are kept apart, however few there are."""
    one = random_buffer(4, 4, 2, Lens(-40.0, 8.0))
    one = replace(one, depth=np.full_like(one.depth, 5.0))
    assert Hierarchy(one, RULE).leaf_count == 1
    widest = RULE.tolerance / RULE.along_lens
    for apart, leaves in ((0.9 * widest, 1), (1.1 * widest, 2)):
        depth = np.where(np.arange(2) == 0, 5.0, one.lens.c0 / (apart - one.lens.c1))
        two = replace(one, depth=np.broadcast_to(depth, one.depth.shape))
        assert Hierarchy(two, RULE).leaf_count == leaves


def test_takes_little_memory() -> None:
    """Beside the buffer there is room for about 60 bytes a sample, even where hardly any share a leaf."""
    samples = random_buffer(60, 60, 8, Lens(-40.0, 8.0), surfaces=3)
    assert Hierarchy(samples, RULE).nbytes < 60 * samples.depth.size


def test_nothing_is_near_dropped_samples() -> None:
    samples = random_buffer(5, 6, 2, Lens(-40.0, 8.0))
    xy = samples.xy.copy()
    xy[2:, 3:] = OFF_IMAGE
    hierarchy = Hierarchy(replace(samples, xy=xy), RULE)
    dropped = np.flatnonzero((xy == OFF_IMAGE).all(axis=-1))
    for x, y in ((3.0, 3.0), (-200.0, -200.0), (5.9, 4.9)):
        assert not np.isin(hierarchy.query(x, y, 0.5, 0.5, 0.0, 1000.0), dropped).any()


def test_samples_outlive_their_names() -> None:
    """The tree reads samples in place and keeps them alive."""
    hierarchy = Hierarchy(random_buffer(20, 20, 2, Lens(-40.0, 8.0)), RULE)
    expected = random_buffer(20, 20, 2, Lens(-40.0, 8.0))
    scratch = [np.full(20 * 20 * 2 * 2, np.nan, np.float32) for _ in range(50)]
    sights = Paths.of_samples(expected).seen_from(0.25, 0.5, 0.0)
    near = sights.sample[np.hypot(*(sights.xy - (9.0, 9.0)).T) < 3.0]
    found = hierarchy.query(9.0, 9.0, 0.25, 0.5, 0.0, 3.0)
    assert len(scratch) == 50
    np.testing.assert_array_equal(np.sort(found), near)
