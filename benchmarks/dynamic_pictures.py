"""Pictures of depth of field from one render with depth: beside rivals, before and after, a focus pull."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow

from dynamic_quality import SHOWN, Quality, give_depth_of_field
from dynamic_scenes import PinholeScene
from fewrays.baselines.gather import gather_blur
from fewrays.cli.sequence import focus_distances
from fewrays.display import Candidate, Panel, auto_exposure, save_picture, sheet, tone_map
from fewrays.dynamic import defocus
from pictures import hero, scene_sheet

__all__ = ["draw_before_and_after", "draw_pull", "draw_rivals"]

_FRAMES = 6
_VIEWS = 64  # where nothing is compared


def draw_rivals(scene: PinholeScene, folder: Path) -> str:
    """Draw everyone at the paper's number of views, and return the picture's name (Figures 8 and 10)."""
    images = {
        "blur by circle of confusion": gather_blur(scene.front.color, scene.front.depth, scene.lens),
        f"{SHOWN} pinhole renders": scene.accumulated[SHOWN],
        f"dynamic, {SHOWN} views": give_depth_of_field(scene, views=SHOWN),
        "with the layer behind": give_depth_of_field(scene, layers=2, views=SHOWN),
    }
    candidates = [
        Candidate(image, name, f"PSNR {q.psnr:.1f} dB, FLIP {q.flip:.3f}")
        for name, image in images.items()
        for q in [Quality.of(image, scene)]
    ]
    name = f"dynamic-{scene.name}.png"
    reference = Candidate(scene.reference.image, f"ray traced, {scene.reference.spp} samples per pixel")
    save_picture(folder / name, scene_sheet(candidates, reference))
    return name


def draw_before_and_after(scene: PinholeScene, path: Path) -> None:
    """Draw the pinhole render on the left, and what becomes of it on the right."""
    image = give_depth_of_field(scene, views=_VIEWS)
    before, after = Candidate(scene.front.color, "pinhole render"), Candidate(image, "fewrays defocus")
    save_picture(path, hero(before, after, scene.reference.image))


def draw_pull(scene: PinholeScene, path: Path) -> None:
    """Draw frames of a focus pull from the nearest to the farthest surface, with the layer behind."""
    finite = scene.front.depth[np.isfinite(scene.front.depth)]
    near, far = (float(value) for value in np.percentile(finite, (2, 98)))
    exposure = auto_exposure(scene.reference.image)
    panels = []
    for distance in focus_distances(near, far, _FRAMES):
        lens = scene.lens.refocus(distance)
        image = defocus(scene.front.color, scene.front.depth, lens, behind=[scene.behind], views=_VIEWS)
        panels.append(Panel(_halved(tone_map(image, exposure)), f"focused at {distance:.2f}"))
    save_picture(path, sheet([panels[:3], panels[3:]]))


def _halved(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return a picture at half its size, for a page of many."""
    image = Pillow.fromarray(picture)
    half = image.resize((image.width // 2, image.height // 2), Pillow.Resampling.LANCZOS)
    return np.asarray(half)
