"""How much of an area light reaches a point past opaque shapes: integrals without noise.

The light is cut into parallel slices. On each, seen from the point, shapes begin and end at places that are
roots of linear or quadratic equations (`Shape.crossings`); in between the slice is seen as a whole or not at
all, and what is seen has a closed form. Across the slices the integrand has kinks, where edges enter or leave
the light, and jumps where an edge lies along them: panels of slices are halved until that does not change
their sums. Slices lie askew to the light's axes, so that jumps are rare.

Three penumbrae have closed forms as shares of the light's area: `ramp`, `segment` and `overlap`. They hold in
the plane of the light, onto which the occluder is projected from the point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.sources.opaque_shapes import Shape

__all__ = ["GRAZE", "irradiance", "overlap", "ramp", "segment", "visible_share"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

GRAZE = 1e-7
"""A surface is not in its own way: hits nearer to the lit point than this share of the ray are the point."""

_SKEW = 0.5547  # radians between the slices and the light's u-axis, where edges are not likely to lie
_STEP = np.array([np.cos(_SKEW), np.sin(_SKEW)])  # along slices and across them, in (lu, lv)
_ACROSS = np.array([-_STEP[1], _STEP[0]])
_PANELS = 6  # that discs are divided into to begin with
_ENDS = np.array(
    [0, 1 / 12, 1 / 2, 11 / 12, 1]
)  # of panels between two corners: what is seen may be no more than one
_CAUTION = 0.05  # share of the tolerance that one panel may change by; few do, and some have not seen all
_CHUNK = 2**14  # slices that are worked on at once


def irradiance(
    shapes: Sequence[Shape],
    light: AreaLight,
    points: Floats,
    normals: Floats,
    times: npt.ArrayLike = 0.0,
    *,
    tolerance: float = 1e-4,
) -> Floats:
    """Integrate ``cos cos / r²`` over the part of a light that is seen from points.

    Parameters
    ----------
    shapes : sequence of Shape
        All that light may stop at, the lit surface among it. None passes through the light.
    light : AreaLight
        In the space of the shapes.
    points, normals : ndarray, (N, 3)
        Points, and unit normals on the side that is to be lit.
    times : array_like, (N,) or one for all
        In [0, 1] over the shutter.
    tolerance : float
        Largest error, about, relative to a surface that faces the light and sees all of it.

    Returns
    -------
    ndarray, (N,)
        Irradiance per unit of emitted radiance, in sr.
    """
    times = np.broadcast_to(np.asarray(times, np.float64), points.shape[:1])
    return _Task(shapes, light, points, normals, times).integrate(tolerance)


def visible_share(
    shapes: Sequence[Shape],
    light: AreaLight,
    points: Floats,
    times: npt.ArrayLike = 0.0,
    *,
    tolerance: float = 1e-4,
) -> Floats:
    """Share of a light's area ``(N,)`` that is seen from points ``(N, 3)``; see `irradiance`."""
    times = np.broadcast_to(np.asarray(times, np.float64), points.shape[:1])
    return _Task(shapes, light, points, None, times).integrate(tolerance)


def ramp(edge: npt.ArrayLike) -> Floats:
    """Share of a square ``[-1, 1]²`` below a line parallel to an edge at `edge`: the linear penumbra."""
    return np.asarray(np.clip(0.5 + 0.5 * np.asarray(edge, np.float64), 0, 1))


def segment(edge: npt.ArrayLike) -> Floats:
    """Share of the unit disc below a line at `edge` from the centre: a circular segment."""
    edge = np.clip(np.asarray(edge, np.float64), -1, 1)
    return np.asarray(0.5 + (edge * np.sqrt(1 - edge**2) + np.arcsin(edge)) / np.pi)


def overlap(distance: npt.ArrayLike, radius: float) -> Floats:
    """Share of the unit disc that a disc of some radius, centred at a distance from its centre, covers.

    The two circles enclose a lens, two circular segments of half angles α and β.
    """
    distance = np.asarray(distance, np.float64)
    apart, inside = distance >= 1 + radius, distance <= abs(1 - radius)
    away = np.where(apart | inside, 1.0, distance)  # any number, where the circles do not cross
    with np.errstate(invalid="ignore", divide="ignore"):
        alpha = np.arccos(np.clip((away**2 + 1 - radius**2) / (2 * away), -1, 1))
        beta = np.arccos(np.clip((away**2 + radius**2 - 1) / (2 * away * radius), -1, 1))
    lens = alpha - 0.5 * np.sin(2 * alpha) + radius**2 * (beta - 0.5 * np.sin(2 * beta))
    return np.asarray(np.where(apart, 0.0, np.where(inside, min(1.0, radius**2), lens / np.pi)))


@dataclass(frozen=True)
class _Task:
    """What is integrated: over which light, seen from which points.

    Parameters
    ----------
    shapes : sequence of Shape
        In the way.
    light : AreaLight
        The light.
    points : ndarray, (N, 3)
        From where it is seen.
    normals : ndarray, (N, 3), or None
        Normals of the lit surface for irradiance, none for the share of the area.
    times : ndarray, (N,)
        When.
    """

    shapes: Sequence[Shape]
    light: AreaLight
    points: Floats
    normals: Floats | None
    times: Floats

    def scale(self) -> Floats:
        """Return the integral ``(N,)``, about, for surfaces that face the light and see all of it."""
        if self.normals is None:
            return np.ones(len(self.points))
        local = self.light.to_light_space(self.points, self.times)
        distance = np.maximum(np.linalg.norm(local, axis=-1), self.light.half_size.min())
        return np.asarray(self.light.area * np.maximum(local[:, 2], 0) / distance**3)

    def integrate(self, tolerance: float) -> Floats:
        """Integrate across the slices by Simpson's rule, on panels that are halved until their sums stay."""
        allowed = _CAUTION * tolerance * self.scale()
        total = np.zeros(len(self.points))
        ends = _first_panels(self.light)
        owner = np.repeat(np.arange(len(self.points)), len(ends) - 1)
        low, high = np.tile(ends[:-1], len(self.points)), np.tile(ends[1:], len(self.points))
        at_low, at_middle, at_high = (
            self._slices_seen(owner, place) for place in (low, 0.5 * (low + high), high)
        )
        while owner.size:
            middle = 0.5 * (low + high)
            at_left = self._slices_seen(owner, 0.5 * (low + middle))
            at_right = self._slices_seen(owner, 0.5 * (middle + high))
            fine = at_low + 4 * at_left + 2 * at_middle + 4 * at_right + at_high
            # By how much halving has changed the sum; a kink in an unlucky place shows in the odd difference.
            change = np.abs(fine - 2 * (at_low + 4 * at_middle + at_high))
            oddity = 0.5 * np.abs(at_high - at_low - 2 * (at_right - at_left))
            twelfth = (high - low) / 12
            settled = ~(twelfth * np.maximum(change, oddity) > allowed[owner])
            total += np.bincount(owner[settled], (twelfth * fine)[settled], len(total))

            def split(left: Floats, right: Floats, again: npt.NDArray[np.bool_] = ~settled) -> Floats:
                return np.concatenate([left[again], right[again]])

            owner = np.concatenate([owner[~settled]] * 2)
            low, high = split(low, middle), split(middle, high)
            at_low, at_middle, at_high = (
                split(at_low, at_middle),
                split(at_left, at_right),
                split(at_middle, at_high),
            )
        return total

    def _slices_seen(self, owner: Indices, places: Floats) -> Floats:
        """Integrate along slices at places ``(K,)`` across the light, each seen from one of the points."""
        result = np.empty(len(owner))
        for first in range(0, len(owner), _CHUNK):
            some = slice(first, first + _CHUNK)
            result[some] = self._slice_sums(owner[some], _slices_at(self.light, places[some]))
        return result

    def _slice_sums(self, owner: Indices, slices: _Slices) -> Floats:
        """Integrate along slices ``(M,)``, each seen from one of the points."""
        along = (slices.step * self.light.half_size) @ self.light.axes[:2]
        start = self.light.points(slices.start, self.times[owner])
        number, first, last = self._seen_pieces(owner, start, along, slices.length)
        seen = last - first
        if self.normals is not None:
            seen = self._kernel_sums(owner[number], start[number], along, first, last)
        return np.asarray(np.bincount(number, slices.weight[number] * seen, len(owner)))

    def _seen_pieces(
        self, owner: Indices, start: Floats, along: Floats, length: Floats
    ) -> tuple[Indices, Floats, Floats]:
        """Find the pieces of slices that are seen: of which slice, from where to where on it, ``(P,)``."""
        eye, time = self.points[owner], self.times[owner]
        places = [shape.crossings(eye, start, along, time) for shape in self.shapes]
        if self.normals is not None:
            normal = self.normals[owner]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                horizon = ((eye - start) * normal).sum(axis=-1) / (normal @ along)
            places.append(horizon[:, None])
        reach = length[:, None]
        cuts = np.concatenate([np.zeros_like(reach), *places, reach], axis=-1)
        cuts = np.sort(np.clip(np.nan_to_num(cuts), 0, reach), axis=-1)

        number, piece = np.nonzero(np.diff(cuts) > 0)
        first, last = cuts[number, piece], cuts[number, piece + 1]
        eye, time = eye[number], time[number]
        target = start[number] + 0.5 * (first + last)[:, None] * along
        seen = np.ones(len(number), bool)
        for shape in self.shapes:
            seen &= shape.hit(target, eye - target, time) >= 1 - GRAZE
        return number[seen], first[seen], last[seen]

    def _kernel_sums(
        self, owner: Indices, start: Floats, along: Floats, first: Floats, last: Floats
    ) -> Floats:
        """Integrate ``cos cos / r²``, times the light's area, along pieces of slices ``(P,)``.

        Along a slice r times the first cosine is linear, r times the second constant and r² quadratic: the
        integral is elementary.
        """
        assert self.normals is not None
        away, normal = start - self.points[owner], self.normals[owner]
        height, rise = (away * normal).sum(axis=-1), normal @ along
        depth = np.maximum(self.light.to_light_space(self.points, self.times)[:, 2], 0)[owner]
        a, b, c = np.square(away).sum(axis=-1), 2 * away @ along, float(along @ along)
        root = 4 * a * c - b**2

        def primitive(s: Floats) -> Floats:
            slope, r2 = 2 * c * s + b, a + s * (b + s * c)
            flat = (slope / r2 + 4 * c / np.sqrt(root) * np.arctan(slope / np.sqrt(root))) / root
            return np.asarray((height - rise * b / (2 * c)) * flat - rise / (2 * c * r2))

        above = height + 0.5 * (first + last) * rise > 0
        lit = above & (depth > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.light.area * np.where(lit, depth * (primitive(last) - primitive(first)), 0.0)


@dataclass(frozen=True)
class _Slices:
    """Parallel slices of a light, in its coordinates (lu, lv).

    Parameters
    ----------
    start : ndarray, (M, 2)
        Where they begin.
    step : ndarray, (2,)
        Their direction, a unit vector.
    length : ndarray, (M,)
        How long they are.
    weight : ndarray, (M,)
        Share of the light's area that a unit of their length, and of their place, stands for.
    """

    start: Floats
    step: Floats
    length: Floats
    weight: Floats


def _slices_at(light: AreaLight, place: Floats) -> _Slices:
    """Cut a light at places ``(M,)`` across it: distances from the middle, or on a disc their arcsines."""
    if light.shape == "disc":
        # A disc's chords grow as a square root of the distance from the rim; as an angle's cosine they are
        # smooth.
        offset, half = np.sin(place), np.cos(place)
        first, last, weight = -half, half, half / np.pi
    else:
        offset = place
        ends = (np.array([[-1.0], [1.0]]) * np.sign(_STEP) - (offset[:, None] * _ACROSS)[:, None]) / _STEP
        first, last = ends[:, 0].max(axis=-1), ends[:, 1].min(axis=-1)
        weight = np.full_like(offset, 0.25)
    return _Slices(offset[:, None] * _ACROSS + first[:, None] * _STEP, _STEP, last - first, weight)


def _first_panels(light: AreaLight) -> Floats:
    """Return the ends of panels ``(K + 1,)`` across the slices of a light: its corners and more."""
    if light.shape == "disc":
        return np.linspace(-0.5 * np.pi, 0.5 * np.pi, _PANELS + 1)
    corners = np.sort([_ACROSS @ corner for corner in ([1, 1], [1, -1], [-1, 1], [-1, -1])])
    between = corners[:-1, None] + np.diff(corners)[:, None] * _ENDS[1:]
    return np.concatenate([corners[:1], between.ravel()])
