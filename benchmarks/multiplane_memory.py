"""Memory that planes take for a 4K image, samples included."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import fewrays
from memory import extra_memory
from report import markdown_table, met
from workloads import repeated

__all__ = ["REPEATS", "Peak", "measure_memory", "section"]

REPEATS = 6
"""How often an example of 640 x 360 pixels is repeated along both axes."""
TARGET = 4.0
"""GB (10⁹ bytes): samples, planes, working memory and image together."""
_GB_PER_MIB = 2**20 / 1e9


@dataclass(frozen=True)
class Peak:
    """Memory in GB of the samples, and what building and rendering add at their peak."""

    name: str
    width: int
    height: int
    spp: int
    samples: float
    build: float
    both: float

    @property
    def together(self) -> float:
        """Samples, and what is added at the peak."""
        return self.samples + self.both


def measure_memory(path: Path) -> Peak:
    """Measure an example that is repeated to 4K; in a process that has not started threads."""
    print(f"memory: {path.stem}, repeated {REPEATS} times", file=sys.stderr)
    samples = repeated(fewrays.load(path), REPEATS)
    build, both = (
        extra_memory(call) * _GB_PER_MIB
        for call in (
            lambda: fewrays.Multiplane.build(samples),
            lambda: fewrays.Multiplane.build(samples).render(),
        )
    )
    size = samples.nbytes / 1e9
    return Peak(path.stem, samples.width, samples.height, samples.spp, size, build, both)


def section(peak: Peak) -> Iterator[str]:
    """Return the page's part on memory."""
    yield "## Memory"
    yield (
        f"GB (10⁹ bytes) for {peak.name}, repeated {REPEATS} times along both axes to {peak.width} x "
        f"{peak.height} pixels with {peak.spp} samples each, on all cores: the samples, what building adds "
        "to the process at its peak, and what building and rendering 128 views add."
    )
    cells = [f"{value:.2f}" for value in (peak.samples, peak.build, peak.both, peak.together)]
    yield markdown_table(["", "samples", "build", "build and render", "together"], [["4K", *cells]])
    good = peak.together <= TARGET
    yield f"Target: at most {TARGET:g} GB, samples included. {met(good)}: {peak.together:.2f} GB."
