"""What is seen at one location of the light field: temporal, sections 3.2 and 3.3.

The samples seen around a location, from its lens point at its time, come from one surface or from several, of
which some hide others. They are told apart, front to back, by `group_into_surfaces`. `find_surface` tells
which surface the location shows:

1. If all samples within R belong to one surface: that one.
2. If the front surface within R has samples in all four quadrants around the location, or a triangle of
   samples around it: that one.
3. Otherwise the location is near an edge. All samples within 2R are grouped, and it shows the first surface
   with a triangle of samples around the location that is small enough for nothing to show through it, or else
   the last.

Triangles (`covers`) are those of section 3.3, but for one thing. A surface ends beyond its outermost samples,
so that triangles of samples alone would make all silhouettes shrink: they get the overhang that there is on
average.

Where no sample is within R, the nearest ones stand in. The surface's samples are averaged under a tent
(`tent_weights`). ``native/surfaces.cpp`` is the native twin.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.temporal.plan import WIDEST, SurfaceRule
from fewrays.temporal.reprojection import Sights

__all__ = [
    "LEAST_SAMPLES",
    "Look",
    "Surface",
    "any_covers",
    "covers",
    "crossings",
    "fills_quadrants",
    "find_surface",
    "group_into_surfaces",
    "is_covered",
    "obviously_covers",
    "surrounds",
    "tent_weights",
]

Float64 = npt.NDArray[np.float64]

LEAST_SAMPLES = 4
"""Samples of a surface that stands on its own: fewer do not tell what it covers (section 3.3)."""

Look = Callable[[float], Sights]
"""From a radius in pixels to the samples within it, at positions relative to the location."""


@dataclass(frozen=True)
class Surface:
    """The surface that a location shows.

    Parameters
    ----------
    sights : Sights
        Its samples, at positions relative to the location.
    tent : float
        Radius of the tent to filter them with, in pixels.
    """

    sights: Sights
    tent: float

    @property
    def slope(self) -> float:
        """The least of its slopes, in pixels per lens unit."""
        return float(self.sights.slope.min())


def find_surface(look: Look, rule: SurfaceRule, tally: Counter[str]) -> Surface | None:
    """Find out which surface a location shows (section 3.3, Figure 6).

    Parameters
    ----------
    look : callable
        Finds the samples around the location.
    rule : SurfaceRule
        With the radius R.
    tally : Counter
        Counts, by the names of `fewrays.temporal.statistics.Statistics`, which case it was.

    Returns
    -------
    Surface or None
        None if there is no sample within 8 R.
    """
    tally["locations"] += 1
    near = look(rule.radius)
    if near.count == 0:
        return _find_wide(look, rule, tally)
    front, *behind = group_into_surfaces(near, rule)
    case = "single" if not behind else "quadrants" if fills_quadrants(front.xy) else "covered"
    if case != "covered" or covers(front.xy, rule):
        tally[case] += 1
        tally["surfaces"] += 2 if behind else 1
        return Surface(front, rule.tent * rule.radius)
    tally["wide"] += 1
    return _choose_surface(look(2 * rule.radius), rule, rule.tent * rule.radius, tally)


def _find_wide(look: Look, rule: SurfaceRule, tally: Counter[str]) -> Surface | None:
    """Do the same where no sample is within R: the radius doubles until there are some."""
    tally["wide"] += 1
    radius = 2 * rule.radius
    while (found := look(radius)).count == 0:
        if radius >= WIDEST * rule.radius:
            tally["empty"] += 1
            return None
        radius *= 2
    return _choose_surface(found, rule, rule.tent * radius, tally)


def _choose_surface(sights: Sights, rule: SurfaceRule, tent: float, tally: Counter[str]) -> Surface:
    """Return the first surface that covers the location, or the last, which nothing else is behind.

    A surface of too few samples is blended with the next behind it.
    """
    groups = group_into_surfaces(sights, rule)
    surface: list[Sights] = []
    for group in groups[:-1]:
        tally["surfaces"] += 1
        surface.append(group)
        if sum(part.count for part in surface) < LEAST_SAMPLES:
            tally["merged"] += 1
            continue
        joined = Sights.join(surface)
        if covers(joined.xy, rule):
            tally["covered"] += 1
            return Surface(joined, tent)
        surface = []
    tally["surfaces"] += 1
    tally["last"] += 1
    return Surface(Sights.join([*surface, groups[-1]]), tent)


def crossings(sights: Sights, rule: SurfaceRule) -> Float64:
    """By how much samples' paths cross within the part of lens and shutter that a location stands for.

    Samples of one surface keep their order along x and along y wherever they are seen from (Eq. 5). While the
    lens point varies by δ, their distance along an axis changes by δ times the difference of their slopes,
    and while time varies, by the difference of their speeds. As much of that as exceeds their distance, they
    may cross.

    Parameters
    ----------
    sights : Sights
        Of N samples.
    rule : SurfaceRule

    Returns
    -------
    ndarray, (N, N)
        In pixels, along the axis where they cross more; not positive where they keep their order.
    """

    def apart(values: Float64) -> Float64:
        return np.abs(values[:, None] - values)

    by_lens = rule.along_lens * apart(sights.slope)
    x, y = (
        by_lens + rule.along_time * apart(speed) - apart(position)
        for position, speed in zip(sights.xy.T, sights.speed.T, strict=True)
    )
    return np.maximum(x, y)


def group_into_surfaces(sights: Sights, rule: SurfaceRule) -> list[Sights]:
    """Tell samples apart into surfaces, front to back (Figure 7).

    In order of slope each sample joins the surface at hand, unless it crosses one of its samples: then it is
    the first of the next. Samples of equal slope, such as those of a plane parallel to the image, belong
    together: all of them join, or none.

    Parameters
    ----------
    sights : Sights
        Of at least one sample.
    rule : SurfaceRule
        With the tolerance, in pixels, by which samples of one surface may cross.

    Returns
    -------
    list of Sights
    """
    ordered = sights.take(np.lexsort([sights.xy[:, 1], sights.xy[:, 0], sights.slope]))
    alike = np.flatnonzero(np.diff(ordered.slope, prepend=-np.inf))  # where samples of another slope begin
    crosses = np.tril(crossings(ordered, rule) > rule.tolerance)
    crosses &= ordered.slope[:, None] != ordered.slope
    # For each sample the last one in front of it that it crosses, or -1; then for all of its slope.
    last_crossed = np.where(crosses, np.arange(ordered.count), -1).max(axis=1)
    starts = [0]
    for first, crossed in zip(alike, np.maximum.reduceat(last_crossed, alike), strict=True):
        if crossed >= starts[-1]:
            starts.append(int(first))
    return [ordered.take(slice(*ends)) for ends in itertools.pairwise([*starts, ordered.count])]


def fills_quadrants(xy: Float64) -> bool:
    """Tell whether all four quadrants around the origin hold some of the points (N, 2)."""
    right, below = (xy >= 0).T
    return len(np.unique(right + 2 * below)) == 4


def covers(xy: Float64, rule: SurfaceRule) -> bool:
    """Tell whether a surface with samples at points (N, 2) around the origin covers it.

    Its samples are moved towards the origin by the overhang, straight against where they lie on average.
    Around an origin well inside of the surface that makes no difference: triangles are there either way.
    """
    return is_covered(_reaching_out(xy, rule), rule.radius)


def surrounds(xy: Float64, rule: SurfaceRule) -> bool:
    """Tell whether samples at points (N, 2) lie on all sides of the origin, however far from each other."""
    if not len(xy):
        return False
    x, y = _reaching_out(xy, rule).T
    angle = np.sort(np.arctan2(y, x))
    return bool(np.diff(angle, append=angle[0] + 2 * np.pi).max() <= np.pi)


def any_covers(sights: Sights, rule: SurfaceRule) -> bool:
    """Tell whether one of the surfaces that samples around the origin belong to covers it.

    A surface of too few samples is blended with the next behind it. What all of them together leave open,
    none covers, although some of them alone might reach out in another direction.
    """
    if not surrounds(sights.xy, rule):
        return False
    surface: list[Sights] = []
    for group in group_into_surfaces(sights, rule):
        surface.append(group)
        joined = Sights.join(surface)
        if joined.count < LEAST_SAMPLES:
            continue
        if covers(joined.xy, rule):
            return True
        surface = []
    return False


def obviously_covers(sights: Sights, rule: SurfaceRule) -> bool:
    """Tell whether samples around the origin are one surface and fill all four quadrants."""
    if sights.count < LEAST_SAMPLES:
        return False
    spread = np.ptp(sights.slope) * rule.along_lens + np.ptp(sights.speed, axis=0).max() * rule.along_time
    return bool(spread <= rule.tolerance) and fills_quadrants(sights.xy)


def _reaching_out(xy: Float64, rule: SurfaceRule) -> Float64:
    """Move points (N, 2) towards the origin by the overhang, against where they lie on average."""
    weight = np.maximum(1 - np.square(xy).sum(axis=-1) / rule.radius**2, 0)
    direction = weight @ xy
    length = float(np.hypot(*direction))
    return xy if length == 0 else xy - rule.overhang / length * direction


def is_covered(xy: Float64, radius: float) -> bool:
    """Tell whether a valid triangle of points holds the origin (section 3.3).

    A triangle is valid if no edge is longer than 2R, for then it would not fit into a circle of radius R, and
    if one of its corners is within R.

    Parameters
    ----------
    xy : ndarray, (N, 2)
        In pixels.
    radius : float
        R, in pixels.
    """
    edge2 = np.square(xy[:, None] - xy).sum(axis=-1)
    short = edge2 <= 4 * radius**2
    # Which way round the origin it is from one point to another: positive, negative or 0. The edges of a
    # triangle that holds the origin all go the same way round.
    turn = xy[:, None, 0] * xy[:, 1] - xy[:, None, 1] * xy[:, 0]
    np.fill_diagonal(short, False)  # three different points
    for corner in np.flatnonzero(np.square(xy).sum(axis=-1) <= radius**2):
        second = np.flatnonzero(short[corner] & (turn[corner] >= 0))
        third = np.flatnonzero(short[corner] & (turn[:, corner] >= 0))
        opposite = np.ix_(second, third)
        if (short[opposite] & (turn[opposite] >= 0)).any():
            return True
    return False


def tent_weights(xy: Float64, radius: float) -> Float64:
    """Weigh points by a radial tent around the origin.

    Parameters
    ----------
    xy : ndarray, (N, 2)
        In pixels.
    radius : float
        Where the tent reaches 0, in pixels. It is doubled while there is no point under the tent; with 0, the
        nearest point has all of the weight.

    Returns
    -------
    ndarray, (N,)
        From 0 to 1, not all 0.
    """
    distance = np.hypot(*xy.T)
    if radius == 0:
        return np.asarray(np.arange(len(xy)) == distance.argmin(), np.float64)
    while radius <= distance.min():
        radius *= 2
    weights: Float64 = np.maximum(1 - distance / radius, 0)
    return weights
