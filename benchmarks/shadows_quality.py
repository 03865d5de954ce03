"""Soft shadows from four samples per pixel of the rendered example, beside averages and the denoiser.

Everyone starts from the same samples and is compared with the reference under the box pixel filter.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.color import gamma_encode
from fewrays.method import Image
from fewrays.metrics import flip
from kept_images import KeptImages
from lit_scenes import SPP, LitScene, load_lit, rendered_variants
from multiplane_quality import Entry
from peers import DENOISER, denoise
from report import markdown_table, met
from scores import score

__all__ = [
    "BEST",
    "CONTENDERS",
    "DENOISER_AOVS",
    "OURS",
    "PLAIN",
    "Lit",
    "denoise_with_aovs",
    "make_image",
    "measure_lit",
    "section",
    "share_of_light",
    "soft_shadow",
    "verdicts",
]

PLAIN = "plain average"
NEAREST = "nearest neighbour"
DENOISER_AOVS = f"{DENOISER}, albedo and normal"
PUBLISHED = "temporal, light at locations"
OURS = {
    "box of shaded samples": "box",
    "temporal of shaded samples": "temporal",
    "multiplane of shaded samples": "multiplane",
}
BEST = "multiplane of shaded samples"
TARGET = 6.0
"""What shaded samples shall gain over plain averaging and over the denoiser, in dB."""

_NOISY = {"temporal, noisy shadows": "temporal", "multiplane, noisy shadows": "multiplane"}
_BOTH = f"{DENOISER} of shaded samples"
CONTENDERS = (PLAIN, NEAREST, DENOISER, DENOISER_AOVS, *_NOISY, PUBLISHED, *OURS, _BOTH)
_PENUMBRA = 0.05  # share of the light from which on a pixel is neither in the dark nor in full light
_ALIKE, _FLAT = 0.995, 0.02  # length of the mean normal, and relative range of depths, on one smooth surface


@dataclass(frozen=True)
class Lit:
    """A variant of the scene, and how good everyone's image of it is.

    Parameters
    ----------
    label : str
    reference_spp : int
    noise_psnr : float
        Of the reference, in dB.
    entries : mapping of str to Entry
        Of whole images.
    penumbra : float
        Share of the pixels that `soft_shadow` tells.
    in_penumbra : mapping of str to float
        PSNR in dB of these.
    """

    label: str
    reference_spp: int
    noise_psnr: float
    entries: Mapping[str, Entry]
    penumbra: float
    in_penumbra: Mapping[str, float]


def make_image(name: str, scene: LitScene, kept: KeptImages) -> Image:
    """Return a contender's image of a scene's samples."""
    if name == PLAIN:
        return scene.averaged
    samples = scene.samples
    ways: dict[str, Callable[[], Image]] = {
        NEAREST: lambda: nearest_neighbour(samples),
        DENOISER: lambda: denoise(scene.averaged),
        DENOISER_AOVS: lambda: denoise_with_aovs(scene),
        PUBLISHED: lambda: fewrays.reconstruct(samples, "temporal", light_at="locations"),
        _BOTH: lambda: denoise(fewrays.reconstruct(scene.shaded, "box")),
    }
    if name in _NOISY:
        return kept.image(name, scene.path, lambda: fewrays.reconstruct(samples, _NOISY[name], shadows=False))
    if name in OURS:
        return kept.image(name, scene.path, lambda: fewrays.reconstruct(scene.shaded, OURS[name]))
    return kept.image(name, scene.path, ways[name])


def nearest_neighbour(samples: fewrays.SampleBuffer) -> Image:
    """Return what locations see if each takes the nearest sample of its surface, noisy shadow included."""
    image: Image = fewrays.reconstruct(
        samples, "temporal", shadows=False, tent_scale=0, smoothing=0, correction=0
    )
    return image


def denoise_with_aovs(scene: LitScene) -> Image:
    """Denoise the plain average with the means of the samples' normals and of what they reflect.

    The albedo is π times the samples' reflectance from their light point to the camera: that of a matte
    surface, and with the highlight of a glossy one. Sky has neither.
    """
    lighting = scene.samples.lighting
    assert lighting is not None
    albedo = np.clip(np.pi * lighting.lights[0].reflectance.mean(axis=2), 0, 1)
    normal = lighting.normal.mean(axis=2)
    result = importlib.import_module("pyoidn").denoise(
        np.ascontiguousarray(scene.averaged),
        np.ascontiguousarray(albedo),
        np.ascontiguousarray(normal),
        hdr=True,
        quality="high",
    )
    return cast(Image, result)


def measure_lit(folder: Path, kept: KeptImages) -> list[Lit]:
    """Let everyone make an image of every variant that has been rendered."""
    return [_measure(load_lit(folder, name), kept) for name in rendered_variants(folder)]


def _measure(scene: LitScene, kept: KeptImages) -> Lit:
    entries, in_penumbra = {}, {}
    penumbra = soft_shadow(scene)
    truth = gamma_encode(scene.reference.image)
    for name in CONTENDERS:
        print(f"excavator, {scene.label}: {name}", file=sys.stderr)
        image = make_image(name, scene, kept)
        entries[name] = Entry(score(image, scene.reference), flip(image, scene.reference.image))
        error = np.square(gamma_encode(image) - truth)[penumbra].mean()
        in_penumbra[name] = float(-10 * np.log10(error))
    noise = scene.reference.noise_psnr
    return Lit(scene.label, scene.reference.spp, noise, entries, float(penumbra.mean()), in_penumbra)


def soft_shadow(scene: LitScene) -> npt.NDArray[np.bool_]:
    """Tell which pixels, ``(H, W)``, show a penumbra on one smooth surface.

    Elsewhere images differ in how they treat silhouettes and the edges of things, in shadow or not.
    """
    light = share_of_light(scene)
    lighting = scene.samples.lighting
    assert lighting is not None
    length = np.linalg.norm(lighting.normal.mean(axis=2), axis=-1)
    depth = scene.samples.depth
    smooth = (length > _ALIKE) & (np.ptp(depth, axis=2) < _FLAT * depth.min(axis=2))
    return np.asarray((light > _PENUMBRA) & (light < 1 - _PENUMBRA) & smooth)


def share_of_light(scene: LitScene) -> npt.NDArray[np.float64]:
    """Return which share of the lamp's light gets to each pixel, ``(H, W)``, as the shaded samples say."""
    lighting = scene.samples.lighting
    assert lighting is not None
    all_of_it = lighting.direct(scene.samples, 0, occluded=False).mean(axis=(2, 3))
    got = (scene.shaded.color - lighting.unlit).mean(axis=(2, 3))
    return np.asarray(np.clip(got / np.maximum(all_of_it, 1e-3 * all_of_it.max()), 0, 1), np.float64)


def section(measured: Sequence[Lit]) -> Iterator[str]:
    """Return the page's part on quality."""
    yield "## Quality"
    yield (
        f"*Excavator*, {SPP} samples per pixel, 640 x 360 pixels: PSNR in dB, in brackets with the "
        "reference's noise taken out, and mean FLIP, under the box pixel filter. "
        f"*{PLAIN}* is the mean of a pixel's samples; as the "
        "pixel filter is a box, the axis-aligned filter of the literature is the same. "
        f"*{NEAREST}*, the top row of Lehtinen et al.'s Figure 11, gives each location the nearest sample of "
        "the surface that it sees, with that sample's own shadow. The denoiser runs at high quality in HDR "
        "mode on the plain average, without and with the means of the samples' albedos and normals. "
        "*Noisy shadows* are methods for lens and time alone, on the samples as they are; *light at "
        "locations* is the paper's way, and *shaded samples* are ours, the default. The last row denoises "
        "their average."
    )
    head = ["", *(each.label for each in measured)]
    rows = [[name, *(str(each.entries[name]) for each in measured)] for name in CONTENDERS]
    noise = ["reference: its noise", *(f"{e.noise_psnr:.1f} dB ({e.reference_spp} spp)" for e in measured)]
    yield markdown_table(head, [*rows, noise])
    yield (
        "The same where there is penumbra alone: pixels of one smooth surface that get between "
        f"{_PENUMBRA:.0%} and {1 - _PENUMBRA:.0%} of the lamp's light (in percent of the image: "
        f"{', '.join(f'{each.penumbra:.1%}' for each in measured)}). PSNR in dB."
    )
    rows = [[name, *(f"{each.in_penumbra[name]:.2f}" for each in measured)] for name in CONTENDERS]
    yield markdown_table(head, rows)
    yield from verdicts(measured)


def verdicts(measured: Sequence[Lit]) -> Iterator[str]:
    """Say where the target is met, as measured."""
    for rivals, called in (((PLAIN,), "plain averaging"), ((DENOISER, DENOISER_AOVS), DENOISER)):
        gains = {}
        for each in measured:
            theirs = max(each.entries[name].psnr.measured for name in rivals)
            there = max(each.in_penumbra[name] for name in rivals)
            gains[each.label] = (
                each.entries[BEST].psnr.measured - theirs,
                each.in_penumbra[BEST] - there,
            )
        good = all(gain >= TARGET for gain, _ in gains.values())
        listed = "; ".join(
            f"{label} {gain:+.2f} dB (in penumbrae {there:+.2f} dB)" for label, (gain, there) in gains.items()
        )
        yield f"Target: *{BEST}* {TARGET:g} dB over {called}. {met(good)}: {listed}."
