"""Opaque shapes whose shadows are known: flat sheets, balls and round columns, still or moving.

A shape says where rays hit it, and at which points of a straight line, seen from an eye, it begins or ceases
to be in the way. With the latter an integral over a light is cut into pieces that are seen as a whole or not
at all (`fewrays.sources.light_integral`).

World space is right-handed, in world units; nothing else is special about it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.sources.outlines import Outline, Rectangle, roots

__all__ = ["Ball", "Column", "Shape", "Sheet", "box", "unit"]

Floats = npt.NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Shape(ABC):
    """What all shapes have in common: what they look like, and how they move.

    Parameters
    ----------
    albedo : (float, float, float)
        Share of the light that the surface, which is matte, reflects: linear RGB.
    motion : (float, float, float)
        By how much it is shifted while the shutter is open, in world units.
    seen : bool
        Whether the camera sees it. Light stops at it in any case.
    """

    albedo: Vector = (0.8, 0.8, 0.8)
    motion: Vector = (0.0, 0.0, 0.0)
    seen: bool = True

    def hit(self, origin: Floats, direction: Floats, time: npt.ArrayLike = 0.0) -> Floats:
        """Follow rays to the shape.

        Parameters
        ----------
        origin, direction : ndarray, (..., 3)
            Where rays start, and where they go.
        time : array_like, (...)
            In [0, 1] over the shutter.

        Returns
        -------
        ndarray, (...)
            How many lengths of `direction` the first hit is away, more than 0; infinite without one.
        """
        return self._hit(origin - self._shift(time), direction)

    def normals(self, points: Floats, time: npt.ArrayLike = 0.0) -> Floats:
        """Return unit normals ``(..., 3)`` at points ``(..., 3)`` of the surface, on its outside."""
        return self._normals(points - self._shift(time))

    def crossings(self, eye: Floats, start: Floats, step: Floats, time: npt.ArrayLike = 0.0) -> Floats:
        """Find where points on straight lines may come into sight or go out of it, behind the shape.

        Parameters
        ----------
        eye : ndarray, (..., 3)
            From where they are seen.
        start, step : ndarray, (..., 3)
            The points are ``start + s step``.
        time : array_like, (...)
            In [0, 1] over the shutter.

        Returns
        -------
        ndarray, (..., n)
            Values of s, in no order and possibly more than needed; NaN stands for none.
        """
        shift = self._shift(time)
        return self._crossings(eye - shift, start - shift, step)

    def _shift(self, time: npt.ArrayLike) -> Floats:
        return np.asarray(np.asarray(time, np.float64)[..., None] * np.asarray(self.motion))

    @abstractmethod
    def _hit(self, origin: Floats, direction: Floats) -> Floats: ...

    @abstractmethod
    def _normals(self, points: Floats) -> Floats: ...

    @abstractmethod
    def _crossings(self, eye: Floats, start: Floats, step: Floats) -> Floats: ...


@dataclass(frozen=True)
class Sheet(Shape):
    """A plane or a part of one, which is matte on both sides.

    Parameters
    ----------
    point : (float, float, float)
        The origin of the sheet's own coordinates (a, b).
    facing : (float, float, float)
        Its normal.
    along : (float, float, float)
        Direction of the a-axis, perpendicular to the normal; the b-axis is ``facing x along``.
    outline : Outline, optional
        Which part of the plane is there; all of it when omitted.

    Raises
    ------
    SampleError
        For vectors that are zero or not perpendicular.
    """

    point: Vector
    facing: Vector
    along: Vector
    outline: Outline | None = None

    def __post_init__(self) -> None:
        if abs(float(unit("facing", self.facing) @ unit("along", self.along))) > 1e-9:
            raise SampleError(f"{self.along} is not perpendicular to facing {self.facing}", field="along")

    def _axes(self) -> tuple[Floats, Floats]:
        """Return unit vectors along a and b ``(2, 3)``, and along the normal ``(3,)``."""
        normal, along = unit("facing", self.facing), unit("along", self.along)
        return np.stack([along, np.cross(normal, along)]), normal

    def _hit(self, origin: Floats, direction: Floats) -> Floats:
        axes, normal = self._axes()
        relative = origin - np.asarray(self.point)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            distance = -(relative @ normal) / (direction @ normal)
            hit = (distance > 0) & np.isfinite(distance)
            if self.outline is not None:
                hit &= self.outline.contains((relative + distance[..., None] * direction) @ axes.T)
        return np.where(hit, distance, np.inf)

    def _normals(self, points: Floats) -> Floats:
        return np.broadcast_to(self._axes()[1], points.shape)

    def _crossings(self, eye: Floats, start: Floats, step: Floats) -> Floats:
        axes, normal = self._axes()
        relative = eye - np.asarray(self.point)
        height, rise = relative @ normal, step @ normal
        # Where points pass through the plane itself.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            through = (-((start - np.asarray(self.point)) @ normal) / rise)[..., None]
        if self.outline is None:
            return np.where(np.isfinite(through), through, np.nan)
        # The line of sight meets the plane at eye + (point - eye) height / (height - the point's height).
        fall = (eye - start) @ normal
        numerator = (
            (relative * fall[..., None] - (eye - start) * height[..., None]) @ axes.T,
            (step * height[..., None] - relative * rise[..., None]) @ axes.T,
        )
        edges = self.outline.crossings(numerator, (fall, -rise))
        return np.concatenate([np.where(np.isfinite(through), through, np.nan), edges], axis=-1)


@dataclass(frozen=True)
class Ball(Shape):
    """A sphere.

    Parameters
    ----------
    center : (float, float, float)
        Its middle.
    radius : float
        Positive.

    Raises
    ------
    SampleError
        For a radius that is not positive.
    """

    center: Vector
    radius: float

    def __post_init__(self) -> None:
        _check_radius(self.radius)

    def _hit(self, origin: Floats, direction: Floats) -> Floats:
        return _hit_round(origin - np.asarray(self.center), direction, self.radius)

    def _normals(self, points: Floats) -> Floats:
        return np.asarray((points - np.asarray(self.center)) / self.radius)

    def _crossings(self, eye: Floats, start: Floats, step: Floats) -> Floats:
        return _tangents(eye - np.asarray(self.center), start - eye, step, self.radius)


@dataclass(frozen=True)
class Column(Shape):
    """A cylinder without ends.

    Parameters
    ----------
    center : (float, float, float)
        A point on its axis.
    axis : (float, float, float)
        Direction of the axis.
    radius : float
        Positive.

    Raises
    ------
    SampleError
        For an axis of no length or a radius that is not positive.
    """

    center: Vector
    axis: Vector
    radius: float

    def __post_init__(self) -> None:
        _check_radius(self.radius)
        unit("axis", self.axis)

    def _across(self, vectors: Floats) -> Floats:
        """Leave out the component along the axis."""
        axis = unit("axis", self.axis)
        return np.asarray(vectors - (vectors @ axis)[..., None] * axis)

    def _hit(self, origin: Floats, direction: Floats) -> Floats:
        return _hit_round(
            self._across(origin - np.asarray(self.center)), self._across(direction), self.radius
        )

    def _normals(self, points: Floats) -> Floats:
        return np.asarray(self._across(points - np.asarray(self.center)) / self.radius)

    def _crossings(self, eye: Floats, start: Floats, step: Floats) -> Floats:
        relative = self._across(eye - np.asarray(self.center))
        return _tangents(relative, self._across(start - eye), self._across(step), self.radius)


def box(
    floor_center: Vector,
    half_size: tuple[float, float],
    height: float,
    *,
    turn: float = 0.0,
    albedo: Vector = (0.8, 0.8, 0.8),
    motion: Vector = (0.0, 0.0, 0.0),
    seen: bool = True,
) -> list[Sheet]:
    """Make a box that stands on a floor whose normal is +y: four sides and a top.

    Parameters
    ----------
    floor_center : (float, float, float)
        The middle of the face that it stands on.
    half_size : (float, float)
        From the middle to its sides, along x and z before it is turned.
    height : float
        In world units.
    turn : float
        Angle about the vertical, in degrees.
    albedo, motion, seen
        As for `Shape`.

    Returns
    -------
    list of Sheet
    """
    x, y, z = floor_center
    cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    first, second = (cosine, 0.0, sine), (-sine, 0.0, cosine)
    middle = (x, y + 0.5 * height, z)
    sheets = []
    for normal, along, out, wide in (
        (first, second, half_size[0], half_size[1]),
        (second, first, half_size[1], half_size[0]),
    ):
        for sign in (-1.0, 1.0):
            point = tuple(m + sign * out * n for m, n in zip(middle, normal, strict=True))
            outline = Rectangle((0.0, 0.0), (wide, 0.5 * height))
            sheets.append((point, normal, along, outline))
    sheets.append(((x, y + height, z), (0.0, 1.0, 0.0), first, Rectangle((0.0, 0.0), half_size)))
    return [
        Sheet((p[0], p[1], p[2]), n, a, o, albedo=albedo, motion=motion, seen=seen) for p, n, a, o in sheets
    ]


def unit(name: str, vector: npt.ArrayLike) -> Floats:
    """Return a vector ``(3,)`` at unit length; raise a `SampleError` that names it if it has none."""
    array = np.asarray(vector, np.float64)
    length = float(np.linalg.norm(array)) if array.shape == (3,) else 0.0
    if not (math.isfinite(length) and length > 0):
        raise SampleError(f"expected three finite numbers, not all 0, got {vector!r}", field=name)
    return np.asarray(array / length)


def _hit_round(origin: Floats, direction: Floats, radius: float) -> Floats:
    """Follow rays to a sphere around 0, or to a cylinder when both vectors lie across its axis."""
    both = roots(
        np.square(origin).sum(axis=-1) - radius**2,
        2 * (origin * direction).sum(axis=-1),
        np.square(direction).sum(axis=-1),
    )
    return np.asarray(np.where(both > 0, both, np.inf).min(axis=-1))


def _tangents(eye: Floats, start: Floats, step: Floats, radius: float) -> Floats:
    """Find where the line of sight along ``start + s step`` touches what `_hit_round` hits.

    The discriminant of the equation of its hits, ``(d · eye)² = |d|² (|eye|² - radius²)``, is quadratic in s.
    """
    above = np.square(eye).sum(axis=-1) - radius**2
    to_start, to_step = (start * eye).sum(axis=-1), (step * eye).sum(axis=-1)
    return roots(
        to_start**2 - above * np.square(start).sum(axis=-1),
        2 * (to_start * to_step - above * (start * step).sum(axis=-1)),
        to_step**2 - above * np.square(step).sum(axis=-1),
    )


def _check_radius(radius: float) -> None:
    if not (math.isfinite(radius) and radius > 0):
        raise SampleError(f"expected a positive, finite number, got {radius!r}", field="radius")
