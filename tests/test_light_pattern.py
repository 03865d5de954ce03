"""Points on lights: stratified, by themselves and together with image, lens and time; reproducible."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import SampleError
from fewrays.sources.patterns import sample_lights, sample_pattern, sample_times


@pytest.mark.parametrize("spp", [1, 4, 8])
@pytest.mark.parametrize("block", [1, 2, 4])
def test_blocks_of_pixels_share_out_the_light(spp: int, block: int) -> None:
    points = (sample_lights(2 * block, 3 * block, spp, seed=3, light=1).astype(np.float64) + 1) / 2
    count = block * block * spp
    for row in range(0, 2 * block, block):
        for column in range(0, 3 * block, block):
            part = points[row : row + block, column : column + block].reshape(count, 2)
            # A (0, 2)-sequence fills every grid of equal cells, wide or tall.
            for power in range(count.bit_length()):
                columns = 2**power
                cell = (part[:, 0] * columns).astype(int) * (count // columns)
                cell += (part[:, 1] * (count // columns)).astype(int)
                assert len(np.unique(cell)) == count


def strata_filled(points: npt.NDArray[np.float64], strata: int) -> float:
    """Return which share of the cells of a grid over [0, 1)^D points (N, D) fill."""
    cells = (points * strata).astype(int) @ strata ** np.arange(points.shape[1])
    return float(len(np.unique(cells)) / strata ** points.shape[1])


@pytest.mark.parametrize("seed", [0, 5])
def test_light_and_lens_and_time_are_stratified_together(seed: int) -> None:
    # As many points as cells: random ones leave 37 % of them empty, points that are tied together far more.
    lens = (sample_pattern(8, 8, 4, seed=seed)[1].reshape(-1, 2).astype(np.float64) + 1) / 2
    time = sample_times(8, 8, 4, seed=seed).reshape(-1, 1).astype(np.float64)
    light = (sample_lights(8, 8, 4, seed=seed).reshape(-1, 2).astype(np.float64) + 1) / 2
    assert strata_filled(np.concatenate([lens, light], axis=1), 4) == 1
    assert strata_filled(np.concatenate([time, light[:, 1:]], axis=1), 16) == 1
    for other in (lens[:, :1], lens[:, 1:], time):
        for axis in range(2):
            assert strata_filled(np.concatenate([other, light[:, axis, None]], axis=1), 16) >= 0.5


@pytest.mark.parametrize(("spp", "bound"), [(1, 0.75), (4, 0.6), (8, 0.55)])
def test_shadow_edges_are_smoother_than_with_random_points(spp: int, bound: float) -> None:
    # An edge that shears by up to 12 px over the light, averaged by a Gaussian over some pixels.
    size, sigma = 16, 2.0
    rng = np.random.default_rng(2)
    corner = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1)[:, :, None]
    errors: dict[str, list[float]] = {"pattern": [], "random": []}
    for seed in range(150):
        along, across = (np.array([np.cos(a), np.sin(a)]) for a in rng.uniform(0, 2 * np.pi, 2))
        slope = rng.choice([1.5, 3.0, 6.0, 12.0])
        middle = size / 2 + rng.uniform(-0.5, 0.5, 2)
        shape = (size, size, spp, 2)
        for name, xy, luv in (
            (
                "pattern",
                sample_pattern(size, size, spp, seed=seed)[0],
                sample_lights(size, size, spp, seed=seed),
            ),
            ("random", corner + rng.random(shape), rng.uniform(-1, 1, shape)),
        ):
            offset = xy - middle
            weight = np.exp(-0.5 * (offset**2).sum(-1) / sigma**2)
            lit = offset @ along - slope * (luv @ across) > 0
            errors[name].append(float((weight * lit).sum() / weight.sum()) - 0.5)
    assert np.std(errors["pattern"]) < bound * np.std(errors["random"])


def test_lights_seeds_and_rows() -> None:
    whole = sample_lights(70, 66, 3, seed=2)
    np.testing.assert_array_equal(sample_lights(70, 66, 3, seed=2, rows=(20, 68)), whole[20:68])
    for other in (
        sample_lights(70, 66, 3, seed=3),
        sample_lights(70, 66, 3, seed=2, light=1),
        sample_lights(70, 66, 3, seed=2, first_sample=3),
        sample_pattern(70, 66, 3, seed=2)[1],
    ):
        assert np.mean(other == whole) < 0.01


def test_discs_are_filled_evenly() -> None:
    radius = np.linalg.norm(sample_lights(16, 16, 16, sampling="disc"), axis=-1)
    assert radius.max() <= 1
    np.testing.assert_allclose(np.quantile(radius**2, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.01)


def test_bad_arguments_are_named() -> None:
    with pytest.raises(SampleError) as caught:
        sample_lights(4, 4, 0)
    assert caught.value.field == "spp"
    with pytest.raises(SampleError) as caught:
        sample_lights(4, 4, 1, seed=-1)
    assert caught.value.field == "seed"
