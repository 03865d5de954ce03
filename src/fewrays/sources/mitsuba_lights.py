"""Light samples of Mitsuba scenes: what a ray from each area light to each camera sample's point meets.

For every camera sample and every rectangle or disc that glows, `LightTracer` traces one ray from a point of
the light to the point that the camera sees (temporal, section 5, Figure 8). Light that comes by any other way
is left to `fewrays.sources.mitsuba_unlit`.

The ray lies exactly on the line between the two points. It starts and ends where it is a little above the
light and above the surface (`_margin`), so that neither counts as its own blocker; and if nothing is in
between, the depth is that of the point itself, to the bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.errors import SampleError
from fewrays.lens import Lens
from fewrays.projection import Projection
from fewrays.sources.mitsuba_motion import MovingShapes
from fewrays.temporal.view_light import density

__all__ = ["FoundLight", "LightTracer", "View", "find_lights"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

_FLIP = np.diag([-1.0, -1.0, 1.0])  # from Mitsuba's camera space, x left and y up, to fewrays'
_SHAPES = {"Rectangle": "rectangle", "Disk": "disc"}
_LEAST_COSINE = 1e-5  # at the light; what it sends out flatter than that is nothing but rounding
_HORIZON = 1e-2  # cosine at the surface at which the BSDF is taken for light points below its horizon
_LARGEST_GRADIENT = 1e6  # slant of a surface, depth over world units across, that still counts as seen


@dataclasses.dataclass(frozen=True)
class FoundLight:
    """A light of the scene: what glows, its shape, and the same in numbers.

    ``mirrored`` tells that the light's v runs against the shape's own.
    """

    emitter: Any
    shape: Any
    area: AreaLight
    mirrored: bool


@dataclasses.dataclass(frozen=True)
class View:
    """The camera as light samples need it; ``to_world`` is Mitsuba's rigid 4 x 4 transform."""

    projection: Projection
    lens: Lens
    to_world: Float64

    def to_camera(self, vectors: Float64) -> Float64:
        """Return world directions (..., 3) in fewrays' camera space."""
        return np.asarray(vectors @ self.to_world[:3, :3] @ _FLIP)

    def points_to_camera(self, points: Float64) -> Float64:
        """Return world points (..., 3) in fewrays' camera space."""
        return self.to_camera(points - self.to_world[:3, 3])

    def points_to_world(self, points: Float64) -> Float64:
        """Return points (..., 3) of fewrays' camera space in the world."""
        return np.asarray(points @ _FLIP @ self.to_world[:3, :3].T + self.to_world[:3, 3])


def find_lights(mi: ModuleType, scene: Any, view: View, moving: MovingShapes | None) -> list[FoundLight]:
    """Find what can be sampled as an area light: rectangles and discs with an ``area`` emitter.

    Parameters
    ----------
    mi : module
        Mitsuba, with the variant active that the scene was loaded under.
    scene : mitsuba.Scene
        As the shutter opens.
    view : View
        The camera whose space the lights are described in.
    moving : MovingShapes, optional
        What moves while the shutter is open.

    Returns
    -------
    list of FoundLight
        At least one. Sheared rectangles are left out: they have no right angles.

    Raises
    ------
    SampleError
        When there is none, or when one moves in another way than being shifted.
    """
    box = scene.bbox()
    middle = np.array([float(x) for x in box.center()]) if box.valid() else np.zeros(3)
    lights = []
    for emitter in scene.emitters():
        shape = emitter.get_shape()
        if emitter.class_name() != "AreaLight" or shape.class_name() not in _SHAPES:
            continue
        place = np.array(mi.traverse(shape)["to_world"].matrix, np.float64).reshape(4, 4)
        unit = place[:3, :3] / np.linalg.norm(place[:3, :3], axis=0)
        if not np.allclose(unit.T @ unit, np.eye(3), atol=1e-4):
            continue
        shift = np.zeros(3) if moving is None else moving.shift_of(shape)
        lights.append(_found(emitter, shape, place, shift, middle, view))
    if not lights:
        raise SampleError(
            "the scene has no rectangle and no disc with an 'area' emitter: add one, or leave lighting out",
            field="lighting",
        )
    return lights


def _found(
    emitter: Any, shape: Any, place: Float64, shift: Float64, middle: Float64, view: View
) -> FoundLight:
    half_u, half_v, normal = place[:3, :3].T
    mirrored = bool(np.cross(half_u, half_v) @ normal < 0)
    size = max(np.linalg.norm(half_u), np.linalg.norm(half_v))
    area = AreaLight(
        center=_vector(view.points_to_camera(place[:3, 3])),
        half_u=_vector(view.to_camera(half_u)),
        half_v=_vector(view.to_camera(-half_v if mirrored else half_v)),
        shape="rectangle" if _SHAPES[shape.class_name()] == "rectangle" else "disc",
        motion=_vector(view.to_camera(shift)),
        # Π through the middle of the scene, where shadows fall: neither slopes nor densities get extreme.
        plane_distance=float(max(size, (middle - place[:3, 3]) @ (normal / np.linalg.norm(normal)))),
    )
    return FoundLight(emitter, shape, area, mirrored)


def _vector(array: Float64) -> tuple[float, float, float]:
    x, y, z = array.tolist()
    return x, y, z


@dataclasses.dataclass(frozen=True)
class LightTracer:
    """Traces light samples for batches of camera samples.

    Parameters
    ----------
    mi : module
        Mitsuba, with the variant active that the scene was loaded under.
    scene : mitsuba.Scene
        In the pose of the batch's instant.
    view : View
        The camera.
    lights : sequence of FoundLight
        What to trace rays from.
    moving : MovingShapes or None
        What moves, in the pose of the batch's instant.
    """

    mi: ModuleType
    scene: Any
    view: View
    lights: Sequence[FoundLight]
    moving: MovingShapes | None

    def trace(
        self, hit: Any, ray: Any, xy: Float32, uv: Float32, depth: Float32, time: float, luv: Float32
    ) -> dict[str, Float32]:
        """Trace one ray from each light to what each of N camera rays has hit.

        Parameters
        ----------
        hit : mitsuba.PreliminaryIntersection3f
            Of N camera rays.
        ray : mitsuba.Ray3f
            Those rays.
        xy, uv : ndarray, (N, 2)
            Their image and lens positions.
        depth : ndarray, (N,)
            Planar depths of the hits.
        time : float
            In [0, 1] over the shutter, that of the present pose.
        luv : ndarray, (N, L, 2)
            Where on each of the L lights its ray starts.

        Returns
        -------
        dict
            ``normal`` (N, 3), ``depth_gradient`` (N, 2), and for each of the lights ``light<k>.<name>`` with
            the names of `fewrays.LightSamples`; everything float32.
        """
        mi, view = self.mi, self.view
        si = hit.compute_surface_interaction(ray, mi.RayFlags.All, hit.is_valid())
        valid = np.asarray(si.is_valid())
        # As `Lighting.points` has it, to the bit: depths are compared with those of these very points.
        seen = xy - view.lens.slope(depth.astype(np.float64))[:, None] * uv
        points = view.projection.points(seen, depth)
        facing = np.where(np.asarray(si.wi.z) < 0, -1.0, 1.0)
        normal, geometric = np.tile([0.0, 0.0, -1.0], (2, len(xy), 1))
        geometric[valid] = view.to_camera(_rows(si.n)[valid])
        normal[valid] = facing[valid, None] * view.to_camera(_rows(si.sh_frame.n)[valid])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        gradient = np.where(valid[:, None], _depth_gradient(view.projection, points, geometric), 0.0)
        surface = _Surface(si, hit, ray, valid, points, geometric, facing, seen, depth, gradient)
        arrays = {"normal": normal, "depth_gradient": gradient}
        for number, light in enumerate(self.lights):
            for name, values in self._trace_light(light, surface, time, luv[:, number]).items():
                arrays[f"light{number}.{name}"] = values
        return {name: np.asarray(values, np.float32) for name, values in arrays.items()}

    def _trace_light(
        self, light: FoundLight, surface: _Surface, time: float, luv: Float32
    ) -> dict[str, npt.NDArray[Any]]:
        area = light.area
        start = area.points(luv, time)
        lxy, receiver = area.project(surface.points, luv, time)
        way = surface.points - start
        distance = np.linalg.norm(way, axis=1)
        cosine = receiver / np.maximum(distance, np.finfo(np.float64).tiny)
        aimed = surface.valid & (cosine > _LEAST_COSINE) & (receiver.astype(np.float32) > 0)
        rho = density(self.view.projection, area, surface.seen, surface.depth, surface.gradient, luv, time)
        aimed &= np.isfinite(rho.astype(np.float32)) & (rho > 0) & np.isfinite(lxy).all(axis=1)
        distance, cosine = (np.where(aimed, values, 1.0) for values in (distance, cosine))
        way = way / distance[:, None]

        fraction, blocker, ray = self._first_hit(surface, start, way, distance, cosine, aimed)
        nothing = np.zeros((len(luv), 3))
        arrays: dict[str, npt.NDArray[Any]] = {
            "lxy": np.where(aimed[:, None], lxy, 0.0),
            "luv": luv,
            "depth": np.where(aimed, receiver * fraction, 1.0),
            "radiance": np.where(aimed[:, None], self._emitted(light, luv, time, way), nothing),
            "density": np.where(aimed, rho, 0.0),
            "reflectance": np.where(aimed[:, None], self._scattered(surface, way), nothing),
        }
        if self.moving is not None:
            travelled = self.moving.displacement(surface.hit, surface.ray)
            travelled = np.where(fraction[:, None] < 1, self.moving.displacement(blocker, ray), travelled)
            moved = (self.view.to_camera(travelled) - area.motion) @ area.axes.T
            moved *= [area.plane_distance, area.plane_distance, 1.0]
            arrays["motion"] = np.where(aimed[:, None], moved, nothing)
        return arrays

    def _first_hit(
        self,
        surface: _Surface,
        start: Float64,
        way: Float64,
        distance: Float64,
        cosine: Float64,
        aimed: npt.NDArray[np.bool_],
    ) -> tuple[Float64, Any, Any]:
        """Return which share (N,) of its way each ray from the light gets, 1 if all; the hits, and the rays.

        `way` are unit vectors from the light to the surface, `cosine` those to the light's normal.
        """
        mi = self.mi
        ends = np.abs(np.einsum("nc,nc->n", way, surface.geometric))
        margins = [
            np.minimum(_margin(mi, self.view.points_to_world(end)) / np.maximum(slant, 1e-9), 0.49 * distance)
            for end, slant in ((start, cosine), (surface.points, ends))
        ]
        ray = self._ray(start + margins[0][:, None] * way, way)
        ray.maxt = mi.Float((distance - sum(margins)).astype(np.float32))
        hit = self.scene.ray_intersect_preliminary(ray, True, active=mi.Bool(aimed))
        blocked = np.asarray(hit.is_valid()) & aimed
        reached = np.where(blocked, margins[0] + np.asarray(hit.t, np.float64), distance)
        return reached / distance, hit, ray

    def _emitted(self, light: FoundLight, luv: Float32, time: float, way: Float64) -> Float32:
        """Return radiance (N, 3) that leaves the light at `luv` along unit vectors `way` (N, 3)."""
        import drjit as dr

        mi, area = self.mi, light.area
        # Not through Mitsuba's own sampling: its texture coordinates on discs are others than those of hits.
        u, v = luv[:, 0].astype(np.float64), luv[:, 1] * (-1.0 if light.mirrored else 1.0)
        if area.shape == "disc":
            u, v = np.hypot(u, v), np.arctan2(v, u) / (2 * np.pi) % 1
        else:
            u, v = (u + 1) / 2, (v + 1) / 2
        si = dr.zeros(mi.SurfaceInteraction3f, len(luv))
        si.t = mi.Float(np.ones(len(luv), np.float32))
        si.p = mi.Point3f(self.view.points_to_world(area.points(luv, time)).T.astype(np.float32))
        si.n = mi.Normal3f(*self._to_world(area.normal).tolist())
        si.sh_frame = mi.Frame3f(si.n)
        si.uv = mi.Point2f(np.stack([u, v]).astype(np.float32))
        si.wi = si.to_local(mi.Vector3f(self._to_world(way).T.astype(np.float32)))
        si.shape = mi.ShapePtr(light.shape)
        return np.asarray(mi.Color3f(light.emitter.eval(si)), np.float32).T

    def _scattered(self, surface: _Surface, way: Float64) -> Float64:
        """Return BSDF values (N, 3) from the light's direction to the camera.

        Below the horizon, where the cosine beside it makes nothing of it, the value near the horizon stands
        in, so that filters over neighbouring samples find no hole.
        """
        mi, si = self.mi, surface.si
        towards = _rows(si.to_local(mi.Vector3f(-self._to_world(way).T.astype(np.float32))))
        towards[:, 2] *= surface.facing
        below = towards[:, 2] <= 0
        towards[below] = _at_the_horizon(towards[below])
        cosine = towards[:, 2:].copy()
        towards[:, 2] *= surface.facing
        wo = mi.Vector3f(towards.T.astype(np.float32))
        value = si.bsdf(surface.ray).eval(mi.BSDFContext(), si, wo, si.is_valid())
        value = np.asarray(value, np.float64).T / np.maximum(cosine, np.finfo(np.float32).tiny)
        return np.asarray(np.where(surface.valid[:, None], value, 0.0))

    def _ray(self, points: Float64, directions: Float64) -> Any:
        """Return Mitsuba's rays from points (N, 3) along directions (N, 3), both in camera space."""
        mi = self.mi
        origin = mi.Point3f(self.view.points_to_world(points).T.astype(np.float32))
        return mi.Ray3f(origin, mi.Vector3f(self._to_world(directions).T.astype(np.float32)))

    def _to_world(self, directions: Float64) -> Float64:
        return np.asarray(directions @ _FLIP @ self.view.to_world[:3, :3].T)


@dataclasses.dataclass(frozen=True)
class _Surface:
    """What N camera rays have hit: Mitsuba's account of it, and positions in camera space.

    ``facing`` is 1 where the camera sees the side that the shading normal points to, else -1. ``seen`` are
    image positions from the lens centre.
    """

    si: Any
    hit: Any
    ray: Any
    valid: npt.NDArray[np.bool_]
    points: Float64
    geometric: Float64
    facing: Float64
    seen: Float64
    depth: Float32
    gradient: Float64


def _at_the_horizon(directions: Float64) -> Float64:
    """Return unit vectors (N, 3) of the same bearings, as little above the horizon as `_HORIZON` says."""
    flat = np.linalg.norm(directions[:, :2], axis=1)
    straight = flat == 0  # down: any bearing will do
    across = np.where(straight[:, None], [1.0, 0.0], directions[:, :2]) / np.where(straight, 1, flat)[:, None]
    up = np.full((len(directions), 1), _HORIZON)
    return np.concatenate([across * np.sqrt(1 - _HORIZON**2), up], axis=1)


def _depth_gradient(projection: Projection, points: Float64, normal: Float64) -> Float64:
    """Return how the depth (N, 2) of tangent planes changes per pixel, as the lens centre sees them.

    The plane through P with normal n has along the ray (x', y', 1) the depth n·P / n·(x', y', 1). Its
    derivative is -Z n_x / (n·P/Z) per unit of x', and one pixel is 1 / focal of that.
    """
    across = np.einsum("nc,nc->n", normal, points) / points[:, 2]
    least = np.linalg.norm(normal, axis=1) / _LARGEST_GRADIENT
    across = np.copysign(np.maximum(np.abs(across), least), across)
    return np.asarray(-points[:, 2:] * normal[:, :2] / (across[:, None] * projection.focal))


def _margin(mi: ModuleType, points: Float64) -> Float64:
    """Return how far (N,) rays keep from surfaces at world points (N, 3).

    A quarter of what Mitsuba keeps, whose rays begin beside the point; these would miss more of what touches
    the surface, as they are cut short where they come in flat.
    """
    return np.asarray((1 + np.abs(points).max(axis=1)) * float(mi.math.RayEpsilon) / 4)


def _rows(vector: Any) -> Float64:
    """Return a Dr.Jit vector as rows (N, 3)."""
    return np.asarray(vector, np.float64).T.copy()
