"""Sample patterns: uniform, stratified, in their own pixels, reproducible."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fewrays import Lens, SampleError
from fewrays.lens import Sampling
from fewrays.sources.patterns import MAX_SPP, sample_pattern, sample_times, warp_to_lens

SAMPLINGS: tuple[Sampling, ...] = ("disc", "square", "gaussian")


def unit_points(height: int, width: int, spp: int, seed: int) -> npt.NDArray[np.float64]:
    """Return the pattern as points of the unit hypercube, (H, W, S, 5), in the order u, v, x, y, t."""
    xy, uv = sample_pattern(height, width, spp, seed=seed, sampling="square")
    times = sample_times(height, width, spp, seed=seed)
    corner = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)[:, :, None]
    return np.concatenate([(uv.astype(np.float64) + 1) / 2, xy - corner, times[..., None]], axis=-1)


def strata_filled(values: npt.NDArray[np.float64], strata: int) -> bool:
    """Tell whether each of the strata of [0, 1) holds one value."""
    return bool((np.bincount((values * strata).astype(int), minlength=strata) == 1).all())


@pytest.mark.parametrize("spp", [1, 2, 4, 8, 16, 64])
@pytest.mark.parametrize("seed", [0, 7])
def test_each_pixel_is_stratified_in_every_dimension(spp: int, seed: int) -> None:
    points = unit_points(5, 6, spp, seed).reshape(-1, spp, 5)
    for pixel in points:
        for dimension in range(5):
            assert strata_filled(pixel[:, dimension], spp)


@pytest.mark.parametrize("spp", [1, 2, 4, 8])
@pytest.mark.parametrize("block", [2, 4, 8])
def test_blocks_of_pixels_share_out_the_lens_and_the_shutter(spp: int, block: int) -> None:
    points = unit_points(2 * block, 3 * block, spp, 3)
    count = block * block * spp
    for row in range(0, 2 * block, block):
        for column in range(0, 3 * block, block):
            part = points[row : row + block, column : column + block].reshape(count, 5)
            assert strata_filled(part[:, 0], count)
            assert strata_filled(part[:, 1], count)
            assert strata_filled(part[:, 4], count)
            # A (0, 2)-sequence fills every grid of equal cells on the lens, wide or tall.
            for power in range(count.bit_length()):
                columns = 2**power
                cell = (part[:, 0] * columns).astype(int) * (count // columns)
                cell += (part[:, 1] * (count // columns)).astype(int)
                assert len(np.unique(cell)) == count


@pytest.mark.parametrize(("spp", "bound"), [(1, 0.9), (8, 0.7)])
def test_sheared_edges_are_smoother_than_with_random_samples(spp: int, bound: float) -> None:
    # An edge at slope 3 px through a tile, under Gaussian weights over image and lens, as the filters see it.
    size, slope, weights_sigma = 16, 3.0, 2.0
    rng = np.random.default_rng(2)
    corner = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1)[:, :, None]
    errors: dict[str, list[float]] = {"pattern": [], "random": []}
    for seed in range(250):
        angle = rng.uniform(0, 2 * math.pi)
        normal = np.array([math.cos(angle), math.sin(angle)])
        centre = size / 2 + rng.uniform(-0.5, 0.5, 2)
        shape = (size, size, spp, 2)
        for name, (xy, uv) in (
            ("pattern", sample_pattern(size, size, spp, seed=seed)),
            ("random", (corner + rng.random(shape), rng.uniform(-1, 1, shape))),
        ):
            offset = xy - centre
            weight = np.exp(-0.5 * (offset**2).sum(-1) / weights_sigma**2 - 4.5 * (uv**2).sum(-1))
            lit = (offset - slope * uv) @ normal > 0
            errors[name].append(float((weight * lit).sum() / weight.sum()) - 0.5)
    assert np.std(errors["pattern"]) < bound * np.std(errors["random"])


@pytest.mark.parametrize(("spp", "bound"), [(4, 0.75), (8, 0.75)])
def test_moving_edges_are_smoother_than_with_random_times(spp: int, bound: float) -> None:
    # As above, in motion: times random beside the pattern leave 0.8 of the error of random points.
    size, slope, weights_sigma = 16, 3.0, 2.0
    rng = np.random.default_rng(11)
    corner = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1)[:, :, None]
    errors: dict[str, list[float]] = {"pattern": [], "random": []}
    for seed in range(300):
        normal, way = (np.array([math.cos(a), math.sin(a)]) for a in rng.uniform(0, 2 * math.pi, 2))
        centre = size / 2 + rng.uniform(-0.5, 0.5, 2)
        velocity = rng.uniform(0, 12) * way
        shape = (size, size, spp)
        for name, (xy, uv), times in (
            ("pattern", sample_pattern(*shape, seed=seed), sample_times(*shape, seed=seed)),
            (
                "random",
                (corner + rng.random((*shape, 2)), rng.uniform(-1, 1, (*shape, 2))),
                rng.random(shape),
            ),
        ):
            offset = xy - centre
            weight = np.exp(-0.5 * (offset**2).sum(-1) / weights_sigma**2 - 4.5 * (uv**2).sum(-1))
            lit = (offset - slope * uv - velocity * (times[..., None] - 0.5)) @ normal > 0
            errors[name].append(float((weight * lit).sum() / weight.sum()) - 0.5)
    assert np.std(errors["pattern"]) < bound * np.std(errors["random"])


@pytest.mark.parametrize(
    ("spp", "block", "lens_quality", "pixel_quality"),
    [(8, 1, 1, 2), (16, 1, 1, 2), (4, 4, 2, 2), (64, 1, 2, 2), (2, 8, 2, 3)],
)
def test_time_is_stratified_jointly_with_the_lens_and_the_pixel(
    spp: int, block: int, lens_quality: int, pixel_quality: int
) -> None:
    # The 2^m points of a block fill every grid of 2^(m - quality) equal cells alike, whatever its shape; the
    # qualities are properties of the generators. Independent times, stratified or not, fail at once.
    run = unit_points(block, block, spp, 6).reshape(-1, 5)
    check_grids(run[:, [0, 1, 4]], lens_quality)
    check_grids(run[:, [2, 3, 4]], pixel_quality)


def check_grids(points: npt.NDArray[np.float64], quality: int) -> None:
    """Assert that N points in 3D put 2^quality into each cell of every grid of N / 2^quality cells."""
    power = len(points).bit_length() - 1 - quality
    for a in range(power + 1):
        for b in range(power + 1 - a):
            cells = (2**a, 2**b, 2 ** (power - a - b))
            index = np.ravel_multi_index(tuple((points * cells).astype(int).T), cells)
            assert (np.bincount(index, minlength=2**power) == 2**quality).all(), cells


@pytest.mark.parametrize("seed", range(3))
def test_positions_are_uniform(seed: int) -> None:
    points = unit_points(64, 64, 4, seed).reshape(-1, 5)
    for power in (1, 2, 3, 4):
        np.testing.assert_allclose((points**power).mean(axis=0), 1 / (power + 1), atol=2e-4)
    np.testing.assert_allclose(np.cov(points.T), np.eye(5) / 12, atol=1e-3)


def test_lens_averages_converge_faster_than_random() -> None:
    # The lens share of a half plane through a pixel block: the error of a defocused edge.
    errors: dict[str, list[float]] = {"pattern": [], "random": []}
    rng = np.random.default_rng(5)
    for seed in range(200):
        normal = np.array([math.cos(seed), math.sin(seed)])
        for name, uv in (
            ("pattern", sample_pattern(4, 4, 8, seed=seed, sampling="square")[1].reshape(-1, 2)),
            ("random", rng.uniform(-1, 1, (128, 2))),
        ):
            errors[name].append(float(np.mean(uv @ normal > 0)) - 0.5)
    assert np.std(errors["pattern"]) < 0.35 * np.std(errors["random"])


@pytest.mark.parametrize("sigma", [0.2, 1 / 3, 0.8])
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_lens_moments_match_the_density(sampling: Sampling, sigma: float) -> None:
    # Midpoint sums of the density that the lens itself states, over the square that holds the support.
    lens = Lens(-1.0, 1.0, sampling=sampling, sigma=sigma)
    t = (np.arange(2000) + 0.5) / 1000 - 1
    grid = np.stack(np.meshgrid(t, t), axis=-1)
    density = lens.sampling_density(grid)
    if sampling == "disc":
        density = np.where((grid**2).sum(-1) <= 1, density, 0)
    density = density / 1000**2
    assert density.sum() == pytest.approx(1, abs=1e-4)

    uv = (
        sample_pattern(64, 64, 16, seed=4, sampling=sampling, sigma=sigma)[1]
        .reshape(-1, 2)
        .astype(np.float64)
    )
    for p, q in ((1, 0), (0, 1), (2, 0), (0, 2), (1, 1), (4, 0), (2, 2)):
        expected = (density * grid[..., 0] ** p * grid[..., 1] ** q).sum()
        assert np.mean(uv[:, 0] ** p * uv[:, 1] ** q) == pytest.approx(expected, abs=2e-4)
    assert np.abs(uv).max() <= 1
    if sampling == "disc":
        assert np.hypot(uv[:, 0], uv[:, 1]).max() <= 1 + 1e-6


@given(st.floats(0.02, 10), st.floats(2.0**-33, 1 - 2.0**-33))
def test_gaussian_warp_inverts_its_distribution(sigma: float, p: float) -> None:
    # Hand the result to the exact distribution function; float32 rounds the position, not the method.
    t = float(warp_to_lens(np.array([[p, 0.5]]), "gaussian", sigma)[0, 0])
    inside = math.erf(1 / (sigma * math.sqrt(2)))
    back = 0.5 + 0.5 * math.erf(t / (sigma * math.sqrt(2))) / inside
    peak = 1 / (sigma * math.sqrt(2 * math.pi) * inside)
    assert back == pytest.approx(p, abs=peak * 2.0**-24 + 1e-9)


def test_disc_warp_keeps_areas_and_neighbours() -> None:
    t = (np.arange(400) + 0.5) / 400
    square = np.stack(np.meshgrid(t, t), axis=-1)
    disc = warp_to_lens(square, "disc").astype(np.float64)
    step_u, step_v = np.diff(disc, axis=1)[:-1], np.diff(disc, axis=0)[:, :-1]
    area = np.abs(step_u[..., 0] * step_v[..., 1] - step_u[..., 1] * step_v[..., 0]) * 400**2
    assert np.percentile(np.abs(area - math.pi), 98) < 0.05
    assert np.hypot(*np.moveaxis(step_u, -1, 0)).max() < 4 / 400


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 5),
    st.integers(1, 5),
    st.integers(1, 9),
    st.integers(0, 2**32 - 1),
    st.sampled_from(SAMPLINGS),
)
def test_samples_stay_in_their_pixels(
    height: int, width: int, spp: int, seed: int, sampling: Sampling
) -> None:
    xy, uv = sample_pattern(height, width, spp, seed=seed, sampling=sampling)
    assert xy.shape == uv.shape == (height, width, spp, 2)
    assert xy.dtype == uv.dtype == np.float32
    expected = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)[:, :, None]
    np.testing.assert_array_equal(np.floor(xy), np.broadcast_to(expected, xy.shape))
    assert np.abs(uv).max() <= 1


def test_samples_stay_in_their_pixels_far_from_the_origin() -> None:
    # At 65535 a float32 step is 1/128 px: 1 in 256 positions would round up into the next pixel.
    xy, _ = sample_pattern(65_536, 2, 2048, rows=(65_535, 65_536))
    np.testing.assert_array_equal(np.floor(xy[..., 1]), 65_535)
    xy, _ = sample_pattern(1, 60_000, 16)
    np.testing.assert_array_equal(np.floor(xy[0, :, :, 0]), np.arange(60_000)[:, None] * np.ones((1, 16)))


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_rows_equal_those_of_the_full_pattern(sampling: Sampling) -> None:
    whole = sample_pattern(150, 70, 3, seed=9, sampling=sampling)
    part = sample_pattern(150, 70, 3, seed=9, sampling=sampling, rows=(61, 131))
    for full, rows in zip(whole, part, strict=True):
        np.testing.assert_array_equal(full[61:131], rows)


def test_times_of_rows_equal_those_of_the_full_pattern() -> None:
    whole = sample_times(150, 70, 3, seed=9, first_sample=5)
    assert whole.shape == (150, 70, 3)
    assert whole.dtype == np.float32
    np.testing.assert_array_equal(
        whole[61:131], sample_times(150, 70, 3, seed=9, first_sample=5, rows=(61, 131))
    )


def test_times_stay_before_the_shutter_closes() -> None:
    # One in 2²⁵ would round up to 1, as the latest of these.
    times = sample_times(1, 1, 2**18, seed=4)
    assert times.max() == np.nextafter(np.float32(1), np.float32(0))
    assert 0 <= times.min() < 2.0**-18


def test_times_repeat_with_the_seed_and_change_with_it() -> None:
    first = sample_times(70, 70, 4, seed=1)
    np.testing.assert_array_equal(first, sample_times(70, 70, 4, seed=1))
    for other in (sample_times(70, 70, 4, seed=2), sample_times(70, 70, 4, seed=1, first_sample=4)):
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.03


def test_patterns_repeat_with_the_seed_and_change_with_it() -> None:
    first, again = (sample_pattern(70, 70, 4, seed=1) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    for other in (sample_pattern(70, 70, 4, seed=2), sample_pattern(70, 70, 4, seed=1, first_sample=4)):
        for a, b in zip(first, other, strict=True):
            assert np.mean(a == b) < 0.01
            correlation = np.corrcoef((a % 1).ravel(), (b % 1).ravel())[0, 1]
            assert abs(correlation) < 0.03


def test_squares_of_pixels_do_not_repeat() -> None:
    _, uv = sample_pattern(64, 192, 1, seed=0)
    assert abs(np.corrcoef(uv[:, :64].ravel(), uv[:, 64:128].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(uv[:, :64].ravel(), uv[:, 128:].ravel())[0, 1]) < 0.05


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"height": 0}, "height"),
        ({"width": -1}, "width"),
        ({"spp": 0}, "spp"),
        ({"spp": MAX_SPP + 1}, "spp"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**32}, "seed"),
        ({"first_sample": -1}, "first_sample"),
        ({"rows": (2, 2)}, "rows"),
        ({"rows": (0, 5)}, "rows"),
        ({"sampling": "hexagon"}, "sampling"),
        ({"sampling": "gaussian", "sigma": 0.0}, "sigma"),
        ({"sampling": "gaussian", "sigma": math.nan}, "sigma"),
    ],
)
def test_bad_arguments_are_named(change: dict[str, object], field: str) -> None:
    arguments = {"height": 4, "width": 4, "spp": 2, **change}
    with pytest.raises(SampleError) as caught:
        sample_pattern(**arguments)  # type: ignore[arg-type]
    assert caught.value.field == field
    if field not in ("sampling", "sigma"):
        with pytest.raises(SampleError) as caught:
            sample_times(**arguments)  # type: ignore[arg-type]
        assert caught.value.field == field
