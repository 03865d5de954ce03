"""Apertures: points against exact moments and areas, inside the rim, evenly spread."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import Lens, SampleError
from fewrays.aperture import MAX_POINTS, Aperture

Float64 = npt.NDArray[np.float64]

APERTURES = (
    Aperture(),
    Aperture("gaussian"),
    Aperture("gaussian", sigma=0.05),
    Aperture("gaussian", sigma=1000.0),
    Aperture("polygon", blades=3),
    Aperture("polygon", blades=5, rotation=17.0),
    Aperture("polygon", blades=6, roundness=0.4),
    Aperture("polygon", blades=12, rotation=-90.0, roundness=1.0),
)

squeezes = st.floats(0.125, 8)
apertures = st.one_of(
    st.builds(Aperture, squeeze=squeezes),
    st.builds(Aperture, st.just("gaussian"), sigma=st.floats(0.001, 1000), squeeze=squeezes),
    st.builds(
        Aperture,
        st.just("polygon"),
        blades=st.integers(3, 64),
        rotation=st.floats(-360, 360),
        roundness=st.floats(0, 1),
        squeeze=squeezes,
    ),
)


def fine_grid(cells: int) -> Float64:
    """Middles of the cells of a grid over [-1, 1]², (cells², 2)."""
    axis = (np.arange(cells) + 0.5) / cells * 2 - 1
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def transmittance(aperture: Aperture, uv: Float64) -> Float64:
    """Light that passes at lens positions, from another definition of each shape than the module's."""
    if aperture.shape == "disc":
        return np.asarray(np.hypot(uv[:, 0], uv[:, 1]) <= 1, np.float64)
    if aperture.shape == "gaussian":
        light: Float64 = np.exp(-0.5 * np.square(uv / aperture.sigma).sum(axis=1))
        return light
    turn = math.radians(aperture.rotation)
    open_: Float64 = np.ones(len(uv))
    for side in range(aperture.blades):
        corners = [turn + 2 * math.pi * (side + end) / aperture.blades for end in (0, 1)]
        outward = np.array([math.cos(sum(corners) / 2), math.sin(sum(corners) / 2)])
        corner = np.array([math.cos(corners[0]), math.sin(corners[0])])
        if aperture.roundness == 0:
            open_ *= (uv - corner) @ outward <= 0
        else:  # a polygon of arcs is where discs through two corners each overlap
            radius = 1 / aperture.roundness
            chord = math.sin(math.pi / aperture.blades)
            center = (corner @ outward - math.sqrt(radius**2 - chord**2)) * outward
            open_ *= np.hypot(*(uv - center).T) <= radius
    return open_


def second_moment(aperture: Aperture) -> float:
    """Mean square of u over the light of a disc, a Gaussian or a polygon with straight sides."""
    if aperture.shape == "polygon":
        return (2 + math.cos(2 * math.pi / aperture.blades)) / 12
    if aperture.shape == "disc":
        return 1 / 4
    sigma = aperture.sigma
    if sigma > 100:
        return 1 / 3  # a uniform square
    edge = math.sqrt(2 / math.pi) / sigma * math.exp(-0.5 / sigma**2) / math.erf(1 / (sigma * math.sqrt(2)))
    return sigma**2 * (1 - edge)


@pytest.mark.parametrize("aperture", APERTURES, ids=repr)
def test_points_have_the_moments_of_the_light(aperture: Aperture) -> None:
    grid = fine_grid(500)
    light = transmittance(aperture, grid)
    light /= light.sum()
    uv = aperture.points(4096)
    rim = float(np.hypot(*uv.T).max())
    for powers in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (4, 0), (2, 2), (0, 4)):
        exact = (light * (grid**powers).prod(axis=1)).sum()
        assert (uv**powers).prod(axis=1).mean() == pytest.approx(exact, abs=2e-3 * rim ** sum(powers))


@pytest.mark.parametrize("aperture", [a for a in APERTURES if a.roundness == 0], ids=repr)
@pytest.mark.parametrize("count", [16, 64, 128, 256, 1024])
def test_moments_are_exact_within_two_points_on_the_rim(aperture: Aperture, count: int) -> None:
    uv = aperture.points(count)
    rim = float(np.hypot(*uv.T).max())
    assert np.abs(np.square(uv).mean(axis=0) - second_moment(aperture)).max() < 2 / count * rim**2
    assert np.abs(uv.mean(axis=0)).max() < 2 / count * rim


@given(aperture=apertures, count=st.integers(1, 700))
def test_points_lie_inside(aperture: Aperture, count: int) -> None:
    uv = aperture.points(count)
    assert uv.shape == (count, 2)
    assert uv.dtype == np.float64
    assert np.abs(uv).max() <= 1
    assert aperture.contains(uv).all()
    assert (aperture.density(uv) > 0).all() or aperture.sigma < 0.03  # far tails of the narrowest are 0


def shares_of_directions(aperture: Aperture, parts: int) -> Float64:
    """Shares of a polygon's area in equal parts of the turn from its first corner on."""
    fine = 16 * parts
    angle = math.radians(aperture.rotation) + np.arange(fine) / fine * 2 * math.pi
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    low, high = np.zeros(fine), np.ones(fine)
    for _ in range(30):  # bisection for the rim
        middle = (low + high) / 2
        inside = transmittance(aperture, middle[:, None] * direction) > 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    triangles = low * np.roll(low, -1)
    shares: Float64 = triangles.reshape(parts, 16).sum(axis=1) / triangles.sum()
    return shares


@pytest.mark.parametrize("blades", [3, 5, 6, 9])
@pytest.mark.parametrize("roundness", [0.0, 0.3, 0.9])
def test_sectors_and_scaled_copies_of_a_polygon_share_out_the_points(blades: int, roundness: float) -> None:
    count = 900
    aperture = Aperture("polygon", blades=blades, rotation=25.0, roundness=roundness)
    uv = aperture.points(count)
    # The first point is in the direction of the first corner, but for rounding.
    turn = (np.arctan2(uv[:, 1], uv[:, 0]) - math.radians(25.0) + 1e-9) / (2 * math.pi) % 1
    parts = 8 * blades  # smaller than a sector: of unequal area, unless the polygon is round
    counts = np.bincount((turn * parts).astype(int), minlength=parts)
    assert np.abs(counts - count * shares_of_directions(aperture, parts)).max() < 2.5
    assert np.ptp(counts.reshape(blades, 8).sum(axis=1)) <= 4
    for share in (0.1, 0.25, 0.5, 0.81):
        assert abs(transmittance(aperture, uv / math.sqrt(share)).sum() - share * count) <= 1


@pytest.mark.parametrize("aperture", APERTURES, ids=repr)
def test_half_planes_hold_their_share(aperture: Aperture) -> None:
    """An edge that crosses a circle of confusion covers it by the share of points on one side."""
    count = 128
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * math.pi, 200)
    normals = np.stack([np.cos(angle), np.sin(angle)])
    sigma = min(aperture.sigma, 0.5) if aperture.shape == "gaussian" else 0.5
    shifts = rng.uniform(-sigma, sigma, 200)
    grid = fine_grid(200)
    light = transmittance(aperture, grid)
    exact = (light / light.sum()) @ (grid @ normals < shifts)
    found = (aperture.points(count) @ normals < shifts).mean(axis=0)
    random = np.sqrt(exact * (1 - exact) / count).mean()
    assert np.sqrt(np.square(found - exact).mean()) < 0.5 * random


def test_the_disc_is_a_vogel_spiral() -> None:
    u, v = Aperture().points(200).T
    assert np.hypot(u, v) == pytest.approx(np.sqrt((np.arange(200) + 0.5) / 200))
    steps = np.diff(np.arctan2(v, u)) % (2 * math.pi)
    assert np.degrees(steps) == pytest.approx(np.full(199, 137.50776405))


def test_a_fully_round_polygon_is_the_disc() -> None:
    polygon = Aperture("polygon", blades=5, roundness=1.0)
    assert polygon.points(300) == pytest.approx(Aperture().points(300), abs=1e-9)
    assert polygon.area == pytest.approx(math.pi)


@pytest.mark.parametrize("aperture", APERTURES, ids=repr)
@pytest.mark.parametrize("squeeze", [2.0, 1.33, 0.5])
def test_squeeze_makes_the_shape_taller_than_wide(aperture: Aperture, squeeze: float) -> None:
    squeezed = replace(aperture, squeeze=squeeze)
    factors = np.array((1, squeeze)) / max(1, squeeze)  # the longer axis stays as it is
    assert squeezed.points(300) == pytest.approx(aperture.points(300) * factors)
    assert squeezed.area == pytest.approx(aperture.area * factors.prod())
    grid = fine_grid(60)
    assert (squeezed.contains(grid * factors) == aperture.contains(grid)).all()
    density = squeezed.density(grid * factors)
    assert density == pytest.approx(aperture.density(grid) / factors.prod())


def test_a_2x_anamorphic_disc_is_an_ellipse_twice_as_tall_as_wide() -> None:
    aperture = Aperture(squeeze=2.0)
    uv = aperture.points(4096)
    assert np.ptp(uv, axis=0) == pytest.approx([1, 2], abs=0.02)
    assert np.square(uv).mean(axis=0) == pytest.approx([1 / 16, 1 / 4], abs=1e-3)
    assert aperture.area == pytest.approx(math.pi / 2)
    assert aperture.contains([[0, 0.99], [0.49, 0], [0.51, 0]]).tolist() == [True, True, False]


def test_rotation_turns_from_u_towards_v() -> None:
    straight = Aperture("polygon", blades=3).points(100)
    u, v = Aperture("polygon", blades=3, rotation=90.0).points(100).T
    assert np.stack([v, -u], axis=-1) == pytest.approx(straight)
    assert Aperture("polygon", blades=3, rotation=90.0).contains([[0, 1], [0, -1], [1, 0]]).tolist() == [
        True,
        False,
        False,
    ]


def test_areas() -> None:
    assert Aperture().area == pytest.approx(math.pi)
    for blades in (3, 4, 7, 12):
        area = blades / 2 * math.sin(2 * math.pi / blades)
        assert Aperture("polygon", blades=blades).area == pytest.approx(area)
        half = math.asin(0.5 * math.sin(math.pi / blades))  # of the arc of a side with radius 2
        segments = blades * 4 * (half - math.sin(half) * math.cos(half))
        assert Aperture("polygon", blades=blades, roundness=0.5).area == pytest.approx(area + segments)
    for sigma in (0.05, 1 / 3, 2.0, 1000.0):
        inside = math.erf(1 / (sigma * math.sqrt(2)))
        area = 2 * math.pi * (sigma * inside) ** 2
        assert Aperture("gaussian", sigma=sigma).area == pytest.approx(area)


@pytest.mark.parametrize("aperture", APERTURES, ids=repr)
def test_contains_and_density_follow_the_shape(aperture: Aperture) -> None:
    grid = fine_grid(300)
    light = transmittance(aperture, grid)
    assert light.mean() * 4 == pytest.approx(aperture.area, rel=3e-3)
    larger, smaller = (transmittance(aperture, grid * scale) > 0 for scale in (0.9999, 1.0001))
    off_the_rim = larger == smaller
    assert off_the_rim.mean() > 0.99
    difference = aperture.density(grid) - light / aperture.area
    assert np.abs(difference[off_the_rim]).max() < 1e-12 / aperture.area
    outside = np.array([[1.001, 0.0], [0.0, -1.1], [0.8, 1.2], [-3.0, 2.0]])
    assert not aperture.contains(outside).any()
    assert (aperture.density(outside) == 0).all()


def test_contains_the_centre_and_keeps_the_shape_of_its_argument() -> None:
    for aperture in APERTURES:
        assert aperture.contains(np.zeros((2, 3, 2), np.float32)).tolist() == [[True] * 3] * 2


@pytest.mark.parametrize("sigma", [0.05, 1 / 3, 2.0])
def test_of_lens(sigma: float) -> None:
    lens = Lens(-3.0, 1.0, aperture="gaussian", sampling="gaussian", sigma=sigma)
    aperture = Aperture.of_lens(lens)
    assert aperture == Aperture("gaussian", sigma=sigma)
    uv = fine_grid(20)
    assert aperture.density(uv) == pytest.approx(lens.sampling_density(uv))
    assert Aperture.of_lens(Lens(-3.0, 1.0)) == Aperture("disc")


def test_points_are_the_same_every_time() -> None:
    for aperture in APERTURES:
        again = Aperture(**{name: getattr(aperture, name) for name in aperture.__dataclass_fields__})
        assert (aperture.points(77) == again.points(77)).all()


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"shape": "star"}, "aperture"),
        ({"sigma": 0.0}, "sigma"),
        ({"sigma": math.nan}, "sigma"),
        ({"blades": 2}, "blades"),
        ({"blades": 5.5}, "blades"),
        ({"blades": 65}, "blades"),
        ({"rotation": math.inf}, "rotation"),
        ({"rotation": math.nan}, "rotation"),
        ({"roundness": -0.1}, "roundness"),
        ({"roundness": 1.01}, "roundness"),
        ({"squeeze": 0.0}, "squeeze"),
        ({"squeeze": 8.5}, "squeeze"),
        ({"squeeze": math.nan}, "squeeze"),
    ],
)
def test_bad_shapes_are_named(options: dict[str, object], field: str) -> None:
    with pytest.raises(SampleError) as error:
        Aperture(**options)  # type: ignore[arg-type]
    assert error.value.field == field


@pytest.mark.parametrize("count", [0, -3, MAX_POINTS + 1])
def test_bad_counts_are_named(count: int) -> None:
    with pytest.raises(SampleError, match="count"):
        Aperture().points(count)
