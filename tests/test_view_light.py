"""The view-light Jacobian against finite differences, and densities against solid angles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fewrays import AreaLight, Projection
from fewrays.temporal.view_light import density, view_light_jacobian

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """A plane ``normal . P = offset`` that a camera sees at `xy`, and a light point that shines there."""

    projection: Projection
    light: AreaLight
    normal: Floats
    offset: float
    xy: Floats
    luv: Floats
    time: float

    def depth(self, xy: Floats) -> Floats:
        """Depth of the plane seen at `xy`, from the plane's equation alone."""
        rays = np.concatenate(
            [(xy - self.projection.center) / self.projection.focal, np.ones((len(xy), 1))], 1
        )
        return np.asarray(self.offset / (rays @ self.normal))

    def on_light_plane(self, xy: Floats) -> Floats:
        """Where rays to what is seen at `xy` meet Π, by intersecting lines with planes in camera space."""
        rays = np.concatenate(
            [(xy - self.projection.center) / self.projection.focal, np.ones((len(xy), 1))], 1
        )
        points = rays * self.depth(xy)[:, None]
        axes = self.light.axes
        start = self.light.points(self.luv, self.time)
        heights = (points - start) @ axes[2]
        met = start + (points - start) * (self.light.plane_distance / heights)[:, None]
        centre = np.array(self.light.center) + self.time * np.array(self.light.motion)
        return np.asarray((met - centre) @ axes[:2].T)

    def jacobian(self) -> Floats:
        """What is tested: of the only place."""
        return view_light_jacobian(*self.arguments())

    def arguments(self) -> tuple[Projection, AreaLight, Floats, Floats, Floats, Floats, float]:
        depth = self.depth(self.xy[None])[0]
        gradient = self.projection.depth_gradient(self.xy, depth, self.normal)
        return self.projection, self.light, self.xy, np.asarray(depth), gradient, self.luv, self.time


def unit(vector: npt.ArrayLike) -> Floats:
    vector = np.asarray(vector, np.float64)
    return np.asarray(vector / np.linalg.norm(vector))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """A random plane, camera, light and place, all of them well away from being seen edge-on."""

    def numbers(low: float, high: float, count: int) -> Floats:
        return np.array([draw(st.floats(low, high)) for _ in range(count)])

    projection = Projection(tuple(numbers(50, 500, 2)), tuple(numbers(-50, 150, 2)))
    xy = numbers(0, 100, 2)
    direction = np.append((xy - projection.center) / projection.focal, 1.0)
    normal = numbers(-1, 1, 3)
    assume(np.linalg.norm(normal) > 0.1)
    normal = unit(normal)
    assume(abs(normal @ unit(direction)) > 0.15)
    point = draw(st.floats(1, 10)) * direction
    u, other = numbers(-1, 1, 3), numbers(-1, 1, 3)
    assume(np.linalg.norm(np.cross(u, other)) > 0.1)
    half_u = draw(st.floats(0.05, 2)) * unit(u)
    half_v = draw(st.floats(0.05, 2)) * unit(np.cross(u, other))
    axis = unit(np.cross(half_u, half_v))
    motion = numbers(-1, 1, 3)
    time = draw(st.floats(0, 1))
    # The light's centre lies where the point is straight enough in front of it at that time.
    away = draw(st.floats(0.5, 8))
    center = point - away * axis - numbers(-3, 3, 1) * unit(half_u) - numbers(-3, 3, 1) * unit(half_v)
    light = AreaLight(
        tuple(center - time * motion),
        tuple(half_u),
        tuple(half_v),
        motion=tuple(motion),
        plane_distance=draw(st.floats(0.3, 5)),
    )
    luv = numbers(-1, 1, 2)
    assume(abs(normal @ unit(point - light.points(luv, time))) > 0.15)
    return Scene(projection, light, normal, float(normal @ point), xy, luv, time)


@given(scene=scenes())
def test_jacobian_is_the_finite_difference(scene: Scene) -> None:
    """Central differences with Richardson's extrapolation, whose error is of fourth order in the step."""

    def difference(step: float) -> Floats:
        offsets = step * np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
        seen = scene.on_light_plane(scene.xy + offsets)
        return np.stack([seen[0] - seen[1], seen[2] - seen[3]], axis=-1) / (2 * step)

    expected = (4 * difference(0.01) - difference(0.02)) / 3
    scale = np.abs(expected).max()
    np.testing.assert_allclose(scene.jacobian(), expected, rtol=0, atol=1e-6 * scale)


@given(scene=scenes())
def test_density_is_that_of_solid_angles(scene: Scene) -> None:
    """A pixel and its image on Π subtend angles that the surface's area and two cosines tie together.

    The surface within a pixel has the area ``r² dω / cos``; from the light point that is the solid angle
    ``area cos' / r'²``, and a solid angle Ω is an area ``Ω h² / cos³`` on a plane at the distance h.
    """
    direction = np.append((scene.xy - scene.projection.center) / scene.projection.focal, 1.0)
    distance = np.linalg.norm(direction) * scene.depth(scene.xy[None])[0]
    ray = unit(direction)
    pixel = ray[2] ** 3 / np.prod(scene.projection.focal)
    area = pixel * distance**2 / abs(ray @ scene.normal)
    from_light = distance * ray - scene.light.points(scene.luv, scene.time)
    away = np.linalg.norm(from_light)
    angle = area * abs(unit(from_light) @ scene.normal) / away**2
    on_plane = angle * scene.light.plane_distance**2 / (unit(from_light) @ scene.light.normal) ** 3
    np.testing.assert_allclose(density(*scene.arguments()) ** 2, on_plane, rtol=1e-9)


@given(scene=scenes(), factor=st.floats(0.2, 5))
def test_density_is_proportional_to_the_plane_distance(scene: Scene, factor: float) -> None:
    further = replace(scene, light=replace(scene.light, plane_distance=factor * scene.light.plane_distance))
    np.testing.assert_allclose(
        density(*further.arguments()), factor * density(*scene.arguments()), rtol=1e-12
    )


def test_the_light_that_faces_the_camera_sees_what_the_camera_sees() -> None:
    """A light at the lens centre, its plane one focal length away, sees pixels one unit apart."""
    projection = Projection((120.0, 120.0), (0.0, 0.0))
    light = AreaLight((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), plane_distance=120.0)
    xy = np.random.default_rng(1).uniform(-60, 60, (50, 2))
    depth = np.random.default_rng(2).uniform(1, 9, 50)
    gradient = np.random.default_rng(3).normal(size=(50, 2))
    jacobian = view_light_jacobian(projection, light, xy, depth, gradient)
    np.testing.assert_allclose(jacobian, np.broadcast_to(np.eye(2), (50, 2, 2)), atol=1e-12)


def test_arrays_give_what_single_places_give() -> None:
    rng = np.random.default_rng(4)
    projection = Projection((80.0, 90.0), (8.0, 6.0))
    light = AreaLight((0, -4, 5), (1, 0, 0), (0, 0, -0.5), motion=(0.5, 0.2, 0))
    xy, luv = rng.uniform(0, 16, (3, 4, 2)), rng.uniform(-1, 1, (3, 4, 2))
    depth, time = rng.uniform(3, 6, (3, 4)), rng.random((3, 4))
    gradient = rng.normal(size=(3, 4, 2))
    together = view_light_jacobian(projection, light, xy, depth, gradient, luv, time)
    assert together.shape == (3, 4, 2, 2)
    for at in np.ndindex(3, 4):
        one = view_light_jacobian(projection, light, xy[at], depth[at], gradient[at], luv[at], time[at])
        np.testing.assert_allclose(together[at], one, rtol=1e-14)


@pytest.mark.parametrize("depth", [5.0, 7.0])
def test_nothing_is_dense_behind_the_light(depth: float) -> None:
    """The light faces the camera: what is as far as it or farther gets no light."""
    projection = Projection((80.0, 80.0), (8.0, 6.0))
    light = AreaLight((0, 0, 5), (1, 0, 0), (0, -1, 0))
    assert density(projection, light, (8.0, 6.0), depth, (0.0, 0.0)) == 0
    assert density(projection, light, (8.0, 6.0), 4.0, (0.0, 0.0)) > 0
