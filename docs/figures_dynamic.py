"""Figures and numbers of `dynamic.md`.

Makes every picture and prints every table of the page that needs no renderer; those of rendered scenes are in
`dynamic-results.md`, which ``benchmarks/dynamic.py`` writes::

    python docs/figures_dynamic.py           # everything, a minute
    python docs/figures_dynamic.py cases     # one part

Truths are images of many samples of the same planes through the same disc lens. Unless a table says
otherwise: 36 views, the box pixel filter. Borders, where a pinhole has not seen enough, are not measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import tyro

from fewrays import Lens, defocus
from fewrays.baselines.gather import gather_blur
from fewrays.display import Panel, tone_map
from fewrays.dynamic import DefocusOptions, DepthLayer, kernel, make_light_field
from fewrays.dynamic.views import Views
from fewrays.method import Image
from fewrays.parallel import Execution
from fewrays.sources.analytic import (
    Mask,
    Plane,
    checker,
    constant,
    disc,
    half_plane,
    reference,
    smooth_noise,
    trace,
)
from fewrays.sources.analytic_pinhole import pinhole
from figure_drawing import enlarge, write
from figure_maker import maker
from figure_measures import print_table
from figure_scenes import TRUTH_SPP, Floats, at_slope, make_lens

LENS = make_lens(aperture="disc", sampling="disc")
PUBLISHED: dict[str, Any] = {
    "lens_points": "halton",
    "prefilter": "mipmap",
    "fill_reach": 0,
    "split_edges": False,
    "growth": 1,
}
_HEIGHT, _WIDTH = 96, 144
_EDGE = (72.0, 48.0)
_SLANT = (1.0, 0.22)  # normal of the edge, towards the background
_BLUR = 11.0  # pixels


# Figure 7.


def _card(slope: float) -> Plane:
    """Return the foreground: a card that covers all to the left of a slanted edge."""
    paint = checker(9, (0.75, 0.3, 0.08), (0.95, 0.65, 0.25))
    towards = (-_SLANT[0], -_SLANT[1])
    return Plane(at_slope(slope), paint, half_plane(_EDGE, towards))


def _wall(slope: float) -> Plane:
    """Return the background."""
    return Plane(at_slope(slope), checker(7, (0.08, 0.16, 0.45), (0.35, 0.55, 0.85)))


def _edge_distance() -> npt.NDArray[np.float64]:
    """Distance of the pixels' centres from the edge, positive over the background, (H, W)."""
    x, y = np.meshgrid(np.arange(_WIDTH) + 0.5, np.arange(_HEIGHT) + 0.5)
    along = (x - _EDGE[0]) * _SLANT[0] + (y - _EDGE[1]) * _SLANT[1]
    return np.asarray(along / np.hypot(*_SLANT), np.float64)


def _ways(front: DepthLayer, behind: DepthLayer, lens: Lens) -> dict[str, Image]:
    """Give a picture depth of field in every way that the page compares."""
    return {
        "blur by circle of confusion": gather_blur(front.color, front.depth, lens),
        "as published": defocus(front.color, front.depth, lens, **PUBLISHED),
        "dynamic": defocus(front.color, front.depth, lens),
        "with the layer behind": defocus(front.color, front.depth, lens, behind=[behind]),
    }


def cases() -> None:
    """Tabulate and draw the four cases of Figure 7: either side of an edge, with either surface in focus."""
    distance = _edge_distance()
    inside = np.zeros(distance.shape, bool)
    inside[16:-16, 20:-20] = True
    sides = ((distance > 0) & (distance < _BLUR), (distance < 0) & (distance > -_BLUR))
    errors: dict[str, list[str]] = {}
    rows = []
    for card, wall, in_focus in ((_card(-_BLUR), _wall(0), "wall"), (_card(0), _wall(_BLUR), "card")):
        front, behind = (pinhole(p, LENS, _HEIGHT, _WIDTH) for p in ([card, wall], [wall]))
        truth = reference([card, wall], LENS, _HEIGHT, _WIDTH, spp=TRUTH_SPP, pixel_filter="box")
        images = {"pinhole": front.color, **_ways(front, behind, LENS), "truth": truth}
        for name, image in images.items():
            squared = np.square(image - truth).mean(axis=-1)
            errors.setdefault(name, []).extend(
                f"{100 * np.sqrt(squared[side & inside].mean()):.2f}" for side in sides
            )
        rows.append(
            [
                Panel(enlarge(tone_map(image[28:68, 44:100]), 5), name, f"{in_focus} in focus")
                for name, image in images.items()
            ]
        )
    head = (
        "",
        "a: wall in focus, its side",
        "b: card's side",
        "c: card in focus, wall's side",
        "d: its side",
    )
    print_table("cases: RMS error in % of white", head, [[name, *e] for name, e in errors.items()][:-1])
    write("dynamic-cases", [part for row in rows for part in (row[:3], row[3:])])


# One view.


def _from_rim(layers: Sequence[DepthLayer], uv: tuple[float, float], **options: Any) -> Image:
    """Return what a single point of the lens sees; black where nothing is known."""
    chosen = DefocusOptions(prefilter="none", **options)
    field = make_light_field(layers, LENS, chosen, Execution())
    field = replace(field, views=Views(np.array([uv]), np.ones(1), field.views.radius))
    sums = np.zeros((field.height, field.width, 5), np.float32)
    kernel.synthesize(field, sums, Execution())
    return np.asarray(sums[..., :3] / np.maximum(sums[..., 4:], 1e-6), np.float32)


def view() -> None:
    """Draw what one point of the lens sees, as its pixels are found (Figure 3)."""
    planes = _still_life()
    layers = [pinhole(planes, LENS, _HEIGHT, _WIDTH), pinhole(planes[1:], LENS, _HEIGHT, _WIDTH)]
    uv = (0.95, 0.1)
    columns, rows = np.meshgrid(np.arange(_WIDTH) + 0.5, np.arange(_HEIGHT) + 0.5)
    centres = np.stack([columns, rows], axis=-1)
    truth, _ = trace(planes, LENS, centres, np.broadcast_to(np.array(uv), centres.shape))
    bare: dict[str, Any] = {"fill_reach": 0, "split_edges": False}
    images: dict[str, Image] = {
        "the pinhole render": layers[0].color,
        "warped; black: no data": _from_rim(layers[:1], uv, **bare),
        "edges apart, background carried on": _from_rim(layers[:1], uv),
        "with the layer behind": _from_rim(layers, uv),
        "truth": np.asarray(truth, np.float32),
    }
    panels = [Panel(enlarge(tone_map(image), 3), name) for name, image in images.items()]
    write("dynamic-view", [panels[:3], panels[3:]])


def _still_life() -> list[Plane]:
    """Return a star in front of a post in focus in front of a wall."""
    return [
        Plane(at_slope(-12), checker(6, (0.75, 0.3, 0.05), (0.95, 0.65, 0.2)), _star((52, 44))),
        Plane(at_slope(0), checker(5, (0.15, 0.35, 0.1), (0.5, 0.7, 0.3)), _post(80, 30)),
        Plane(at_slope(9), checker(9, (0.1, 0.18, 0.45), (0.35, 0.5, 0.8))),
    ]


def _star(center: tuple[float, float]) -> Mask:
    def mask(xy: Floats) -> npt.NDArray[np.bool_]:
        x, y = np.moveaxis(xy - np.array(center), -1, 0)
        inside: npt.NDArray[np.bool_] = np.hypot(x, y) < 22 + 8 * np.cos(5 * np.arctan2(y, x))
        return inside

    return mask


def _post(left: float, width: float) -> Mask:
    right_of, left_of = half_plane((left, 0), (1, 0)), half_plane((left + width, 0), (-1, 0))
    return lambda xy: right_of(xy) & left_of(xy)


# Rims.


def rims() -> None:
    """Draw antialiased edges out of focus, taken apart and not, with each depth that a renderer may give."""
    planes = [
        Plane(at_slope(-14), constant(0.02, 0.03, 0.02), _star((48, 44))),
        Plane(at_slope(0), smooth_noise(30, mean=(0.75, 0.8, 0.9), contrast=0.05)),
    ]
    size = (88, 96)
    front = pinhole(planes, LENS, *size)
    truth = reference(planes, LENS, *size, spp=TRUTH_SPP, pixel_filter="box")
    depths = {
        "depth of the pixel's centre": front.depth,
        "depth averaged over the pixel": _averaged(planes, size),
    }
    rows, panels = [], []
    for name, depth in depths.items():
        images = {
            "as one": defocus(front.color, depth, LENS, split_edges=False, views=64),
            "taken apart": defocus(front.color, depth, LENS, views=64),
        }
        rows.append([name, *(f"{_rms(image, truth):.2f}" for image in images.values())])
        panels.append(
            [Panel(enlarge(tone_map(image[16:72, 16:80]), 5), how, name) for how, image in images.items()]
        )
    panels[0].append(Panel(enlarge(tone_map(truth[16:72, 16:80]), 5), "truth"))
    print_table("rims: RMS error in % of white", ("", "edges as one", "taken apart"), rows)
    write("dynamic-rims", panels)


def _averaged(planes: Sequence[Plane], size: tuple[int, int], fine: int = 8) -> npt.NDArray[np.float32]:
    """Return depth (H, W) averaged over each pixel, as some renderers give it."""
    height, width = size
    x, y = np.meshgrid((np.arange(width * fine) + 0.5) / fine, (np.arange(height * fine) + 0.5) / fine)
    centres = np.stack([x, y], axis=-1)
    _, depth = trace(planes, LENS, centres, np.zeros_like(centres))
    mean: npt.NDArray[np.float32] = depth.reshape(height, fine, width, fine).mean(axis=(1, 3))
    return mean


def _rms(image: Image, truth: Image) -> float:
    return 100 * float(np.sqrt(np.square(image - truth)[16:-16, 16:-16].mean()))


# Apertures.


def apertures() -> None:
    """Draw small lights out of focus through several apertures, and add their light up."""
    height, width = 120, 176
    planes = _night()
    layer = pinhole(planes, LENS, height, width)
    ways: dict[str, dict[str, Any]] = {
        "36 Halton points, mip pyramid": {**PUBLISHED, "growth": 0},
        "36 views": {},
        "256 views": {"views": 256},
        "6 blades": {"views": 256, "blades": 6, "rotation": 10.0},
        "5 blades, roundness 0.5": {"views": 256, "blades": 5, "roundness": 0.5},
        "squeeze 2: anamorphic": {"views": 256, "squeeze": 2.0},
        "cat's eye 0.8": {"views": 256, "cats_eye": 0.8},
    }
    images = {name: defocus(layer.color, layer.depth, LENS, **options) for name, options in ways.items()}
    images["truth, disc"] = reference(planes, LENS, height, width, spp=TRUTH_SPP, pixel_filter="box")
    panels = [Panel(enlarge(tone_map(image, -1.0), 2), name) for name, image in images.items()]
    rows = [[name, f"{100 * image.sum() / layer.color.sum():.1f}"] for name, image in images.items()]
    print_table("apertures: light in % of the pinhole render's", ("", "light"), rows)
    write("dynamic-apertures", [panels[:4], panels[4:]])


def _night() -> list[Plane]:
    """Return lights out of focus behind a post in focus."""
    rng = np.random.default_rng(5)
    lights = [
        Plane(at_slope(16 - 0.1 * i), constant(*(180 * color)), disc((float(x), float(y)), 1.6))
        for i, (x, y, color) in enumerate(
            zip(rng.uniform(28, 148, 9), rng.uniform(24, 96, 9), rng.uniform(0.3, 1, (9, 3)), strict=True)
        )
    ]
    post = Plane(at_slope(0), checker(6, (0.15, 0.1, 0.05), (0.4, 0.3, 0.2)), _post(82, 9))
    return [post, *lights, Plane(at_slope(20), smooth_noise(24, mean=(0.05, 0.07, 0.14), contrast=0.02))]


PARTS: dict[str, Callable[[], None]] = {part.__name__: part for part in (view, cases, rims, apertures)}


if __name__ == "__main__":
    tyro.cli(maker(PARTS, "dynamic.md"))
