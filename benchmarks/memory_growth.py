"""Memory that methods need beyond their input and output, as images grow."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import fewrays
from contenders import OURS, PLAIN, PUBLISHED
from memory import extra_memory
from peers import DENOISER, denoise_filter
from report import markdown_table, met
from workloads import leaf_planes

__all__ = ["SIZES", "Peak", "measure_memory", "section", "verdict"]

SIZES = ((1280, 720, 8), (3840, 2160, 2), (7680, 4320, 1))
"""Width and height in pixels, samples per pixel."""
TARGET = 200.0
"""MB beyond input and output."""
_MB_PER_MIB = 2**20 / 1e6
_METHODS = (OURS, PUBLISHED, PLAIN)


@dataclass(frozen=True)
class Peak:
    """Memory in MB: of the samples, of the image, and at its peak beyond both for each contender."""

    width: int
    height: int
    spp: int
    samples: float
    image: float
    extra: dict[str, float]


def measure_memory(width: int, height: int, spp: int) -> Peak:
    """Measure each contender's first call; in a process that has not started threads."""
    print(f"memory at {width} x {height}, {spp} spp", file=sys.stderr)
    samples = leaf_planes(height, width, spp)
    image = fewrays.reconstruct(samples, PLAIN)
    calls: dict[str, Callable[[], object]] = {DENOISER: lambda: denoise_filter(image, None)()}
    calls |= {method: _call(samples, method) for method in _METHODS}
    size = image.nbytes / 1e6
    extra = {name: extra_memory(call) * _MB_PER_MIB - size for name, call in calls.items()}
    return Peak(width, height, spp, samples.nbytes / 1e6, size, extra)


def _call(samples: fewrays.SampleBuffer, method: str) -> Callable[[], object]:
    return lambda: fewrays.reconstruct(samples, method)


def section(peaks: Sequence[Peak], threads: int) -> Iterator[str]:
    """Return the page's part on memory."""
    yield "## Memory"
    yield (
        "MB (10⁶ bytes) that the first call adds to the process at its peak, less the image it returns, "
        f"with {threads} threads, on planes of leaves."
    )
    head = ["size", "samples", "image", *peaks[0].extra]
    rows = [
        [
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
    """Say at which sizes the target is met."""
    missed = [f"{p.width} x {p.height} ({p.extra[OURS]:.0f} MB)" for p in peaks if p.extra[OURS] >= TARGET]
    return (
        f"Target: `{OURS}` takes less than {TARGET:g} MB beyond input and output. "
        f"{met(not missed)} at {', '.join(missed) or 'every size'}."
    )
