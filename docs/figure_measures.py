"""What the tables of the pages measure, and how a table is printed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays import SampleBuffer, reconstruct
from fewrays.method import Image
from fewrays.metrics import psnr_display

BORDER = 16
"""Pixels that are not measured: samples are missing there."""

PUBLISHED = "layered-published"
by_layers = partial(reconstruct, method="layered")


def print_table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a Markdown table under a heading."""
    print(f"\n### {title}\n\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(
            "| " + " | ".join(f"{cell:.1f}" if isinstance(cell, float) else str(cell) for cell in row) + " |"
        )


def inner(image: npt.NDArray[Any], border: int = BORDER) -> npt.NDArray[Any]:
    """Return an image without its border."""
    return image[border:-border, border:-border]


def quality(image: Image, truth: Image, border: int = BORDER) -> float:
    """Return the PSNR in dB, without the border."""
    return psnr_display(inner(image, border), inner(truth, border))


def rms_error(image: Image, truth: Image, border: int = BORDER) -> float:
    """Return the root mean square error in percent of white, without the border."""
    return 100 * float(np.sqrt(np.square(inner(image - truth, border), dtype=np.float64).mean()))


def cpu_seconds(run: Callable[[], object], repetitions: int) -> float:
    """Return the least CPU time of several runs."""
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def relative_times(
    samples: SampleBuffer, choices: Sequence[dict[str, Any]], base: int, method: str = "layered"
) -> list[float]:
    """Return the CPU time of each choice of options over that of the one at index `base`, on one thread."""
    rounds = [
        [cpu_seconds(lambda: reconstruct(samples, method, threads=1, **chosen), 1) for chosen in choices]  # noqa: B023
        for _ in range(6)
    ]
    best = np.min(rounds, axis=0)
    return [float(seconds / best[base]) for seconds in best]


def seam_ratio(image: Image, truth: Image) -> float:
    """How much more the error jumps from pixel to pixel across borders of 32 px than elsewhere."""
    jump = np.abs(np.diff(inner(image - truth), axis=1)).mean(axis=(0, 2))
    border = (np.arange(len(jump)) + BORDER + 1) % 32 == 0
    return float(jump[border].mean() / jump[~border].mean())
