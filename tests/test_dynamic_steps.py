"""The steps of depth of field from one image, each on its own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fewrays.aperture import Aperture
from fewrays.dynamic import fill, kernel
from fewrays.dynamic.edges import Split, split_edges
from fewrays.dynamic.fill import Background
from fewrays.dynamic.mipmap import mip_level, mipmap
from fewrays.dynamic.prefilter import Blur, prefilter
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.surfaces import edges_of_surfaces, front_slopes, slope_gradient
from fewrays.dynamic.views import Views, cosine_falloff, halton_points
from fewrays.dynamic.warp import NOTHING, WarpSource, warp
from fewrays.parallel import Execution


def sheet_of(slope: npt.NDArray[np.floating], light: npt.NDArray[np.floating] | None = None) -> Sheet:
    slope = slope.astype(np.float32)
    ones = np.ones(slope.shape, np.float32)
    full = np.ones((*slope.shape, 4), np.float32) if light is None else light.astype(np.float32)
    return Sheet(full, ones, slope, ones > 0)


def warped(slope: npt.NDArray[np.floating], u: float, v: float, **options: int) -> npt.NDArray[np.int64]:
    sheet = sheet_of(slope)
    return warp(WarpSource.of_sheet(sheet, sheet.shown, 1.0), slope.shape, u, v, **options)[0]


# Views.


def test_halton_points_begin_as_the_sequence_does() -> None:
    square = Aperture("gaussian", sigma=1000.0)
    expected = 2 * np.array([[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]]) - 1
    np.testing.assert_allclose(halton_points(square, 4), expected)


@pytest.mark.parametrize("points", ["vogel", "halton"])
@pytest.mark.parametrize("aperture", [Aperture(), Aperture("gaussian"), Aperture("polygon", blades=5)])
def test_views_integrate_over_the_aperture(points: str, aperture: Aperture) -> None:
    views = Views.of_aperture(aperture, 2000, points)  # type: ignore[arg-type]
    assert aperture.contains(views.uv).all()
    dense = aperture.points(50000)
    second = views.weight @ np.square(views.uv) / views.weight.sum()
    np.testing.assert_allclose(second, np.square(dense).mean(axis=0), rtol=0.02)
    assert np.pi * views.radius**2 * 2000 == pytest.approx(aperture.area)


def test_one_view_looks_through_the_centre() -> None:
    np.testing.assert_array_equal(Views.of_aperture(Aperture(), 1, "halton").uv, [[0.0, 0.0]])


def test_cosine_falloff() -> None:
    """At f/1 the rim is seen under atan(1/2)."""
    assert cosine_falloff(np.array([[0.6, 0.8]]), 1.0)[0] == pytest.approx(np.cos(np.arctan(0.5)) ** 4)


# Warping.


def test_what_is_in_focus_stays_and_what_is_not_is_shifted() -> None:
    numbers = np.arange(30).reshape(5, 6)
    np.testing.assert_array_equal(warped(np.zeros((5, 6)), 0.9, -0.7), numbers)
    shifted = warped(np.full((5, 6), 2.0), 1.0, -0.5)  # by 2 columns and -1 row; the border goes on
    np.testing.assert_array_equal(shifted[:4, 2:], numbers[1:, :4])
    np.testing.assert_array_equal(shifted[:4, 0], numbers[1:, 0])


def test_the_nearest_wins() -> None:
    slope = np.array([[-3.0, 0.0, 0.0, 0.0, 5.0, 5.0]])
    assert warped(slope, -1.0, 0.0)[0, 3] == 0  # moved there by 3, over a pixel in focus
    assert warped(slope, 0.6, 0.0)[0, 1] == 1


def test_stretched_surfaces_do_not_tear_and_edges_do() -> None:
    ramp = np.linspace(0, 8, 12)[None].repeat(3, axis=0)
    assert (warped(ramp, 1.0, 0.0) != NOTHING).all()
    step = np.where(np.arange(12) < 6, 0.0, 5.0)[None]
    gap = warped(step, 0.8, 0.0)[0]
    np.testing.assert_array_equal(gap[6:10], NOTHING)  # 0.8 * 5 pixels are uncovered
    np.testing.assert_array_equal(warped(step, 0.8, 0.0, growth=1)[0, 7:9], NOTHING)


def test_gradients_stop_at_edges() -> None:
    slope = np.array([[0.0, 0.5, 1.0, 7.0, 7.25]], np.float32)
    gradient = slope_gradient(slope, 1.0, np.ones_like(slope, bool))
    np.testing.assert_allclose(gradient, [[0.5, 0.5, 0.5, 0.25, 0.25]])


# Blur between the views.


def test_mip_levels_follow_equation_8() -> None:
    """36 views: a circle of confusion of radius 24 has a footprint of 8 pixels."""
    np.testing.assert_allclose(mip_level([0.0, 3.0, 6.0, -24.0], 1 / 6), [0, 0, 1, 3])


@pytest.mark.parametrize("radius", [0.1, 0.3, 0.55, 1.0])
def test_blur_has_the_variance_that_is_asked_for(radius: float) -> None:
    light = np.zeros((65, 65, 4))
    light[32, 32] = 1
    blurred = prefilter(sheet_of(np.full((65, 65), 5.0), light), Blur(radius, 1.0)).light[..., 0]
    away = np.arange(65) - 32
    assert blurred.sum() == pytest.approx(1, rel=1e-5)
    for axis in (0, 1):
        assert blurred.sum(axis=axis) @ away**2 == pytest.approx((5 * radius) ** 2, rel=1e-4)


def test_mip_levels_keep_energy() -> None:
    light = np.zeros((64, 64, 4))
    light[20, 33] = 1
    blurred = mipmap(sheet_of(np.full((64, 64), 5.0), light), 0.5).light[..., 0]
    assert blurred.sum() == pytest.approx(1, rel=1e-5)
    assert blurred.max() < 0.2


def test_blur_stays_within_a_surface_and_a_pyramid_does_not() -> None:
    slope = np.where(np.arange(40) < 20, 0.0, 12.0)[None].repeat(20, axis=0)
    light = np.where(slope[..., None] == 0, 100.0, np.ones(4))
    sheet = sheet_of(slope, light)
    np.testing.assert_allclose(prefilter(sheet, Blur(0.5, 1.0)).light, light, rtol=1e-6)
    assert mipmap(sheet, 0.5).light[10, 21, 0] > 5


# Behind the edges.


def test_backgrounds_are_carried_on_under_what_is_in_front() -> None:
    slope = np.zeros((21, 31), np.float32)
    slope[:, 10:20] = -6.0  # a bar before a background of two colours
    light = np.where(np.arange(31)[:, None] < 15, [1.0, 0, 0, 1], [0, 1.0, 0, 1]) * np.ones((21, 1, 1))
    edge, all_of_it = np.zeros(slope.shape, bool), np.ones(slope.shape, bool)
    back = fill.guess_background(
        light.astype(np.float32), slope, slope, edge, all_of_it, 1.0, 64, Execution()
    )
    np.testing.assert_array_equal(back.known, slope < 0)
    np.testing.assert_allclose(back.light[10, 11], [1, 0, 0, 1], atol=0.1)
    np.testing.assert_allclose(back.light[10, 18], [0, 1, 0, 1], atol=0.1)
    np.testing.assert_allclose(back.slope[10, 10:20], 0.0)


def test_what_no_view_uncovers_is_not_guessed() -> None:
    slope = np.where(np.arange(60) < 30, -8.0, 0.0)[None].repeat(9, axis=0).astype(np.float32)
    steps = fill.find_behind(slope, slope, np.zeros(slope.shape, bool), slope < 1, 1.0, 64)
    found = np.any(steps[:, 4] > 0, axis=0)
    np.testing.assert_array_equal(found, (np.arange(60) >= 30 - 9) & (np.arange(60) < 30))


def test_native_search_is_the_same() -> None:
    rng = np.random.default_rng(3)
    slope = rng.choice([-9.0, -2.5, 0.0, 4.0], (23, 31)).astype(np.float32)
    light = rng.random((23, 31, 4)).astype(np.float32)
    edge, needed = rng.random(slope.shape) < 0.4, rng.random(slope.shape) < 0.8
    both = [
        engine.guess_background(light, slope, slope, edge, needed, 1.0, 10, Execution())
        for engine in (fill, kernel)
    ]
    np.testing.assert_array_equal(both[0].known, both[1].known)
    np.testing.assert_allclose(both[0].slope, both[1].slope, atol=1e-5)
    np.testing.assert_allclose(both[0].light, both[1].light, atol=1e-6)


# Edges.


@pytest.mark.parametrize("coverage", [0.0, 0.2, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("slope_there", [-6.0, 0.0, -2.0])
def test_mixed_pixels_are_taken_apart(coverage: float, slope_there: float) -> None:
    front, behind = np.array([1.0, 0.2, 0.1, 1.0]), np.array([0.1, 5.0, 0.3, 1.0])
    light = np.where(np.arange(9)[:, None] < 4, front, behind) * np.ones((7, 1, 1))
    slope = np.where(np.arange(9) < 4, -6.0, 0.0) * np.ones((7, 1))
    light[:, 4] = coverage * front + (1 - coverage) * behind
    slope[:, 4] = slope_there
    whole = Split(light.astype(np.float32), np.ones(slope.shape, np.float32), slope.astype(np.float32))
    everywhere = np.broadcast_to(behind, light.shape).astype(np.float32)
    back = Background(everywhere, np.zeros(slope.shape, np.float32), np.ones(slope.shape, bool))
    split = split_edges(whole, edges_of_surfaces(whole.slope, 1.0), back, 1.0)
    if coverage == 0:
        np.testing.assert_allclose(split.coverage[3, 4], 1)
        np.testing.assert_allclose(split.slope[3, 4], 0)
        return
    np.testing.assert_allclose(split.coverage[3, 4], coverage, atol=1e-5)
    np.testing.assert_allclose(split.slope[3, 4], -6)
    np.testing.assert_allclose(split.light[3, 4], coverage * front, atol=1e-5)
    again = split.light + (1 - split.coverage[..., None]) * behind
    np.testing.assert_allclose(again, light, atol=1e-5)


def test_front_slopes_are_the_least_around() -> None:
    slope = np.zeros((5, 5), np.float32)
    slope[2, 2] = -3
    np.testing.assert_array_equal(front_slopes(slope)[1:4, 1:4], -3)
    assert front_slopes(slope).sum() == -27
