"""Figures and numbers of `shadows.md` that need no renderer.

Those of rendered scenes and of penumbrae are in `shadows-results.md`, written by
``benchmarks/shadows.py``::

    python docs/figures_shadows.py              # everything, a minute
    python docs/figures_shadows.py geometry     # one part

4 samples per pixel and 128 light points; shares and errors are those of the light that gets there unblocked.
Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import tyro

from fewrays import SampleBuffer, reconstruct
from fewrays.display import Panel, auto_exposure, tone_map
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.sources.analytic_shadows import (
    Ball,
    Camera,
    Column,
    Disc,
    Rectangle,
    Scene,
    Sheet,
    aimed,
    box,
    render_lit,
    true_image,
)
from figure_drawing import BLUE, GREEN, GREY, INK, ORANGE, Plot, enlarge, write
from figure_maker import maker
from figure_measures import inner, print_table

SPP = 4
_BORDER = 4  # pixels
_DARK, _DIM = 1e-6, 0.02  # shares of the brightest pixel
_WAYS: dict[str, Callable[[SampleBuffer], Image]] = {
    "plain average": lambda samples: reconstruct(samples, "box", shadows=False),
    "light at locations": lambda samples: reconstruct(samples, "temporal", light_at="locations"),
    "shaded samples": lambda samples: reconstruct(samples, "box"),
}
_ASIDE = Camera(40, 40, position=(0, 3, 4), target=(0, 0.3, 0), fov=35)
_FLOOR = Sheet((0, 0, 0), (0, 1, 0), (1, 0, 0))
_DISTANT = aimed((-8, 16, 6), (0, 0, 0), (1.5, 1.5), "disc", radiance=(100, 100, 100))

_LIGHT_HEIGHT, _HALF, _PLANE = 4.0, 0.9, 0.9
_COVER = ((-1.15, 1.95), (0.15, 1.95))


def geometry() -> None:
    """Draw light samples in a slice of space, and the same as one point of the light sees them."""
    rng = np.random.default_rng(4)
    count = 14
    start = _HALF * (2 * (rng.permutation(count) + rng.random(count)) / count - 1)
    aim = 5.2 * (np.arange(count) + rng.random(count)) / count - 2.6
    traced, seen = _stage(), _stage()
    traced.text(1.15, _LIGHT_HEIGHT - 0.02, "light")
    traced.text(2.0, _PLANE + 0.25, "second plane")
    traced.text(-2.3, 1.95, "blocker")
    point, receiver = 0.45, -0.55
    for x0, x1 in zip(start.tolist(), aim.tolist(), strict=True):
        hit, blocked = _first_hit(x0, x1)
        color = ORANGE if blocked else GREEN
        traced.line([(x0, _LIGHT_HEIGHT), hit], color, 1)
        traced.dot(*hit, color, 4)
        traced.dot(x0, _LIGHT_HEIGHT, INK, 3)
        seen.line([(point, _LIGHT_HEIGHT), _towards(point, hit, 0.0)], (216, 217, 220), 1)
    for x0, x1 in zip(start.tolist(), aim.tolist(), strict=True):
        hit, blocked = _first_hit(x0, x1)
        seen.dot(*hit, ORANGE if blocked else GREEN, 4)
        seen.dot(*_towards(point, hit, _PLANE), ORANGE if blocked else GREEN, 3)
    place = _towards(point, (receiver, 0.0), _PLANE)[0]
    seen.line([(point, _LIGHT_HEIGHT), (receiver, 0.0)], BLUE, 2)
    seen.line([(place - 0.35, _PLANE - 0.1), (place + 0.35, _PLANE - 0.1)], INK, 3)
    seen.dot(receiver, 0.0, BLUE, 6)
    seen.text(receiver + 0.12, -0.3, "receiver", BLUE)
    seen.text(place + 0.42, _PLANE - 0.17, "R around its place")
    seen.dot(point, _LIGHT_HEIGHT, BLUE, 5)
    write(
        "shadows-geometry",
        [
            [
                Panel(
                    traced.picture(),
                    "Light samples: a ray to what each camera sample hit",
                    "green: it arrives; orange: something is in between",
                ),
                Panel(
                    seen.picture(),
                    "All of them, seen from one point of the light",
                    "near the receiver's place, most end in front of it: it is in shadow",
                ),
            ]
        ],
    )


def _stage() -> Plot:
    """Return a slice of space with the light, the plane Π, a blocker and the ground."""
    plot = Plot(620, 400, (-3.0, 3.4), (-0.6, 4.35))
    plot.line([(-3.0, 0.0), (3.4, 0.0)], GREY, 3)
    plot.line([(-3.0, _PLANE), (3.4, _PLANE)], (196, 198, 203), 1)
    plot.line([(-_HALF, _LIGHT_HEIGHT), (_HALF, _LIGHT_HEIGHT)], INK, 4)
    plot.line(list(_COVER), INK, 5)
    return plot


def _first_hit(start: float, aim: float) -> tuple[tuple[float, float], bool]:
    """Follow a ray from the light to the ground; return where it ends, and whether at the blocker."""
    (left, height), (right, _) = _COVER
    x = start + (aim - start) * (1 - height / _LIGHT_HEIGHT)
    return ((x, height), True) if left < x < right else ((aim, 0.0), False)


def _towards(start: float, through: tuple[float, float], height: float) -> tuple[float, float]:
    """Return where the ray from a light point through another point is at some height."""
    x, y = through
    return start + (x - start) * (_LIGHT_HEIGHT - height) / (_LIGHT_HEIGHT - y), height


def contact() -> None:
    """Draw and measure things that stand on the ground: where they touch it, shadows begin."""
    shapes = [_FLOOR, *box((-0.55, 0, -0.1), (0.36, 0.3), 0.75, turn=25.0), Ball((0.6, 0.35, 0.25), 0.35)]
    lamp = aimed((-2.4, 3.4, -1.2), (0, 0, 0), (0.45, 0.45), radiance=(28, 26, 22))
    camera = replace(_ASIDE, width=128, height=96)
    scene = Scene(camera, shapes, [lamp], unlit=(0.015, 0.018, 0.024))
    samples, truth = render_lit(scene, SPP), true_image(scene, rays=8, tolerance=2e-3)
    exposure = auto_exposure(truth)
    images = {name: way(samples) for name, way in _WAYS.items()}
    panels = [
        Panel(
            enlarge(tone_map(image, exposure), 3),
            name,
            f"PSNR {psnr_display(inner(image, _BORDER), inner(truth, _BORDER)):.1f} dB",
        )
        for name, image in images.items()
    ]
    write(
        "shadows-contact", [[*panels[:2]], [panels[2], Panel(enlarge(tone_map(truth, exposure), 3), "truth")]]
    )


def full_light() -> None:
    """Tabulate surfaces that nothing is in front of: they must not shadow themselves."""
    steep = aimed((16, 6, 8), (0, 0, 0), (1.5, 1.5), radiance=(100, 100, 100))
    round_camera = Camera(40, 40, position=(0, 4, 3), target=(0, 0.9, 0.6), fov=16)
    round_lamp = aimed((1, 16, 12), (0, 0, 0), (1.5, 1.5), "disc", radiance=(100, 100, 100))
    defocused = replace(_ASIDE, lens_radius=0.3, focus_distance=4.0)
    scenes = {
        "level plane": Scene(_ASIDE, [_FLOOR], [_DISTANT]),
        "level plane, defocused": Scene(defocused, [_FLOOR], [_DISTANT]),
        "steep plane": Scene(_ASIDE, [Sheet((0, 0, 0), (1.5, 0.4, 0.9), (0.4, -1.5, 0))], [steep]),
        "ball": Scene(round_camera, [Ball((0, 0, 0), 1.4)], [round_lamp]),
        "column": Scene(round_camera, [Column((0, 0, 0), (1, 0.2, 0), 1.2)], [round_lamp]),
    }
    rows: list[list[object]] = []
    for name, scene in scenes.items():
        exact = inner(true_image(scene, rays=32 if scene.camera.lens_radius else 4, tolerance=1e-3), _BORDER)
        samples = render_lit(scene, SPP)
        worst = [
            float(np.abs(inner(_WAYS[way](samples), _BORDER) / exact - 1).max())
            for way in ("light at locations", "shaded samples")
        ]
        rows.append([name, *(f"{value:.2%}" for value in worst)])
    print_table("full_light: largest error", ("", "light at locations", "shaded samples"), rows)


def leaks() -> None:
    """Tabulate the light that gets to places in the dark, two pixels and more off what is lit."""
    wall = Sheet((0, 0.6, 0), (0, 0, 1), (1, 0, 0), Rectangle((0, 0), (3, 0.6)))
    behind = aimed((0, 2, -3), (0, 0, 0), (0.4, 0.4), radiance=(30, 30, 30))
    aslant = aimed((-1, 4, -4), (0, 0, 0), (0.4, 0.4), radiance=(30, 30, 30))
    lid = Sheet((0, 0.1, 0), (0, 1, 0), (1, 0, 0), Disc((0, 0), 0.7), seen=False)
    scenes = {
        "behind a wall without thickness": Scene(_ASIDE, [_FLOOR, wall], [behind]),
        "at the foot of a box": Scene(_ASIDE, [_FLOOR, *box((0, 0, 0), (0.5, 0.4), 0.7)], [aslant]),
        "at the foot of a turned box": Scene(
            _ASIDE, [_FLOOR, *box((0, 0, 0), (0.5, 0.4), 0.7, turn=35.0)], [aslant]
        ),
        "under a disc just above the floor": Scene(_ASIDE, [_FLOOR, lid], [aslant]),
    }
    rows: list[list[object]] = []
    for name, scene in scenes.items():
        exact = inner(true_image(scene, rays=8, tolerance=1e-3), _BORDER)[..., 0]
        dark = (exact < _DARK * exact.max()) & _eroded(exact < _DIM * exact.max(), 2)
        samples = render_lit(scene, SPP)
        cells = []
        for way in ("light at locations", "shaded samples"):
            found = inner(_WAYS[way](samples), _BORDER)[..., 0][dark] / exact.max()
            cells.append(f"{found.mean():.2%}, {found.max():.2%}")
        rows.append([name, f"{dark.sum()}", *cells])
    head = ("", "dark pixels", "light at locations: mean, largest", "shaded samples: mean, largest")
    print_table("leaks: light in the dark, as a share of the brightest pixel's", head, rows)


def _eroded(mask: npt.NDArray[np.bool_], distance: int) -> npt.NDArray[np.bool_]:
    """Return the pixels of a mask whose surroundings are in it too."""
    side = 2 * distance + 1
    padded = np.pad(mask, distance, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, (side, side)).all(axis=(-1, -2)))


PARTS: dict[str, Callable[[], None]] = {
    "geometry": geometry,
    "contact": contact,
    "full_light": full_light,
    "leaks": leaks,
}


if __name__ == "__main__":
    tyro.cli(maker(PARTS, "shadows.md"))
