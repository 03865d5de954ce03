"""Shapes of the aperture, and equally weighted points that integrate over them.

Points lie on a Vogel spiral [1]_: point k of N stands at the turn ``k / φ²`` (the golden angle) and encloses
the share ``(k + 1/2) / N`` of the light. On a disc the radius is then the root of that share. Every other
shape is star-shaped about the lens centre, so that two one-dimensional warps carry the spiral over and keep
shares of light: the turn goes through the inverse of the light's distribution over directions, the share
through that over radii along the direction. Neighbours stay neighbours, and any number of points is evenly
spread.

References
----------
.. [1] H. Vogel. "A better way to construct the sunflower head". Mathematical Biosciences 44 (3-4), 1979.
   DOI:10.1016/0025-5564(79)90080-4
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import require_option
from fewrays.lens import Lens

__all__ = ["MAX_POINTS", "Aperture", "ApertureShape"]

ApertureShape = Literal["disc", "gaussian", "polygon"]
Float64 = npt.NDArray[np.float64]

MAX_POINTS = 2**16
"""Most points of an aperture in one set."""

_GOLDEN_TURN = (3 - math.sqrt(5)) / 2  # the golden angle, in turns
_RIM = 1e-5  # positions this far beyond the rim still count as inside: float32 rounds them there
_KNOTS = 2048  # of the distribution over half a sector; linear between them: within 1e-7 of the angle
_QUADRATURE = 64  # nodes over half a sector, where the rim is smooth


@dataclass(frozen=True)
class Aperture:
    """What an image integrates over on the lens.

    Parameters
    ----------
    shape : {"disc", "gaussian", "polygon"}
        The unit disc, a Gaussian cut off at the square ``[-1, 1]²`` (as `fewrays.Lens` has it), or a regular
        polygon with its corners on the unit circle.
    sigma : float
        Standard deviation of the Gaussian along one axis before the cut, in lens units, 0.001 to 1000.
    blades : int
        Number of corners of the polygon, 3 to 64.
    rotation : float
        Direction of the polygon's first corner in degrees, from +u towards +v (clockwise on an image, whose y
        points down), -360 to 360.
    roundness : float
        Curvature of the polygon's sides in units of the circle's, 0 to 1: at 0 they are straight, at 1 they
        are arcs of the unit circle.

    Raises
    ------
    SampleError
        For an unknown shape or a number out of its range.

    Examples
    --------
    >>> round(Aperture("polygon", blades=4).area, 6)
    2.0
    """

    shape: ApertureShape = "disc"
    sigma: float = 1.0 / 3.0
    blades: int = 6
    rotation: float = 0.0
    roundness: float = 0.0

    def __post_init__(self) -> None:
        shapes = get_args(ApertureShape)
        require_option("aperture", self.shape, self.shape in shapes, f"out of {', '.join(shapes)}")
        require_option("sigma", self.sigma, 0.001 <= self.sigma <= 1000, "from 0.001 to 1000 lens radii")
        require_option(
            "blades",
            self.blades,
            isinstance(self.blades, int) and 3 <= self.blades <= 64,
            "that is a whole number from 3 to 64",
        )
        require_option("rotation", self.rotation, abs(self.rotation) <= 360, "from -360 to 360 degrees")
        require_option("roundness", self.roundness, 0 <= self.roundness <= 1, "from 0 to 1")

    @classmethod
    def of_lens(cls, lens: Lens) -> Aperture:
        """Return the aperture that a lens has of its own."""
        return cls(lens.aperture, sigma=lens.sigma)

    @cached_property
    def area(self) -> float:
        """Light that passes, in lens units², where the lens centre lets 1 pass per unit of area.

        That is the geometric area of a disc or polygon, and of a Gaussian ``2πσ² erf²(1 / (σ √2))``.
        """
        nodes, weights = np.polynomial.legendre.leggauss(_QUADRATURE)
        half = math.pi / self._sectors
        light = self._light_of_direction(self._rim(half * (nodes + 1) / 2))
        return float(self._sectors * half * (weights * light).sum())

    def contains(self, uv: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Tell which lens positions ``(..., 2)`` let light pass; the rim does, with 1e-5 for rounding."""
        uv = np.asarray(uv, np.float64)
        turn = (np.arctan2(uv[..., 1], uv[..., 0]) - self._first_corner) / (2 * math.pi)
        from_middle = (turn * self._sectors % 1 - 0.5) * (2 * math.pi / self._sectors)
        inside: npt.NDArray[np.bool_] = np.hypot(uv[..., 0], uv[..., 1]) <= self._rim(from_middle) + _RIM
        return inside

    def density(self, uv: npt.ArrayLike) -> Float64:
        """Share of the light per lens unit² at lens positions ``(..., 2)``; 0 outside."""
        uv = np.asarray(uv, np.float64)
        light = np.ones(uv.shape[:-1])
        if self.shape == "gaussian":
            light = np.exp(-0.5 * np.square(uv / self.sigma).sum(axis=-1))
        density: Float64 = np.where(self.contains(uv), light / self.area, 0.0)
        return density

    def points(self, count: int) -> Float64:
        """Spread points over the aperture, for integrals as plain means.

        Parameters
        ----------
        count : int
            Number of points, 1 to `MAX_POINTS`.

        Returns
        -------
        ndarray, (count, 2)
            Lens positions (u, v), from the centre outwards. Each stands for the same share of the light.

        Raises
        ------
        SampleError
            For a count out of range.
        """
        require_option("count", count, 1 <= count <= MAX_POINTS, f"from 1 to {MAX_POINTS}")
        k = np.arange(count, dtype=np.float64)
        angle, rim = self._direction(k * _GOLDEN_TURN % 1)
        radius = self._radius((k + 0.5) / count, rim)
        uv: Float64 = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.clip(uv, -1, 1)  # a cosine's rounding must not leave the square

    @property
    def _sectors(self) -> int:
        """How many equal sectors, from corner to corner, the shape consists of."""
        return {"disc": 1, "gaussian": 4, "polygon": self.blades}[self.shape]

    @property
    def _first_corner(self) -> float:
        """Direction in radians where the first sector begins."""
        return {"disc": 0.0, "gaussian": math.pi / 4, "polygon": math.radians(self.rotation)}[self.shape]

    def _rim(self, from_middle: Float64) -> Float64:
        """Distance of the rim from the lens centre, at angles in radians from the middle of a sector.

        A polygon's side is an arc of curvature κ through two corners on the unit circle. With c and s the
        cosine and sine of half a sector, its own centre lies ``ε / κ`` behind the lens centre, where
        ``ε = √(1 - κ² s²) - κ c``; the formula is written so that κ = 0 is no exception.
        """
        if self.shape == "disc":
            return np.ones_like(from_middle)
        if self.shape == "gaussian":
            return 1 / np.cos(from_middle)
        cosine, sine = math.cos(math.pi / self.blades), math.sin(math.pi / self.blades)
        root = math.sqrt(1 - (self.roundness * sine) ** 2)
        behind = root - self.roundness * cosine
        power = self.roundness * (sine**2 - cosine**2) + 2 * cosine * root
        across = np.sqrt(1 - (behind * np.sin(from_middle)) ** 2)
        rim: Float64 = power / (behind * np.cos(from_middle) + across)
        return rim

    def _light_of_direction(self, rim: Float64) -> Float64:
        """Light per radian in directions with the given rims: the integral of r dr times transmittance."""
        if self.shape == "gaussian":
            light: Float64 = -(self.sigma**2) * np.expm1(-0.5 * (rim / self.sigma) ** 2)
            return light
        return rim**2 / 2

    def _radius(self, share: Float64, rim: Float64) -> Float64:
        """Radius within which lies a share of the light of a direction."""
        if self.shape == "gaussian":
            within = share * np.expm1(-0.5 * (rim / self.sigma) ** 2)
            radius: Float64 = self.sigma * np.sqrt(-2 * np.log1p(within))
            return radius
        return rim * np.sqrt(share)

    def _direction(self, turn: Float64) -> tuple[Float64, Float64]:
        """Return angles in radians and their rims, for shares of light that angles enclose with 0."""
        sector, within = np.divmod(turn * self._sectors, 1)
        shares, angles = self._half_sector
        side = 2 * within - 1
        from_middle = np.copysign(np.interp(np.abs(side), shares, angles), side)
        middle = self._first_corner + (sector + 0.5) * (2 * math.pi / self._sectors)
        return middle + from_middle, self._rim(from_middle)

    @cached_property
    def _half_sector(self) -> tuple[Float64, Float64]:
        """Shares of the light between a sector's middle and angles in radians up to its end, and these."""
        angles = np.linspace(0, math.pi / self._sectors, 2 * _KNOTS + 1)
        light = self._light_of_direction(self._rim(angles))
        simpson = light[:-2:2] + 4 * light[1::2] + light[2::2]
        shares = np.concatenate([[0], np.cumsum(simpson)])
        return shares / shares[-1], angles[::2]
