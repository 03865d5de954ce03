"""Whether anything pops while a depth slides across the borders of a method's layers, frame by frame."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

import fewrays
from contenders import OURS, PLAIN, PUBLISHED, make_image, pixel_filter_of
from fewrays.method import Image
from fewrays.sources.analytic import (
    PixelFilter,
    Plane,
    constant,
    exact_waves,
    half_plane,
    sample,
    smooth_noise,
)
from report import markdown_table, met

__all__ = ["METHODS", "Slide", "change_beyond_truth", "measure_slides", "section", "verdict"]

METHODS = (PLAIN, PUBLISHED, OURS)
SPP = 8
STEP = 0.05  # pixels of slope from frame to frame
TARGET = 2.0
"""How far the worst frame may lie above the median of the frames around it."""
_SIZE, _BORDER, _AROUND = (72, 96), 12, 10  # pixels; pixels; frames on either side
_LENS = fewrays.Lens(-40.0, 20.0, aperture="gaussian", sampling="square")
_DARK, _LIGHT = 0.1, 0.8  # radiance
_SIGMA_PIX = 0.5  # pixels, of the Gaussian pixel filter
_WALL = smooth_noise(6.0, waves=8, seed=3)


@dataclass(frozen=True)
class Slide:
    """How an image changed beyond the truth's change while a slope slid.

    Parameters
    ----------
    scene, method : str
        What slid, and how it was reconstructed.
    slopes : ndarray, (F,)
        In pixels, of the later of each two frames.
    change : ndarray, (F,)
        Root mean square over the pixels of the image's change less the truth's, as a share of radiance 1.
    """

    scene: str
    method: str
    slopes: npt.NDArray[np.float64]
    change: npt.NDArray[np.float64]

    @property
    def worst(self) -> float:
        """Largest change over the median of all frames."""
        return float(self.change.max() / np.median(self.change))

    @property
    def standing_out(self) -> npt.NDArray[np.float64]:
        """Every frame's change over the median of the frames around it."""
        spans = [self.change[max(0, i - _AROUND) : i + _AROUND + 1] for i in range(len(self.change))]
        ratios: npt.NDArray[np.float64] = self.change / np.array([np.median(span) for span in spans])
        return ratios


@dataclass(frozen=True)
class _Scene:
    name: str
    slopes: npt.NDArray[np.float64]
    planes: Callable[[float], list[Plane]]
    truth: Callable[[float, PixelFilter], Image]


def measure_slides() -> list[Slide]:
    """Slide a wall through the focal plane, and a cover towards it, with the same random numbers."""
    slides = []
    for scene in (_wall(), _edge()):
        print(f"popping: {scene.name}", file=sys.stderr)
        buffers = [sample(scene.planes(slope), _LENS, *_SIZE, SPP, seed=7) for slope in scene.slopes]
        filters = {pixel_filter_of(method) for method in METHODS}
        truths = {f: [scene.truth(slope, f) for slope in scene.slopes] for f in filters}
        for method in METHODS:
            images = [make_image(method, samples) for samples in buffers]
            change = change_beyond_truth(images, truths[pixel_filter_of(method)], _BORDER)
            slides.append(Slide(scene.name, method, scene.slopes[1:], change))
    return slides


def change_beyond_truth(
    images: Sequence[Image], truths: Sequence[Image], border: int
) -> npt.NDArray[np.float64]:
    """Return, for each two successive frames, the RMS of the images' change less the truths'.

    Parameters
    ----------
    images, truths : sequence of ndarray, (H, W, 3)
        Frames.
    border : int
        Pixels along the image's edges that do not count.

    Returns
    -------
    ndarray, (frames - 1,)
    """
    inner = slice(border, -border or None)
    errors = [
        image[inner, inner].astype(np.float64) - truth[inner, inner]
        for image, truth in zip(images, truths, strict=True)
    ]
    return np.array([np.sqrt(np.square(b - a).mean()) for a, b in pairwise(errors)])


def _wall() -> _Scene:
    """Return one textured plane that fills the image; its truth is exact."""

    def truth(slope: float, pixel_filter: PixelFilter) -> Image:
        return exact_waves(_WALL, _LENS.depth(slope), _LENS, *_SIZE, pixel_filter=pixel_filter)

    slopes = np.arange(-6.0, 6.0 + STEP / 2, STEP)
    return _Scene("wall through the focal plane", slopes, lambda s: [Plane(_LENS.depth(s), _WALL)], truth)


def _edge() -> _Scene:
    """Return a plain cover over half of a plain wall; it slides through the focal plane towards the wall."""

    def planes(slope: float) -> list[Plane]:
        cover = Plane(_LENS.depth(slope), constant(_LIGHT), half_plane((_SIZE[1] / 2, 0), (1, 0)))
        return [Plane(_LENS.depth(4.0), constant(_DARK)), cover]

    return _Scene("cover before a wall", np.arange(-6.0, 3.0 + STEP / 2, STEP), planes, _exact_edge)


def _exact_edge(slope: float, pixel_filter: PixelFilter) -> Image:
    """Integrate the cover's opacity over the aperture, cut off at its square, and over the pixel filter."""
    u, weights = np.polynomial.legendre.leggauss(128)
    weights = weights * np.exp(-np.square(u) / (2 * _LENS.sigma**2))
    covered = np.arange(_SIZE[1])[:, None] + 0.5 - _SIZE[1] / 2 - slope * u  # pixels from the cover's edge
    if pixel_filter == "gaussian":
        inside = 0.5 + 0.5 * np.vectorize(math.erf)(covered / (_SIGMA_PIX * math.sqrt(2)))
    else:
        inside = np.clip(covered + 0.5, 0, 1)
    profile = _DARK + (_LIGHT - _DARK) * (inside @ (weights / weights.sum()))
    return np.broadcast_to(profile[:, None], (*_SIZE, 3)).astype(np.float32)


def section(slides: Sequence[Slide], picture: str) -> Iterator[str]:
    """Return the page's part on popping."""
    yield "## Popping"
    yield (
        f"A depth slides by {STEP:g} px of slope from frame to frame, across the borders of layers, while "
        f"all random numbers stay the same ({SPP} samples per pixel). Measured is the change of the image "
        "from a frame to the next, less the change of the truth, which is exact: its RMS, in thousandths of "
        "radiance 1. Where a method hands samples from one layer to another with a jolt, a frame stands out. "
        "Its change is therefore given over the median of all frames, and over the median of the "
        f"{2 * _AROUND + 1} frames around it, for the change also grows steadily towards focus. `{PLAIN}` "
        "knows no layers; it shows how much chance alone makes a frame stand out, as rays cross the edge."
    )
    head = [
        "scene",
        "method",
        "median",
        "worst",
        "worst / median",
        "worst / frames around it",
        "at slope, px",
    ]
    rows = []
    for slide in slides:
        standing_out = slide.standing_out
        rows.append(
            [
                slide.scene, slide.method, f"{1000 * np.median(slide.change):.2f}",
                f"{1000 * slide.change.max():.2f}", f"{slide.worst:.2f}",
                f"{standing_out.max():.2f}", f"{slide.slopes[standing_out.argmax()]:+.2f}",
            ]
        )  # fmt: skip
    yield markdown_table(head, rows)
    yield verdict([slide for slide in slides if slide.method == OURS])
    yield f"![change beyond the truth's, frame by frame]({picture})"


def verdict(slides: Sequence[Slide]) -> str:
    """Say in which scenes the worst frame stands out."""
    worst = {slide.scene: float(slide.standing_out.max()) for slide in slides}
    missed = [f"{scene} ({value:.2f})" for scene, value in worst.items() if value > TARGET]
    return (
        f"Target: no frame of `{OURS}` changes by more than {TARGET:g} times the median of those around it. "
        f"{met(not missed)} on {', '.join(missed) or 'every scene'}."
    )
