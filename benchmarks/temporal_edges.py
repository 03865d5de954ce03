"""Whether surfaces keep their size: the silhouettes of discs, against the area that they really cover.

Figure 5 of Lehtinen et al. 2011 shows what there is to get wrong. Samples leave gaps within a surface's
outline, and whoever fills these gaps may as well let the outline grow, by up to R. What is measured here is
an image from one point of the lens at one time, in which every silhouette is sharp: the area of discs in it,
less their true area, over their circumference. That is how far the outline lies outside the true one on
average, in pixels.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.sources.analytic import Motion, Plane, constant, motion_of, sample
from fewrays.temporal import TemporalOptions, kernel, make_plan
from fewrays.temporal.hierarchy import Hierarchy
from report import markdown_table, met

__all__ = ["CASES", "SPP", "Case", "Outline", "measure_outlines", "section", "verdict"]

SPP = (1, 2, 4, 8, 16)
TARGET = 0.1
"""Pixels by which an outline may lie outside or inside the true one, on average."""
_SIZE, _RADIUS, _SPACING = 168, 11.0, 42.0  # pixels: 9 discs, away from the image's borders
_FINE = 2  # locations per pixel and axis
_LENS = fewrays.Lens(-40.0, 20.0)
_MOVE = 8.0  # pixels over the shutter

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """Discs before a wall: the slopes of both in pixels, and the discs' movement over the shutter."""

    name: str
    discs: float
    wall: float
    move: float = 0.0

    def motion(self) -> Motion:
        """Return how the discs move."""
        return motion_of(_LENS.depth(self.discs), (self.move, 0.5 * self.move))


CASES = (
    Case("in focus before a blurred wall", 0.0, 10.0),
    Case("blurred before a wall in focus", -10.0, 0.0),
    Case("blurred before a blurred wall", -10.0, 10.0),
    Case("barely before the wall", -2.0, 0.0),
    Case("moving and blurred", -10.0, 0.0, _MOVE),
)


@dataclass(frozen=True)
class Outline:
    """How far the outlines of a case lie from the true ones.

    Parameters
    ----------
    case : str
        Its name.
    spp : int
        Samples per pixel.
    outside : float
        Pixels beyond the true outline on average; negative where discs have shrunk.
    off : float
        Mean distance from it to either side, in pixels: outside and inside do not cancel.
    bare : float
        As `outside`, for surfaces that end at their outermost samples.
    """

    case: str
    spp: int
    outside: float
    off: float
    bare: float


def measure_outlines(cases: Sequence[Case], spps: Sequence[int]) -> list[Outline]:
    """Measure the discs of every case."""
    found = []
    for case in cases:
        print(f"silhouettes: {case.name}", file=sys.stderr)
        found += [_measure(case, spp) for spp in spps]
    return found


def _measure(case: Case, spp: int) -> Outline:
    """Look at discs of radiance 1 before 0 from the lens centre, in the middle of the shutter."""
    planes = [
        Plane(_LENS.depth(case.discs), constant(1.0), partial(_discs, (0.0, 0.0)), case.motion()),
        Plane(_LENS.depth(case.wall), constant(0.0)),
    ]
    samples = sample(planes, _LENS, _SIZE, _SIZE, spp)
    rule = make_plan(samples, TemporalOptions()).rule
    x = (np.arange(_SIZE * _FINE) + 0.5) / _FINE
    places = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    true = _discs((case.move / 2, case.move / 4), places).astype(np.float64)
    hierarchy = Hierarchy(samples, rule)
    locations = np.zeros((len(places), 5), np.float32)
    locations[:, :2] = places
    locations[:, 4] = 0.5
    seen, bare = (
        kernel.reconstruct_locations(hierarchy, each, locations)[0][:, 0].astype(np.float64)
        for each in (rule, replace(rule, overhang=0.0))
    )
    count = len(_centers())
    circumference = count * 2 * math.pi * _RADIUS * _FINE**2  # in locations, for an outline of 1 px
    return Outline(
        case.name,
        spp,
        outside=float((seen - true).sum() / circumference),
        off=float(np.abs(seen - true).sum() / circumference),
        bare=float((bare - true).sum() / circumference),
    )


def _centers() -> Floats:
    """Places (9, 2) of the discs, each on a grid and off it by a part of a pixel of its own."""
    grid = np.stack(np.meshgrid(*2 * [_SPACING * np.arange(1, 4)]), axis=-1).reshape(-1, 2)
    return np.asarray(grid + np.random.default_rng(1).uniform(-0.5, 0.5, grid.shape))


def _discs(moved: tuple[float, float], xy: Floats) -> npt.NDArray[np.bool_]:
    """Tell what lies in one of the discs, moved by some pixels."""
    distance2 = np.square(xy[:, None] - _centers() - np.array(moved)).sum(axis=-1)
    inside: npt.NDArray[np.bool_] = (distance2 < _RADIUS**2).any(axis=-1)
    return inside


def section(outlines: Sequence[Outline]) -> Iterator[str]:
    """Return the page's part on silhouettes."""
    yield "## Silhouettes"
    yield (
        f"Discs of {_RADIUS:g} px before a wall, seen from the lens centre in the middle of the shutter: how "
        "far their outlines lie outside the true ones on average, in px, negative where they have shrunk "
        "(the area covered too much, over the circumference). In brackets the mean distance to either side, "
        "which is the raggedness that the samples leave."
    )
    spps = list(dict.fromkeys(each.spp for each in outlines))
    rows = []
    for case in dict.fromkeys(each.case for each in outlines):
        row = [each for each in outlines if each.case == case]
        rows.append([case, *(f"{each.outside:+.3f} ({each.off:.3f})" for each in row)])
        rows.append([f"{case}, no overhang", *(f"{each.bare:+.3f}" for each in row)])
    yield markdown_table(["discs", *(f"{spp} spp" for spp in spps)], rows)
    yield verdict(outlines)


def verdict(outlines: Sequence[Outline]) -> str:
    """Say where outlines lie too far off."""
    missed = [f"{o.case} at {o.spp} spp ({o.outside:+.2f})" for o in outlines if abs(o.outside) > TARGET]
    return (
        f"Target: at most {TARGET:g} px outside or inside. {met(not missed)} on "
        f"{', '.join(missed) or 'all discs'}."
    )
