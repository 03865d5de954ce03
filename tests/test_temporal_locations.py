"""Reconstruction locations: exact margins, and five dimensions that are jointly well distributed."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import SampleError
from fewrays.aperture import Aperture
from fewrays.pixel_filter import PixelFilter
from fewrays.temporal.locations import Locations, make_locations
from fewrays.temporal.shutter import Shutter, ShutterResponse

Float64 = npt.NDArray[np.float64]

RESPONSES: tuple[ShutterResponse, ...] = ("box", "trapezoid", "triangle", "gaussian")
FILTERS = (
    PixelFilter("box"),
    PixelFilter("gaussian"),
    PixelFilter("blackman-harris"),
    PixelFilter("mitchell"),
)
APERTURES = (Aperture(), Aperture("gaussian"), Aperture("polygon", blades=5, roundness=0.2))


def in_each_stratum_once(values: npt.NDArray[np.floating]) -> bool:
    """Tell whether each of as many equal parts of [0, 1] as there are values holds one."""
    strata = np.floor(values.astype(np.float64) * len(values)).astype(int)
    return bool((np.sort(strata) == np.arange(len(values))).all())


def as_matrix(locations: Locations) -> Float64:
    """Columns x, y, u, v, t, the latter from the middle of the shutter."""
    columns = [locations.offset, locations.uv, locations.t[:, None] - 0.5]
    return np.concatenate(columns, axis=1, dtype=np.float64)


@given(
    count=st.integers(1, 600),
    aperture=st.sampled_from(APERTURES),
    pixel_filter=st.sampled_from(FILTERS),
    response=st.sampled_from(RESPONSES),
    shutter=st.tuples(st.floats(0, 1), st.floats(0, 1)).map(lambda times: (min(times), max(times))),
)
def test_any_number_of_locations(
    count: int,
    aperture: Aperture,
    pixel_filter: PixelFilter,
    response: ShutterResponse,
    shutter: tuple[float, float],
) -> None:
    locations = make_locations(count, aperture, pixel_filter, Shutter(*shutter, response))
    assert locations.count == count
    shapes = {"uv": (count, 2), "t": (count,), "offset": (count, 2), "weight": (count,)}
    again = make_locations(count, aperture, pixel_filter, Shutter(*shutter, response))
    for name, shape in shapes.items():
        values = getattr(locations, name)
        assert values.shape == shape
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
        assert (values == getattr(again, name)).all()
    assert (locations.uv == aperture.points(count).astype(np.float32)).all()
    assert np.float32(shutter[0]) <= locations.t.min() <= locations.t.max() <= np.float32(shutter[1])
    assert np.abs(locations.offset).max() <= np.float32(pixel_filter.radius)
    assert locations.weight.sum(dtype=np.float64) == pytest.approx(1, abs=1e-6)
    if pixel_filter.shape != "mitchell":
        assert (locations.weight == np.float32(1 / count)).all()


@pytest.mark.parametrize("count", [1, 2, 16, 100, 128, 255, 4096])
def test_times_and_offsets_are_stratified(count: int) -> None:
    locations = make_locations(count, Aperture(), PixelFilter())
    assert in_each_stratum_once(locations.t)
    assert in_each_stratum_once(locations.offset[:, 0] + 0.5)
    assert in_each_stratum_once(locations.offset[:, 1] + 0.5)


@pytest.mark.parametrize(
    ("response", "variance"),
    [
        ("box", 1 / 12),
        ("trapezoid", ((3 / 4) ** 2 + (1 / 4) ** 2) / 12),  # two boxes, convolved
        ("triangle", 2 * (1 / 2) ** 2 / 12),
        ("gaussian", (1 - 6 * math.exp(-4.5) / math.sqrt(2 * math.pi) / math.erf(3 / math.sqrt(2))) / 36),
    ],
)
def test_moments_of_shutter_responses(response: ShutterResponse, variance: float) -> None:
    t = make_locations(1024, Aperture(), PixelFilter(), Shutter(0.2, 0.7, response)).t.astype(np.float64)
    assert t.mean() == pytest.approx(0.45, abs=1e-6)
    assert np.square(t - 0.45).mean() == pytest.approx(variance / 4, rel=1e-3)


@pytest.mark.parametrize("response", RESPONSES)
def test_density_is_that_of_the_times(response: ShutterResponse) -> None:
    shutter = Shutter(0.2, 0.7, response)
    edges = np.linspace(0, 1, 21)
    counts, _ = np.histogram(shutter.times((np.arange(20000) + 0.5) / 20000), edges)
    fine = np.linspace(0, 1, 20 * 500 + 1)
    middle = (fine[:-1] + fine[1:]) / 2
    expected = shutter.density(middle).reshape(20, 500).mean(axis=1) / 20
    np.testing.assert_allclose(counts / 20000, expected, atol=3e-3)
    assert expected.sum() == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize(
    ("times", "field"),
    [((0.5, 0.4), "shutter"), ((-0.1, 0.4), "shutter"), ((0.0, math.nan), "shutter")],
)
def test_bad_shutter_times_are_named(times: tuple[float, float], field: str) -> None:
    with pytest.raises(SampleError) as error:
        Shutter(*times)
    assert error.value.field == field


def test_bad_shutter_response_is_named() -> None:
    with pytest.raises(SampleError, match="sine"):
        Shutter(response="sine")  # type: ignore[arg-type]


def test_an_instant() -> None:
    assert (make_locations(32, Aperture(), PixelFilter(), Shutter(0.25, 0.25)).t == 0.25).all()


def test_signed_weights_integrate_under_mitchell_netravali() -> None:
    locations = make_locations(256, Aperture(), PixelFilter("mitchell"))
    lobe = np.abs(locations.offset) > 8 / 7
    assert ((locations.weight < 0) == (lobe[:, 0] ^ lobe[:, 1])).all()
    assert (locations.weight < 0).any()
    weight = locations.weight[:, None].astype(np.float64)
    assert (weight * locations.offset).sum(axis=0) == pytest.approx(np.zeros(2), abs=0.01)
    assert (weight * np.square(locations.offset)).sum(axis=0) == pytest.approx(np.full(2, 1 / 9), abs=0.02)


def edges(rng: np.random.Generator, count: int) -> tuple[Float64, Float64]:
    """Draw edges in the image: normal . (x, y) + slope normal . (u, v) + motion t < shift."""
    angle = rng.uniform(0, 2 * math.pi, count)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    slope, motion = 10 ** rng.uniform(-0.5, 1.5, (2, count, 1)) * rng.integers(0, 2, (2, count, 1))
    coefficients = np.concatenate([normal, slope * normal, motion], axis=1)
    spread = np.sqrt(np.square(coefficients) @ np.array([1 / 12, 1 / 12, 1 / 4, 1 / 4, 1 / 12]))
    return coefficients, rng.uniform(-1.5, 1.5, count) * spread


@pytest.mark.parametrize("count", [64, 128, 256])
def test_edges_are_smoother_than_with_points_paired_at_random(count: int) -> None:
    rng = np.random.default_rng(3)
    first, second = edges(rng, 400), edges(rng, 400)

    def coverage(points: Float64) -> Float64:
        """How much of an edge's pixel is seen behind another edge."""
        front, back = (edge @ points.T < shift[:, None] for edge, shift in (first, second))
        return np.concatenate([front.mean(axis=1), (front & back).mean(axis=1)])

    def random_points(number: int) -> Float64:
        radius, angle = np.sqrt(rng.random(number)), rng.uniform(0, 2 * math.pi, number)
        others = rng.random((3, number)) - 0.5
        return np.stack(
            [others[0], others[1], radius * np.cos(angle), radius * np.sin(angle), others[2]], axis=1
        )

    exact = np.mean([coverage(random_points(2**14)) for _ in range(12)], axis=0)
    points = as_matrix(make_locations(count, Aperture(), PixelFilter()))
    shuffled = np.concatenate(
        [points[rng.permutation(count), :2], points[:, 2:4], points[rng.permutation(count), 4:]], axis=1
    )

    def error(candidate: Float64) -> float:
        return float(np.sqrt(np.square(coverage(candidate) - exact).mean()))

    assert error(points) < 0.45 * error(random_points(count))
    assert error(points) < 0.85 * error(shuffled)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"count": 0}, "count"),
        ({"count": 2**16 + 1}, "count"),
    ],
)
def test_bad_options_are_named(options: dict[str, object], field: str) -> None:
    arguments = {"count": 16, "aperture": Aperture(), "pixel_filter": PixelFilter(), **options}
    with pytest.raises(SampleError) as error:
        make_locations(**arguments)  # type: ignore[arg-type]
    assert error.value.field == field
