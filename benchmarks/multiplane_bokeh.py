"""Lights out of focus behind leaves: discs that leaves bite into, as everyone reconstructs them.

Far lights, much brighter than what is around them, are blurred to discs. Leaves in focus cut them off
sharply, leaves between focus and lights cover a part of each disc, which shows the leaf's outline softly, and
leaves near the lens veil them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw

import fewrays
from fewrays.aperture_options import ApertureOptions
from fewrays.display import Panel, save_picture, sheet, tone_map
from fewrays.method import Image
from fewrays.metrics import flip, psnr_display
from fewrays.sources.analytic import Mask, Plane, constant, disc, sample, smooth_noise, trace
from peers import DENOISER, denoise
from report import markdown_table

__all__ = ["LENS", "SPP", "Bokeh", "draw", "measure_bokeh", "planes", "section"]

HEIGHT, WIDTH, SPP = 120, 200, 16
VIEWS = 1536  # of the truth
LENS = fewrays.Lens(-500.0, 100.0, aperture="disc", sampling="disc")
MANY = "multiplane, 1024 views"
NAMES = ("box", DENOISER, "layered-published", "layered", "temporal", "multiplane", MANY)
_LIGHTS, _RADIANCE, _RADIUS = 9, 110.0, 2.4  # of the lights: number, radiance, radius in pixels
_MARGIN, _FINE = 48, 6  # pixels that leaves reach beyond the image; mask cells per pixel
_EXPOSURE, _ZOOM = -0.6, 2


@dataclass(frozen=True)
class Bokeh:
    """An image of the lights: PSNR and FLIP, and RMS error of radiance over the truth's RMS in percent."""

    name: str
    image: Image
    psnr: float
    flip: float
    error: float


def planes() -> list[Plane]:
    """Return the scene, without a renderer."""
    rng = np.random.default_rng(12)
    wall = Plane(LENS.depth(26.0), smooth_noise(24.0, mean=(0.03, 0.05, 0.09), contrast=0.02))
    lights = []
    for number in range(_LIGHTS):
        column, row = number % 3, number // 3
        place = (
            WIDTH * (column + 0.5) / 3 + rng.uniform(-16, 16),
            HEIGHT * (row + 0.5) / 3 + rng.uniform(-8, 8),
        )
        color = _RADIANCE * rng.uniform((0.7, 0.4, 0.2), (1.0, 0.8, 0.7))
        lights.append(Plane(LENS.depth(18.0 + 0.2 * number), constant(*color.tolist()), disc(place, _RADIUS)))
    covers = [
        _cover(12.0, _leaves(34, 9.0), (0.02, 0.05, 0.02), 3),
        _cover(6.0, _leaves(26, 12.0), (0.04, 0.10, 0.03), 4),
        _cover(0.0, _leaves(16, 15.0), (0.10, 0.24, 0.06), 5),
        _cover(-9.0, _leaves(4, 17.0), (0.05, 0.09, 0.04), 6),
    ]
    return [wall, *lights, *covers]


def _cover(slope: float, mask: Mask, mean: tuple[float, float, float], seed: int) -> Plane:
    """Return leaves of a colour that varies a little."""
    return Plane(LENS.depth(slope), smooth_noise(5.0, mean=mean, contrast=0.12 * mean[1], seed=seed), mask)


def _leaves(count: int, length: float) -> Mask:
    """Return a mask of pointed leaves of that half length in pixels, at random places."""
    rng = np.random.default_rng(count)
    size = (WIDTH + 2 * _MARGIN, HEIGHT + 2 * _MARGIN)
    picture = Pillow.new("1", (_FINE * size[0], _FINE * size[1]))
    draw = ImageDraw.Draw(picture)
    for _ in range(count):
        center, turn = rng.uniform((0, 0), size), rng.uniform(0, 2 * np.pi)
        along = np.linspace(-1, 1, 24)
        across = 0.36 * (1 - along**2) * (1 + 0.25 * along)
        outline = length * np.stack(
            [np.concatenate([along, along[::-1]]), np.concatenate([across, -across[::-1]])], axis=-1
        )
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        corners = _FINE * (center + outline @ rotation)
        draw.polygon([tuple(corner) for corner in corners.tolist()], fill=1)
    inside = np.asarray(picture)

    def mask(xy: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        column, row = np.floor(_FINE * (xy + _MARGIN)).astype(np.int64).T
        result: npt.NDArray[np.bool_] = inside[row % inside.shape[0], column % inside.shape[1]]
        return result

    return mask


def measure_bokeh() -> tuple[Image, list[Bokeh]]:
    """Return the truth under the box filter, and everyone's image."""
    print("bokeh behind leaves", file=sys.stderr)
    scene = planes()
    samples = sample(scene, LENS, HEIGHT, WIDTH, SPP)
    truth = _truth(scene)
    box = fewrays.reconstruct(samples, "box")
    images = {name: fewrays.reconstruct(samples, name) for name in NAMES if name not in (DENOISER, MANY)}
    images |= {DENOISER: denoise(box), MANY: fewrays.reconstruct(samples, "multiplane", views=1024)}
    found = []
    for name in NAMES:
        image = images[name]
        error = float(np.sqrt(np.square(image - truth, dtype=np.float64).mean() / np.square(truth).mean()))
        found.append(Bokeh(name, image, psnr_display(image, truth), flip(image, truth), 100 * error))
    return truth, found


def _truth(scene: list[Plane]) -> Image:
    """Average sharp views from lens points that all pixels share: lights leave no noise behind."""
    points = ApertureOptions().aperture_of(LENS).points(VIEWS)
    offsets = np.random.default_rng(5).uniform(-0.5, 0.5, (VIEWS, 2))
    grid = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1).astype(np.float32)
    total = np.zeros((HEIGHT, WIDTH, 3))
    for uv, offset in zip(points, offsets, strict=True):
        total += trace(scene, LENS, grid + offset, np.broadcast_to(uv, grid.shape))[0]
    return (total / VIEWS).astype(np.float32)


def draw(path: Path, truth: Image, found: list[Bokeh]) -> None:
    """Draw everyone's image and the truth, four in a row."""
    panels = [Panel(_picture(each.image), each.name, f"PSNR {each.psnr:.1f} dB") for each in found]
    panels.append(Panel(_picture(truth), "truth", f"{VIEWS} views"))
    panels[0] = Panel(panels[0].picture, f"{SPP} samples per pixel, averaged", panels[0].note)
    save_picture(path, sheet([panels[:4], panels[4:]]))


def _picture(image: Image) -> npt.NDArray[np.uint8]:
    return tone_map(image, _EXPOSURE).repeat(_ZOOM, axis=0).repeat(_ZOOM, axis=1)


def section(found: list[Bokeh], picture: str) -> Iterator[str]:
    """Return the page's part on lights behind leaves."""
    yield "## Lights behind leaves"
    yield (
        f"Lights of {_RADIUS:g} px and radiance {_RADIANCE:g} at most, blurred to discs of 18 to 20 px, "
        f"behind leaves at slopes of 12, 6, 0 and -9 px; disc lens, {SPP} samples per pixel. Leaves in focus "
        "cut discs off, leaves behind the focus bite into them. PSNR in dB and FLIP as elsewhere; *error* is "
        "of the radiance itself, RMS over the truth's RMS. `layered` has a Gaussian lens and pixel filter "
        "instead of disc and box. The grain of the discs is that of the lens points; it goes with more views."
    )
    rows = [[each.name, f"{each.psnr:.2f}", f"{each.flip:.4f}", f"{each.error:.1f}"] for each in found]
    yield markdown_table(["", "PSNR", "FLIP", "error, %"], rows)
    yield f"![lights behind leaves, from everyone and the truth]({picture})"
