"""What the options of shading do to quality and time: the number of light points, and how far to look."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import fewrays
from fewrays.color import gamma_encode
from lit_scenes import LitScene
from report import markdown_table
from scores import Score, score
from shadows_quality import soft_shadow

__all__ = ["CHOICES", "Choice", "measure_options", "section"]

CHOICES: Sequence[Mapping[str, Any]] = (
    {"light_points": 32},
    {"light_points": 64},
    {},
    {"light_points": 256},
    {"light_points": 512},
    {"correction": 0},
    {"correction": 0.7},
    {"correction": 1.5},
    {"radius_scale": 1.0},
    {"radius_scale": 1.3},
    {"radius_scale": 2.2},
    {"radius_scale": 3.0},
)
"""Options of `fewrays.shade` to try; none are the defaults."""

_METHOD = "multiplane"


@dataclass(frozen=True)
class Choice:
    """Options, the score of the image and of its penumbrae in dB, and CPU seconds to shade the samples."""

    name: str
    score: Score
    in_penumbra: float
    seconds: float


def measure_options(scene: LitScene) -> list[Choice]:
    """Shade with each choice of options, and reconstruct."""
    penumbra = soft_shadow(scene)
    truth = gamma_encode(scene.reference.image)
    choices = []
    for options in CHOICES:
        name = ", ".join(f"{option} {value:g}" for option, value in options.items()) or "as it is"
        print(f"options: {name}", file=sys.stderr)
        start = time.process_time()
        shaded = fewrays.shade(scene.samples, threads=1, **options)
        seconds = time.process_time() - start
        image = fewrays.reconstruct(shaded, _METHOD)
        error = float(np.square(gamma_encode(image) - truth)[penumbra].mean())
        choices.append(Choice(name, score(image, scene.reference), float(-10 * np.log10(error)), seconds))
    return choices


def section(scene: LitScene, choices: Sequence[Choice]) -> Iterator[str]:
    """Return the page's part on options."""
    yield "## What the options do"
    yield (
        f"Options of `shade`, on *{scene.label}*: PSNR in dB of `{_METHOD}` made of the shaded samples, of "
        "the whole image and where there is penumbra, and CPU seconds of shading on one thread (single "
        "calls, loaded machine). As it is: `light_points` 128, `correction` 0.5 px, `radius_scale` 1.4."
    )
    rows = [
        [each.name, str(each.score), f"{each.in_penumbra:.2f}", f"{each.seconds:.1f}"] for each in choices
    ]
    yield markdown_table(["", "PSNR", "in penumbrae", "CPU, s"], rows)
