"""Pictures of what the multiplane method makes of rendered scenes: results, planes, what these allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw

import fewrays
from disc_scenes import MOVING, STILL, rendered
from example_renders import SCENES, load_references, samples_file
from fewrays.display import (
    FRAMES,
    Candidate,
    Panel,
    Window,
    auto_exposure,
    choose_windows,
    save_picture,
    sheet,
    tone_map,
)
from fewrays.method import Image
from fewrays.metrics import flip, psnr_display
from fewrays.multiplane.maps import BLOCK, Maps
from kept_images import KeptImages
from multiplane_quality import OURS, PLAIN, TEMPORAL, make_images
from peers import DENOISER
from pictures import hero

__all__ = [
    "draw_before_and_after",
    "draw_comparison",
    "draw_one_sample",
    "draw_planes",
    "draw_rack_focus",
    "plane_image",
]

_WIDTH, _SMALL = 400, 280  # pixels of a panel, and of one among many
_CROP = 50  # pixels of the image's in a magnified part
_SPP = 8

Picture = npt.NDArray[np.uint8]
Planes = fewrays.Multiplane


def draw_before_and_after(renders: Path, path: Path, spp: int) -> None:
    """Draw the picture at the top of the README: samples averaged, and what becomes of them."""
    samples = fewrays.load(samples_file(renders, STILL, "disc", spp))
    truth = load_references(renders, f"{STILL}_disc")["box"].image
    before = Candidate(fewrays.reconstruct(samples, PLAIN), f"{spp} samples per pixel")
    after = Candidate(fewrays.reconstruct(samples, OURS), "the same samples, fewrays")
    save_picture(path, hero(before, after, truth))


def draw_comparison(renders: Path, path: Path, scene: str, spp: int, kept: KeptImages) -> None:
    """Draw everyone's image of a scene through the disc lens, and parts of it magnified."""
    samples = samples_file(renders, scene, "disc", spp)
    truth = load_references(renders, f"{scene}_disc")["box"].image
    made = make_images(samples, kept)
    images = {name: made[name] for name in (PLAIN, DENOISER, TEMPORAL, OURS)}
    notes = [f"PSNR {psnr_display(i, truth):.1f} dB · FLIP {flip(i, truth):.3f}" for i in images.values()]
    titles = [f"{spp} samples per pixel, averaged", DENOISER, TEMPORAL, OURS, "reference"]
    exposure = auto_exposure(truth)
    pictures = [tone_map(image, exposure) for image in (*images.values(), truth)]
    windows = _windows(pictures)
    rows = [
        [
            Panel(_framed(picture, windows), title, note)
            for picture, title, note in zip(pictures, titles, [*notes, ""], strict=True)
        ]
    ]
    for window, color in zip(windows, FRAMES, strict=True):
        rows.append([Panel(_magnified(window.of(picture), color)) for picture in pictures])
    save_picture(path, sheet(rows))


def _windows(pictures: Sequence[Picture]) -> list[Window]:
    """Choose parts by rule: where the denoiser errs most, where temporal does, and where ours does."""
    truth = pictures[-1].astype(np.float64)
    errors = [np.square(picture - truth).mean(axis=-1) for picture in pictures[1:4]]
    return choose_windows(errors, _CROP)


def _framed(picture: Picture, windows: Sequence[Window]) -> Picture:
    scale = _WIDTH / picture.shape[1]
    page = Pillow.fromarray(_reduced(picture, _WIDTH))
    draw = ImageDraw.Draw(page)
    for window, color in zip(windows, FRAMES, strict=True):
        x, y, side = (round(scale * value) for value in (window.column, window.row, window.size))
        draw.rectangle((x, y, x + side, y + side), outline=color, width=2)
    return np.asarray(page)


def _magnified(picture: Picture, color: tuple[int, int, int]) -> Picture:
    factor = _WIDTH // picture.shape[1]
    page = Pillow.fromarray(picture.repeat(factor, axis=0).repeat(factor, axis=1))
    ImageDraw.Draw(page).rectangle((0, 0, page.width - 1, page.height - 1), outline=color, width=3)
    return np.asarray(page)


def draw_one_sample(renders: Path, path: Path, kept: KeptImages) -> list[str]:
    """Draw what one sample per pixel gives, and return the scenes that have been rendered so."""
    names = [*rendered(renders, SCENES, 1), *rendered(renders, [MOVING], 1)]
    rows = []
    for name in names:
        samples = samples_file(renders, name, "disc", 1)
        truth = load_references(renders, f"{name}_disc")["box"].image
        made = make_images(samples, kept)
        exposure = auto_exposure(truth)
        row = [
            Panel(
                _shown(made[way], exposure, _SMALL),
                f"{name}, {title}",
                f"PSNR {psnr_display(made[way], truth):.1f} dB",
            )
            for way, title in ((PLAIN, "1 sample per pixel"), (DENOISER, DENOISER), (OURS, OURS))
        ]
        rows.append([*row, Panel(_shown(truth, exposure, _SMALL), "reference")])
    if rows:
        save_picture(path, sheet(rows))
    return names


def draw_rack_focus(renders: Path, path: Path) -> None:
    """Draw foliage from the same planes: focused from near to far, and through other lenses."""
    samples = fewrays.load(samples_file(renders, STILL, "disc", _SPP))
    planes = Planes.build(samples)
    near, far = np.quantile(samples.depth, [0.02, 0.9])
    shown: dict[str, Callable[[], Image]] = {}
    for inverse in np.linspace(1 / near, 1 / far, 6):
        shown[f"focus at {1 / inverse:.2f}"] = _rendered(planes, planes.lens.refocus(float(1 / inverse)))
    for scale in (0.25, 1.0, 2.0):
        lens = planes.lens.refocus(aperture_scale=scale)
        shown[f"as rendered, aperture x {scale:g}"] = _rendered(planes, lens)
    shown["6 blades"] = _rendered(planes, None, blades=6)
    shown["5 curved blades, cat's eye"] = _rendered(planes, None, blades=5, roundness=0.5, cats_eye=0.8)
    shown["anamorphic, squeeze 2"] = _rendered(planes, None, squeeze=2.0)
    images = {name: render() for name, render in shown.items()}
    exposure = auto_exposure(images["as rendered, aperture x 1"])
    panels = [Panel(_shown(image, exposure), name) for name, image in images.items()]
    save_picture(path, sheet([panels[i : i + 3] for i in range(0, len(panels), 3)]))


def _rendered(planes: Planes, lens: fewrays.Lens | None, **options: Any) -> Callable[[], Image]:
    return lambda: planes.render(lens, **options)


def draw_planes(renders: Path, path: Path) -> int:
    """Draw six of the planes of foliage, opacity above radiance, and return how many there are."""
    planes = Planes.build(fewrays.load(samples_file(renders, STILL, "disc", _SPP)))
    maps = planes.maps
    exposure = auto_exposure(planes.render(views=16))
    found = [plane_image(maps, k) for k in range(maps.plane_count)]
    coverage = np.array([image[..., 0].mean() for image in found])
    # The fullest of each sixth of the planes, so that they range from front to back.
    parts = np.array_split(np.arange(maps.plane_count), 6)
    chosen = [int(part[np.argmax(coverage[part])]) for part in parts]
    rows: list[list[Panel]] = []
    for three in (chosen[:3], chosen[3:]):
        opacity = [Panel(_reduced(_grey(found[k][..., 0]), _WIDTH), *_plane_caption(maps, k)) for k in three]
        rows += [opacity, [Panel(_shown(found[k][..., 1:], exposure)) for k in three]]
    save_picture(path, sheet(rows))
    return maps.plane_count


def _plane_caption(maps: Maps, k: int) -> tuple[str, str]:
    cells = int(maps.grid.cells[k])
    return (
        f"C = {maps.shear.slope[k]:.1f} px",
        f"plane {k + 1} of {maps.plane_count}, {cells} x {cells} cells",
    )


def plane_image(maps: Maps, k: int) -> npt.NDArray[np.float32]:
    """Return opacity and premultiplied radiance of a plane within the image, (H, W, 4), a mean per pixel."""
    rows, columns = BLOCK
    cells, (left, top) = int(maps.grid.cells[k]), maps.grid.corner[k]
    across, down = (int(n) for n in maps.grid.shape[k])
    unit = 4 * (rows + 1) * (columns + 1)
    padding = (maps.halves.size - int(_units(maps)) * unit) // 2
    values = maps.halves.view(np.float16)
    plane = np.zeros((down * rows, across * columns, 4), np.float32)
    for place in range(down * across):
        slot = int(maps.slots[maps.grid.first_slot[k] + place])
        if slot < 0:
            continue
        first = padding + slot * unit
        block = values[first : first + unit * cells**2].reshape(4, cells**2, rows + 1, columns + 1)
        row, column = divmod(place, across)
        inner = block[:, :, :rows, :columns].astype(np.float32).mean(axis=1)
        plane[row * rows : (row + 1) * rows, column * columns : (column + 1) * columns] = np.moveaxis(
            inner, 0, -1
        )
    seen = plane[-top : -top + maps.height, -left : -left + maps.width]
    return np.asarray(seen * np.array([1, *3 * [maps.scale[k]]], np.float32))


def _units(maps: Maps) -> int:
    """Units that all blocks take."""
    per_block = np.repeat(maps.grid.cells.astype(np.int64) ** 2, maps.grid.shape.prod(axis=1))
    return int(per_block[maps.slots >= 0].sum())


def _grey(values: npt.NDArray[np.float32]) -> Picture:
    grey: Picture = np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def _shown(image: Image, exposure: float, width: int = _WIDTH) -> Picture:
    return _reduced(tone_map(image, exposure), width)


def _reduced(picture: Picture, width: int) -> Picture:
    height = round(picture.shape[0] * width / picture.shape[1])
    return np.asarray(Pillow.fromarray(picture).resize((width, height), Pillow.Resampling.LANCZOS))
