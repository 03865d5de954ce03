"""Figures and numbers of `temporal.md`.

Makes every picture and prints every table of the page that needs no renderer; those of rendered scenes are in
`temporal-results.md`, which ``benchmarks/temporal.py`` writes::

    python docs/figures_temporal.py            # everything, some minutes
    python docs/figures_temporal.py planes     # one part

Unless a table says otherwise: 8 samples per pixel, 128 locations, a disc lens, the box pixel filter, and PSNR
after clip to [0, 1] and gamma 2.2. Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import tyro
from PIL import Image as Pillow

from fewrays import SampleBuffer, reconstruct
from fewrays.display import Panel, tone_map
from fewrays.method import Image
from fewrays.sources.analytic import (
    Mask,
    Plane,
    checker,
    constant,
    disc,
    exact_waves,
    half_plane,
    motion_of,
    reference,
    sample,
    smooth_noise,
    trace,
)
from fewrays.temporal import TemporalOptions, kernel, make_plan, surfaces
from fewrays.temporal.dispersion import dispersion, published_radius
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.locations import make_locations
from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.reprojection import Paths
from figure_drawing import BLUE, INK, ORANGE, Plot, difference, enlarge, write
from figure_maker import maker
from figure_measures import print_table, quality
from figure_scenes import SPP, TRUTH_SPP, Floats, at_slope, leaves, make_lens

LENS = make_lens(aperture="disc", sampling="disc")
_MOTION = (9.0, 4.0)  # pixels over the shutter
_PAINT = (
    (0.15, 0.4, 0.1), (0.3, 0.5, 0.1), (0.2, 0.45, 0.3), (0.7, 0.4, 0.2), (0.4, 0.55, 0.7), (0.8, 0.85, 0.8)
)  # fmt: skip


# Light fields.


def rays() -> None:
    """Draw a slice of a light field, its samples, and these samples as one lens point sees them."""
    width, height, span, row = 760, 190, 64.0, 1.0
    planes = [
        Plane(at_slope(-12), constant(0.8, 0.12, 0.08), lambda xy: np.abs(xy[..., 0] - 24) < 7),
        Plane(at_slope(0), checker(4, (0.12, 0.25, 0.12), (0.35, 0.6, 0.3)), lambda xy: xy[..., 0] > 36),
        Plane(at_slope(14), checker(10, (0.1, 0.25, 0.6), (0.45, 0.7, 1.0))),
    ]

    def hit(x: Floats, u: Floats) -> tuple[npt.NDArray[np.float32], Floats]:
        xy = np.stack([x, np.full_like(x, row)], axis=-1)
        color, depth = trace(planes, LENS, xy, np.stack([u, np.zeros_like(u)], axis=-1))
        return color, np.asarray(LENS.slope(depth), np.float64)

    across, up = (np.arange(2 * n) + 0.5 for n in (width, height))
    x, u = np.meshgrid(span * across / (2 * width), 1 - up / height)
    dense = Plot(width, height, (0, span), (-1, 1))
    dense.image.paste(Pillow.fromarray(tone_map(hit(x, u)[0])))
    dense.line([(33, -1), (33, 1)], INK, 3)
    dense.text(34, 0.78, "a pixel is the mean along this line")

    rng = np.random.default_rng(1)
    strata = rng.permuted(np.tile(np.arange(SPP), (int(span), 1)), axis=1)
    few_x = (np.arange(int(span))[:, None] + rng.random(strata.shape)).ravel()
    few_u = 2 * ((strata + rng.random(strata.shape)) / SPP).ravel() - 1
    color, slope = hit(few_x, few_u)
    sampled = Plot(width, height, (0, span), (-1, 1))
    moved = Plot(width, height, (0, span), (-1, 1))
    point = 0.5
    for x_i, u_i, c, shown in zip(few_x, few_u, slope, tone_map(color[None])[0].tolist(), strict=True):
        sampled.dot(x_i, u_i, tuple(shown), 3)
        seen = x_i + (point - u_i) * c
        moved.line([(x_i, u_i), (seen, point)], (216, 217, 220), 1)
    for x_i, u_i, c, shown in zip(few_x, few_u, slope, tone_map(color[None])[0].tolist(), strict=True):
        moved.dot(x_i + (point - u_i) * c, point + 0.04 * (c / 14), tuple(shown), 3)
    moved.line([(33 - 1.2, 0.3), (33 + 1.2, 0.3)], INK, 3)
    moved.text(34.6, 0.3, "R around a location")
    write(
        "temporal-rays",
        [
            [
                Panel(
                    dense.picture(), "A slice of the light field", "image position to the right, lens upwards"
                )
            ],
            [Panel(sampled.picture(), "What the renderer traced: 8 samples per pixel")],
            [
                Panel(
                    moved.picture(),
                    "All samples, seen from one point of the lens",
                    "each moves along its own slope; near the location are front and back",
                )
            ],
        ],
    )


def radius() -> None:
    """Print the radius R that patterns of samples have, still and moving."""
    rows = []
    for spp in (1, 2, 4, 8, 16, 32):
        still, moving = (
            dispersion(sample([Plane(1.0, constant(0.5), motion=motion)], LENS, 48, 48, spp))
            for motion in ((0.0, 0.0, 0.0), motion_of(1.0, _MOTION))
        )
        rows.append([spp, *(f"{value:.2f}" for value in (published_radius(spp), still, moving, 1.7 * still))])
    head = ("spp", "2/√spp", "measured, still", "measured, moving", "R used, still")
    print_table("radius: the largest hole of reprojected samples, in px", head, rows)


# Surfaces.


def edges() -> None:
    """Draw a silhouette as four rules see it: what fills holes must not let outlines grow."""
    height, width, fine = 40, 56, 6
    planes = [
        Plane(at_slope(-10), checker(5, (0.7, 0.25, 0.05), (0.95, 0.6, 0.2)), _star((width / 2, height / 2))),
        Plane(at_slope(6), checker(7, (0.1, 0.2, 0.5), (0.3, 0.5, 0.8))),
    ]
    guard = 16
    planes = [_moved(plane, guard) for plane in planes]
    samples = sample(planes, LENS, height + 2 * guard, width + 2 * guard, 4)
    rule = make_plan(samples, TemporalOptions()).rule
    grid = np.stack(
        np.meshgrid((np.arange(width * fine) + 0.5) / fine, (np.arange(height * fine) + 0.5) / fine), axis=-1
    )
    places = (grid + guard).reshape(-1, 2)
    truth, _ = trace(planes, LENS, places, np.zeros_like(places))
    bare = SurfaceRule(rule.radius, rule.along_lens, rule.along_time)
    images = {
        "truth: seen from the lens centre": truth,
        "any front sample within R wins": _front_wins(samples, places, rule),
        "triangles of samples": _seen(samples, places, bare),
        "triangles and overhang": _seen(samples, places, rule),
    }
    shape = (height * fine, width * fine, 3)
    panels = [Panel(tone_map(image.reshape(shape)), name) for name, image in images.items()]
    write("temporal-edges", [panels[:2], panels[2:]])


def _star(center: tuple[float, float]) -> Mask:
    """Tell what lies in a star of five points, in pixels."""

    def mask(xy: Floats) -> npt.NDArray[np.bool_]:
        x, y = np.moveaxis(xy - np.array(center), -1, 0)
        inside: npt.NDArray[np.bool_] = np.hypot(x, y) < 12 + 5 * np.cos(5 * np.arctan2(y, x))
        return inside

    return mask


def _moved(plane: Plane, by: float) -> Plane:
    """Return a still plane moved right and down, so that there is a guard band around the image."""
    color, mask = plane.color, plane.mask
    return Plane(plane.depth, lambda xy: color(xy - by), mask and (lambda xy: mask(xy - by)))


def _seen(samples: SampleBuffer, places: Floats, rule: SurfaceRule) -> npt.NDArray[np.float32]:
    """Reconstruct places of the lens centre's view, (N, 3)."""
    locations = np.zeros((len(places), 5), np.float32)
    locations[:, :2] = places
    return kernel.reconstruct_locations(Hierarchy(samples, rule), rule, locations)[0]


def _front_wins(samples: SampleBuffer, places: Floats, rule: SurfaceRule) -> npt.NDArray[np.float32]:
    """Reconstruct the same as if the front surface covered whatever it has a sample near."""
    sights = Paths.of_samples(samples).seen_from(0.0, 0.0, 0.0)
    color = samples.color.reshape(-1, 3)
    found = np.zeros((len(places), 3), np.float32)
    for number, (x, y) in enumerate(places):
        around = sights.relative_to(x, y)
        near = around.take(np.square(around.xy).sum(axis=-1) <= rule.radius**2)
        if near.count:
            front = surfaces.group_into_surfaces(near, rule)[0]
            weights = surfaces.tent_weights(front.xy, rule.radius)
            found[number] = weights @ color[front.sample] / weights.sum()
    return found


def locations() -> None:
    """Draw the 128 locations of a pixel: on the lens, over time, and on the pixel."""
    options = TemporalOptions()
    where = make_locations(128, options.aperture_of(LENS), options.filter_of_pixels())
    lens = Plot(300, 300, (-1.08, 1.08), (-1.08, 1.08))
    pixel = Plot(300, 300, (-0.54, 0.54), (-0.54, 0.54))
    shutter = Plot(620, 300, (-0.02, 1.02), (-0.03, 1.08))
    turns = [(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * math.pi, 200)]
    lens.line(turns, INK, 1)
    pixel.line([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5)], INK, 1)
    for (u, v), t, (x, y) in zip(where.uv.tolist(), where.t.tolist(), where.offset.tolist(), strict=True):
        color = tuple(round(a + t * (b - a)) for a, b in zip(BLUE, ORANGE, strict=True))
        assert len(color) == 3
        lens.dot(u, v, color, 4)
        pixel.dot(x, y, color, 4)
        shutter.dot(t, math.hypot(u, v), color, 4)
    write(
        "temporal-locations",
        [
            [
                Panel(lens.picture(), "lens points", "blue: early, orange: late"),
                Panel(pixel.picture(), "places in the pixel"),
                Panel(shutter.picture(), "time to the right, distance from the lens centre upwards"),
            ]
        ],
    )


# What is made of the locations.


def _grove() -> list[Plane]:
    """Return the leaves of layered.md, painted so softly that edges and blur are what matters."""
    return [
        replace(plane, color=smooth_noise(6.0, mean=mean, contrast=0.1, seed=number))
        for number, (plane, mean) in enumerate(zip(leaves(), _PAINT, strict=True))
    ]


@cache
def _grove_samples(spp: int) -> SampleBuffer:
    return sample(_grove(), LENS, 128, 192, spp)


@cache
def _grove_truth() -> Image:
    return reference(_grove(), LENS, 128, 192, spp=4 * TRUTH_SPP, pixel_filter="box")


def refinement() -> None:
    """Tabulate and draw what smoothing and correction make of few and of many locations."""
    ways: dict[str, dict[str, Any]] = {
        "mean of the locations": {"smoothing": 0.0, "correction": 0.0},
        "smoothed": {"correction": 0.0},
        "corrected": {"smoothing": 0.0},
        "both (default)": {},
    }
    truth = _grove_truth()
    rows, panels = [], []
    for name, options in ways.items():
        images = [
            reconstruct(_grove_samples(spp), "temporal", locations=count, **options)
            for spp in (2, 8)
            for count in (32, 128)
        ]
        rows.append([name, *(quality(image, truth) for image in images)])
        error = enlarge(difference(images[2], truth, 4.0), 2)
        panels.append(Panel(error, name, f"8 spp, 32 locations: {quality(images[2], truth):.1f} dB"))
    box = [quality(reconstruct(_grove_samples(spp), "box"), truth) for spp in (2, 8)]
    rows.insert(0, ["box", box[0], box[0], box[1], box[1]])
    head = ("grove", *(f"{spp} spp, {count} locations" for spp in (2, 8) for count in (32, 128)))
    print_table("refinement: PSNR in dB", head, rows)
    write("temporal-refinement", [panels[:2], panels[2:]])


def planes() -> None:
    """Tabulate planes of smooth noise, whose image is exact: in focus, defocused, and moving."""
    texture = smooth_noise(5.0, seed=2)
    rows = []
    for slope in (0.0, 1.0, 2.0, 4.0, 8.0, 16.0):
        cells: list[object] = [f"{slope:g}"]
        for velocity in ((0.0, 0.0), _MOTION):
            depth = at_slope(slope)
            motion = motion_of(depth, velocity)
            samples = sample([Plane(depth, texture, motion=motion)], LENS, 96, 96, SPP)
            truth = exact_waves(texture, depth, LENS, 96, 96, motion=motion, pixel_filter="box")
            for method in ("box", "temporal"):
                cells.append(quality(reconstruct(samples, method), truth, 24))
        rows.append(cells)
    head = ("C in px", "still: box", "temporal", "moving: box", "temporal")
    print_table("planes: PSNR in dB", head, rows)


def apertures() -> None:
    """Draw lights, some of them moving, through other apertures and other shutters than the samples'."""
    height, width = 144, 208
    samples = sample(_night(), LENS, height, width, 16)
    ways: dict[str, dict[str, Any]] = {
        "disc, shutter 0 to 1": {},
        "6 blades": {"blades": 6, "rotation": 10.0},
        "5 blades, roundness 0.5": {"blades": 5, "roundness": 0.5},
        "disc, shutter 0 to 0.5": {"shutter": (0.0, 0.5)},
        "disc, triangular response": {"shutter_response": "triangle"},
        "disc, an instant": {"shutter": (0.5, 0.5)},
    }
    panels = [
        Panel(enlarge(tone_map(reconstruct(samples, "temporal", locations=512, **options), -1.0), 2), name)
        for name, options in ways.items()
    ]
    write("temporal-apertures", [panels[:3], panels[3:]])


def _night() -> list[Plane]:
    """Return lights out of focus behind a fence in focus; two of them drive by."""
    rng = np.random.default_rng(3)
    lights = [
        Plane(at_slope(20 - 0.1 * i), constant(*(140 * color)), disc((float(x), float(y)), 2.5))
        for i, (x, y, color) in enumerate(
            zip(rng.uniform(10, 200, 7), rng.uniform(12, 80, 7), rng.uniform(0.3, 1, (7, 3)), strict=True)
        )
    ]
    for i, (x, y) in enumerate(((40.0, 112.0), (150.0, 126.0))):
        depth = at_slope(9 - i)
        tail = constant(60.0, 6.0, 3.0) if i else constant(60.0, 55.0, 40.0)
        lights.append(Plane(depth, tail, disc((x, y), 2.5), motion_of(depth, (30.0, -3.0))))
    post = Plane(at_slope(0), checker(6, (0.15, 0.1, 0.05), (0.4, 0.3, 0.2)), _post(96, 10))
    return [post, *lights, Plane(at_slope(24), smooth_noise(24, mean=(0.05, 0.07, 0.14), contrast=0.02))]


def _post(left: float, width: float) -> Mask:
    right_of = half_plane((left, 0), (1, 0))
    left_of = half_plane((left + width, 0), (-1, 0))
    return lambda xy: right_of(xy) & left_of(xy)


PARTS: dict[str, Callable[[], None]] = {
    part.__name__: part for part in (rays, radius, edges, locations, refinement, planes, apertures)
}


if __name__ == "__main__":
    tyro.cli(maker(PARTS, "temporal.md"))
