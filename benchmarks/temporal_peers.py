"""The temporal method beside Open Image Denoise and every other method, through the disc lens."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from disc_scenes import MOVING, STILL, DiscScene, load_disc_scene
from fewrays.display import Candidate, save_picture
from fewrays.method import Image
from fewrays.metrics import flip
from fewrays.pixel_filter import PixelFilterShape
from peers import DENOISER, denoise
from pictures import hero, scene_sheet
from report import markdown_table, met
from scores import Score, score

__all__ = ["Compared", "measure_all", "measure_peers", "section", "verdict"]

TARGET = 1.5
"""What 16 samples per pixel of foliage shall gain over the denoiser, in dB; FLIP must not be worse."""
_JUDGED_SPP = 16
_OURS = "temporal"
_ALGORITHMS: dict[str, PixelFilterShape] = {
    "box": "box",
    "axis-aligned": "gaussian",
    "sheared": "gaussian",
    "layered": "gaussian",
    DENOISER: "box",
    _OURS: "box",
}


@dataclass(frozen=True)
class Compared:
    """An image ``(H, W, 3)`` of a scene's samples, and how good it is."""

    scene: str
    spp: int
    algorithm: str
    image: Image
    psnr: Score
    flip: float


def measure_peers(scene: DiscScene) -> list[Compared]:
    """Let everyone make an image, and compare it with the reference of its own pixel filter."""
    print(f"{scene.label}: everyone", file=sys.stderr)
    images = {name: fewrays.reconstruct(scene.samples, name) for name in _ALGORITHMS if name != DENOISER}
    images[DENOISER] = denoise(images["box"])
    compared = []
    for name, pixel_filter in _ALGORITHMS.items():
        reference = scene.references[pixel_filter]
        quality = score(images[name], reference), flip(images[name], reference.image)
        compared.append(Compared(scene.name, scene.samples.spp, name, images[name], *quality))
    return compared


def _draw(folder: Path, scene: DiscScene, compared: Sequence[Compared]) -> str:
    """Draw the average, the denoiser's image, ours and the reference, and return the picture's name.

    Of the scene in motion the README's picture as well: before and after.
    """
    titles = {
        "box": f"{scene.samples.spp} samples per pixel, averaged",
        DENOISER: DENOISER,
        _OURS: "temporal",
    }
    images = {each.algorithm: each for each in compared}
    candidates = [
        Candidate(
            images[name].image,
            title,
            f"PSNR {images[name].psnr.measured:.1f} dB · FLIP {images[name].flip:.3f}",
        )
        for name, title in titles.items()
    ]
    reference = scene.references["box"]
    note = f"{reference.spp} samples per pixel, noise {reference.noise_psnr:.1f} dB"
    if scene.name == MOVING:
        after = Candidate(images[_OURS].image, "the same samples, fewrays")
        save_picture(folder / "temporal-hero.png", hero(candidates[0], after, reference.image))
    name = f"temporal-{scene.name}.png"
    save_picture(folder / name, scene_sheet(candidates, Candidate(reference.image, "reference", note)))
    return name


def measure_all(folder: Path, images: Path, scenes: Sequence[str], spps: Sequence[int]) -> Iterator[str]:
    """Yield the page's part, drawing the scenes at their least samples per pixel."""
    measured: list[Compared] = []
    pictures = []
    for name in scenes:
        for spp in spps:
            scene = load_disc_scene(folder, name, spp)
            compared = measure_peers(scene)
            measured += compared
            if spp == min(spps):
                pictures.append((name, _draw(images, scene, compared)))
    yield from section(measured)
    for name, file in pictures:
        yield f"![{name}: average, {DENOISER}, temporal, reference](images/{file})"


def section(measured: Sequence[Compared]) -> Iterator[str]:
    """Return the page's part on peers."""
    yield "## Beside Open Image Denoise"
    yield (
        "PSNR in dB, in brackets with the reference's noise taken out, and mean FLIP. Every image is "
        f"compared with the reference of its own pixel filter: the box for `box`, {DENOISER} and `temporal`, "
        f"the Gaussian of σ = 0.5 px for the others. {DENOISER} runs at high quality in HDR mode on the "
        "plain average. `layered` takes the disc for the Gaussian of equal second moment, hence its errors "
        "here are mostly those of the lens."
    )
    head = ["image", *(f"{scene}, {spp} spp" for scene, spp in _columns(measured))]
    rows = []
    for algorithm in _ALGORITHMS:
        row = [each for each in measured if each.algorithm == algorithm]
        rows.append([algorithm, *(f"{each.psnr} · {each.flip:.4f}" for each in row)])
    yield markdown_table(head, rows)
    judged = {e.algorithm: e for e in measured if (e.scene, e.spp) == (STILL, _JUDGED_SPP)}
    yield verdict(judged.get(_OURS), judged.get(DENOISER))


def _columns(measured: Sequence[Compared]) -> list[tuple[str, int]]:
    return list(dict.fromkeys((each.scene, each.spp) for each in measured))


def verdict(ours: Compared | None, denoised: Compared | None) -> str:
    """Say whether our image of foliage gains enough over the denoiser's."""
    text = (
        f"Target, {STILL} at {_JUDGED_SPP} samples per pixel: at least {TARGET:+.1f} dB over {DENOISER}, and "
        "FLIP not worse. "
    )
    if ours is None or denoised is None:
        return text + "Not measured."
    gain = ours.psnr.measured - denoised.psnr.measured
    corrected = ours.psnr.corrected - denoised.psnr.corrected
    good = gain >= TARGET and ours.flip <= denoised.flip
    return (
        text + f"{met(good)}: {gain:+.2f} dB ({corrected:+.2f} dB), FLIP {ours.flip:.4f} against "
        f"{denoised.flip:.4f}."
    )
