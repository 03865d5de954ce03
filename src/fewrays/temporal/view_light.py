"""How densely the camera's samples see the light: the view-light Jacobian (temporal, Appendix B).

Light samples are aimed at what camera samples hit, so that their density on the light's plane Π follows from
where the light, the camera and the surface are. A pixel's step along x takes the hit point P over the
surface's tangent plane by

    dP/dx = (z / fx, 0, 0) + dz/dx r,    r = P / z,

and along y likewise. On its way from the light point L, relative to which P is q = P - L in light space, the
step is seen on Π, at the distance d, from the light-space depth w:

    d(lx, ly) = d / w (d(X, Y) - (q_X, q_Y) / w dw).

The paper gets to the same by chaining projective maps and differentiating; it puts the light point at the
light's centre.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.projection import Projection

__all__ = ["density", "view_light_jacobian"]

Float64 = npt.NDArray[np.float64]


def view_light_jacobian(
    projection: Projection,
    light: AreaLight,
    xy: npt.ArrayLike,
    depth: npt.ArrayLike,
    depth_gradient: npt.ArrayLike,
    luv: npt.ArrayLike = (0.0, 0.0),
    time: npt.ArrayLike = 0.5,
) -> Float64:
    """Return how rays from a light point move over Π as what they are aimed at moves over the image.

    The camera is a pinhole at the lens centre, as in the paper: the density changes with the lens point
    only as much as the surface's slope (circle of confusion) changes over a pixel.

    Parameters
    ----------
    projection : Projection
        How the lens centre sees camera space.
    light : AreaLight
        The light, with the plane Π.
    xy : array_like, (..., 2)
        Where the lens centre sees the points, in pixels.
    depth : array_like, (...)
        Their planar depths.
    depth_gradient : array_like, (..., 2)
        Depth units per pixel along x and y of the surfaces' tangent planes.
    luv : array_like, (..., 2)
        Light points; the centre unless given.
    time : array_like, (...)
        In [0, 1] over the shutter, of which the middle stands for all of it unless given.

    Returns
    -------
    ndarray, (..., 2, 2)
        ``d(lx, ly) / d(x, y)``, world units on Π per pixel. It means nothing for points that are not in front
        of the light, and is not finite for those in its plane.
    """
    points = projection.points(xy, depth)
    steps = _steps_on_surface(projection, points, np.asarray(depth_gradient, np.float64))
    local = light.to_light_space(points, time)
    steps = steps @ light.axes.T
    sides = local[..., :2] - np.asarray(luv, np.float64) * light.half_size
    across, along = steps[..., :2], steps[..., 2:]
    depth = local[..., 2, None, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        moved = (across - sides[..., None, :] / depth * along) * (light.plane_distance / depth)
    return np.asarray(np.swapaxes(moved, -1, -2))


def density(
    projection: Projection,
    light: AreaLight,
    xy: npt.ArrayLike,
    depth: npt.ArrayLike,
    depth_gradient: npt.ArrayLike,
    luv: npt.ArrayLike = (0.0, 0.0),
    time: npt.ArrayLike = 0.5,
) -> Float64:
    """Return the lengths on Π that a pixel's length becomes: what `LightSamples.density` holds.

    Parameters
    ----------
    projection, light, xy, depth, depth_gradient, luv, time
        As for `view_light_jacobian`.

    Returns
    -------
    ndarray, (...)
        ``sqrt |det J|`` in world units per pixel; 0 for points that are not in front of the light.
    """
    jacobian = view_light_jacobian(projection, light, xy, depth, depth_gradient, luv, time)
    in_front = light.to_light_space(projection.points(xy, depth), time)[..., 2] > 0
    with np.errstate(invalid="ignore", over="ignore"):
        determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
        return np.where(in_front, np.sqrt(np.abs(determinant)), 0.0)


def _steps_on_surface(projection: Projection, points: Float64, gradient: Float64) -> Float64:
    """Return by how much points move over their tangent planes per pixel: rows x and y, ``(..., 2, 3)``."""
    depth = points[..., 2:]
    steps = gradient[..., :, None] * (points / depth)[..., None, :]
    steps[..., 0, 0] += depth[..., 0] / projection.focal[0]
    steps[..., 1, 1] += depth[..., 0] / projection.focal[1]
    return np.asarray(steps)
