"""Whether the tiles that a method works in show: how the error jumps across their borders and inside them."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

import fewrays
from contenders import OURS, PUBLISHED, make_image, tile_side
from example_renders import SCENES, load_references, samples_file
from fewrays.color import gamma_encode
from fewrays.method import Image
from fewrays.sources.analytic import Mask, Plane, disc, reference, sample, smooth_noise
from report import markdown_table, met
from workloads import LEAF_LENS, leaf_stack

__all__ = ["Seam", "jump_ratios", "measure_seams", "section", "verdict"]

SPP, TRUTH_SPP = 8, 256
SIZE = (288, 448)  # height and width of the analytic scenes in pixels
TARGET = 1.05
_METHODS = (OURS, PUBLISHED)


@dataclass(frozen=True)
class Seam:
    """How much more the error jumps across tile borders than elsewhere, and by chance.

    Parameters
    ----------
    scene, method : str
        What was reconstructed, and how.
    tile : int
        Side of the tiles in pixels.
    inside : float
        Root mean square jump between neighbours inside tiles, as a share of white after gamma 2.2.
    ratio : float
        Mean square jump across borders over that inside tiles.
    elsewhere : float
        Mean of the same ratio for grids of equal tiles that lie elsewhere.
    scatter : float
        Its standard deviation over these grids.
    """

    scene: str
    method: str
    tile: int
    inside: float
    ratio: float
    elsewhere: float
    scatter: float

    @property
    def deviations(self) -> float:
        """By how many standard deviations the true grid stands out."""
        return (self.ratio - self.elsewhere) / self.scatter


def measure_seams(renders: Path) -> list[Seam]:
    """Measure the example scenes that have been rendered, and two analytic scenes."""
    seams = []
    for name, samples, truth in _scenes(renders):
        print(f"seams: {name}", file=sys.stderr)
        for method in _METHODS:
            image = make_image(method, samples)
            error = gamma_encode(image.astype(np.float64)) - gamma_encode(truth.astype(np.float64))
            seams.append(_seam(name, method, error))
    return seams


def jump_ratios(error: npt.NDArray[np.float64], tile: int) -> npt.NDArray[np.float64]:
    """Return the mean square jump across the lines of a grid over that everywhere else, for every grid.

    Parameters
    ----------
    error : ndarray, (H, W, C)
        Image minus truth.
    tile : int
        Distance of the grids' lines in pixels.

    Returns
    -------
    ndarray, (tile,)
        Of the grids that begin 0, 1, … pixels from the image's left and upper edge.
    """
    sums, counts = np.zeros(tile), np.zeros(tile)
    for axis in (0, 1):
        energy = np.square(np.diff(error, axis=axis)).sum(axis=(1 - axis, 2))
        phase = np.arange(1, len(energy) + 1) % tile
        sums += np.bincount(phase, energy, tile)
        counts += np.bincount(phase, minlength=tile) * (error.shape[1 - axis] * error.shape[2])
    ratios: npt.NDArray[np.float64] = (sums / counts) / ((sums.sum() - sums) / (counts.sum() - counts))
    return ratios


def _seam(scene: str, method: str, error: npt.NDArray[np.float64]) -> Seam:
    tile = tile_side(method)
    ratios = jump_ratios(error, tile)
    jumps = [np.square(np.diff(error, axis=axis)).mean() for axis in (0, 1)]
    others = ratios[1:]
    return Seam(
        scene,
        method,
        tile,
        float(np.sqrt(np.mean(jumps))),
        float(ratios[0]),
        others.mean(),
        others.std(ddof=1),
    )


def _scenes(renders: Path) -> Iterator[tuple[str, fewrays.SampleBuffer, Image]]:
    """Yield names, samples and truths."""
    for name in SCENES:
        path = samples_file(renders, name, "square", SPP)
        if path.exists():
            yield f"example {name}", fewrays.load(path), load_references(renders, name)["gaussian"].image
    for name, stack in (("planes of leaves", leaf_stack(*SIZE)), ("scattered discs", _discs())):
        truth = reference(stack, LEAF_LENS, *SIZE, spp=TRUTH_SPP)
        yield name, sample(stack, LEAF_LENS, *SIZE, SPP), truth


def _discs() -> list[Plane]:
    """Discs here and there before a textured wall: some tiles hold one plane, some two or three."""
    rng = np.random.default_rng(5)
    stack = [Plane(LEAF_LENS.depth(5.0), smooth_noise(5.0, seed=1))]
    for seed, slope in enumerate((-10.0, -3.0, 0.0), start=2):
        centers = rng.uniform((0, 0), SIZE[::-1], (14, 2))
        masks = [disc((x, y), radius) for (x, y), radius in zip(centers, rng.uniform(8, 28, 14), strict=True)]
        stack.append(Plane(LEAF_LENS.depth(slope), smooth_noise(5.0, seed=seed), partial(_any_of, masks)))
    return stack


def _any_of(masks: Sequence[Mask], xy: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = np.any([mask(xy) for mask in masks], axis=0)
    return inside


def section(seams: Sequence[Seam]) -> Iterator[str]:
    """Return the page's part on seams."""
    yield "## Seams"
    yield (
        "Filters that change from tile to tile could leave the tiles' borders in the image. Measured is the "
        "error image, reconstruction minus truth after clip to [0, 1] and gamma 2.2: the mean square of its "
        "jump from a pixel to the next, across tile borders over everywhere else, rows and columns together. "
        f"Without seams the ratio is 1. {SPP} samples per pixel, lens positions uniform over the square."
    )
    yield (
        "A ratio strays from 1 by chance as well, as edges happen to lie on borders. *Elsewhere* is the same "
        "ratio for grids of equal tiles that lie at every other offset: mean and standard deviation; the "
        "last column says by how many of these standard deviations the true grid stands out. Truths are "
        f"brute-force images with noise of their own ({TRUTH_SPP} samples per pixel for the analytic scenes; "
        "for the examples see the page on quality), which jumps everywhere alike and pulls it towards 1."
    )
    head = ["scene", "method", "tile, px", "RMS jump, % of white", "ratio at borders", "elsewhere", "σ away"]
    rows = [
        [
            s.scene, s.method, str(s.tile), f"{100 * s.inside:.2f}", f"{s.ratio:.3f}",
            f"{s.elsewhere:.3f} ± {s.scatter:.3f}", f"{s.deviations:+.1f}",
        ]
        for s in seams
    ]  # fmt: skip
    yield markdown_table(head, rows)
    yield verdict([s for s in seams if s.method == OURS])


def verdict(seams: Sequence[Seam]) -> str:
    """Say on which scenes the target is met."""
    missed = [f"{s.scene} ({s.ratio:.3f}, {s.deviations:+.1f} σ)" for s in seams if s.ratio > TARGET]
    return (
        f"Target: at most {TARGET:g} for `{OURS}`. {met(not missed)} on {', '.join(missed) or 'every scene'}."
    )
