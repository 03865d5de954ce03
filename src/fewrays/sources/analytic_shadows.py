"""Scenes whose soft shadows are known: matte shapes under area lights, seen through a thin lens.

Sheets, balls and columns, still or moving, stand in the light of rectangles and discs. Each is a receiver
and an occluder; some may be out of the camera's sight and still cast shadows. `render_lit` makes the few
samples that a method reconstructs from, one light sample for each camera sample and light; `true_image` the
image that it should arrive at, whose light is integrated without noise (`fewrays.sources.light_integral`).

World space is right-handed with +y up. The camera turns it into camera space, x right, y down, z forward.

Examples
--------
A floor, and the shadow of a disc above it, seen from the side:

>>> floor = Sheet((0, 0, 0), (0, 1, 0), (1, 0, 0))
>>> blocker = Sheet((0, 1, 0), (0, 1, 0), (1, 0, 0), Disc((0, 0), 0.5))
>>> lamp = aimed((0, 4, 0), (0, 0, 0), (1, 1), "disc", radiance=(5.0, 5.0, 5.0))
>>> camera = Camera(24, 32, position=(0, 3, 5), target=(0, 0, 0))
>>> scene = Scene(camera, [floor, blocker], [lamp])
>>> samples = render_lit(scene, 4)
>>> samples.lighting
Lighting(32 x 24 pixels, 4 spp, 1 lights)
>>> true_image(scene).shape
(24, 32, 3)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight, LightShape
from fewrays.errors import SampleError, require_option
from fewrays.lens import Lens, Sampling
from fewrays.light_samples import LightSamples
from fewrays.lighting import Lighting
from fewrays.method import Image
from fewrays.projection import Projection
from fewrays.samples import SampleBuffer
from fewrays.sources.light_integral import GRAZE, irradiance
from fewrays.sources.opaque_shapes import Ball, Column, Shape, Sheet, box, unit
from fewrays.sources.outlines import Bars, Disc, HalfPlane, Rectangle
from fewrays.sources.patterns import sample_lights, sample_pattern, sample_times
from fewrays.temporal.view_light import density

__all__ = [
    "AreaLight",
    "Ball",
    "Bars",
    "Camera",
    "Column",
    "Disc",
    "HalfPlane",
    "Lamp",
    "Rectangle",
    "Scene",
    "Sheet",
    "aimed",
    "box",
    "render_lit",
    "true_image",
    "true_radiance",
]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Vector = tuple[float, float, float]

_BACKGROUND_DEPTH = 1e4  # in distances to the target
_EDGE_ON = 1e-6  # cosine below which a depth gradient is that of a surface a little less steep


@dataclass(frozen=True)
class Camera:
    """A thin lens at a place in the world.

    Parameters
    ----------
    height, width : int
        Image size in pixels.
    position, target : (float, float, float)
        Where the lens centre is, and a point on the optical axis.
    up : (float, float, float)
        What is upright on the image; not parallel to the optical axis.
    fov : float
        Horizontal angle of view in degrees.
    lens_radius : float
        In world units; 0 is a pinhole.
    focus_distance : float, optional
        Depth of the focal plane; that of the target when omitted.

    Raises
    ------
    SampleError
        For a target at the lens, an `up` along the optical axis, and what `Lens.thin_lens` rejects.
    """

    height: int
    width: int
    position: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov: float = 40.0
    lens_radius: float = 0.0
    focus_distance: float | None = None

    def __post_init__(self) -> None:
        if np.linalg.norm(np.cross(self.axes[2], unit("up", self.up))) < 1e-6:
            raise SampleError(f"{self.up} is parallel to the optical axis; choose another", field="up")

    @cached_property
    def distance(self) -> float:
        """Distance from the lens centre to the target."""
        return float(np.linalg.norm(np.subtract(self.target, self.position)))

    @cached_property
    def axes(self) -> Floats:
        """Camera space's x, y and z in world space: the rows of a rotation ``(3, 3)``."""
        forward = unit("target", np.subtract(self.target, self.position))
        right = np.cross(forward, unit("up", self.up))
        right /= max(float(np.linalg.norm(right)), 1e-30)
        return np.stack([right, np.cross(forward, right), forward])

    @cached_property
    def projection(self) -> Projection:
        """How the lens centre sees camera space."""
        return Projection.from_fov(self.width, self.height, self.fov)

    @cached_property
    def lens(self) -> Lens:
        """The lens in image units."""
        focus = self.distance if self.focus_distance is None else self.focus_distance
        return Lens.thin_lens(self.width, focus_distance=focus, fov=self.fov, lens_radius=self.lens_radius)

    def rays(self, xy: Floats, uv: Floats) -> tuple[Floats, Floats]:
        """Return rays in world space through image positions and lens positions ``(..., 2)``.

        Returns
        -------
        origin, direction : ndarray, (..., 3)
            A ray reaches the depth z at ``origin + z direction``.
        """
        focal, center = np.asarray(self.projection.focal), np.asarray(self.projection.center)
        zeros, ones = np.zeros((*xy.shape[:-1], 1)), np.ones((*xy.shape[:-1], 1))
        # The lens centre sees the ray's point of depth z at xy - (c0 / z + c1) uv: linear in z when z is
        # multiplied in.
        at_lens = np.concatenate([-self.lens.c0 * uv / focal, zeros], axis=-1)
        per_depth = np.concatenate([(xy - center - self.lens.c1 * uv) / focal, ones], axis=-1)
        return at_lens @ self.axes + np.asarray(self.position), per_depth @ self.axes

    def to_camera(self, points: npt.ArrayLike) -> Floats:
        """Return points ``(..., 3)`` of the world in camera space."""
        return self.turn(np.asarray(points, np.float64) - np.asarray(self.position))

    def turn(self, vectors: npt.ArrayLike) -> Floats:
        """Return vectors ``(..., 3)`` of the world, which have no place, in camera space."""
        return np.asarray(np.asarray(vectors, np.float64) @ self.axes.T)

    def see_light(self, light: AreaLight) -> AreaLight:
        """Return a light of the world in camera space."""
        return replace(
            light,
            center=tuple(self.to_camera(light.center)),
            half_u=tuple(self.turn(light.half_u)),
            half_v=tuple(self.turn(light.half_v)),
            motion=tuple(self.turn(light.motion)),
        )


@dataclass(frozen=True)
class Lamp:
    """An area light of one colour, which the camera does not see and which is in nobody's way.

    Parameters
    ----------
    light : AreaLight
        In world space.
    radiance : (float, float, float)
        Linear RGB, emitted from everywhere on it to all directions in front of it.
    """

    light: AreaLight
    radiance: Vector = (1.0, 1.0, 1.0)


def aimed(
    center: Vector,
    target: Vector,
    half_size: tuple[float, float],
    shape: LightShape = "rectangle",
    *,
    motion: Vector = (0.0, 0.0, 0.0),
    radiance: Vector = (1.0, 1.0, 1.0),
) -> Lamp:
    """Make a lamp that faces a point.

    Parameters
    ----------
    center, target : (float, float, float)
        Its middle, and the point.
    half_size : (float, float)
        Half its sizes; the first is horizontal (+y being up), or along x where it faces straight up or down.
    shape, motion
        As for `AreaLight`, whose plane Π lies at the target.
    radiance : (float, float, float)
        As for `Lamp`.
    """
    way = np.subtract(target, center)
    normal = unit("target", way)
    level = np.cross((0.0, 1.0, 0.0), normal)
    along_u = unit("half_u", level) if np.linalg.norm(level) > 1e-9 else np.array([1.0, 0.0, 0.0])
    along_v = np.cross(normal, along_u)
    light = AreaLight(
        center,
        half_u=tuple(half_size[0] * along_u),
        half_v=tuple(half_size[1] * along_v),
        shape=shape,
        motion=motion,
        plane_distance=float(np.linalg.norm(way)),
    )
    return Lamp(light, radiance)


@dataclass(frozen=True)
class Scene:
    """All that there is.

    Parameters
    ----------
    camera : Camera
        Who looks.
    shapes : sequence of Shape
        What light falls on and stops at.
    lamps : sequence of Lamp
        At least one.
    unlit : (float, float, float)
        Radiance of everything, the background too, on top of the light of the lamps.

    Raises
    ------
    SampleError
        Without a lamp or without a shape.
    """

    camera: Camera
    shapes: Sequence[Shape]
    lamps: Sequence[Lamp]
    unlit: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("shapes", "lamps"):
            if not getattr(self, name):
                raise SampleError("expected at least one", field=name)

    @property
    def moves(self) -> bool:
        """Whether any shape moves."""
        return any(any(shape.motion) for shape in self.shapes)

    @property
    def times_matter(self) -> bool:
        """Whether any shape or lamp moves."""
        return self.moves or any(lamp.light.moves for lamp in self.lamps)


def render_lit(scene: Scene, spp: int, *, seed: int = 0) -> SampleBuffer:
    """Sample a scene, with one light sample for each camera sample and lamp.

    Light points are stratified over each lamp within every pixel and every aligned block of pixels, as lens
    positions are.

    Parameters
    ----------
    scene : Scene
        What to look at.
    spp : int
        Samples per pixel.
    seed : int
        The same seed gives the same samples.

    Returns
    -------
    SampleBuffer
        With `lighting`; with times where shapes or lamps move, and with motion where shapes do.

    Raises
    ------
    SampleError
        For sizes or a seed out of range.
    """
    camera = scene.camera
    size = (camera.height, camera.width, spp)
    xy, uv = sample_pattern(*size, seed=seed, sampling=camera.lens.sampling)
    time = sample_times(*size, seed=seed) if scene.times_matter else None
    hits = _trace(scene, xy, uv, time)
    lighting = Lighting(
        projection=camera.projection,
        normal=np.where(hits.on_shape[:, None], camera.turn(hits.normal), [0.0, 0.0, -1.0]).reshape(*size, 3),
        depth_gradient=hits.depth_gradient(camera).reshape(*size, 2),
        unlit=np.broadcast_to(scene.unlit, (*size, 3)),
        lights=[
            _light_samples(scene, lamp, hits, _light_points(lamp, number, size, seed))
            for number, lamp in enumerate(scene.lamps)
        ],
    )
    samples = SampleBuffer(
        xy=xy,
        uv=uv,
        depth=hits.depth.reshape(size),
        color=lighting.unlit,
        lens=camera.lens,
        time=time,
        motion=hits.motion(scene).reshape(*size, 3) if scene.moves else None,
        lighting=lighting,
    )
    return replace(samples, color=lighting.color(samples))


def true_image(scene: Scene, *, rays: int = 16, tolerance: float = 1e-4, seed: int = 1) -> Image:
    """Integrate a scene over pixels, lens, shutter and lamps, pixels by a box.

    The light of each ray's point is integrated to `tolerance`. What is left are the errors of the mean over
    the rays, which fall faster than one over their number where the image is smooth, and as one over their
    square root or somewhat faster where a pixel, the lens or the shutter sees an edge.

    Parameters
    ----------
    scene : Scene
        What to look at.
    rays : int
        Camera rays per pixel.
    tolerance : float
        Largest error, about, of the light of a point, relative to that of a surface which faces the lamp.
    seed : int
        Differs from `render_lit`'s, so that the two have no ray in common.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32.

    Raises
    ------
    SampleError
        For sizes, a seed or a tolerance out of range.
    """
    camera = scene.camera
    size = (camera.height, camera.width, rays)
    xy, uv = sample_pattern(*size, seed=seed, sampling=camera.lens.aperture)
    hits = _trace(scene, xy, uv, sample_times(*size, seed=seed) if scene.times_matter else None)
    lit = np.zeros((len(hits.depth), 3))
    which = np.flatnonzero(hits.on_shape)
    albedo = np.array([shape.albedo for shape in scene.shapes])[hits.shape[which]]
    lit[which] = true_radiance(
        scene, hits.point[which], hits.normal[which], albedo, hits.time[which], tolerance=tolerance
    )
    image: Image = (lit.reshape(*size, 3).mean(axis=2) + np.asarray(scene.unlit)).astype(np.float32)
    return image


def true_radiance(
    scene: Scene,
    points: Floats,
    normals: Floats,
    albedo: npt.ArrayLike = (0.8, 0.8, 0.8),
    times: npt.ArrayLike = 0.0,
    *,
    tolerance: float = 1e-4,
) -> Floats:
    """Return the radiance ``(N, 3)`` that matte points send everywhere in the light of the lamps.

    Parameters
    ----------
    scene : Scene
        Its shapes and lamps count.
    points, normals : ndarray, (N, 3)
        On surfaces in world space, and unit normals on the side that is looked at.
    albedo : array_like, (N, 3) or one for all
        Share of light that is reflected.
    times : array_like, (N,) or one for all
        In [0, 1] over the shutter.
    tolerance : float
        As in `true_image`.
    """
    require_option("tolerance", tolerance, tolerance > 0, "above 0")
    total = np.zeros((len(points), 3))
    for lamp in scene.lamps:
        arriving = irradiance(scene.shapes, lamp.light, points, normals, times, tolerance=tolerance)
        total += arriving[:, None] * np.asarray(lamp.radiance)
    return np.asarray(total * np.asarray(albedo) / math.pi)


@dataclass(frozen=True)
class _Hits:
    """What N camera rays have hit, in world space.

    Parameters
    ----------
    shape : ndarray of int, (N,)
        Index of the shape, -1 for the background.
    seen_at : ndarray, (N, 2)
        Where the lens centre sees the point, in pixels.
    depth : ndarray, (N,)
        Planar depth.
    time : ndarray, (N,)
        When.
    point, normal : ndarray, (N, 3)
        The point and the unit normal on the side that was hit.
    """

    shape: Indices
    seen_at: Floats
    depth: Floats
    time: Floats
    point: Floats
    normal: Floats

    @property
    def on_shape(self) -> npt.NDArray[np.bool_]:
        """Whether rays hit anything but the background."""
        return np.asarray(self.shape >= 0)

    def depth_gradient(self, camera: Camera) -> Floats:
        """Slope of the tangent plane's depth over the image of the lens centre, per pixel, ``(N, 2)``.

        With the plane n · P = k and P = z d(x, y), z = k / (n · d), whose derivatives are those of n · d.
        """
        focal = np.asarray(camera.projection.focal)
        normal = camera.turn(self.normal)
        sight = np.concatenate(
            [(self.seen_at - camera.projection.center) / focal, np.ones((len(self.depth), 1))], axis=-1
        )
        facing = (normal * sight).sum(axis=-1)
        # A lens sees a little around the edge of what is round: there the plane may even face away.
        facing = np.where(np.abs(facing) < _EDGE_ON, np.copysign(_EDGE_ON, facing), facing)
        gradient = -normal[:, :2] / focal * (self.depth / facing)[:, None]
        return np.where(self.on_shape[:, None], gradient, 0.0)

    def motion(self, scene: Scene) -> Floats:
        """Change of ``(x w, y w, w)`` over the shutter, ``(N, 3)``."""
        projection = scene.camera.projection
        moved = scene.camera.turn(_motions(scene, self.shape))
        across = moved[:, :2] * projection.focal + moved[:, 2:] * projection.center
        return np.concatenate([across, moved[:, 2:]], axis=-1)


def _motions(scene: Scene, shape: Indices) -> Floats:
    """Shift over the shutter, in world space, of the shapes of some indices; none of -1."""
    return np.array([*(each.motion for each in scene.shapes), (0.0, 0.0, 0.0)])[shape]


def _trace(scene: Scene, xy: npt.ArrayLike, uv: npt.ArrayLike, time: npt.NDArray[np.float32] | None) -> _Hits:
    """Find the first shape that the camera sees along each ray."""
    camera = scene.camera
    xy, uv = np.asarray(xy, np.float64).reshape(-1, 2), np.asarray(uv, np.float64).reshape(-1, 2)
    times = np.zeros(len(xy)) if time is None else time.astype(np.float64).ravel()
    origin, direction = camera.rays(xy, uv)
    depth, index = np.full(len(xy), _BACKGROUND_DEPTH * camera.distance), np.full(len(xy), -1)
    normal = np.zeros_like(origin)
    for number, shape in enumerate(scene.shapes):
        if not shape.seen:
            continue
        reached = shape.hit(origin, direction, times)
        nearer = reached < depth
        depth[nearer], index[nearer] = reached[nearer], number
        points = origin[nearer] + reached[nearer, None] * direction[nearer]
        normal[nearer] = shape.normals(points, times[nearer])
    facing_away = (normal * direction).sum(axis=-1) > 0
    normal[facing_away] *= -1
    seen_at = xy - camera.lens.slope(depth)[:, None] * uv
    return _Hits(index, seen_at, depth, times, origin + depth[:, None] * direction, normal)


def _light_points(lamp: Lamp, number: int, size: tuple[int, int, int], seed: int) -> Floats:
    """Choose points (lu, lv) on a lamp for all samples, ``(H, W, S, 2)``."""
    sampling: Sampling = "disc" if lamp.light.shape == "disc" else "square"
    return sample_lights(*size, seed=seed, light=number, sampling=sampling).astype(np.float64)


def _light_samples(scene: Scene, lamp: Lamp, hits: _Hits, light_points: Floats) -> LightSamples:
    """Follow a ray from a point of a lamp towards what each camera ray has hit, to what it hits first."""
    light, camera = lamp.light, scene.camera
    luv = light_points.reshape(-1, 2)
    seen_light = camera.see_light(light)
    lxy, receiver_depth = light.project(hits.point, luv, hits.time)
    lit = hits.on_shape & (receiver_depth > 0)
    way, blocker = _first_blockers(scene, light, hits, luv)
    rho = density(
        camera.projection, seen_light, hits.seen_at, hits.depth, hits.depth_gradient(camera), luv, hits.time
    )
    albedo = np.array([*(shape.albedo for shape in scene.shapes), (0.0, 0.0, 0.0)])[hits.shape]
    motion = None
    if scene.moves or light.moves:
        motion = (_motions(scene, blocker) - np.asarray(light.motion)) @ light.axes.T
        motion[:, :2] *= light.plane_distance

    def placed(values: Floats, otherwise: float = 0.0) -> Floats:
        used = lit.reshape(-1, *(1,) * (values.ndim - 1))
        return np.where(used, values, otherwise).reshape(*light_points.shape[:-1], *values.shape[1:])

    return LightSamples(
        light=seen_light,
        lxy=placed(lxy),
        luv=light_points,
        # Light-space depth grows evenly along a ray from 0 on the light.
        depth=placed(way * receiver_depth, 1.0),
        radiance=placed(np.broadcast_to(lamp.radiance, albedo.shape)),
        density=placed(rho),
        reflectance=placed(albedo / math.pi),
        motion=None if motion is None else placed(motion),
    )


def _first_blockers(scene: Scene, light: AreaLight, hits: _Hits, luv: Floats) -> tuple[Floats, Indices]:
    """Say how far, as a share of their way, light rays get to what camera rays hit, and to which shape."""
    start = light.points(luv, hits.time)
    way, blocker = np.ones(len(luv)), hits.shape.copy()
    for number, shape in enumerate(scene.shapes):
        reached = shape.hit(start, hits.point - start, hits.time)
        nearer = (reached < way) & (reached < 1 - GRAZE)
        way[nearer], blocker[nearer] = reached[nearer], number
    return way, blocker
