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

__all__ = ["Seam", "jump_ratios", "measure_seams", "paired_ratio", "section", "verdict"]

SPP, TRUTH_SPP = 8, 256
SIZE = (288, 384)  # height and width of the analytic scenes in pixels
TARGET = 1.05
_EDGE = 32  # pixels
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
    ratios : ndarray, (tile,)
        Mean square jump across the lines of a grid over that everywhere else: of the tiles' own grid first,
        then of equal grids that lie elsewhere.
    paired, uncertainty : float
        Mean square jump across lines that are borders over that across the same lines when they are not,
        and its standard error.
    """

    scene: str
    method: str
    tile: int
    inside: float
    ratios: npt.NDArray[np.float64]
    paired: float
    uncertainty: float


def measure_seams(renders: Path) -> list[Seam]:
    """Measure the example scenes that have been rendered, and two analytic scenes."""
    seams = []
    for name, samples, truth in _scenes(renders):
        print(f"seams: {name}", file=sys.stderr)
        seams += [_seam(name, method, samples, truth) for method in _METHODS]
    return seams


def _seam(scene: str, method: str, samples: fewrays.SampleBuffer, truth: Image) -> Seam:
    tile = tile_side(method)
    offset = tile // 2
    error = _display_error(make_image(method, samples), truth)
    moved = _display_error(make_image(method, _cut(samples, offset)), truth[offset:, offset:])
    edge = offset + min(offset, _EDGE)  # the samples that were cut off are missing up to here
    paired, uncertainty = paired_ratio(
        error[edge:, edge:], moved[edge - offset :, edge - offset :], edge, tile
    )
    inside = np.sqrt(np.mean([np.square(np.diff(error, axis=axis)).mean() for axis in (0, 1)]))
    return Seam(scene, method, tile, float(inside), jump_ratios(error, tile), paired, uncertainty)


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
        energy = _line_energy(error, axis)
        phase = np.arange(1, len(energy) + 1) % tile
        sums += np.bincount(phase, energy, tile)
        counts += np.bincount(phase, minlength=tile) * (error.shape[1 - axis] * error.shape[2])
    ratios: npt.NDArray[np.float64] = (sums / counts) / ((sums.sum() - sums) / (counts.sum() - counts))
    return ratios


def paired_ratio(
    error: npt.NDArray[np.float64], moved: npt.NDArray[np.float64], start: int, tile: int
) -> tuple[float, float]:
    """Compare lines between pixels when tiles meet there with the same lines when they do not.

    Parameters
    ----------
    error, moved : ndarray, (H, W, C)
        Image minus truth of the same pixels, reconstructed with tiles that begin at the original image's edge
        and with tiles that begin half a tile from it.
    start : int
        Distance of these pixels from the original image's left and upper edge.
    tile : int
        Side of the tiles in pixels.

    Returns
    -------
    ratio : float
        Mean square jump at borders over that of the same lines elsewhere; what the image shows there cancels.
    uncertainty : float
        Its standard error, by leaving out one line at a time.
    """
    borders, others = [], []
    for axis in (0, 1):
        line = start + 1 + np.arange(error.shape[axis] - 1)
        first, second = _line_energy(error, axis), _line_energy(moved, axis)
        for phase, at_border, elsewhere in ((0, first, second), (tile // 2, second, first)):
            borders += at_border[line % tile == phase].tolist()
            others += elsewhere[line % tile == phase].tolist()
    border, other = np.array(borders), np.array(others)
    without = (border.sum() - border) / (other.sum() - other)
    count = len(border)
    uncertainty = np.sqrt((count - 1) / count * np.square(without - without.mean()).sum())
    return float(border.sum() / other.sum()), float(uncertainty)


def _line_energy(error: npt.NDArray[np.float64], axis: int) -> npt.NDArray[np.float64]:
    """Sum of squared jumps across each line between rows (axis 0) or columns (axis 1)."""
    energy: npt.NDArray[np.float64] = np.square(np.diff(error, axis=axis)).sum(axis=(1 - axis, 2))
    return energy


def _display_error(image: Image, truth: Image) -> npt.NDArray[np.float64]:
    return gamma_encode(image.astype(np.float64)) - gamma_encode(truth.astype(np.float64))


def _cut(samples: fewrays.SampleBuffer, offset: int) -> fewrays.SampleBuffer:
    """Return the samples without so many pixels at the left and upper edge."""
    kept = np.s_[offset:, offset:]
    xy = samples.xy[kept] - np.float32(offset)
    return fewrays.SampleBuffer(xy, samples.uv[kept], samples.depth[kept], samples.color[kept], samples.lens)


def _scenes(renders: Path) -> Iterator[tuple[str, fewrays.SampleBuffer, Image]]:
    """Yield names, samples and truths."""
    for name in SCENES:
        path = samples_file(renders, name, "square", SPP)
        if path.exists():
            yield f"example {name}", fewrays.load(path), load_references(renders, name)["gaussian"].image
    for name, stack in (("planes of leaves", leaf_stack(*SIZE, planes=10)), ("scattered discs", _discs())):
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
        "What the image shows there matters more than the tiles, for errors gather at edges. Two measures "
        "tell how much. *Other grids*: the same ratio for grids of equal tiles at every other offset, mean "
        "and standard deviation. *Same lines*: the image is made once more with the tiles moved by half a "
        "tile, and each line between pixels is compared with itself, as a border over inside a tile, so that "
        "the image's own structure cancels; with its standard error. This ratio is the one that is judged. "
        f"Truths are brute-force images with noise of their own ({TRUTH_SPP} samples per pixel for the "
        "analytic scenes; for the examples see the page on quality), which jumps everywhere alike and pulls "
        "the ratios towards 1."
    )
    head = ["scene", "method", "tile, px", "RMS jump, % of white", "at borders", "other grids", "same lines"]
    rows = [
        [
            s.scene, s.method, str(s.tile), f"{100 * s.inside:.2f}", f"{s.ratios[0]:.3f}",
            f"{s.ratios[1:].mean():.3f} ± {s.ratios[1:].std(ddof=1):.3f}",
            f"{s.paired:.3f} ± {s.uncertainty:.3f}",
        ]
        for s in seams
    ]  # fmt: skip
    yield markdown_table(head, rows)
    yield verdict([s for s in seams if s.method == OURS])


def verdict(seams: Sequence[Seam]) -> str:
    """Say on which scenes the target is met."""
    missed = [f"{s.scene} ({s.paired:.3f} ± {s.uncertainty:.3f})" for s in seams if s.paired > TARGET]
    return (
        f"Target: at most {TARGET:g} for `{OURS}`, on the same lines. "
        f"{met(not missed)} on {', '.join(missed) or 'every scene'}."
    )
