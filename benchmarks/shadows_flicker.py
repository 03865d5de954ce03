"""A lamp that moves: how much flickers from frame to frame of what should not, each frame made by itself."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fewrays.color import gamma_encode
from fewrays.method import Image
from kept_images import KeptImages
from lit_scenes import SPP, LitScene, frames, how_to_render_lit, load_lit
from peers import DENOISER
from report import markdown_table
from shadows_quality import BEST, DENOISER_AOVS, OURS, PLAIN, make_image

__all__ = ["Flicker", "measure_flicker", "section"]

STILL = 0.01
"""Change of the truth, as a share of white after gamma 2.2, below which a pixel stands still."""

_AROUND = 2  # pixels, over which the truth's change is averaged, as its noise would count as one
_FEWEST = 2  # frames
_CONTENDERS = (PLAIN, DENOISER, DENOISER_AOVS, *OURS)


@dataclass(frozen=True)
class Flicker:
    """What changes between frames where the truth does not.

    Parameters
    ----------
    frame_count : int
    size : (int, int)
        Height and width.
    share : float
        Of pixels that stand still from one frame to the next.
    change : dict of str to float
        Mean absolute change of these, as a share of white after gamma 2.2, by contender.
    of_reference : float
        That of the references, which is their noise and slow change.
    """

    frame_count: int
    size: tuple[int, int]
    share: float
    change: dict[str, float]
    of_reference: float


def measure_flicker(folder: Path, kept: KeptImages) -> Flicker | None:
    """Let everyone make every frame; None where fewer than two have been rendered."""
    names = frames(folder)
    if len(names) < _FEWEST:
        return None
    truths: list[Image] = []
    shown: list[dict[str, Image]] = []
    for name in names:
        scene = load_lit(folder, name)
        truths.append(scene.reference.image)
        shown.append(_everyone(scene, kept))
    still = [_still(before, after) for before, after in pairwise(truths)]
    change = {name: _change([each[name] for each in shown], still) for name in shown[0]}
    height, width = truths[0].shape[:2]
    return Flicker(len(names), (height, width), float(np.mean(still)), change, _change(truths, still))


def _everyone(scene: LitScene, kept: KeptImages) -> dict[str, Image]:
    print(f"flicker: {scene.label}", file=sys.stderr)
    return {name: make_image(name, scene, kept) for name in _CONTENDERS}


def _still(before: Image, after: Image) -> npt.NDArray[np.bool_]:
    """Tell which pixels ``(H, W)`` do not change, on average over their surroundings."""
    change = gamma_encode(after) - gamma_encode(before)
    side = 2 * _AROUND + 1
    padded = np.pad(change, ((_AROUND, _AROUND), (_AROUND, _AROUND), (0, 0)), mode="edge")
    mean = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(0, 1)).mean(axis=(-1, -2))
    return np.asarray((np.abs(mean) < STILL).all(axis=-1))


def _change(images: Sequence[Image], still: Sequence[npt.NDArray[np.bool_]]) -> float:
    """Mean absolute change from each image to the next, of the pixels that stand still."""
    changes = [
        np.abs(gamma_encode(after) - gamma_encode(before))[where]
        for before, after, where in zip(images[:-1], images[1:], still, strict=True)
    ]
    return float(np.concatenate(changes).mean())


def section(flicker: Flicker | None) -> Iterator[str]:
    """Return the page's part on flicker."""
    yield "## Flicker"
    if flicker is None:
        yield f"Not rendered, hence missing:\n\n{how_to_render_lit(['light'])}"
        return
    height, width = flicker.size
    yield (
        f"The still variant in {flicker.frame_count} frames of {width} x {height} pixels, over which the "
        f"lamp moves sideways. Every frame has {SPP} samples per pixel of its own and is made by itself. "
        "Mean absolute change from frame to frame, in percent of white after gamma 2.2, of pixels whose "
        f"truth changes by less than {STILL:.0%} ({flicker.share:.0%} of all); and as a share of that of "
        "the plain average. The references' own change is noise, and what little the truth changes."
    )
    first = next(iter(flicker.change.values()))
    rows = [[name, f"{value:.2%}", f"{value / first:.2f}"] for name, value in flicker.change.items()]
    rows.append(["reference", f"{flicker.of_reference:.2%}", ""])
    yield markdown_table(["", "change", "of the plain average's"], rows)
    best = min(flicker.change, key=lambda name: flicker.change[name])
    yield f"Least flicker: *{best}*; *{BEST}* {flicker.change[BEST]:.2%}."
