"""Pictures and numbers of `apertures.md`.

Needs no renderer and takes about a minute::

    python docs/figures_apertures.py           # everything
    python docs/figures_apertures.py shapes    # one part
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tyro
from scipy.stats import qmc  # type: ignore[import-untyped]

from fewrays import save_image
from fewrays.aperture import Aperture, ApertureImage
from fewrays.aperture_options import ApertureOptions
from fewrays.display import Panel, tone_map
from fewrays.method import Image
from fewrays.pixel_filter import PixelFilter
from fewrays.sources.analytic import Plane, constant, disc, trace
from fewrays.temporal.locations import make_locations
from fewrays.vignetting import CatsEye
from figure_drawing import BLUE, GREY, Picture, Plot, enlarge, write
from figure_maker import maker
from figure_measures import print_table
from figure_scenes import Floats, at_slope, make_lens

LENS = make_lens(aperture="disc", sampling="disc")
_POINTS = 128
_VIEWS = 512  # lens points that pictures average over
_COUNTS = (32, 128, 512)
_IMAGE = 96  # pixels of a painted aperture along each side


# Apertures.


def painted(inside: Callable[[Floats, Floats], npt.NDArray[np.bool_]]) -> Floats:
    """Return the antialiased image (h, w) of a shape on the lens square."""
    fine = 4 * _IMAGE
    axis = (2 * np.arange(fine) + 1) / fine - 1
    open_ = inside(*np.meshgrid(axis, axis)).astype(np.float64)
    return np.asarray(open_.reshape(_IMAGE, 4, _IMAGE, 4).mean(axis=(1, 3)))


def ring(u: Floats, v: Floats) -> npt.NDArray[np.bool_]:
    """Tell what a mirror lens lets pass, whose secondary mirror is in the way."""
    return np.asarray(np.abs(np.hypot(u, v) - 0.725) < 0.275)


def heart(u: Floats, v: Floats) -> npt.NDArray[np.bool_]:
    """Tell what is inside a heart."""
    x, y = 1.25 * u, 0.15 - 1.25 * v
    return np.asarray((x**2 + y**2 - 1) ** 3 < x**2 * y**3)


def spots(u: Floats, v: Floats) -> npt.NDArray[np.bool_]:
    """Tell what is inside one of two discs."""
    return np.asarray((np.hypot(u - 0.5, v) < 0.4) | (np.hypot(u + 0.5, v + 0.2) < 0.35))


def blots(u: Floats, v: Floats) -> npt.NDArray[np.bool_]:
    """Tell what is inside five scattered discs of different sizes."""
    x, y, radius = np.random.default_rng(3).uniform((-0.6, -0.6, 0.12), (0.6, 0.6, 0.35), (5, 3)).T
    return np.asarray((np.hypot(u[..., None] - x, v[..., None] - y) < radius).any(axis=-1))


# Parts.


def shapes() -> None:
    """Draw points of apertures, and lights behind and in front of the focal plane through these apertures."""
    with tempfile.TemporaryDirectory() as folder:
        files = {name: Path(folder) / f"{name}.npy" for name in ("ring", "heart")}
        save_image(files["ring"], painted(ring))
        save_image(files["heart"], painted(heart))
        ways: dict[str, dict[str, Any]] = {
            "disc": {},
            "6 blades": {"blades": 6, "rotation": 10.0},
            "5 blades, roundness 0.5": {"blades": 5, "rotation": -90.0, "roundness": 0.5},
            "image: mirror lens": {"aperture_image": files["ring"]},
            "image: heart": {"aperture_image": files["heart"]},
            "disc, squeeze 2": {"squeeze": 2.0},
        }
        points, lights = [], []
        for name, options in ways.items():
            aperture = ApertureOptions(**options).aperture_of(LENS)
            points.append(Panel(_drawn(aperture.points(_POINTS)), name))
            image = _averaged(_lights(), aperture, CatsEye(), 104, 104)
            lights.append(Panel(enlarge(tone_map(image), 2)))
    write("apertures", [points[:3], lights[:3], points[3:], lights[3:]])


def cats_eye() -> None:
    """Draw a field of lights with optical vignetting, with and without the darkening that it causes."""
    ways = {
        "no vignetting": CatsEye(),
        "strength 0.6": CatsEye(0.6),
        "strength 1": CatsEye(1.0),
        "strength 1, darken": CatsEye(1.0, darken=True),
    }
    panels = [
        Panel(tone_map(_averaged(_field(), Aperture(), eye, 320, 512)), name) for name, eye in ways.items()
    ]
    write("apertures-cats-eye", [panels[:2], panels[2:]])


def evenness() -> None:
    """Print errors of half-planes of an image's points and of other points, relative to random ones."""
    pixels = painted(_unit_disc)
    exact = [error(Aperture().points(n), pixels) / random_error(pixels, n) for n in _COUNTS]
    rows: list[list[object]] = [["exact disc", "spiral", *(f"{r:.2f}" for r in exact)]]
    named = {"disc": _unit_disc, "ring": ring, "heart": heart, "two spots": spots, "five blots": blots}
    for name, inside in named.items():
        pixels = painted(inside)
        aperture = Aperture("image", image=ApertureImage(pixels))
        kinds: dict[str, Callable[[int], list[Floats]]] = {
            "spiral": lambda n: [aperture.points(n)],  # noqa: B023
            "Fibonacci lattice": lambda n: [carried_by_rows(pixels, lattice(n))],  # noqa: B023
            "Sobol": lambda n: [carried_by_rows(pixels, sobol(n, seed)) for seed in range(8)],  # noqa: B023
        }
        for kind, points in kinds.items():
            errors = [math.sqrt(np.mean([error(uv, pixels) ** 2 for uv in points(n)])) for n in _COUNTS]
            ratios = [e / random_error(pixels, n) for e, n in zip(errors, _COUNTS, strict=True)]
            rows.append([name, kind, *(f"{r:.2f}" for r in ratios)])
    print_table("evenness: error relative to random points", ("aperture", "points", *map(str, _COUNTS)), rows)


def lattice(count: int) -> Floats:
    """Return a Fibonacci lattice on the unit square, (count, 2)."""
    k = np.arange(count)
    return np.stack([(k + 0.5) / count, k * (math.sqrt(5) - 1) / 2 % 1], axis=-1)


def sobol(count: int, seed: int) -> Floats:
    """Return scrambled Sobol points on the unit square, (count, 2)."""
    return np.asarray(qmc.Sobol(2, seed=seed).random(count))


def carried_by_rows(pixels: Floats, unit: Floats) -> Floats:
    """Carry points of the unit square over to an image: to a row by its light, then along the row."""
    height, width = pixels.shape
    rows = np.concatenate([[0], np.cumsum(pixels.sum(axis=1))]) / pixels.sum()
    row = np.interp(unit[:, 0], rows, np.arange(height + 1))
    enclosed = np.pad(np.cumsum(pixels, axis=1), ((0, 0), (1, 0)))[np.minimum(row.astype(int), height - 1)]
    column = [
        np.interp(share * e[-1], e, np.arange(width + 1))
        for share, e in zip(unit[:, 1], enclosed, strict=True)
    ]
    return np.stack([2 * np.array(column) / width - 1, 2 * row / height - 1], axis=-1)


def _unit_disc(u: Floats, v: Floats) -> npt.NDArray[np.bool_]:
    return np.asarray(np.hypot(u, v) < 1)


def half_planes(pixels: Floats) -> tuple[Callable[[Floats], npt.NDArray[np.bool_]], Floats]:
    """Return which of 500 half-planes hold points, as a function, and their shares of an image's light."""
    axis = (2 * np.arange(_IMAGE) + 1) / _IMAGE - 1
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    light = pixels.ravel() / pixels.sum()
    mean = light @ grid
    spread = math.sqrt(light @ np.square(grid - mean).sum(axis=1) / 2)
    rng = np.random.default_rng(1)
    angle, shift = rng.uniform(0, 2 * math.pi, 500), rng.uniform(-1.5, 1.5, 500) * spread
    normals = np.stack([np.cos(angle), np.sin(angle)])

    def held(uv: Floats) -> npt.NDArray[np.bool_]:
        return np.asarray((uv - mean) @ normals < shift)

    # A pixel that an edge crosses counts by parts, or its size would limit what can be measured.
    parts = (np.stack(np.meshgrid(*2 * [(np.arange(3) - 1) / 1.5]), axis=-1) / _IMAGE).reshape(-1, 2)
    lit = light > 0
    exact = np.mean([light[lit] @ held(grid[lit] + part) for part in parts], axis=0)
    return held, np.asarray(exact)


def error(uv: Floats, pixels: Floats) -> float:
    """Return the root-mean-square error of points over half-planes."""
    held, exact = half_planes(pixels)
    return float(np.sqrt(np.square(held(uv).mean(axis=0) - exact).mean()))


def random_error(pixels: Floats, count: int) -> float:
    """Return the root-mean-square error that random points have."""
    _, exact = half_planes(pixels)
    return math.sqrt(float((exact * (1 - exact)).mean()) / count)


# Drawing.


def _drawn(uv: Floats) -> Picture:
    """Draw points of an aperture within the lens square and its rim, v downwards."""
    plot = Plot(208, 208, (-1.15, 1.15), (1.15, -1.15))
    turn = np.linspace(0, 2 * math.pi, 181)
    plot.line([(float(a), float(b)) for a, b in zip(np.cos(turn), np.sin(turn), strict=True)], GREY, 1)
    for u, v in uv.tolist():
        plot.dot(u, v, BLUE, 2.6)
    return plot.picture()


def _lights() -> list[Plane]:
    """Return a light behind the focal plane and one in front of it, before a dim wall."""
    return [
        Plane(at_slope(-15), constant(4.0, 5.6, 7.2), disc((25.0, 80.0), 3.0)),
        Plane(at_slope(30), constant(26.0, 19.5, 10.5), disc((62.0, 42.0), 3.0)),
        Plane(at_slope(31), constant(0.015, 0.02, 0.03)),
    ]


def _field() -> list[Plane]:
    """Return lights behind the focal plane, one in every square of 64 px, before a dim wall."""
    every = disc((32.0, 32.0), 4.0)
    return [
        Plane(at_slope(26), constant(26.0, 19.5, 10.5), lambda xy: every(np.mod(xy, 64))),
        Plane(at_slope(27), constant(0.03, 0.045, 0.07)),
    ]


def _averaged(planes: list[Plane], aperture: Aperture, eye: CatsEye, height: int, width: int) -> Image:
    """Average what many lens points see of planes, weighted by the optical vignetting."""
    where = make_locations(_VIEWS, aperture, PixelFilter("box"))
    rim = eye.front_rim(where.uv, height, width)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([x, y], axis=-1)
    light, passed = np.zeros((height, width, 3)), np.zeros((height, width, 1))
    for uv, offset in zip(where.uv, where.offset, strict=True):
        weight = rim.passes(uv, pixels)[..., None]
        seen, _ = trace(planes, LENS, pixels + offset, np.broadcast_to(uv, pixels.shape))
        light += weight * seen
        passed += weight
    return np.asarray(light / (where.count if eye.darken else passed), np.float32)


PARTS: dict[str, Callable[[], None]] = {part.__name__: part for part in (shapes, cats_eye, evenness)}


if __name__ == "__main__":
    tyro.cli(maker(PARTS, "apertures.md"))
