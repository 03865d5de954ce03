"""Telling surfaces apart: against Equation 5, Figure 7 and triangles spelt out, and the cases of Figure 6."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.reprojection import Sights
from fewrays.temporal.surfaces import (
    LEAST_SAMPLES,
    Surface,
    covers,
    crossings,
    fills_quadrants,
    find_surface,
    group_into_surfaces,
    is_covered,
    tent_weights,
)

Float64 = npt.NDArray[np.float64]

RULE = SurfaceRule(radius=1.0, along_lens=0.1, along_time=0.05)
FRONT, MIDDLE, BACK = -40.0, 0.0, 40.0  # slopes that cross within any distance here


def sights_of(xy: npt.ArrayLike, slope: npt.ArrayLike, speed: npt.ArrayLike = 0.0) -> Sights:
    xy = np.reshape(np.asarray(xy, np.float64), (-1, 2))
    count = len(xy)
    return Sights(
        np.arange(count),
        xy,
        np.broadcast_to(np.asarray(slope, np.float64), count),
        np.broadcast_to(np.asarray(speed, np.float64), (count, 2)),
    )


def ring(count: int, radius: float, first: float = 0.1) -> list[tuple[float, float]]:
    """Points on a circle around the location."""
    angle = first + 2 * np.pi * np.arange(count) / count
    return [(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in angle]


def resolve(samples: Sights, rule: SurfaceRule = RULE) -> tuple[Surface | None, Counter[str]]:
    """Find the surface at the origin."""
    tally: Counter[str] = Counter()
    surface = find_surface(lambda r: samples.take(np.hypot(*samples.xy.T) <= r), rule, tally)
    return surface, tally


class TestCrossings:
    @given(
        place=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
        slope=st.floats(-20, 20),
        speed=st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    )
    def test_samples_cross_where_their_order_changes(
        self, place: tuple[float, float], slope: float, speed: tuple[float, float]
    ) -> None:
        """Equation 5: the signs of the distances at all corners of lens times shutter."""
        pair = sights_of(
            [(0.0, 0.0), place], [3.0, 3.0 + slope], [(1.0, -2.0), (1.0 + speed[0], -2.0 + speed[1])]
        )
        keeps_order = True
        for axis in (0, 1):
            distances = [
                place[axis] + slope * RULE.along_lens * lens + speed[axis] * RULE.along_time * time
                for lens, time in itertools.product((-1, 1), (-1, 1))
            ]
            if min(map(abs, distances)) < 1e-9:
                return  # rounding decides
            keeps_order &= len({distance > 0 for distance in distances}) == 1
        crossing = crossings(pair, RULE)
        assert crossing[0, 1] == crossing[1, 0]
        assert (crossing[0, 1] <= 0) == keeps_order

    def test_by_how_much(self) -> None:
        pair = sights_of([(0, 0), (0.3, 5)], [2, 12], [(0, 0), (8, 0)])
        assert crossings(pair, RULE)[0, 1] == pytest.approx(10 * 0.1 + 8 * 0.05 - 0.3)
        pair = sights_of([(0, 0), (9, 0.2)], [2, 12], [(0, 0), (0, -6)])
        assert crossings(pair, RULE)[0, 1] == pytest.approx(10 * 0.1 + 6 * 0.05 - 0.2)


def literally_grouped(sights: Sights) -> list[list[int]]:
    """Figure 7, line by line; samples of one slope take their turn together."""
    order = sorted(range(sights.count), key=lambda i: (sights.slope[i], *sights.xy[i]))
    crosses = crossings(sights, RULE) > RULE.tolerance
    surfaces: list[list[int]] = [[]]
    for _, alike in itertools.groupby(order, key=lambda i: sights.slope[i]):
        samples = list(alike)
        if any(crosses[sample, other] for sample in samples for other in surfaces[-1]):
            surfaces.append([])
        surfaces[-1] += samples
    return surfaces


class TestGrouping:
    @given(count=st.integers(1, 40), slopes=st.sampled_from([0.1, 3.0, 30.0]), seed=st.integers(0, 10**6))
    def test_follows_figure_7(self, count: int, slopes: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        sights = sights_of(
            rng.uniform(-2, 2, (count, 2)),
            rng.normal(0, slopes, count).round(1),
            rng.normal(0, slopes, (count, 2)),
        )
        groups = group_into_surfaces(sights, RULE)
        assert [group.sample.tolist() for group in groups] == literally_grouped(sights)

    def test_order_in_the_buffer_does_not_matter(self) -> None:
        rng = np.random.default_rng(1)
        sights = sights_of(rng.uniform(-2, 2, (50, 2)), rng.normal(0, 5, 50).round(0))
        shuffled = sights.take(rng.permutation(50))
        pairs = zip(group_into_surfaces(sights, RULE), group_into_surfaces(shuffled, RULE), strict=True)
        for one, other in pairs:
            np.testing.assert_array_equal(one.sample, other.sample)

    def test_parallel_planes_are_as_many_surfaces(self) -> None:
        xy = np.random.default_rng(0).uniform(-1, 1, (60, 2))
        slope = np.array([BACK, FRONT, MIDDLE])[np.arange(60) % 3]
        groups = group_into_surfaces(sights_of(xy, slope), RULE)
        assert [set(group.slope.tolist()) for group in groups] == [{FRONT}, {MIDDLE}, {BACK}]
        assert [group.count for group in groups] == [20, 20, 20]

    def test_a_plane_that_is_not_folded_is_one_surface_however_wide_its_range_of_slopes(self) -> None:
        """Its slope changes by less along x and y than makes it turn its back to a part of the lens."""
        steps = np.arange(-1, 1.01, 0.25)
        xy = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        # A diagonal: no two samples differ in slope but not in x, nor in y.
        diagonal = np.stack([steps, steps], axis=-1)
        tilted = sights_of(diagonal, 9.0 * diagonal[:, 0])
        assert np.ptp(tilted.slope) * RULE.along_lens > 10 * RULE.tolerance
        assert len(group_into_surfaces(tilted, RULE)) == 1
        # Changing faster than 1 / δ, it is folded.
        assert len(group_into_surfaces(sights_of(diagonal, 16.0 * diagonal[:, 0]), RULE)) > 1
        assert len(group_into_surfaces(sights_of(xy, 0.4 * xy[:, 0]), RULE)) == 1

    def test_what_moves_differently_is_another_surface(self) -> None:
        xy = np.random.default_rng(0).uniform(-1, 1, (40, 2))
        speed = np.where(np.arange(40)[:, None] % 2, (60.0, 0.0), (0.0, 0.0))
        slope = np.where(np.arange(40) % 2, -0.2, 0.2)
        moving = group_into_surfaces(sights_of(xy, slope, speed), RULE)
        assert [set(group.speed[:, 0].tolist()) for group in moving] == [{60.0}, {0.0}]
        assert len(group_into_surfaces(sights_of(xy, slope), RULE)) == 1


def literally_covered(xy: Float64, radius: float) -> bool:
    """All triangles, by the barycentric coordinates of the origin."""
    for corners in itertools.combinations(xy, 3):
        edges = [np.hypot(*(a - b)) for a, b in itertools.combinations(corners, 2)]
        if max(edges) > 2 * radius or min(np.hypot(*corner) for corner in corners) > radius:
            continue
        shares = np.linalg.solve(np.vstack([np.transpose(corners), np.ones(3)]), [0.0, 0.0, 1.0])
        if (shares >= 0).all():
            return True
    return False


class TestCover:
    @given(count=st.integers(0, 9), seed=st.integers(0, 10**6))
    def test_is_any_valid_triangle(self, count: int, seed: int) -> None:
        xy = np.random.default_rng(seed).uniform(-1.6, 1.6, (count, 2))
        assert is_covered(xy, 1.0) == literally_covered(xy, 1.0)

    def test_valid_triangles_are_small(self) -> None:
        corners = np.array(ring(3, 1.0))
        assert is_covered(corners, 1.0)
        # Its edges are √3 long.
        assert not is_covered(corners, 0.85)
        assert is_covered(corners[:, ::-1], 1.0)
        assert is_covered(corners - 0.4 * corners[0], 1.0)
        assert not is_covered(corners + 0.6 * corners[0], 1.0)

    def test_one_corner_is_near(self) -> None:
        corners = np.array(ring(3, 1.1))  # edges 1.9 long
        assert not is_covered(corners, 1.0)
        assert is_covered(0.9 * corners, 1.0)
        assert is_covered(corners - 0.15 * corners[0], 1.0)

    def test_a_sample_at_the_location_itself_is_part_of_triangles(self) -> None:
        corners = np.array([(0.0, 0.0), (0.5, 0.1), (0.6, 0.7)])
        for order in itertools.permutations(range(3)):
            assert is_covered(corners[list(order)], 1.0)

    @given(seed=st.integers(0, 10**6))
    def test_samples_in_all_quadrants_cover(self, seed: int) -> None:
        """What section 3.3 takes for granted."""
        rng = np.random.default_rng(seed)
        radius, angle = np.sqrt(rng.random(4)), np.pi / 2 * (np.arange(4) + rng.random(4))
        xy = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        assert fills_quadrants(xy)
        assert is_covered(xy, 1.0)
        for missing in range(4):
            assert not fills_quadrants(np.delete(xy, missing, axis=0))


class TestTent:
    def test_falls_from_1_to_0(self) -> None:
        xy = np.array([(0.0, 0.0), (0.3, 0.4), (0.0, -1.0), (2.0, 0.0), (5.0, 0.0)])
        np.testing.assert_allclose(tent_weights(xy, 2.0), [1.0, 0.75, 0.5, 0.0, 0.0])

    def test_is_doubled_until_it_holds_a_sample(self) -> None:
        np.testing.assert_allclose(tent_weights(np.array([(3.0, 0.0), (0.0, 4.0)]), 0.5), [0.25, 0.0])
        np.testing.assert_allclose(tent_weights(np.array([(2.0, 0.0)]), 1.0), [0.5])

    def test_of_no_radius_takes_the_nearest_sample(self) -> None:
        xy = np.array([(0.5, 0.5), (0.0, 0.4), (1.0, 0.0)])
        np.testing.assert_array_equal(tent_weights(xy, 0.0), [0, 1, 0])


class TestOverhang:
    """A surface juts out beyond its outermost samples by a stated distance."""

    @pytest.mark.parametrize("turn", [0.0, 0.7, 2.0, 4.0])
    def test_moves_an_edge_outwards(self, turn: float) -> None:
        edge = np.array([(0.0, y) for y in (-0.9, -0.3, 0.3, 0.9)] + [(0.5, y) for y in (-0.6, 0.0, 0.6)])
        rotation = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
        rule = SurfaceRule(radius=1.0, along_lens=0.1, along_time=0.05, overhang=0.2)
        for distance in np.arange(0.01, 0.5, 0.02):
            xy = (np.array([distance, 0.0]) + edge) @ rotation
            assert not covers(xy, RULE)
            assert covers(xy, rule) == (distance < 0.2)

    @given(seed=st.integers(0, 10**6))
    def test_fills_no_holes_wider_than_itself(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        rule = SurfaceRule(radius=1.0, along_lens=0.1, along_time=0.05, overhang=0.1)
        xy = rng.uniform(-1.5, 1.5, (12, 2))
        xy[:, 0] = np.where(xy[:, 0] > 0, xy[:, 0] + 0.11, xy[:, 0])
        right = xy[xy[:, 0] > 0]
        assert not covers(right * (1, 0.01), rule)


class TestFindSurface:
    """Figure 6, and what happens where there are too few samples."""

    def test_one_surface(self) -> None:
        surface, tally = resolve(sights_of([(0.5, 0.2), (0.9, 0.0), (1.5, 0.0)], MIDDLE))
        assert surface is not None
        assert surface.sights.count == 2
        assert tally == {"locations": 1, "single": 1, "surfaces": 1}

    def test_a_front_surface_in_all_quadrants(self) -> None:
        samples = sights_of([*ring(4, 0.9), *ring(3, 0.2)], [FRONT] * 4 + [BACK] * 3)
        surface, tally = resolve(samples)
        assert surface is not None
        assert set(surface.sights.slope) == {FRONT}
        assert tally == {"locations": 1, "quadrants": 1, "surfaces": 2}

    def test_a_front_surface_with_a_triangle_within_r(self) -> None:
        samples = sights_of([*ring(3, 0.9), *ring(3, 0.2)], [FRONT] * 3 + [BACK] * 3)
        surface, tally = resolve(samples)
        assert surface is not None
        assert set(surface.sights.slope) == {FRONT}
        assert tally == {"locations": 1, "covered": 1, "surfaces": 2}

    def test_a_triangle_that_reaches_beyond_r(self) -> None:
        front = [(-0.9, 0.0), (0.8, 0.9), (0.9, -0.8), (0.8, 0.0)]
        samples = sights_of([*front, *ring(4, 0.2)], [FRONT] * 4 + [BACK] * 4)
        surface, tally = resolve(samples)
        assert surface is not None
        assert set(surface.sights.slope) == {FRONT}
        assert surface.sights.count == 4
        assert tally == {"locations": 1, "wide": 1, "covered": 1, "surfaces": 1}

    @pytest.mark.parametrize("nearest", [0.05, 0.5])
    def test_a_front_surface_beside_the_location_does_not_bloat(self, nearest: float) -> None:
        rng = np.random.default_rng(0)
        front = rng.uniform((nearest, -2), (2, 2), (40, 2))
        samples = sights_of([*front, *rng.uniform(-2, 2, (40, 2))], [FRONT] * 40 + [BACK] * 40)
        surface, tally = resolve(samples)
        assert surface is not None
        assert set(surface.sights.slope) == {BACK}
        assert tally == {"locations": 1, "wide": 1, "last": 1, "surfaces": 2}

    def test_the_middle_one_of_three(self) -> None:
        front = np.random.default_rng(0).uniform((0.2, -2), (2, 2), (30, 2))
        samples = sights_of([*front, *ring(7, 0.9), *ring(7, 0.5)], [FRONT] * 30 + [MIDDLE] * 7 + [BACK] * 7)
        surface, tally = resolve(samples)
        assert surface is not None
        assert set(surface.sights.slope) == {MIDDLE}
        assert tally == {"locations": 1, "wide": 1, "covered": 1, "surfaces": 2}

    def test_too_few_samples_are_blended_with_what_is_behind(self) -> None:
        """They join the next surface, and with that the next but one, until there are enough."""
        few = [(0.3, 0.1)], [(0.4, -0.2), (0.2, 0.2)]
        samples = sights_of([*few[0], *few[1], *ring(5, 0.8)], [FRONT, MIDDLE, MIDDLE, *[BACK] * 5])
        assert len(few[0]) + len(few[1]) < LEAST_SAMPLES
        surface, tally = resolve(samples)
        assert surface is not None
        assert surface.sights.count == 8
        assert tally == {"locations": 1, "wide": 1, "last": 1, "surfaces": 3, "merged": 2}

    @pytest.mark.parametrize(("distance", "tent"), [(1.5, 2.0), (3.0, 4.0), (7.9, 8.0)])
    def test_the_nearest_stand_in_where_none_is_near(self, distance: float, tent: float) -> None:
        surface, tally = resolve(sights_of(ring(6, distance), MIDDLE))
        assert surface is not None
        assert surface.sights.count == 6
        assert surface.tent == tent
        assert tally == {"locations": 1, "wide": 1, "last": 1, "surfaces": 1}

    def test_nothing(self) -> None:
        surface, tally = resolve(sights_of(ring(6, 8.1), MIDDLE))
        assert surface is None
        assert tally == {"locations": 1, "wide": 1, "empty": 1}

    def test_the_tent_scales(self) -> None:
        for distance, expected in ((0.5, 0.7), (3.0, 2.8)):
            surface, _ = resolve(sights_of(ring(6, distance), MIDDLE), SurfaceRule(1.0, 0.1, 0.05, tent=0.7))
            assert surface is not None
            assert surface.tent == pytest.approx(expected)
