"""Shapes of the aperture, and equally weighted points that integrate over them.

Points lie on a Vogel spiral [1]_: point k of N stands at the turn ``k / φ²`` (the golden angle) and encloses
the share ``(k + 1/2) / N`` of the light. On a disc the radius is then the root of that share. Two
one-dimensional warps carry the spiral over to every other shape and keep shares of light: the turn goes
through the inverse of the light's distribution over directions, the share through that over radii along the
direction. Neighbours stay neighbours, and any number of points is evenly spread.

A disc, a Gaussian and polygons are star-shaped about the lens centre and have these distributions in closed
form or from one table. An aperture image may hold anything: there the spiral winds around the centre of its
light, and the light along each of many rays is added up pixel by pixel. Over half-planes that cut discs,
rings, hearts and separate spots, 128 such points have 0.20 to 0.24 of the error of random points; the exact
disc's own have 0.20. Carried over by rows and columns, Sobol points have 0.25 to 0.28, a Fibonacci lattice
0.20 to 0.27: rows tear spots apart that rays keep together (``docs/figures_apertures.py evenness``).

References
----------
.. [1] H. Vogel. "A better way to construct the sunflower head". Mathematical Biosciences 44 (3-4), 1979.
   DOI:10.1016/0025-5564(79)90080-4
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, first_index, require_option
from fewrays.lens import Lens

__all__ = ["MAX_POINTS", "Aperture", "ApertureImage", "ApertureShape"]

ApertureShape = Literal["disc", "gaussian", "polygon", "image"]
Float64 = npt.NDArray[np.float64]

MAX_POINTS = 2**16
"""Most points of an aperture in one set."""

_GOLDEN_TURN = (3 - math.sqrt(5)) / 2  # the golden angle, in turns
_RIM = 1e-5  # positions this far beyond the rim still count as inside: float32 rounds them there
_KNOTS = 2048  # of the distribution over half a sector; linear between them: within 1e-7 of the angle
_QUADRATURE = 64  # nodes over half a sector, where the rim is smooth
_BLACK = 1e-30  # transmittance that is none
_MOST_PIXELS = 256  # of an aperture image along each side
_RAYS = 4096  # over an aperture image: none runs along its rows, and some meet every one of its pixels


class ApertureImage:
    """Transmittance over the lens square, pixel by pixel.

    Two of them are equal if their pixels are.

    Parameters
    ----------
    pixels : array_like, (h, w)
        Transmittance of equal parts of the square ``[-1, 1]²``: row 0 is at v = -1, the top of an image, and
        column 0 at u = -1, its left. Not negative, not all 0; only ratios matter for what an image
        integrates over. More than 256 rows or columns are averaged down to that many.

    Raises
    ------
    SampleError
        For another shape, or values that are negative, not finite, beyond 1e30, or all 0 (below 1e-30).

    Examples
    --------
    >>> ApertureImage([[0.0, 1.0], [1.0, 1.0]]).area
    3.0
    """

    def __init__(self, pixels: npt.ArrayLike) -> None:
        array = np.asarray(pixels)
        if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "fiub":
            raise SampleError(
                f"expected real numbers of shape (h, w), got {array.dtype} of shape {array.shape}",
                field="aperture_image",
            )
        array = array.astype(np.float64)
        bad = ~((array >= 0) & (array <= 1 / _BLACK))
        if bad.any():
            index = first_index(bad)
            raise SampleError(
                f"expected transmittances from 0 to {1 / _BLACK:g}, got {array[index]:g} at row {index[0]}, "
                f"column {index[1]}",
                field="aperture_image",
            )
        if array.max() < _BLACK:
            raise SampleError("is black: no light passes; paint what is open white", field="aperture_image")
        self.pixels: Float64 = np.ascontiguousarray(_reduced(_reduced(array).T).T)
        """Read-only, (h, w), at most 256 a side."""
        self.pixels.setflags(write=False)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ApertureImage) and np.array_equal(self.pixels, other.pixels)

    def __hash__(self) -> int:
        return hash((self.pixels.shape, self.pixels.sum()))

    def __repr__(self) -> str:
        height, width = self.pixels.shape
        return f"ApertureImage({height} x {width} pixels)"

    @property
    def area(self) -> float:
        """Light that passes, in lens units², where a transmittance of 1 lets all pass."""
        return 4 * float(self.pixels.mean())

    def transmittance(self, uv: Float64) -> Float64:
        """Return the transmittance at lens positions ``(..., 2)``; 0 outside the square.

        Within 1e-5 of a border rounding decides on which side of it a position lies: the lighter one counts.
        """
        around = [self._at(uv + np.array((u, v))) for u in (-_RIM, _RIM) for v in (-_RIM, _RIM)]
        light: Float64 = np.asarray(np.maximum.reduce(around))
        light[(np.abs(uv) > 1 + _RIM).any(axis=-1)] = 0
        return light

    def points(self, count: int) -> Float64:
        """Spread points ``(count, 2)`` of equal light over the image: see `Aperture.points`.

        The light along a ray from the centre is ``Σ T (r₁² - r₀²) / 2`` over its pieces between borders of
        pixels, with which all integrals are exact for constant pixels; only directions are rounded, to one in
        4096. A piece without light holds no share of it, so that no point lies in the dark.
        """
        centre, direction = self._centre(), _directions()
        borders = self._borders(centre, direction)
        light = self._light(centre, direction, borders)
        enclosed = np.cumsum(light).reshape(light.shape)
        of_rays = enclosed[:, -1]
        k = np.arange(count, dtype=np.float64)
        ray = np.searchsorted(of_rays[:-1], k * _GOLDEN_TURN % 1 * of_rays[-1], side="right")
        before = np.concatenate([[0], of_rays])[ray]
        wanted = before + (k + 0.5) / count * (of_rays[ray] - before)
        piece = np.minimum(np.searchsorted(enclosed.ravel(), wanted), light.size - 1)
        ray, step = np.divmod(piece, light.shape[1])
        share = 1 - np.clip((enclosed[ray, step] - wanted) / light[ray, step], 0, 1)
        inner, outer = np.square(borders[ray, step]), np.square(borders[ray, step + 1])
        radius = np.sqrt(inner + share * (outer - inner))
        uv: Float64 = centre + radius[:, None] * direction[ray]
        return uv

    def _at(self, uv: Float64) -> Float64:
        """Return the pixels that positions ``(..., 2)`` of the square lie in."""
        height, width = self.pixels.shape
        column = np.clip((uv[..., 0] + 1) * (0.5 * width), 0, width - 1).astype(np.intp)
        row = np.clip((uv[..., 1] + 1) * (0.5 * height), 0, height - 1).astype(np.intp)
        light: Float64 = self.pixels[row, column]
        return light

    def _centre(self) -> Float64:
        """Return the centre of the light, (2,)."""
        light = self.pixels / self.pixels.sum()
        height, width = light.shape
        u, v = ((2 * np.arange(n) + 1) / n - 1 for n in (width, height))
        return np.array([light.sum(axis=0) @ u, light.sum(axis=1) @ v])

    def _borders(self, centre: Float64, direction: Float64) -> Float64:
        """Return the radii (rays, w + h + 2) at which rays cross borders of pixels, in order.

        Borders behind the centre are at 0, those beyond the square where the ray leaves it.
        """
        height, width = self.pixels.shape
        lines = [
            (np.linspace(-1, 1, n + 1) - start) / along[:, None]
            for n, start, along in zip((width, height), centre, direction.T, strict=True)
        ]
        leaves = np.minimum(*(np.maximum(each[:, 0], each[:, -1]) for each in lines))
        radii = np.clip(np.concatenate(lines, axis=1), 0, leaves[:, None])
        return np.sort(radii, axis=1)

    def _light(self, centre: Float64, direction: Float64, borders: Float64) -> Float64:
        """Return the share of all light, up to a factor, of each piece of each ray."""
        middle = (borders[:, 1:] + borders[:, :-1]) / 2
        light = self._at(centre + middle[..., None] * direction[:, None])
        light *= np.diff(np.square(borders), axis=1)
        return light


@dataclass(frozen=True)
class Aperture:
    """What an image integrates over on the lens.

    Parameters
    ----------
    shape : {"disc", "gaussian", "polygon", "image"}
        The unit disc, a Gaussian cut off at the square ``[-1, 1]²`` (as `fewrays.Lens` has it), a regular
        polygon with its corners on the unit circle, or what an image says.
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
    squeeze : float
        Anamorphic factor, 1/8 to 8: how many times as tall as wide the shape becomes. Film calls a lens 2x
        when its blurred lights are ellipses twice as tall as wide. Nothing leaves ``[-1, 1]²``, because the
        shape, after its rotation, becomes narrower: u is divided by `squeeze`; below 1, v is multiplied.
    image : ApertureImage, optional
        For the shape of that name.

    Raises
    ------
    SampleError
        For an unknown shape, a number out of its range, or an image without its shape or the reverse.

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
    squeeze: float = 1.0
    image: ApertureImage | None = None

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
        require_option("squeeze", self.squeeze, 0.125 <= self.squeeze <= 8, "from 0.125 to 8")
        wanted = "that is an ApertureImage, for the shape 'image' alone"
        is_image = self.image is None or isinstance(self.image, ApertureImage)
        fits = is_image and (self.image is not None) == (self.shape == "image")
        require_option("image", self.image, fits, wanted)

    @classmethod
    def of_lens(cls, lens: Lens) -> Aperture:
        """Return the aperture that a lens has of its own."""
        return cls(lens.aperture, sigma=lens.sigma)

    @cached_property
    def area(self) -> float:
        """Light that passes, in lens units², where the lens centre lets 1 pass per unit of area.

        That is the geometric area of a disc or polygon, of a Gaussian ``2πσ² erf²(1 / (σ √2))``, and of an
        image 4 times the mean; each times the factor of the squeeze.
        """
        squeezed = float(self.scale.prod())
        if self.image is not None:
            return squeezed * self.image.area
        nodes, weights = np.polynomial.legendre.leggauss(_QUADRATURE)
        half = math.pi / self.sectors
        light = self._light_of_direction(self._rim(half * (nodes + 1) / 2))
        return squeezed * float(self.sectors * half * (weights * light).sum())

    def contains(self, uv: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Tell which lens positions ``(..., 2)`` let light pass; the rim does, with 1e-5 for rounding."""
        return self._contains(np.asarray(uv, np.float64) / self.scale)

    def density(self, uv: npt.ArrayLike) -> Float64:
        """Share of the light per lens unit² at lens positions ``(..., 2)``; 0 outside."""
        uv = np.asarray(uv, np.float64) / self.scale
        if self.image is not None:
            return self.image.transmittance(uv) / self.area
        light = np.ones(uv.shape[:-1])
        if self.shape == "gaussian":
            light = np.exp(-0.5 * np.square(uv / self.sigma).sum(axis=-1))
        density: Float64 = np.where(self._contains(uv), light / self.area, 0.0)
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
            Lens positions (u, v), from the centre outwards, or from the centre of an image's light. Each
            stands for the same share of the light.

        Raises
        ------
        SampleError
            For a count out of range.
        """
        require_option("count", count, 1 <= count <= MAX_POINTS, f"from 1 to {MAX_POINTS}")
        uv = self._spiral(count) if self.image is None else self.image.points(count)
        return np.clip(uv * self.scale, -1, 1)  # a cosine's rounding must not leave the square

    @property
    def scale(self) -> Float64:
        """Factors by which the squeeze shortens u and v."""
        return np.array([min(1.0, 1 / self.squeeze), min(1.0, self.squeeze)])

    def _contains(self, uv: Float64) -> npt.NDArray[np.bool_]:
        """Tell which positions ``(..., 2)`` are inside before the squeeze."""
        if self.image is not None:
            return self.image.transmittance(uv) > 0
        turn = (np.arctan2(uv[..., 1], uv[..., 0]) - self.first_corner) / (2 * math.pi)
        from_middle = (turn * self.sectors % 1 - 0.5) * (2 * math.pi / self.sectors)
        inside: npt.NDArray[np.bool_] = np.hypot(uv[..., 0], uv[..., 1]) <= self._rim(from_middle) + _RIM
        return inside

    def _spiral(self, count: int) -> Float64:
        """Return the points of a star-shaped aperture before the squeeze."""
        k = np.arange(count, dtype=np.float64)
        angle, rim = self._direction(k * _GOLDEN_TURN % 1)
        radius = self._radius((k + 0.5) / count, rim)
        uv: Float64 = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return uv

    @property
    def sectors(self) -> int:
        """How many equal sectors, from corner to corner, the shape consists of."""
        return {"disc": 1, "gaussian": 4, "polygon": self.blades}[self.shape]

    @property
    def first_corner(self) -> float:
        """Direction in radians where the first sector begins."""
        return {"disc": 0.0, "gaussian": math.pi / 4, "polygon": math.radians(self.rotation)}[self.shape]

    @property
    def rim_arc(self) -> tuple[float, float]:
        """Numbers ε and p of the rim's distance ``p / (ε cos φ + √(1 - ε² sin² φ))`` from the lens centre.

        φ is the angle from the middle of a sector. A polygon's side is an arc of curvature κ through two
        corners on the unit circle. With c and s the cosine and sine of half a sector, its own centre lies
        ``ε / κ`` behind the lens centre, where ``ε = √(1 - κ² s²) - κ c``; the formula is written so that
        κ = 0 is no exception. A disc has the lens centre for its own; a square's sides are straight, as is
        that which holds a Gaussian.
        """
        if self.shape != "polygon":
            return (1.0, 2.0) if self.shape == "gaussian" else (0.0, 1.0)
        cosine, sine = math.cos(math.pi / self.blades), math.sin(math.pi / self.blades)
        root = math.sqrt(1 - (self.roundness * sine) ** 2)
        power = self.roundness * (sine**2 - cosine**2) + 2 * cosine * root
        return root - self.roundness * cosine, power

    def _rim(self, from_middle: Float64) -> Float64:
        """Distance of the rim from the lens centre, at angles in radians from the middle of a sector."""
        if self.shape == "disc":
            return np.ones_like(from_middle)
        if self.shape == "gaussian":
            return 1 / np.cos(from_middle)
        behind, power = self.rim_arc
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
        sector, within = np.divmod(turn * self.sectors, 1)
        shares, angles = self._half_sector
        side = 2 * within - 1
        from_middle = np.copysign(np.interp(np.abs(side), shares, angles), side)
        middle = self.first_corner + (sector + 0.5) * (2 * math.pi / self.sectors)
        return middle + from_middle, self._rim(from_middle)

    @cached_property
    def _half_sector(self) -> tuple[Float64, Float64]:
        """Shares of the light between a sector's middle and angles in radians up to its end, and these."""
        angles = np.linspace(0, math.pi / self.sectors, 2 * _KNOTS + 1)
        light = self._light_of_direction(self._rim(angles))
        simpson = light[:-2:2] + 4 * light[1::2] + light[2::2]
        shares = np.concatenate([[0], np.cumsum(simpson)])
        return shares / shares[-1], angles[::2]


def _directions() -> Float64:
    """Return the unit vectors ``(rays, 2)`` of evenly spread rays, none of them along an axis."""
    angle = (np.arange(_RAYS) + 0.5) * (2 * math.pi / _RAYS)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _reduced(pixels: Float64) -> Float64:
    """Average rows down to as many as an aperture image has at most, by the areas of those they overlap.

    Sums of what overlaps, not differences of running sums: what is dark must stay exactly 0.
    """
    rows = len(pixels)
    if rows <= _MOST_PIXELS:
        return pixels
    borders = np.linspace(0, rows, _MOST_PIXELS + 1)
    averages = []
    for top, bottom in itertools.pairwise(borders):
        row = np.arange(int(top), math.ceil(bottom))
        overlap = np.minimum(row + 1, bottom) - np.maximum(row, top)
        averages.append(overlap @ pixels[row] / (bottom - top))
    return np.stack(averages)
