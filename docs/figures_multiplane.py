"""Figures and numbers of `multiplane.md` that need no renderer.

Those of rendered scenes are in `multiplane-results.md`, which ``benchmarks/multiplane.py`` writes::

    python docs/figures_multiplane.py            # everything, a minute or two
    python docs/figures_multiplane.py larger     # one part

Unless a table says otherwise: 8 samples per pixel, 128 views, a disc lens, the box pixel filter, and PSNR
after clip to [0, 1] and gamma 2.2. Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from fewrays import Multiplane, reconstruct, save_image
from fewrays.display import Panel, tone_map
from fewrays.method import Image
from fewrays.multiplane import render
from fewrays.multiplane.slabs import SlabRule
from fewrays.sources.analytic import (
    Plane,
    constant,
    disc,
    exact_waves,
    motion_of,
    reference,
    sample,
    smooth_noise,
)
from figure_drawing import BLUE, GREEN, GREY, INK, ORANGE, Plot, difference, enlarge, write
from figure_maker import maker
from figure_measures import inner, print_table, quality
from figure_scenes import SPP, TRUTH_SPP, at_slope, leaves, make_lens
from figures_apertures import heart, painted

LENS = make_lens(aperture="disc", sampling="disc")
_MOTION = (9.0, 4.0)  # pixels over the shutter
_SLOPES = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0)


# What rays tell of planes.


def rays() -> None:
    """Draw rays and planes: where a ray counts as a hit, where as a pass, and where it says nothing."""
    plot = Plot(860, 330, (-1.6, 9.4), (-2.2, 2.2))
    depths = (2.0, 4.0, 6.0, 8.0)
    things = {2.0: (0.7, 1.9), 4.0: (-1.9, -0.6), 6.0: (-0.4, 0.5), 8.0: (-2.1, 2.1)}
    for number, depth in enumerate(depths, 1):
        plot.line([(depth, -2.1), (depth, 2.1)], (216, 217, 220), 1)
        plot.line([(depth, y) for y in things[depth]], INK, 5)
        plot.text(depth + 0.08, -2.05, f"plane {number}")
    plot.line([(0, -1), (0, 1)], BLUE, 4)
    plot.text(-1.5, 1.2, "lens")
    for u, aim in ((0.8, 0.1), (0.3, 1.4), (-0.3, -1.0), (-0.8, 0.9), (0.0, -0.2)):
        slope = (aim - u) / depths[2]
        hit = next(d for d in depths if things[d][0] <= u + slope * d <= things[d][1])
        plot.line([(0, u), (hit, u + slope * hit)], GREY, 1)
        for depth in depths:
            if depth < hit:
                plot.dot(depth, u + slope * depth, GREEN, 4)
        plot.dot(hit, u + slope * hit, ORANGE, 6)
    title = "What five rays say of four planes"
    note = "orange: hits; green: passes; of what lies behind its hit a ray says nothing"
    write("multiplane-rays", [[Panel(plot.picture(), title, note)]])


def slabs() -> None:
    """Print how thick planes are, and how many there are up to a blur."""
    rule = SlabRule()
    rows = []
    for size in (1.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0):
        own = int(rule.index(size))
        edges = rule.slope([own - 0.5, own + 0.5])
        rows.append([f"{size:g}", f"{edges[1] - edges[0]:.2f}", 2 * own + 1])
    print_table("slabs", ("blur radius, px", "thickness, px", "planes from -C to C"), rows)


# Known truths.


def planes() -> None:
    """Tabulate planes of smooth noise, whose image is exact: in focus, defocused, and moving."""
    texture = smooth_noise(5.0, seed=2)
    rows = []
    for slope in _SLOPES:
        cells: list[object] = [f"{slope:g}"]
        for velocity in ((0.0, 0.0), _MOTION):
            depth = at_slope(slope)
            motion = motion_of(depth, velocity)
            samples = sample([Plane(depth, texture, motion=motion)], LENS, 96, 96, SPP)
            truth = exact_waves(texture, depth, LENS, 96, 96, motion=motion, pixel_filter="box")
            for method in ("box", "temporal", "multiplane"):
                cells.append(quality(reconstruct(samples, method), truth, 24))
        rows.append(cells)
    head = (
        "C in px",
        *(f"{kind}: {m}" for kind in ("still", "moving") for m in ("box", "temporal", "multiplane")),
    )
    print_table("planes: PSNR in dB", head, rows)


def compensation() -> None:
    """Tabulate what it gains to draw views together by the blur of the maps."""
    rows = []
    for period in (4.0, 6.0, 10.0):
        texture = smooth_noise(period, seed=2)
        for slope in (0.0, 1.0, 2.5, 4.0, 8.0):
            depth = at_slope(slope)
            built = Multiplane.build(sample([Plane(depth, texture)], LENS, 96, 96, 16))
            truth = exact_waves(texture, depth, LENS, 96, 96, pixel_filter="box")
            with patch.object(render, "shrink_of", lambda slope, *_: np.ones(len(slope))):
                apart = built.render()
            rows.append(
                [f"{period:g}", f"{slope:g}", quality(apart, truth, 24), quality(built.render(), truth, 24)]
            )
    head = ("texture, px", "C in px", "views as they are", "views drawn together")
    print_table("compensation: PSNR in dB, 16 spp", head, rows)


# Other lenses.


def apertures() -> None:
    """Draw lights behind and before the focus through many apertures, all from the same planes."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "heart.npy"
        save_image(picture, painted(heart))
        built = Multiplane.build(sample(_lights(), LENS, 120, 168, 16))
        ways: dict[str, dict[str, Any]] = {
            "disc": {},
            "6 blades": {"blades": 6, "rotation": 10.0},
            "5 blades, roundness 0.5": {"blades": 5, "rotation": -90.0, "roundness": 0.5},
            "image: heart": {"aperture_image": picture},
            "cat's eye 1": {"cats_eye": 1.0},
            "squeeze 2": {"squeeze": 2.0},
        }
        panels = [
            Panel(enlarge(tone_map(built.render(views=1024, **options), -0.8), 2), name)
            for name, options in ways.items()
        ]
    write("multiplane-apertures", [panels[:3], panels[3:]])


def _lights() -> list[Plane]:
    """Return lights before and behind the focus, before a dark wall."""
    rng = np.random.default_rng(8)
    lights = []
    for number in range(12):
        column, row = number % 4, number // 4
        place = (42 * column + rng.uniform(14, 28), 40 * row + rng.uniform(14, 26))
        slope = float(rng.choice([-12.0, 12.0])) + 0.1 * number
        color = 60 * rng.uniform((0.7, 0.5, 0.3), 1.0)
        lights.append(Plane(at_slope(slope), constant(*color.tolist()), disc(place, 2.0)))
    return [*lights, Plane(at_slope(18), smooth_noise(24, mean=(0.05, 0.06, 0.12), contrast=0.02))]


def edges() -> None:
    """Draw and measure what rays along edges do for things in focus."""
    scene = leaves()
    rows, panels = [], []
    for slope in (-9.0, -4.0, 5.0, 14.0):
        lens = LENS.refocus(at_slope(slope))
        truth = reference(scene, lens, 128, 192, spp=TRUTH_SPP, pixel_filter="box")
        row: list[Any] = [f"{slope:g}"]
        for spp in (4, 8, 16):
            samples = sample(scene, lens, 128, 192, spp)
            alone = reconstruct(samples, "multiplane", along_edges=0.0)
            along = reconstruct(samples, "multiplane")
            row += [quality(image, truth, 32) for image in (alone, along)]
            if slope == -9 and spp == 4:
                panels = _shown({"truth": truth, "cells alone, 4 spp": alone, "along edges": along}, truth)
        rows.append(row)
    counts = [f"{spp} spp: {way}" for spp in (4, 8, 16) for way in ("cells alone", "along edges")]
    print_table("edges: PSNR in dB, leaves", ("focus on C =", *counts), rows)
    write("multiplane-edges", panels)


def larger() -> None:
    """Draw and measure what planes show through lenses that no sample has looked through."""
    scene = leaves()
    built = Multiplane.build(sample(scene, LENS, 128, 192, SPP))
    rows, panels = [], []
    for scale in (0.5, 1.0, 1.5, 2.0, 3.0):
        lens = LENS.refocus(aperture_scale=scale)
        truth = reference(scene, lens, 128, 192, spp=TRUTH_SPP, pixel_filter="box")
        own = reconstruct(sample(scene, lens, 128, 192, SPP), "multiplane")
        image = built.render(lens)
        rows.append([f"x {scale:g}", *(quality(each, truth, 48) for each in (image, own))])
        if scale == 2:
            panels = _shown(
                {"truth, lens x 2": truth, "planes of the lens x 1": image, "of samples x 2": own}, truth
            )
    print_table(
        "larger: PSNR in dB, leaves", ("lens radius", "the same planes", "samples of that lens"), rows
    )
    write("multiplane-larger", panels)


def refocused() -> None:
    """Measure planes that are looked at with another focus, and what resolution does for them."""
    scene = leaves()
    samples = sample(scene, LENS, 128, 192, SPP)
    rows = []
    for slope in (-9.0, -4.0, 5.0, 14.0):
        lens = LENS.refocus(at_slope(slope))
        truth = reference(scene, lens, 128, 192, spp=TRUTH_SPP, pixel_filter="box")
        ways = [
            Multiplane.build(samples, memory=0.0).render(lens),
            Multiplane.build(samples).render(lens),
            Multiplane.build(samples, linear_to=32.0).render(lens),
            reconstruct(sample(scene, lens, 128, 192, SPP), "multiplane"),
        ]
        rows.append([f"{slope:g}", *(quality(image, truth, 32) for image in ways)])
    head = (
        "focus on C =",
        "memory 0",
        "the same planes",
        "linear_to 32",
        "samples of that focus",
    )
    print_table("refocused: PSNR in dB, leaves", head, rows)


def _shown(images: dict[str, Image], truth: Image) -> list[list[Panel]]:
    rows = []
    for name, image in images.items():
        row = [Panel(enlarge(tone_map(inner(image)), 3), name)]
        if image is not truth:
            row.append(
                Panel(enlarge(difference(inner(image), inner(truth), 4), 3), "difference from it, x 4")
            )
        rows.append(row)
    return rows


PARTS: dict[str, Callable[[], None]] = {
    part.__name__: part for part in (rays, slabs, edges, planes, compensation, apertures, larger, refocused)
}


if __name__ == "__main__":
    tyro.cli(maker(PARTS, "multiplane.md"))
