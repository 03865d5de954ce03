"""The failure of compositing by average opacity (layered, Figures 6 to 8), and what is left of it.

A red disc before a green one, both far out of focus on either side of the focal plane. Around the rim a pixel
sees red through one half of the lens and green through the other; averaged opacities cannot know that nothing
is covered there.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import fewrays
from contenders import pixel_filter_of
from fewrays.sources.analytic import Plane, constant, disc, reference, sample
from report import markdown_table, met

__all__ = ["LENS", "SCENES", "SIZE", "SPP", "WAYS", "Loss", "measure_discs", "section", "two_discs"]

OURS = "multiplane"
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "layered-published": ("layered-published", {}),
    "layered": ("layered", {}),
    "temporal": ("temporal", {}),
    OURS: (OURS, {}),
    f"{OURS}, no smoothing": (OURS, {"smoothing": 0.0}),
    f"{OURS}, 1024 views": (OURS, {"views": 1024}),
    f"{OURS}, 8192 views": (OURS, {"views": 8192}),
}
"""Method and options, by name."""
SCENES = {
    "as in Figure 6": (24.0, 14.0),
    "lens half as wide": (12.0, 14.0),
    "front disc half as wide": (24.0, 7.0),
}
"""Slope of the discs and radius of the front one, in pixels."""
SIZE, SPP, SEEDS = 96, 16, 6
LENS = fewrays.Lens(-500.0, 100.0, aperture="gaussian", sampling="square")
_TRUTH_SPP, _BORDER = 512, 16

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Loss:
    """Errors of the green disc behind, in percent of its radiance.

    Parameters
    ----------
    scene, way : str
        Where, and how: names of `SCENES` and `WAYS`.
    systematic : float
        RMS error of the mean over all seeds, less what noise explains.
    random : float
        RMS deviation of single images from that mean.
    lost : float
        Of all the disc's light, in percent of it; negative where it gained.
    """

    scene: str
    way: str
    systematic: float
    random: float
    lost: float


def two_discs(slope: float, front_radius: float) -> list[Plane]:
    """Return a red disc before a green one before black, at slopes -C, C and 30 px."""
    middle = (SIZE / 2, SIZE / 2)
    return [
        Plane(LENS.depth(-slope), constant(1.0, 0.0, 0.0), disc(middle, front_radius)),
        Plane(LENS.depth(slope), constant(0.0, 1.0, 0.0), disc(middle, 14.0)),
        Plane(LENS.depth(30.0), constant(0.0)),
    ]


def measure_discs() -> list[Loss]:
    """Reconstruct every scene in every way, of many seeds."""
    measured = []
    for scene, (slope, front_radius) in SCENES.items():
        print(f"two discs, {scene}", file=sys.stderr)
        planes = two_discs(slope, front_radius)
        buffers = [sample(planes, LENS, SIZE, SIZE, SPP, seed=seed) for seed in range(SEEDS)]
        truths = {name: _truths(planes, name) for name in ("box", "gaussian")}
        for way, (method, options) in WAYS.items():
            images = [_green(fewrays.reconstruct(each, method, **options)) for each in buffers]
            measured.append(_loss(scene, way, np.array(images), truths[pixel_filter_of(method)]))
    return measured


def _truths(planes: Sequence[Plane], pixel_filter: str) -> Floats:
    """Two independent true images of green (2, H, W), whose difference tells their noise."""
    return np.array(
        [
            _green(
                reference(
                    planes,
                    LENS,
                    SIZE,
                    SIZE,
                    spp=_TRUTH_SPP,
                    pixel_filter="box" if pixel_filter == "box" else "gaussian",
                    seed=1000 + number,
                )
            )
            for number in range(2)
        ]
    )


def _green(image: npt.NDArray[np.float32]) -> Floats:
    inner = slice(_BORDER, -_BORDER)
    return image[inner, inner, 1].astype(np.float64)


def _loss(scene: str, way: str, images: Floats, truths: Floats) -> Loss:
    mean, truth = images.mean(axis=0), truths.mean(axis=0)
    variance = float(images.var(axis=0, ddof=1).mean())
    noise = variance / len(images) + float(np.square(truths[0] - truths[1]).mean() / 4)
    error = float(np.square(mean - truth).mean())
    lost = float((truth - mean).sum() / truth.sum())
    systematic, random = np.sqrt(max(error - noise, 0.0)), np.sqrt(variance)
    return Loss(scene, way, 100 * float(systematic), 100 * float(random), 100 * lost)


def section(measured: Sequence[Loss]) -> Iterator[str]:
    """Return the page's part on two discs."""
    yield "## The layered paper's failure case"
    yield (
        "Its Figures 6 to 8: a red disc before a green one, 14 px in radius, both out of focus by ±24 px "
        f"before black, through the Gaussian lens, {SPP} samples per pixel. Errors of the green disc in % of "
        f"its radiance, over {SEEDS} sets of samples: *systematic* is the RMS error of the mean of all "
        "images, less what noise explains of it; *random* the RMS deviation of a single image from that "
        "mean; *lost* the share of all the disc's light (negative where it gained)."
    )
    rows = [
        [each.scene, each.way, f"{each.systematic:.2f}", f"{each.random:.2f}", f"{each.lost:+.2f}"]
        for each in measured
    ]
    yield markdown_table(["discs", "image", "systematic, %", "random, %", "lost, %"], rows)
    ours = [each for each in measured if each.way == OURS]
    biased = [each.scene for each in ours if each.systematic > each.random]
    yield (
        "Target: exact within noise, that is no more systematic than random error. "
        f"{met(not biased)} on {', '.join(biased) or 'all discs'}."
    )
