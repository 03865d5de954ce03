"""Outlines of flat shapes: what lies inside, and where a line that is seen in perspective crosses them.

An outline is drawn on a plane with coordinates (a, b) in world units. A point that moves along a straight
line in space and is seen, from an eye, through that plane crosses it at ``numerator(s) / denominator(s)``,
both of them linear in how far it has moved, s. An outline's edges are lines or circles, so that s where the
point goes in or out of sight is the root of a linear or a quadratic equation.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError

__all__ = ["Bars", "Disc", "HalfPlane", "Outline", "Rectangle", "roots"]

Floats = npt.NDArray[np.float64]
Pair = tuple[float, float]


class Outline(ABC):
    """Part of a plane."""

    @abstractmethod
    def contains(self, positions: Floats) -> npt.NDArray[np.bool_]:
        """Whether positions ``(..., 2)`` in world units on the plane lie inside, ``(...)``."""

    @abstractmethod
    def crossings(self, numerator: tuple[Floats, Floats], denominator: tuple[Floats, Floats]) -> Floats:
        """Find where a point of the plane that moves in perspective crosses the edges.

        Parameters
        ----------
        numerator : (ndarray, ndarray), (..., 2)
            Value at s = 0 and change per unit of s of a vector.
        denominator : (ndarray, ndarray), (...)
            The same of the number that divides it: the point is at their quotient.

        Returns
        -------
        ndarray, (..., n)
            Values of s; NaN for edges that are not crossed.
        """


@dataclass(frozen=True)
class HalfPlane(Outline):
    """All that lies on the side of a line that a vector points to.

    Parameters
    ----------
    point : (float, float)
        On the line.
    towards : (float, float)
        Across the line, into the half-plane.

    Raises
    ------
    SampleError
        For a vector of no length.
    """

    point: Pair
    towards: Pair

    def __post_init__(self) -> None:
        if not math.hypot(*self.towards) > 0:
            raise SampleError(f"expected a vector that is not 0, got {self.towards}", field="towards")

    def contains(self, positions: Floats) -> npt.NDArray[np.bool_]:
        """Whether positions lie beyond the line."""
        return np.asarray((positions - np.asarray(self.point)) @ np.asarray(self.towards) > 0)

    def crossings(self, numerator: tuple[Floats, Floats], denominator: tuple[Floats, Floats]) -> Floats:
        """Cross the line at most once."""
        return _line_crossings(
            [self.towards], [float(np.dot(self.point, self.towards))], numerator, denominator
        )


@dataclass(frozen=True)
class Rectangle(Outline):
    """A rectangle along the plane's axes.

    Parameters
    ----------
    center : (float, float)
        Its middle.
    half_size : (float, float)
        From there to its edges, positive.

    Raises
    ------
    SampleError
        For half sizes that are not positive.
    """

    center: Pair
    half_size: Pair

    def __post_init__(self) -> None:
        if not min(self.half_size) > 0:
            raise SampleError(f"expected positive numbers, got {self.half_size}", field="half_size")

    def contains(self, positions: Floats) -> npt.NDArray[np.bool_]:
        """Whether positions lie between both pairs of edges."""
        return np.asarray((np.abs(positions - np.asarray(self.center)) < self.half_size).all(axis=-1))

    def crossings(self, numerator: tuple[Floats, Floats], denominator: tuple[Floats, Floats]) -> Floats:
        """Cross the lines that the four edges lie on."""
        (a, b), (half_a, half_b) = self.center, self.half_size
        normals = [(1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, 1.0)]
        return _line_crossings(
            normals, [a - half_a, a + half_a, b - half_b, b + half_b], numerator, denominator
        )


@dataclass(frozen=True)
class Disc(Outline):
    """A disc.

    Parameters
    ----------
    center : (float, float)
        Its middle.
    radius : float
        Positive.

    Raises
    ------
    SampleError
        For a radius that is not positive.
    """

    center: Pair
    radius: float

    def __post_init__(self) -> None:
        if not self.radius > 0:
            raise SampleError(f"expected a positive number, got {self.radius}", field="radius")

    def contains(self, positions: Floats) -> npt.NDArray[np.bool_]:
        """Whether positions are nearer to the middle than the radius."""
        return np.asarray(np.square(positions - np.asarray(self.center)).sum(axis=-1) < self.radius**2)

    def crossings(self, numerator: tuple[Floats, Floats], denominator: tuple[Floats, Floats]) -> Floats:
        """Cross the circle at most twice: ``|numerator - center denominator| = radius |denominator|``."""
        start, step = (
            top - np.asarray(self.center) * bottom[..., None]
            for top, bottom in zip(numerator, denominator, strict=True)
        )
        d0, d1 = (self.radius * bottom for bottom in denominator)
        return roots(
            np.square(start).sum(axis=-1) - d0**2,
            2 * ((start * step).sum(axis=-1) - d0 * d1),
            np.square(step).sum(axis=-1) - d1**2,
        )


@dataclass(frozen=True)
class Bars(Outline):
    """A grating: parallel bars, endlessly long, with gaps between them.

    Parameters
    ----------
    count : int
        How many bars, at least 1.
    period : float
        From each bar to the next, positive.
    fill : float
        Share of the period that a bar covers, in (0, 1).
    center : (float, float)
        The middle of the grating.
    across : (float, float)
        Direction from bar to bar.

    Raises
    ------
    SampleError
        For numbers out of range.
    """

    count: int
    period: float
    fill: float = 0.5
    center: Pair = (0.0, 0.0)
    across: Pair = (1.0, 0.0)

    def __post_init__(self) -> None:
        for name, good in (
            ("count", self.count >= 1),
            ("period", self.period > 0),
            ("fill", 0 < self.fill < 1),
            ("across", math.hypot(*self.across) > 0),
        ):
            if not good:
                raise SampleError(f"a grating cannot have {getattr(self, name)}", field=name)

    def contains(self, positions: Floats) -> npt.NDArray[np.bool_]:
        """Whether positions lie between the two edges of a bar."""
        place = (positions - np.asarray(self.center)) @ self._direction() / self.period + 0.5 * self.count
        inside = np.abs(np.mod(place, 1) - 0.5) < 0.5 * self.fill
        return np.asarray(inside & (place > 0) & (place < self.count))

    def crossings(self, numerator: tuple[Floats, Floats], denominator: tuple[Floats, Floats]) -> Floats:
        """Cross both edges of every bar."""
        middles = (np.arange(self.count) - 0.5 * (self.count - 1)) * self.period
        edges = np.concatenate(
            [middles - 0.5 * self.fill * self.period, middles + 0.5 * self.fill * self.period]
        )
        normal = self._direction()
        offsets = edges + normal @ np.asarray(self.center)
        return _line_crossings([normal] * len(edges), offsets, numerator, denominator)

    def _direction(self) -> Floats:
        return np.asarray(self.across, np.float64) / math.hypot(*self.across)


def roots(constant: Floats, linear: Floats, square: Floats) -> Floats:
    """Solve ``constant + linear s + square s² = 0`` for arrays of coefficients ``(...)``.

    Returns
    -------
    ndarray, (..., 2)
        NaN where there is no solution. Both are accurate however small `square` is.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        far = -0.5 * (linear + np.copysign(np.sqrt(linear**2 - 4 * square * constant), linear))
        both = np.stack([far / square, constant / far], axis=-1)
    return np.where(np.isfinite(both), both, np.nan)


def _line_crossings(
    normals: npt.ArrayLike,
    offsets: npt.ArrayLike,
    numerator: tuple[Floats, Floats],
    denominator: tuple[Floats, Floats],
) -> Floats:
    """Cross the lines ``normal · position = offset``, n of them: ``(..., n)``."""
    normals, offsets = np.asarray(normals, np.float64), np.asarray(offsets, np.float64)
    start, step = (
        top @ normals.T - bottom[..., None] * offsets
        for top, bottom in zip(numerator, denominator, strict=True)
    )
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        places = -start / step
    return np.where(np.isfinite(places), places, np.nan)
