"""Bright lights out of focus: whether the lens points that all pixels share can be seen in the image.

A light that is smaller than what lies between two neighbouring lens points, seen through these, shows the
points themselves. The authors' code turns the pattern from tile to tile; then tiles show as well, and a
highlight across a border is cut. Three kinds of images are compared with the truth: such tiles, one set of
points for the whole image, and the method as it is, which smooths what is widely blurred.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.display import Panel, save_picture, sheet, tone_map
from fewrays.method import Image
from fewrays.parallel import Execution
from fewrays.sources.analytic import Mask, Plane, constant, reference, sample, smooth_noise
from fewrays.temporal import TemporalOptions, kernel, make_plan
from fewrays.temporal.plan import Plan
from fewrays.temporal.refine import smooth_bands
from report import markdown_table

__all__ = ["Highlight", "draw", "measure_highlights", "section"]

_HEIGHT, _WIDTH, _ZOOM = 128, 192, 3  # pixels; magnification of the picture
_SLOPES = (8.0, 14.0, 22.0)  # pixels
_RADIANCE, _RADIUS = 300.0, 2.0  # of the lights, before a wall of 0.15; pixels
_TILE, _TURNS = 32, 6  # pixels; ways in which the points may be turned
_STOPS = -2.0
_LENS = fewrays.Lens(-60.0, _SLOPES[-1] + 8)


@dataclass(frozen=True)
class Highlight:
    """An image of the lights, and how wrong it is.

    Parameters
    ----------
    name : str
        How it was made.
    image : ndarray, (H, W, 3)
        Linear radiance.
    error : float
        RMS of image minus truth over the mean radiance that the truth has in the lights' discs, in %.
    darkest : float
        Least luminance of any pixel over that of the truth there, in %.
    """

    name: str
    image: Image
    error: float
    darkest: float


def measure_highlights() -> tuple[Image, list[Highlight]]:
    """Make the truth and the images."""
    print("highlights", file=sys.stderr)
    planes = _planes()
    samples = sample(planes, _LENS, _HEIGHT, _WIDTH, 16)
    truth = reference(planes, _LENS, _HEIGHT, _WIDTH, spp=1024, pixel_filter="box")
    plan = make_plan(samples, TemporalOptions())
    ways: dict[str, Callable[[], Image]] = {
        "points turned by tile": lambda: _turned_by_tile(samples, plan),
        "one set of points": lambda: _mean(samples, plan, smoothing=0.0),
        "one set, smoothed": lambda: _mean(samples, plan, smoothing=1.0),
        "temporal": lambda: fewrays.reconstruct(samples, "temporal"),
        "temporal, 512 locations": lambda: fewrays.reconstruct(samples, "temporal", locations=512),
    }
    return truth, [_judged(name, make(), truth) for name, make in ways.items()]


def _judged(name: str, image: Image, truth: Image) -> Highlight:
    lit = truth.max(axis=-1) > 0.5
    error = image.astype(np.float64) - truth
    rms = float(np.sqrt(np.square(error).mean()))
    darkest = float((image.mean(axis=-1) / truth.mean(axis=-1)).min())
    return Highlight(name, image, 100 * rms / float(truth[lit].mean()), 100 * darkest)


def _planes() -> list[Plane]:
    """Return lights at three depths, across borders of tiles and off them, before a dark wall."""
    colors = ((1.0, 0.75, 0.4), (0.6, 0.8, 1.0), (1.0, 0.9, 0.75))
    rng = np.random.default_rng(4)
    planes = [Plane(_LENS.depth(_SLOPES[-1] + 4), smooth_noise(20.0, mean=(0.12, 0.14, 0.2), contrast=0.03))]
    for number, (slope, color) in enumerate(zip(_SLOPES, colors, strict=True)):
        left = _WIDTH * (number + 0.5) / len(_SLOPES)
        places = np.array([(left, 0.3 * _HEIGHT), (left, 0.75 * _HEIGHT)]) + rng.uniform(-9, 9, (2, 2))
        # A light's radiance keeps its disc of equal brightness, whatever the blur.
        scale = _RADIANCE * (slope / _SLOPES[-1]) ** 2
        planes.append(Plane(_LENS.depth(slope), constant(*(scale * c for c in color)), _spots(places)))
    return planes


def _spots(places: npt.NDArray[np.float64]) -> Mask:
    return partial(_near_any, places)


def _near_any(places: npt.NDArray[np.float64], xy: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = np.any(
        [np.square(xy - place).sum(axis=-1) < _RADIUS**2 for place in places], axis=0
    )
    return inside


def _mean(samples: fewrays.SampleBuffer, plan: Plan, *, smoothing: float) -> Image:
    """Reconstruct all locations of a plan, without the correction towards the samples' own mean."""
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    kernel.reconstruct_tiles(samples, plan, bands, Execution())
    return smooth_bands(bands, plan.band_starts, smoothing * plan.rule.along_lens)


def _turned_by_tile(samples: fewrays.SampleBuffer, plan: Plan) -> Image:
    """Reconstruct every tile with the lens points turned by an angle of its own."""
    rng = np.random.default_rng(0)
    rows, columns = -(-_HEIGHT // _TILE), -(-_WIDTH // _TILE)
    turn_of_tile = rng.integers(0, _TURNS, (rows, columns))
    turn = turn_of_tile.repeat(_TILE, axis=0).repeat(_TILE, axis=1)[:_HEIGHT, :_WIDTH]
    image = np.zeros((_HEIGHT, _WIDTH, 3), np.float32)
    for number in range(_TURNS):
        angle = 2 * math.pi * number / _TURNS
        axes = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]], np.float32)
        turned = replace(plan, locations=replace(plan.locations, uv=plan.locations.uv @ axes))
        here = turn == number
        image[here] = _mean(samples, turned, smoothing=0.0)[here]
    return image


def draw(path: Path, truth: Image, highlights: list[Highlight]) -> None:
    """Draw the truth and the images, three in a row."""
    images = [("truth", truth), *((each.name, each.image) for each in highlights)]
    panels = [
        Panel(tone_map(image, _STOPS).repeat(_ZOOM, axis=0).repeat(_ZOOM, axis=1), name)
        for name, image in images
    ]
    save_picture(path, sheet([panels[i : i + 3] for i in range(0, len(panels), 3)]))


def section(highlights: list[Highlight], picture: str) -> Iterator[str]:
    """Return the page's part on highlights."""
    yield "## Highlights out of focus"
    yield (
        f"Lights of {_RADIUS:g} px, over a thousand times brighter than the wall behind them, blurred to "
        f"radii of {', '.join(f'{slope:g}' for slope in _SLOPES)} px; 16 samples and, where it does not say "
        "otherwise, 128 locations per pixel. *Error*: RMS over the mean radiance of the lights' discs. "
        "*Darkest*: the least of all pixels, over the truth there."
    )
    rows = [[each.name, f"{each.error:.1f}", f"{each.darkest:.0f}"] for each in highlights]
    yield markdown_table(["", "error, %", "darkest, %"], rows)
    yield f"![lights: the truth, and images from 128 lens points]({picture})"
