"""Optical vignetting: blurred lights turn from discs into cat's eyes towards the corners of the image.

A lens is longer than thin. Rays that come in at an angle meet its front rim, which stands before the aperture
and so appears displaced against it by a distance that grows like the tangent of the angle: in proportion to
the distance from the image's centre. What passes is where the two overlap, as in the variable cone model of
lenses [1]_. With r the distance of a pixel from the centre in half diagonals, e its direction there, and s
the strength, the rim is the circle

    |(u, v) + s r e| = 1,

displaced towards the centre of the image: a ray that reaches the pixel through an outer point of the aperture
passed still farther out where the front rim stands. Lights behind the focal plane lose their outer side,
those in front of it their inner side. In a lens whose rear rim cuts it is the other way round.

Two discs of radius 1 whose centres are ``d = s r`` apart overlap in a lens shape of the area
``2 acos(d/2) - d √(4 - d²) / 2``. It is ``2 - d`` wide along e and ``√(4 - d²)`` across: its long axis is
tangential.

With few lens points the rim must be soft, or points drop out one by one from pixel to pixel. Its width is the
mean distance of N points that are spread over the unit disc, and it lies half inside of the exact rim and
half outside, for which the light is right to first order; but it never reaches farther in than half the
displacement: in the centre of the image nothing is cut.

References
----------
.. [1] N. Asada, A. Amano, M. Baba. "Photometric calibration of zoom lens systems". Proceedings of the 13th
   International Conference on Pattern Recognition, 1996.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, require_option

__all__ = ["CatsEye", "FrontRim"]

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FrontRim:
    """Where a lens's front rim appears from each pixel, in the numbers that kernels need.

    The twin of the structure of the same name in ``native/math/cats_eye.h``.

    Parameters
    ----------
    centre_x, centre_y : float
        Middle of the image, in pixels.
    per_pixel : float
        Displacement against the aperture per pixel of distance from the middle, in lens units.
    radius : float
        Of the rim, in lens units: 1, or what a larger aperture takes.
    softness : float
        Width over which the rim fades, in lens units, above 0.
    """

    centre_x: float
    centre_y: float
    per_pixel: float
    radius: float
    softness: float

    def passes(self, uv: npt.ArrayLike, xy: npt.ArrayLike) -> Float64:
        """Return the share of light, 0 to 1, that passes the rim.

        Parameters
        ----------
        uv : array_like, (..., 2)
            Lens positions.
        xy : array_like, (..., 2)
            Image positions in pixels.

        Returns
        -------
        ndarray, (...)
            For both broadcast together.
        """
        middle = np.array((self.centre_x, self.centre_y))
        displacement = self.per_pixel * (np.asarray(xy, np.float64) - middle)
        beyond = np.linalg.norm(np.asarray(uv, np.float64) + displacement, axis=-1) - self.radius
        inner = -0.5 * np.minimum(np.linalg.norm(displacement, axis=-1), self.softness)
        share: Float64 = np.clip(1 - (beyond - inner) / self.softness, 0, 1)
        return share


@dataclass(frozen=True)
class CatsEye:
    """Optical vignetting that grows from the image's centre towards its corners.

    Parameters
    ----------
    strength : float
        Displacement of the front rim in the corners of the image, in lens radii, 0 to 1: 0 for none, at 1 an
        aperture disc keeps 39 % of its area there.
    darken : bool
        Whether what the rim cuts off is lost, as in a lens, where the corners become dark. Otherwise blurred
        lights change their shape alone.

    Raises
    ------
    SampleError
        For a strength out of range.
    """

    strength: float = 0.0
    darken: bool = False

    def __post_init__(self) -> None:
        require_option("cats_eye", self.strength, 0 <= self.strength <= 1, "from 0 to 1")

    def front_rim(self, uv: npt.ArrayLike, height: int, width: int) -> FrontRim:
        """Return the rim for a set of lens points and an image of a size in pixels.

        Parameters
        ----------
        uv : array_like, (N, 2)
            Lens positions: all that pixels average over, for their number makes the rim soft. A rim that
            would cut them in the centre of the image is as large as they need.
        height, width : int
            Of the image, in pixels.

        Raises
        ------
        SampleError
            For no points, or points of another shape.
        """
        uv = np.asarray(uv, np.float64)
        if uv.ndim != 2 or uv.shape[1] != 2 or len(uv) == 0:
            raise SampleError(f"expected lens positions of shape (N, 2), got {uv.shape}", field="uv")
        return FrontRim(
            centre_x=0.5 * width,
            centre_y=0.5 * height,
            per_pixel=self.strength / (0.5 * math.hypot(width, height)),
            radius=max(1.0, float(np.linalg.norm(uv, axis=1).max())),
            softness=math.sqrt(math.pi / len(uv)),
        )

    def weights(self, uv: npt.ArrayLike, height: int, width: int) -> Float64:
        """Weigh lens points for every pixel.

        Parameters
        ----------
        uv : array_like, (N, 2)
            Lens positions that stand for equal shares of light.
        height, width : int
            Of the image, in pixels.

        Returns
        -------
        ndarray, (N, H, W)
            From 0 to 1 with `darken`. Otherwise they are scaled so that those of a pixel sum to N; where the
            rim lets none of the points pass, which takes an aperture far from the lens centre, all weigh 1.

        Raises
        ------
        SampleError
            As `front_rim` does.
        """
        rim = self.front_rim(uv, height, width)
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        passing = rim.passes(np.asarray(uv, np.float64)[:, None, None], np.stack([x, y], axis=-1))
        if self.darken:
            return passing
        total = passing.sum(axis=0)
        scale = np.divide(len(passing), total, out=np.ones_like(total), where=total > 0)
        weights: Float64 = np.where(total > 0, passing * scale, 1.0)
        return weights
