"""`Projection`: from what the lens centre sees at a pixel to points in space.

Camera space has its origin at the lens centre, x to the right, y down and z forward along the optical axis,
in world units (right-handed: x cross y is z). The lens centre sees a point (X, Y, Z) at

    x = cx + fx X / Z,    y = cy + fy Y / Z.

`fewrays.Lens` needs none of this: how a sample moves over the image does not depend on where the image's
centre is. Light does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError

__all__ = ["Projection", "finite_numbers"]

_LARGEST = 1e30  # so that squares of products can be computed in float64


@dataclass(frozen=True)
class Projection:
    """How the lens centre sees space.

    Parameters
    ----------
    focal : tuple of float
        Focal length along x and along y, in pixels per unit of ``tan(angle)``; positive.
    center : tuple of float
        Where the optical axis meets the image, in pixels: usually its middle, ``(W / 2, H / 2)``.

    Raises
    ------
    SampleError
        For anything but two finite numbers, or a focal length that is not positive.

    Examples
    --------
    >>> projection = Projection(focal=(640.0, 640.0), center=(320.0, 180.0))
    >>> projection.points([480.0, 180.0], 4.0).tolist()
    [1.0, 0.0, 4.0]
    """

    focal: tuple[float, float]
    center: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("focal", "center"):
            numbers = finite_numbers(f"projection.{name}", getattr(self, name), 2)
            object.__setattr__(self, name, numbers)
        if min(self.focal) <= 0:
            raise SampleError(
                f"expected positive numbers of pixels, got {self.focal}; x points right and y down",
                field="projection.focal",
            )

    @classmethod
    def from_fov(cls, width: int, height: int, fov: float) -> Projection:
        """Return the projection of a camera with square pixels that looks at the middle of its image.

        Parameters
        ----------
        width, height : int
            Of the image, in pixels.
        fov : float
            Horizontal angle of view in degrees.
        """
        if not 0 < fov < 180:
            raise SampleError(f"expected an angle between 0 and 180 degrees, got {fov!r}", field="fov")
        focal = 0.5 * width / math.tan(math.radians(fov) / 2)
        return cls((focal, focal), (0.5 * width, 0.5 * height))

    def points(self, xy: npt.ArrayLike, depth: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the points that the lens centre sees.

        Parameters
        ----------
        xy : array_like, (..., 2)
            Where it sees them, in pixels: for a sample ``xy - C(depth) * uv``.
        depth : array_like, (...)
            Their planar depths.

        Returns
        -------
        ndarray, (..., 3)
            In camera space.
        """
        depth = np.asarray(depth, np.float64)[..., None]
        sides = (np.asarray(xy, np.float64) - self.center) / self.focal * depth
        return np.concatenate([sides, np.broadcast_to(depth, (*sides.shape[:-1], 1))], axis=-1)

    def depth_gradient(
        self, xy: npt.ArrayLike, depth: npt.ArrayLike, normal: npt.ArrayLike
    ) -> npt.NDArray[np.float64]:
        """Return how the depth of tangent planes changes over the image.

        Along a plane with the normal n, ``z n . r`` is the same for all directions ``r = (X/Z, Y/Z, 1)``.

        Parameters
        ----------
        xy : array_like, (..., 2)
            Where the lens centre sees points, in pixels.
        depth : array_like, (...)
            Their planar depths.
        normal : array_like, (..., 3)
            Normals there of the surface itself, not of its shading, in camera space; of any length and sign.

        Returns
        -------
        ndarray, (..., 2)
            Depth units per pixel along x and y; infinite or NaN where the plane is seen edge-on.
        """
        rays = self.points(xy, np.ones_like(np.asarray(depth, np.float64)))
        normal = np.asarray(normal, np.float64)
        facing = (normal * rays).sum(axis=-1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            result: npt.NDArray[np.float64] = (
                -np.asarray(depth, np.float64)[..., None] / facing * (normal[..., :2] / self.focal)
            )
        return result

    def pixels(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return where the lens centre sees points ``(..., 3)`` in front of it, ``(..., 2)`` in pixels."""
        points = np.asarray(points, np.float64)
        result: npt.NDArray[np.float64] = points[..., :2] / points[..., 2:] * self.focal + self.center
        return result


def finite_numbers(name: str, value: object, count: int) -> tuple[float, ...]:
    """Return `value` as a tuple of `count` numbers up to 1e30; raise a `SampleError` that names it."""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise SampleError(f"expected {count} numbers, got {value!r}", field=name) from None
    if array.shape != (count,) or not (np.abs(array) <= _LARGEST).all():
        raise SampleError(f"expected {count} finite numbers up to {_LARGEST:g}, got {value!r}", field=name)
    return tuple(array.tolist())
