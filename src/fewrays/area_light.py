"""`AreaLight`: a flat light, and the two planes by which its rays are told apart (temporal, section 5).

A ray from the light is known by where it starts, (lu, lv) in units of the light's half sizes, and by where it
meets a plane Π, parallel to the light at the distance d in front of it: (lx, ly), in world units. That is the
lens and the image over again. Let (X, Y, w) be a point relative to the light's centre, along its two axes and
its normal, and a the half size along the first axis. The ray from the light point lu to that point meets Π at

    lx = X d / w + a lu (1 - d / w) = lx0 + C(w) lu,    C(w) = c0 / w + c1,  c0 = -a d,  c1 = a:

what a camera sample does, `w` being the *light-space depth* and the light's centre the lens's. The two axes
have slopes of their own unless the light is a square or a circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.projection import finite_numbers

__all__ = ["AreaLight", "LightShape"]

Float64 = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
LightShape = Literal["rectangle", "disc"]

_SQUARENESS = 1e-4  # largest cosine between the half sizes that counts as a right angle
_SMALLEST = 1e-30  # length of a vector that still has a direction once it is squared


@dataclass(frozen=True)
class AreaLight:
    """A flat light that stands still or is shifted while the shutter is open, in camera space.

    Camera space is that of `fewrays.Projection`: x right, y down, z forward, world units.

    Parameters
    ----------
    center : tuple of float
        The light's centre as the shutter opens.
    half_u, half_v : tuple of float
        From the centre to the middles of two neighbouring edges, or to the rim of a disc; perpendicular. The
        light emits to the side of ``half_u x half_v``.
    shape : {"rectangle", "disc"}
        A disc with two different half sizes is an ellipse.
    motion : tuple of float
        By how much it is shifted until the shutter closes.
    plane_distance : float
        Distance d of the plane Π on which rays are told apart, positive. The result hardly depends on it: it
        sets the unit of densities. About the distance from the light to the scene is a good choice.

    Raises
    ------
    SampleError
        For vectors that are not finite, half sizes that are zero or not perpendicular, an unknown shape, or a
        distance that is not positive.

    Examples
    --------
    >>> light = AreaLight(center=(0, -3, 5), half_u=(1, 0, 0), half_v=(0, 0, -0.5))
    >>> light.normal.tolist(), light.area
    ([0.0, 1.0, 0.0], 2.0)
    >>> lxy, depth = light.project([0.5, 1.0, 5.0], luv=[1.0, 0.0])
    >>> lxy.tolist(), float(depth)
    ([0.875, 0.0], 4.0)
    """

    center: Vector
    half_u: Vector
    half_v: Vector
    shape: LightShape = "rectangle"
    motion: Vector = (0.0, 0.0, 0.0)
    plane_distance: float = 1.0

    def __post_init__(self) -> None:
        for name in ("center", "half_u", "half_v", "motion"):
            object.__setattr__(self, name, finite_numbers(f"light.{name}", getattr(self, name), 3))
        (distance,) = finite_numbers("light.plane_distance", [self.plane_distance], 1)
        object.__setattr__(self, "plane_distance", distance)
        if distance <= 0:
            raise SampleError(f"expected a positive distance, got {distance:g}", field="light.plane_distance")
        if self.shape not in get_args(LightShape):
            raise SampleError(
                f"expected one of {', '.join(get_args(LightShape))}; got {self.shape!r}", field="light.shape"
            )
        self._check_half_sizes()

    def _check_half_sizes(self) -> None:
        for name in ("half_u", "half_v"):
            if math.hypot(*getattr(self, name)) < _SMALLEST:
                raise SampleError(
                    f"expected a vector of a length over {_SMALLEST:g}, got {getattr(self, name)}",
                    field=f"light.{name}",
                )
        cosine = float(self._axis("half_u") @ self._axis("half_v"))
        if abs(cosine) > _SQUARENESS:
            raise SampleError(
                f"expected a vector perpendicular to half_u, got an angle of "
                f"{math.degrees(math.acos(max(-1.0, min(1.0, cosine)))):.4g} degrees",
                field="light.half_v",
            )

    def _axis(self, name: str) -> Float64:
        vector = np.array(getattr(self, name))
        return np.asarray(vector / math.hypot(*vector))

    @property
    def axes(self) -> Float64:
        """Unit vectors along u, along v and along the normal: the rows of a rotation ``(3, 3)``."""
        u = self._axis("half_u")
        normal = np.cross(u, self._axis("half_v"))
        normal /= math.hypot(*normal)
        # Perpendicular to rounding, although half_v may be out by _SQUARENESS.
        return np.stack([u, np.cross(normal, u), normal]) + 0.0  # no negative zeros

    @property
    def normal(self) -> Float64:
        """Unit vector ``(3,)`` towards the side that it emits to."""
        return np.asarray(self.axes[2])

    @property
    def half_size(self) -> Float64:
        """Half sizes ``(2,)`` along u and v in world units: the slope at infinite depth, c1."""
        return np.array([math.hypot(*self.half_u), math.hypot(*self.half_v)])

    @property
    def area(self) -> float:
        """Area in square world units."""
        return float(self.half_size.prod()) * (4.0 if self.shape == "rectangle" else math.pi)

    @property
    def moves(self) -> bool:
        """Whether it is shifted while the shutter is open."""
        return any(self.motion)

    def slope(self, depth: npt.ArrayLike) -> Float64:
        """Return by how much (lx, ly) grow per unit of (lu, lv) for points at light-space depths.

        Parameters
        ----------
        depth : array_like, (...)
            Light-space depths, not 0.

        Returns
        -------
        ndarray, (..., 2)
            ``half_size * (1 - plane_distance / depth)``, in world units.
        """
        depth = np.asarray(depth, np.float64)[..., None]
        return np.asarray(self.half_size * (1 - self.plane_distance / depth))

    def centers(self, time: npt.ArrayLike = 0.0) -> Float64:
        """Return where its centre is at times ``(...)``: ``(..., 3)`` in camera space."""
        time = np.asarray(time, np.float64)[..., None]
        return np.asarray(np.array(self.center) + time * np.array(self.motion))

    def points(self, luv: npt.ArrayLike, time: npt.ArrayLike = 0.0) -> Float64:
        """Return points on the light.

        Parameters
        ----------
        luv : array_like, (..., 2)
            In ``[-1, 1]²``; on a disc the rim is at radius 1.
        time : array_like, (...)
            In [0, 1] over the shutter.

        Returns
        -------
        ndarray, (..., 3)
            In camera space.
        """
        offset = np.asarray(luv, np.float64) * self.half_size @ self.axes[:2]
        return np.asarray(self.centers(time) + offset)

    def to_light_space(self, points: npt.ArrayLike, time: npt.ArrayLike = 0.0) -> Float64:
        """Return points relative to the light's centre at a time, along its axes and its normal.

        Parameters
        ----------
        points : array_like, (..., 3)
            In camera space.
        time : array_like, (...)
            In [0, 1] over the shutter.

        Returns
        -------
        ndarray, (..., 3)
            ``(X, Y, w)`` in world units; w, the light-space depth, is positive in front of the light.
        """
        return np.asarray((np.asarray(points, np.float64) - self.centers(time)) @ self.axes.T)

    def project(
        self, points: npt.ArrayLike, luv: npt.ArrayLike, time: npt.ArrayLike = 0.0
    ) -> tuple[Float64, Float64]:
        """Return where the rays from light points to points meet the plane Π, and the points' depths.

        Parameters
        ----------
        points : array_like, (..., 3)
            In camera space.
        luv : array_like, (..., 2)
            Where on the light the rays start; 0 for its centre.
        time : array_like, (...)
            In [0, 1] over the shutter.

        Returns
        -------
        lxy : ndarray, (..., 2)
            In world units. It means nothing, and may be infinite, unless the depth is positive.
        depth : ndarray, (...)
            Light-space depths.
        """
        local = self.to_light_space(points, time)
        depth = local[..., 2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at_center = local[..., :2] * (self.plane_distance / depth)[..., None]
            return at_center + self.slope(depth) * np.asarray(luv, np.float64), depth

    def hits(
        self, lxy: npt.ArrayLike, luv: npt.ArrayLike, depth: npt.ArrayLike, time: npt.ArrayLike = 0.0
    ) -> Float64:
        """Return the points at light-space depths along rays: the inverse of `project`.

        Parameters
        ----------
        lxy, luv : array_like, (..., 2)
            The rays: where they meet Π in world units, and where they start.
        depth : array_like, (...)
            Light-space depths.
        time : array_like, (...)
            In [0, 1] over the shutter.

        Returns
        -------
        ndarray, (..., 3)
            In camera space.
        """
        start = np.asarray(luv, np.float64) * self.half_size
        depth = np.asarray(depth, np.float64)[..., None]
        sides = start + (np.asarray(lxy, np.float64) - start) * (depth / self.plane_distance)
        local = np.concatenate([sides, np.broadcast_to(depth, (*sides.shape[:-1], 1))], axis=-1)
        return np.asarray(local @ self.axes + self.centers(time))
