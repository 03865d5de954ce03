"""Circles of confusion from small to larger than the image, behind and in front of what is in focus."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import fewrays
from contenders import RIVALS, make_image, pixel_filter_of
from fewrays.metrics import psnr_display
from fewrays.sources.analytic import (
    Mask,
    Plane,
    checker,
    half_plane,
    reference,
    sample,
    smooth_noise,
    stripes,
)
from report import markdown_table
from workloads import seen_from

__all__ = ["RADII", "Blur", "measure_blur", "section"]

RADII = (8, 16, 30, 60, 120, 240)
"""Circle-of-confusion radii in pixels."""
SPP, TRUTH_SPP = 8, 256
_WINDOW = (96, 128)  # height and width of what is compared, in pixels
_SQUARE = 16  # pixels, of the checkerboard that is out of focus
_SHARP = smooth_noise(6.0, waves=8, seed=1)


@dataclass(frozen=True)
class Blur:
    """PSNR in dB of every algorithm for one circle of confusion, by what is blurred."""

    radius: int
    psnr: dict[str, dict[str, float]]


def measure_blur(radius: int) -> Blur:
    """Reconstruct a blurred cover before a sharp wall, and a sharp card before a blurred wall."""
    print(f"blur of {radius} px", file=sys.stderr)
    lens = fewrays.Lens(-4.0 * radius, 2.0 * radius, aperture="gaussian", sampling="square")
    texture = checker(_SQUARE, (0.05, 0.1, 0.2), (0.95, 0.7, 0.5))
    focus = lens.focus_distance
    margin = radius + 16
    card: Mask = half_plane((margin + _WINDOW[1] / 2, margin + _WINDOW[0] / 2), (1.0, 0.3))
    scenes = {
        "cover": [Plane(focus, _SHARP), Plane(lens.depth(-radius), texture, stripes(2.5 * radius))],
        "wall": [Plane(lens.depth(radius), texture), Plane(focus, _SHARP, card)],
    }
    return Blur(radius, {name: _psnr(planes, lens, margin) for name, planes in scenes.items()})


def _psnr(planes: Sequence[Plane], lens: fewrays.Lens, margin: int) -> dict[str, float]:
    """PSNR of everyone in a window with so much of a margin around it that no sample is missing."""
    height, width = _WINDOW
    samples = sample(planes, lens, height + 2 * margin, width + 2 * margin, SPP)
    window = [seen_from(plane, margin, margin) for plane in planes]
    truths = {
        f: reference(window, lens, height, width, spp=TRUTH_SPP, pixel_filter=f)
        for f in {pixel_filter_of(algorithm) for algorithm in RIVALS}
    }
    inner = np.s_[margin : margin + height, margin : margin + width]
    return {
        algorithm: psnr_display(make_image(algorithm, samples)[inner], truths[pixel_filter_of(algorithm)])
        for algorithm in RIVALS
    }


def section(blurs: Sequence[Blur]) -> Iterator[str]:
    """Return the page's part on large blur."""
    yield "## Large circles of confusion"
    yield (
        "PSNR in dB after clip to [0, 1] and gamma 2.2, at "
        f"{SPP} samples per pixel with lens positions uniform over the square, against brute-force images of "
        f"{TRUTH_SPP} samples per pixel. *Blurred cover*: bars, 2.5 radii apart, before a sharp wall. "
        "*Blurred wall*: a sharp card that covers half of a wall out of focus. What is out of focus is a "
        f"checkerboard of {_SQUARE} px, strong in contrast: to be free of noise it needs samples from all "
        "over its circle of confusion. Around what is compared lies a margin wider than that circle, so "
        "that no samples are missing."
    )
    head = [
        "radius, px",
        *(f"{algorithm}, blurred {name}" for name in ("cover", "wall") for algorithm in RIVALS),
    ]
    rows = [
        [
            f"{b.radius}",
            *(f"{b.psnr[name][algorithm]:.2f}" for name in ("cover", "wall") for algorithm in RIVALS),
        ]
        for b in blurs
    ]
    yield markdown_table(head, rows)
