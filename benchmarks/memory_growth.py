"""Memory that methods need beyond their input and output, as images grow."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from contenders import OURS, PLAIN, PUBLISHED
from memory import extra_memory
from peers import DENOISER, denoise_filter
from report import markdown_table, met
from workloads import leaf_planes, repeated

__all__ = ["SIZES", "Peak", "measure_memory", "section", "verdict", "workloads"]

SIZES = ((1280, 720, 8), (3840, 2160, 2), (7680, 4320, 1))
"""Width and height in pixels, samples per pixel, of planes of leaves."""
REPEATS = 3
"""How often examples are repeated, along both axes."""
TARGET = 200.0
"""MB beyond input and output."""
ALONE = f"{OURS}, 1 thread"
_MB_PER_MIB = 2**20 / 1e6
_METHODS = {
    ALONE: (OURS, 1),
    OURS: (OURS, None),
    PUBLISHED: (PUBLISHED, None),
    PLAIN: (PLAIN, None),
}


@dataclass(frozen=True)
class Peak:
    """Memory in MB: of the samples, of the image, and at its peak beyond both for each contender."""

    name: str
    width: int
    height: int
    spp: int
    samples: float
    image: float
    extra: dict[str, float]


def workloads(
    sizes: Sequence[tuple[int, int, int]], examples: dict[str, Path]
) -> Iterator[tuple[str, fewrays.SampleBuffer]]:
    """Yield planes of leaves of growing size, and examples repeated side by side: large images, all dense."""
    for width, height, spp in sizes:
        yield "planes of leaves", leaf_planes(height, width, spp)
    for scene, path in examples.items():
        yield f"{scene}, repeated", repeated(fewrays.load(path), REPEATS)


def measure_memory(name: str, samples: fewrays.SampleBuffer) -> Peak:
    """Measure each contender's first call; in a process that has not started threads."""
    width, height, spp = samples.width, samples.height, samples.spp
    print(f"memory of {name} at {width} x {height}, {spp} spp", file=sys.stderr)
    image = fewrays.reconstruct(samples, PLAIN)
    calls: dict[str, Callable[[], object]] = {DENOISER: lambda: denoise_filter(image, None)()}
    calls |= {label: _call(samples, *how) for label, how in _METHODS.items()}
    size = image.nbytes / 1e6
    extra = {label: extra_memory(call) * _MB_PER_MIB - size for label, call in calls.items()}
    return Peak(name, width, height, spp, samples.nbytes / 1e6, size, extra)


def _call(samples: fewrays.SampleBuffer, method: str, threads: int | None) -> Callable[[], object]:
    return lambda: fewrays.reconstruct(samples, method, threads=threads)


def section(peaks: Sequence[Peak], threads: int) -> Iterator[str]:
    """Return the page's part on memory."""
    yield "## Memory"
    yield (
        "MB (10⁶ bytes) that the first call adds to the process at its peak, less the image it returns, "
        f"with {threads} threads where nothing else is said. Examples are repeated {REPEATS} times along "
        "both axes."
    )
    head = ["", "size", "samples", "image", *peaks[0].extra]
    rows = [
        [
            peak.name,
            f"{peak.width} x {peak.height}, {peak.spp} spp",
            f"{peak.samples:.0f}",
            f"{peak.image:.0f}",
            *(f"{extra:.0f}" for extra in peak.extra.values()),
        ]
        for peak in peaks
    ]
    yield markdown_table(head, rows)
    yield verdict(peaks)


def verdict(peaks: Sequence[Peak]) -> str:
    """Say where the target is met."""
    missed = [
        f"{peak.name} at {peak.width} x {peak.height} ({peak.extra[ALONE]:.0f} MB)"
        for peak in peaks
        if peak.extra[ALONE] >= TARGET
    ]
    where = f": {', '.join(missed)}" if missed else ""
    return (
        f"Target: `{OURS}` takes less than {TARGET:g} MB beyond input and output, on one core. "
        f"{met(not missed)}{where}."
    )
