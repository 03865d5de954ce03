"""Lights far brighter than the scene: what becomes of their energy, and whether they sparkle."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import fewrays
from contenders import OURS, PLAIN, RIVALS, make_image, pixel_filter_of
from fewrays.method import Image
from fewrays.sources.analytic import (
    PixelFilter,
    Plane,
    constant,
    disc,
    reference,
    sample,
    smooth_noise,
    stripes,
)
from report import markdown_table, met

__all__ = ["CASES", "LENS", "Behaviour", "LightCase", "Measured", "measure_light", "section", "verdict"]

RADIANCE, RADIUS = 1000.0, 3.0  # of the light; pixels
SPP, SEEDS, TRUTH_SPP = 8, 64, 512
SIZE = 96  # pixels a side
TARGET = 0.01
"""By how much total radiance may differ from the truth's."""
LENS = fewrays.Lens(-40.0, 20.0, aperture="gaussian", sampling="square")
_MARGIN = 4.0  # pixels that the pixel filter may carry light beyond its footprint


@dataclass(frozen=True)
class LightCase:
    """Where the light, the wall behind it and, if any, bars in front of it lie, as slopes in pixels."""

    name: str
    light: float
    wall: float
    cover: float | None = None

    def planes(self) -> list[Plane]:
        """Return the scene: a round light in the middle of the image."""
        middle = (SIZE / 2, SIZE / 2)
        planes = [
            Plane(LENS.depth(self.wall), smooth_noise(8.0, waves=8, seed=1)),
            Plane(LENS.depth(self.light), constant(RADIANCE), disc(middle, RADIUS)),
        ]
        if self.cover is not None:
            mask = stripes(16.0, direction=(1.0, 0.5))
            planes.append(Plane(LENS.depth(self.cover), smooth_noise(8.0, waves=8, seed=2), mask))
        return planes

    def footprint(self) -> npt.NDArray[np.bool_]:
        """Return where any ray, or the pixel filter, can bring the light: ``(SIZE, SIZE)``.

        The aperture is cut off at a square, so that the light's image ends at one as well.
        """
        reach = abs(self.light) + RADIUS + _MARGIN
        near = np.abs(np.arange(SIZE) + 0.5 - SIZE / 2) <= reach
        inside: npt.NDArray[np.bool_] = near[:, None] & near
        return inside


CASES = (
    LightCase("in focus", 0.0, 6.0),
    LightCase("defocused", 10.0, 14.0),
    LightCase("behind a blurred cover", 4.0, 8.0, cover=-10.0),
    LightCase("in front, blurred", -10.0, 0.0),
)


@dataclass(frozen=True)
class Behaviour:
    """What an algorithm made of a light, over all seeds.

    Parameters
    ----------
    algorithm : str
        Who it was.
    totals : ndarray, (seeds,)
        Sum of the image over that of the truth.
    least : float
        The smallest value of any pixel.
    outside : float
        Largest excess over the truth beyond the light's footprint, as a share of the truth's peak.
    inside : float
        The same within the footprint.
    systematic : float
        Largest error of the mean over all seeds, either way, as a share of the truth's peak.
    """

    algorithm: str
    totals: npt.NDArray[np.float64]
    least: float
    outside: float
    inside: float
    systematic: float

    @property
    def mean(self) -> float:
        """Mean of the totals."""
        return float(self.totals.mean())

    @property
    def uncertainty(self) -> float:
        """Standard error of that mean."""
        return float(self.totals.std(ddof=1) / np.sqrt(len(self.totals)))


@dataclass(frozen=True)
class Measured:
    """A case, how everyone behaved, and images of the first seed and the truth for pictures."""

    case: LightCase
    behaviours: Mapping[str, Behaviour]
    images: Mapping[str, Image]
    truth: Image

    def beside_samples(self, algorithm: str) -> tuple[float, float]:
        """Return mean and standard error of the totals over those of the samples' plain averages."""
        ratios = self.behaviours[algorithm].totals / self.behaviours[PLAIN].totals
        return float(ratios.mean()), float(ratios.std(ddof=1) / np.sqrt(len(ratios)))


def measure_light(case: LightCase) -> Measured:
    """Reconstruct a case from `SEEDS` sets of samples."""
    print(f"light: {case.name}", file=sys.stderr)
    planes = case.planes()
    filters = {pixel_filter_of(algorithm) for algorithm in RIVALS}
    truths = {f: _truth(planes, f) for f in filters}
    buffers = [sample(planes, LENS, SIZE, SIZE, SPP, seed=10 + seed) for seed in range(SEEDS)]
    behaviours, first = {}, {}
    for algorithm in RIVALS:
        images = [make_image(algorithm, samples) for samples in buffers]
        truth = truths[pixel_filter_of(algorithm)]
        behaviours[algorithm] = behaviour(algorithm, images, truth, case.footprint())
        first[algorithm] = images[0]
    return Measured(case, behaviours, first, truths["gaussian"])


def _truth(planes: Sequence[Plane], pixel_filter: PixelFilter) -> Image:
    return reference(planes, LENS, SIZE, SIZE, spp=TRUTH_SPP, pixel_filter=pixel_filter)


def behaviour(
    algorithm: str, images: Sequence[Image], truth: Image, footprint: npt.NDArray[np.bool_]
) -> Behaviour:
    """Measure images ``(H, W, 3)`` of one truth whose light can reach the pixels of a footprint."""
    excess = np.max([image - truth for image in images], axis=0) / truth.max()
    totals = np.array([image.sum(dtype=np.float64) for image in images]) / truth.sum(dtype=np.float64)
    return Behaviour(
        algorithm,
        totals,
        least=float(min(image.min() for image in images)),
        outside=float(excess[~footprint].max()),
        inside=float(excess[footprint].max()),
        systematic=float(np.abs(np.mean(images, axis=0) - truth).max() / truth.max()),
    )


def section(measured: Sequence[Measured], picture: str) -> Iterator[str]:
    """Return the page's part on lights."""
    yield "## Lights"
    yield (
        f"A round light of radiance {RADIANCE:g} and a radius of {RADIUS:g} px over a scene of about 0.5: "
        f"{SEEDS} sets of samples with {SPP} samples per pixel, lens positions uniform over the square. "
        "*Total* is the sum of the image over that of the truth, with the standard error of the mean over "
        f"the seeds. `{PLAIN}` shows the samples' own scatter: they hold the light that they happened to "
        "hit, weighted by the aperture. *Over the samples' total* divides each image's sum by that of the "
        "plain average of the same samples. *Excess* is the largest value by which any pixel of any seed "
        "exceeds the truth, as a share of the truth's peak: beyond the light's footprint, which neither lens "
        "nor pixel filter can leave, and within it. *Systematic* is the largest error of the mean over all "
        "seeds, as a share of the peak: what is wrong with the light's shape."
    )
    head = [
        "light",
        "image",
        "total",
        "over the samples' total",
        "least value",
        "excess outside",
        "inside",
        "systematic",
    ]
    rows = []
    for one in measured:
        for name, b in one.behaviours.items():
            mean, error = one.beside_samples(name)
            rows.append(
                [
                    one.case.name, name, f"{b.mean:.4f} ± {b.uncertainty:.4f}", f"{mean:.4f} ± {error:.4f}",
                    f"{b.least:.3g}", f"{b.outside:.2%}", f"{b.inside:.1%}", f"{b.systematic:.1%}",
                ]
            )  # fmt: skip
    yield markdown_table(head, rows)
    yield verdict(measured)
    yield (
        f"![lights: truth, plain average, Open Image Denoise, the layered methods]({picture})\n\n"
        "Each light twice: one stop darker than the scene, and exposed for the light's peak."
    )


def verdict(measured: Sequence[Measured]) -> str:
    """Say where total radiance is conserved, and where the seeds do not suffice to tell."""
    missed, undecided = [], []
    for one in measured:
        ours, plain = one.behaviours[OURS], one.behaviours[PLAIN]
        deviation = abs(ours.mean - 1)
        text = f"{one.case.name} ({ours.mean - 1:+.1%}; the samples themselves {plain.mean - 1:+.1%})"
        if deviation > TARGET + 2 * ours.uncertainty:
            missed.append(text)
        elif deviation > TARGET:
            undecided.append(text)
    others = "in all other places" if undecided else "in every place"
    text = (
        f"Target: the total radiance of `{OURS}` is within {TARGET:.0%} of the truth's. "
        f"{met(not missed)} for lights {', '.join(missed) or others}."
    )
    if undecided:
        text += f" Within two standard errors of it, hence undecided: {', '.join(undecided)}."
    return text
