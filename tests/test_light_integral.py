"""Integrals over a light against closed forms and against counting: shapes, outlines and what they hide."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from fewrays import AreaLight, SampleError
from fewrays.sources.light_integral import irradiance, overlap, ramp, segment, visible_share
from fewrays.sources.opaque_shapes import Ball, Column, Shape, Sheet, box
from fewrays.sources.outlines import Bars, Disc, HalfPlane, Outline, Rectangle
from shadow_scenes import level

Floats = npt.NDArray[np.float64]

ABOVE = 3.0  # height of the light over the floor y = 0
DOWN = AreaLight((0, ABOVE, 0), (1, 0, 0), (0, 0, 1))
DISC = replace(DOWN, shape="disc")
UP = np.array([0.0, 1.0, 0.0])


def floor_points(x: npt.ArrayLike, z: float = 0.0) -> Floats:
    x = np.asarray(x, np.float64)
    return np.stack([x, np.zeros_like(x), np.full_like(x, z)], axis=-1)


def lambert(corners: Floats, point: Floats, normal: Floats) -> float:
    """Irradiance from a polygon of radiance 1, all of it above the horizon: Lambert's formula."""
    away = corners - point
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    following = np.roll(away, -1, axis=0)
    edges = np.cross(away, following)
    lengths = np.maximum(np.linalg.norm(edges, axis=-1), 1e-300)
    angles = np.arctan2(lengths, (away * following).sum(axis=-1))
    return 0.5 * abs(float((angles / lengths * (edges @ normal)).sum()))


def clip(corners: Floats, point: Floats, normal: Floats) -> Floats:
    """Cut a polygon off at a plane, keeping the side that the normal points to."""
    kept: list[Floats] = []
    for here, there in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        a, b = (here - point) @ normal, (there - point) @ normal
        if a >= 0:
            kept.append(here)
        if a * b < 0:
            kept.append(here + (there - here) * a / (a - b))
    return np.array(kept).reshape(-1, 3)


def corners_of(light: AreaLight) -> Floats:
    return light.points(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]))


class TestPenumbrae:
    """Occluders parallel to the light: their edges on the light, from a point, are magnified edges."""

    height = 1.2
    magnified = ABOVE / height
    x = np.linspace(-2, 2, 41)

    def test_half_plane_and_rectangle(self) -> None:
        light = replace(DOWN, half_u=(0.8, 0, 0), half_v=(0, 0, 0.5))
        shapes = [level(0), level(self.height, HalfPlane((0.2, 0), (-1, 0)))]
        share = visible_share(shapes, light, floor_points(self.x, 0.3))
        edge = self.x + (0.2 - self.x) * self.magnified
        np.testing.assert_allclose(share, 1 - ramp(edge / 0.8), atol=1e-4)
        assert share.min() == 0
        assert share.max() == pytest.approx(1, abs=1e-12)

    @pytest.mark.parametrize("direction", [0.0, 0.7, 2.0])
    def test_half_plane_and_disc(self, direction: float) -> None:
        towards = (math.cos(direction), math.sin(direction))
        shapes = [level(0), level(self.height, HalfPlane((0, 0), towards))]
        points = floor_points(self.x, 0.3)
        share = visible_share(shapes, DISC, points)
        along = points[:, 0] * towards[0] - points[:, 2] * towards[1]
        np.testing.assert_allclose(share, segment(along - along * self.magnified), atol=1e-4)

    @pytest.mark.parametrize("radius", [0.2, 0.4, 0.7])
    def test_disc_and_disc(self, radius: float) -> None:
        shapes = [level(0), level(self.height, Disc((0.1, 0), radius))]
        points = floor_points(self.x)
        share = visible_share(shapes, DISC, points)
        middle = points[:, ::2] + (np.array([0.1, 0.0]) - points[:, ::2]) * self.magnified
        hidden = overlap(np.linalg.norm(middle, axis=-1), radius * self.magnified)
        np.testing.assert_allclose(share, 1 - hidden, atol=1e-4)
        assert hidden.max() == pytest.approx(min(1, (radius * self.magnified) ** 2), abs=0.05)

    def test_an_edge_along_the_slices(self) -> None:
        """What is a jump across the slices takes no more than more of them."""
        from fewrays.sources import light_integral

        across = (-math.sin(light_integral._SKEW), math.cos(light_integral._SKEW))
        plane = HalfPlane((0, 0), (across[0], -across[1]))
        points = floor_points(self.x)
        share = visible_share([level(self.height, plane)], DISC, points)
        edge = points[:, 0] * across[0] * (1 - self.magnified)
        np.testing.assert_allclose(share, segment(edge), atol=1e-4)

    def test_closed_forms_by_hand(self) -> None:
        np.testing.assert_allclose(ramp([-2, -1, 0, 0.5, 3]), [0, 0, 0.5, 0.75, 1])
        np.testing.assert_allclose(segment([-1, 0, 2]), [0, 0.5, 1], atol=1e-15)
        # A circle of radius sqrt 2 around a point of the unit circle: Hippocrates' lune holds area 1 of it.
        np.testing.assert_allclose(overlap(1.0, math.sqrt(2)), 1 - 1 / math.pi)
        np.testing.assert_allclose(overlap([0, 0.4, 2.5], 0.5), [0.25, 0.25, 0])
        np.testing.assert_allclose(overlap([0, 0.5], 1.5), 1)


class TestIrradiance:
    def test_a_disc_overhead(self) -> None:
        """On its axis a disc gives the irradiance π R² / (R² + h²)."""
        points = np.array([[0, 0, 0], [0, 1, 0], [0, 2.5, 0]], np.float64)
        exact = np.pi / (1 + (ABOVE - points[:, 1]) ** 2)
        np.testing.assert_allclose(
            irradiance([], DISC, points, np.broadcast_to(UP, points.shape)), exact, rtol=2e-5
        )

    def test_none_behind_the_light_or_the_surface(self) -> None:
        points = np.array([[0, 4, 0], [0, 0, 0], [0.5, 3.0, 0]], np.float64)
        normals = np.array([UP, -UP, -UP])
        np.testing.assert_array_equal(irradiance([], DOWN, points, normals), 0)

    @given(
        x=st.floats(-2, 2),
        z=st.floats(-2, 2),
        tilt=st.tuples(*[st.floats(-0.6, 0.6)] * 2),
        lamp=st.tuples(*[st.floats(-0.5, 0.5)] * 2),
        edge=st.floats(-1, 1),
        turn=st.floats(0, 6.3),
        shape=st.sampled_from(["half-plane", "rectangle"]),
    )
    @example(x=0, z=-0.5625, tilt=(0, 0), lamp=(0.5, 0.4375), edge=0, turn=0, shape="half-plane")
    def test_tilted_edges_before_tilted_rectangles(
        self,
        x: float,
        z: float,
        tilt: tuple[float, float],
        lamp: tuple[float, float],
        edge: float,
        turn: float,
        shape: str,
    ) -> None:
        """The part of a polygon that is seen past a straight edge is a polygon: in the example, a corner."""
        normal = np.array([tilt[0], 1.0, tilt[1]])
        normal /= np.linalg.norm(normal)
        along = np.cross(normal, [math.cos(turn), 0.0, math.sin(turn)])
        along /= np.linalg.norm(along)
        half_u = np.array([1.0, lamp[0], 0.0])
        half_v = 0.6 * np.cross([lamp[1], -1.0, -lamp[1]], half_u)
        light = AreaLight((0.3, 3, 0), (1.0, lamp[0], 0.0), (half_v[0], half_v[1], half_v[2]))
        assume(light.normal[1] < -0.3)
        point = np.array([x, 0.0, z])
        corners = corners_of(light)
        assume((corners[:, 1] > 1.5).all())
        assume(light.to_light_space(point)[2] > 0.1)
        origin = np.array([0.1, 1.0, 0.0])
        outline: Outline = HalfPlane((edge, 0), (1, 0))
        if shape == "rectangle":
            outline = Rectangle((edge, 0.1), (0.3, 0.4))
        occluder = Sheet((0.1, 1.0, 0.0), tuple(normal), tuple(along), outline)
        # The line of sight passes the sheet between point and light, not beside them.
        assume((point - origin) @ normal < -0.1)
        assume(((corners - origin) @ normal > 0.1).all())

        def behind(corners: Floats, value: float, axis: Floats, sign: float) -> Floats:
            """What is seen through the half of the sheet's plane where ``sign (axis - value) > 0``."""
            on_edge = origin + value * axis
            direction = np.cross(normal, axis)
            plane = np.cross(on_edge - point, direction)
            inside = on_edge + sign * axis - point
            return clip(corners, point, plane * np.sign(plane @ inside))

        hidden = corners
        if shape == "half-plane":
            hidden = behind(hidden, edge, along, 1)
        else:
            second = np.cross(normal, along)
            for axis, middle, half in ((along, edge, 0.3), (second, 0.1, 0.4)):
                for sign in (-1.0, 1.0):
                    if len(hidden):
                        hidden = behind(hidden, middle + sign * half, axis, -sign)
        full = lambert(corners, point, UP)
        expected = full - (lambert(hidden, point, UP) if len(hidden) > 2 else 0.0)
        actual = irradiance([level(0), occluder], light, point[None], UP[None])
        np.testing.assert_allclose(actual, expected, atol=2e-4 * max(full, 1e-2))

    def test_each_at_its_own_time(self) -> None:
        """A moving light over a still edge, a still light over a moving one, both moving alike."""
        times = np.linspace(0, 1, 7)
        points = floor_points(np.full(7, 0.3))
        still = level(1.0, HalfPlane((0, 0), (-1, 0)))
        moving = replace(still, motion=(0.4, 0.0, 0.0))
        light = replace(DISC, motion=(0.4, 0.0, 0.0))
        for shape, lamp, start, edge in (
            (still, light, 0.4 * times, 0 * times),
            (moving, DISC, 0 * times, 0.4 * times),
            (moving, light, 0.4 * times, 0.4 * times),
        ):
            share = visible_share([shape], lamp, points, times)
            seen_edge = 0.3 + (edge - 0.3) * ABOVE - start
            np.testing.assert_allclose(share, 1 - segment(seen_edge), atol=1e-4)


SHAPES: list[Shape] = [
    level(1.0),
    Sheet((0, 1, 0), (0.2, 1, 0.1), (1, -0.2, 0), HalfPlane((0.1, 0.2), (1, 2))),
    level(1, Rectangle((0.1, 0.0), (0.5, 0.3))),
    Sheet((0, 1, 0), (0.3, 1, 0), (0, 0, 1), Disc((0.1, 0.2), 0.6)),
    level(1, Bars(3, 0.4, 0.4, (0.1, 0), (1, 1))),
    Ball((0.1, 1.2, 0), 0.5),
    Column((0, 1.1, 0), (1, 0.3, 0.2), 0.4),
    Ball((0.1, 1.2, 0), 0.5, motion=(0.5, 0.1, 0)),
]


@pytest.mark.parametrize("shape", SHAPES)
@settings(max_examples=25)
@given(
    eye=st.tuples(st.floats(-1, 1), st.floats(-0.5, 0.3), st.floats(-1, 1)),
    start=st.tuples(st.floats(-2, 2), st.floats(2, 3), st.floats(-2, 2)),
    step=st.tuples(st.floats(-3, 3), st.floats(-1, 1), st.floats(-3, 3)),
    time=st.floats(0, 1),
)
def test_nothing_comes_into_sight_unannounced(
    shape: Shape,
    eye: tuple[float, float, float],
    start: tuple[float, float, float],
    step: tuple[float, float, float],
    time: float,
) -> None:
    assume(np.linalg.norm(step) > 0.1)
    s = np.linspace(0, 1, 400)
    targets = np.array(start) + s[:, None] * np.array(step)
    hidden = shape.hit(targets, np.array(eye) - targets, np.full(400, time)) < 1
    changes = np.flatnonzero(hidden[1:] != hidden[:-1])
    crossings = shape.crossings(np.array([eye]), np.array([start]), np.array([step]), np.array([time]))[0]
    for change in changes:
        near = (crossings >= s[change] - 1e-6) & (crossings <= s[change + 1] + 1e-6)
        assert near.any(), (s[change], crossings)


@pytest.mark.parametrize("shape", SHAPES)
def test_hits_lie_on_the_shape_and_normals_stand_on_it(shape: Shape) -> None:
    rng = np.random.default_rng(1)
    origin = rng.uniform(-1.5, 1.5, (3000, 3)) + 3 * UP
    direction = rng.uniform(-1, 1, (3000, 3)) + UP - origin
    time = rng.random(3000)
    distance = shape.hit(origin, direction, time)
    hit = np.isfinite(distance)
    assert hit.sum() > 50
    origin, direction, time, distance = origin[hit], direction[hit], time[hit], distance[hit]
    points = origin + distance[:, None] * direction
    normals = shape.normals(points, time)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=1e-9)
    # Nearby rays hit points that differ along the surface only.
    nudged = direction + 1e-6 * rng.normal(size=direction.shape)
    beside = origin + shape.hit(origin, nudged, time)[:, None] * nudged
    same = np.linalg.norm(beside - points, axis=-1) < 1e-4
    assert same.mean() > 0.95
    np.testing.assert_allclose(((beside - points) * normals).sum(axis=-1)[same], 0, atol=1e-7)
    # A ray that starts a little before the hit finds it there.
    again = shape.hit(points - 1e-3 * direction, direction, time)
    np.testing.assert_allclose(again, 1e-3, rtol=1e-6)


def test_round_shapes_by_hand() -> None:
    down = np.array([[0.0, -1.0, 0.0]])
    above = np.array([[0.0, 5.0, 0.0]])
    np.testing.assert_allclose(Ball((0, 1, 0), 0.5).hit(above, down), 3.5)
    np.testing.assert_allclose(Column((0, 1, 7), (0, 0, 2), 0.5).hit(above, down), 3.5)
    np.testing.assert_allclose(Ball((0, 1, 0), 0.5).hit(np.array([[0.0, 1.0, 0.0]]), down), 0.5)
    assert np.isinf(Ball((0, 1, 0), 0.5).hit(above, -down)).all()
    assert np.isinf(level(1.0).hit(above, np.array([[1.0, 0.0, 0.0]]))).all()


def test_a_box_is_closed_but_below() -> None:
    sides = box((0.2, 0, -0.3), (0.4, 0.3), 0.8, turn=25)
    rng = np.random.default_rng(2)
    inside = np.array([0.2, 0.4, -0.3])
    ways = rng.normal(size=(2000, 3))
    reach = np.min([side.hit(np.broadcast_to(inside, ways.shape), ways) for side in sides], axis=0)
    upwards = ways[:, 1] > -0.5 * np.abs(ways[:, 0]) - 0.5 * np.abs(ways[:, 2])
    assert np.isfinite(reach[upwards]).all()
    assert np.isinf(reach[(ways[:, 1] < 0) & (np.hypot(ways[:, 0], ways[:, 2]) < -0.5 * ways[:, 1])]).all()
    from_above = np.broadcast_to([0.2, 3.0, -0.3], (1, 3))
    assert min(float(side.hit(from_above, np.array([[0.0, -1.0, 0.0]]))[0]) for side in sides) == 2.2


def test_outlines_by_hand() -> None:
    places = np.array([[0.0, 0.0], [0.6, 0.0], [1.1, 0.0], [0.0, 0.9]])
    np.testing.assert_array_equal(Disc((0, 0), 1).contains(places), [True, True, False, True])
    np.testing.assert_array_equal(HalfPlane((0.5, 0), (1, 0)).contains(places), [False, True, True, False])
    np.testing.assert_array_equal(Rectangle((0, 0), (1, 0.5)).contains(places), [True, True, False, False])
    bars = Bars(2, 1.0, 0.5)
    np.testing.assert_array_equal(bars.contains(places), [False, True, False, False])
    along = np.stack([np.linspace(-3, 3, 60001), np.zeros(60001)], axis=-1)
    assert bars.contains(along).mean() == pytest.approx(1 / 6, abs=1e-4)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Disc((0, 0), 0.0), "radius"),
        (lambda: Rectangle((0, 0), (1.0, -1.0)), "half_size"),
        (lambda: HalfPlane((0, 0), (0.0, 0.0)), "towards"),
        (lambda: Bars(0, 1.0), "count"),
        (lambda: Bars(2, 1.0, 1.0), "fill"),
        (lambda: Ball((0, 0, 0), math.inf), "radius"),
        (lambda: Column((0, 0, 0), (0, 0, 0), 1.0), "axis"),
        (lambda: Sheet((0, 0, 0), (0, 1, 0), (0, 1, 1)), "along"),
        (lambda: Sheet((0, 0, 0), (0, math.nan, 0), (0, 1, 1)), "facing"),
    ],
)
def test_shapes_that_are_none(make: object, field: str) -> None:
    assert callable(make)
    with pytest.raises(SampleError, match=rf"^{field}: "):
        make()
