"""Pictures of soft shadows on the rendered example: whole images, parts magnified, and where they err.

All pictures of a sheet share one exposure. Magnified parts are chosen by rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw

from fewrays.display import (
    Candidate,
    Panel,
    Window,
    auto_exposure,
    choose_windows,
    error_picture,
    save_picture,
    sheet,
    tone_map,
)
from fewrays.method import Image
from fewrays.metrics import flip, psnr_display
from kept_images import KeptImages
from lit_scenes import SPP, LitScene
from peers import DENOISER
from pictures import hero
from shadows_quality import BEST, PLAIN, make_image, share_of_light, soft_shadow

__all__ = ["PARTS_SHOWN", "draw_all"]

_SHOWN = {PLAIN: f"{SPP} samples per pixel", DENOISER: DENOISER, BEST: "fewrays"}
PARTS_SHOWN = (
    "most penumbra",
    "sharpest edges of shadows",
    f"largest errors of {DENOISER}",
    "largest errors of ours",
)
_WIDTH = 400  # pixels of a panel
_PART, _ZOOM = 64, 5  # pixels of a magnified part before it is
_STRIP = 100  # pixels, likewise
_GENTLE = 0.1  # change of the share of light from pixel to pixel in a penumbra
_FRAMES = ((255, 166, 43), (64, 196, 255), (255, 92, 160), (150, 230, 90))

Picture = npt.NDArray[np.uint8]


def draw_all(scenes: Sequence[LitScene], folder: Path, kept: KeptImages) -> dict[str, str]:
    """Draw everything, and return the pictures' names with what they show.

    Parameters
    ----------
    scenes : sequence of LitScene
        The rendered variants, of which the last makes the picture of before and after.
    folder : path
        Where the pictures go.
    kept : KeptImages
    """
    exposure = auto_exposure(scenes[0].reference.image)
    images = [{name: make_image(name, scene, kept) for name in _SHOWN} for scene in scenes]
    drawn = {
        "shadows-variants.png": sheet(
            [row for scene, each in zip(scenes, images, strict=True) for row in _rows(scene, each, exposure)]
        ),
        "shadows-parts.png": sheet(_parts(scenes[0], images[0], exposure)),
        "shadows-errors.png": sheet(
            [_errors(scene, each, exposure) for scene, each in zip(scenes, images, strict=True)]
        ),
    }
    before = Candidate(images[-1][PLAIN], _SHOWN[PLAIN])
    after = Candidate(images[-1][BEST], "the same samples, fewrays")
    drawn["shadows-hero.png"] = hero(before, after, scenes[0].reference.image)
    for name, picture in drawn.items():
        save_picture(folder / name, picture)
    return {
        "shadows-variants.png": "three variants: samples averaged, denoised, ours, reference",
        "shadows-parts.png": f"parts of the variant *{scenes[0].label}*: {', '.join(PARTS_SHOWN)}",
        "shadows-errors.png": "errors of the same images, black for none to pale yellow for 25 % of white",
    }


def _rows(scene: LitScene, images: dict[str, Image], exposure: float) -> list[list[Panel]]:
    """Return everyone's image of a variant and the reference, and below a part with penumbrae, magnified."""
    truth = scene.reference.image
    pictures = [tone_map(image, exposure) for image in (*images.values(), truth)]
    titles = [*(f"{scene.label}: {title}" for title in _SHOWN.values()), "reference"]
    notes = [*(_note(image, truth) for image in images.values()), f"{scene.reference.spp} samples per pixel"]
    (window,) = choose_windows([_softness(scene)], _STRIP)
    height = round(_STRIP * truth.shape[0] / truth.shape[1])
    top = window.row + (_STRIP - height) // 2
    parts = [p[top : top + height, window.column : window.column + _STRIP] for p in pictures]
    return [
        [Panel(_reduced(p), *text) for p, *text in zip(pictures, titles, notes, strict=True)],
        [Panel(_enlarged(part, _WIDTH // _STRIP)) for part in parts],
    ]


def _softness(scene: LitScene) -> npt.NDArray[np.float64]:
    """Say how much of penumbra each pixel is, ``(H, W)``: half lit, among others about as much lit."""
    light = share_of_light(scene)
    edges = np.hypot(*np.gradient(light))
    return np.asarray(4 * light * (1 - light) * (edges < _GENTLE))


def _note(image: Image, truth: Image) -> str:
    return f"PSNR {psnr_display(image, truth):.1f} dB · FLIP {flip(image, truth):.3f}"


def _errors(scene: LitScene, images: dict[str, Image], exposure: float) -> list[Panel]:
    """Return where everyone's image of a variant errs."""
    truth = tone_map(scene.reference.image, exposure)
    return [
        Panel(_reduced(error_picture(tone_map(image, exposure), truth)), f"{scene.label}: {_SHOWN[name]}")
        for name, image in images.items()
    ]


def _parts(scene: LitScene, images: dict[str, Image], exposure: float) -> list[list[Panel]]:
    """Return parts of everyone's image side by side, under the whole that shows where they are."""
    pictures = [*(tone_map(image, exposure) for image in images.values())]
    truth = tone_map(scene.reference.image, exposure)
    edges = np.hypot(*np.gradient(share_of_light(scene))) * soft_shadow(scene)
    errors = [np.square(picture.astype(np.float64) - truth).mean(axis=-1) for picture in pictures[1:]]
    windows = choose_windows([_softness(scene), edges, *errors], _PART)
    titles = [*_SHOWN.values(), "reference"]
    rows = []
    for number, (window, color) in enumerate(zip(windows, _FRAMES, strict=True)):
        row = [Panel(_magnified(window.of(picture), color)) for picture in (*pictures, truth)]
        if number == 0:
            row = [replace(panel, title=title) for panel, title in zip(row, titles, strict=True)]
        rows.append([*row, Panel(_framed(truth, window, color), PARTS_SHOWN[number])])
    return rows


def _framed(picture: Picture, window: Window, color: tuple[int, int, int]) -> Picture:
    page = Pillow.fromarray(_reduced(picture))
    x, y, side = (round(_WIDTH / picture.shape[1] * v) for v in (window.column, window.row, window.size))
    ImageDraw.Draw(page).rectangle((x, y, x + side, y + side), outline=color, width=3)
    return np.asarray(page)


def _magnified(picture: Picture, color: tuple[int, int, int]) -> Picture:
    page = Pillow.fromarray(_enlarged(picture, _ZOOM))
    ImageDraw.Draw(page).rectangle((0, 0, page.width - 1, page.height - 1), outline=color, width=3)
    return np.asarray(page)


def _enlarged(picture: Picture, factor: int) -> Picture:
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def _reduced(picture: Picture) -> Picture:
    height = round(picture.shape[0] * _WIDTH / picture.shape[1])
    return np.asarray(Pillow.fromarray(picture).resize((_WIDTH, height), Pillow.Resampling.LANCZOS))
