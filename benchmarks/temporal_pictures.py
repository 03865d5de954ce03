"""Pictures of what the temporal method can do: one sample per pixel, other foci, other shutters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow

import fewrays
from disc_scenes import MOVING, SCENES, STILL
from example_renders import load_references, samples_file
from fewrays.display import Panel, auto_exposure, save_picture, sheet, tone_map
from fewrays.method import Image
from fewrays.metrics import psnr_display

__all__ = ["draw_one_sample", "draw_rack_focus", "draw_shutters"]

_WIDTH = 360  # pixels of a panel
_SPP, _FRAMES = 8, 6  # of the samples; of the rack focus

Picture = npt.NDArray[np.uint8]


def draw_one_sample(renders: Path, path: Path) -> list[str]:
    """Draw what one sample per pixel gives, averaged and reconstructed, beside the reference (Figure 10).

    Returns
    -------
    list of str
        The scenes shown: those of which one sample per pixel has been rendered, through the disc lens or
        else the Gaussian one.
    """
    rows, shown = [], []
    for name in SCENES:
        for sampling, label in (("disc", f"{name}_disc"), ("gaussian", name)):
            file = samples_file(renders, name, sampling, 1)
            if not (file.exists() and (renders / f"{label}_reference.json").exists()):
                continue
            rows.append(
                _one_sample_row(name, fewrays.load(file), load_references(renders, label)["box"].image)
            )
            shown.append(name)
            break
    if rows:
        save_picture(path, sheet(rows))
    return shown


def _one_sample_row(name: str, samples: fewrays.SampleBuffer, truth: Image) -> list[Panel]:
    exposure = auto_exposure(truth)
    images = {
        f"{name}, 1 sample per pixel": fewrays.reconstruct(samples, "box"),
        "temporal": fewrays.reconstruct(samples, "temporal"),
    }
    panels = [
        Panel(_small(image, exposure), title, f"PSNR {psnr_display(image, truth):.1f} dB")
        for title, image in images.items()
    ]
    return [*panels, Panel(_small(truth, exposure), "reference")]


def draw_rack_focus(renders: Path, path: Path) -> None:
    """Draw foliage focused from near to far, and with half and twice the aperture (Figure 13)."""
    samples = fewrays.load(samples_file(renders, STILL, "disc", _SPP))
    near, far = np.quantile(samples.depth, [0.02, 0.9])
    panels = []
    for inverse in np.linspace(1 / near, 1 / far, _FRAMES):
        image = fewrays.reconstruct(samples.refocus(focus_distance=float(1 / inverse)), "temporal")
        panels.append((f"focus at {1 / inverse:.2f}", image))
    for scale in (0.5, 1.0, 2.0):
        image = fewrays.reconstruct(samples.refocus(aperture_scale=scale), "temporal")
        panels.append((f"as rendered, aperture x {scale:g}", image))
    exposure = auto_exposure(panels[-2][1])
    drawn = [Panel(_small(image, exposure), title) for title, image in panels]
    save_picture(path, sheet([drawn[i : i + 3] for i in range(0, len(drawn), 3)]))


def draw_shutters(renders: Path, path: Path) -> None:
    """Draw the moving scene with the shutter open for all of its interval, for half of it, and for none."""
    samples = fewrays.load(samples_file(renders, MOVING, "disc", _SPP))
    shutters: dict[str, dict[str, Any]] = {
        "shutter 0 to 1": {},
        "shutter 0 to 0.5": {"shutter": (0.0, 0.5)},
        "an instant, 0.5": {"shutter": (0.5, 0.5)},
        "an instant, aperture x 0.01": {"shutter": (0.5, 0.5)},
    }
    images = []
    for name, options in shutters.items():
        through = samples.refocus(aperture_scale=0.01) if "aperture" in name else samples
        images.append((name, fewrays.reconstruct(through, "temporal", **options)))
    exposure = auto_exposure(images[0][1])
    panels = [Panel(_small(image, exposure, 640), name) for name, image in images]
    save_picture(path, sheet([panels[:2], panels[2:]]))


def _small(image: Image, exposure: float, width: int = _WIDTH) -> Picture:
    """Return a picture of an image, reduced to a panel's width."""
    picture = Pillow.fromarray(tone_map(image, exposure))
    height = round(picture.height * width / picture.width)
    return np.asarray(picture.resize((width, height), Pillow.Resampling.LANCZOS))
