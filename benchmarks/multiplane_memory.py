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
_VIEWS = 16  # more take no more memory


@dataclass(frozen=True)
class Peak:
    """Memory in GB of the samples, and what building and rendering add at their peak."""

    name: str
    width: int
    height: int
    spp: int
    samples: float
    added: float

    @property
    def together(self) -> float:
        """Samples, and what is added at the peak."""
        return self.samples + self.added


def measure_memory(path: Path) -> Peak:
    """Measure an example that is repeated to 4K; in a process that has not started threads."""
    print(f"memory: {path.stem}, repeated {REPEATS} times", file=sys.stderr)
    samples = repeated(fewrays.load(path), REPEATS)
    added = extra_memory(lambda: fewrays.Multiplane.build(samples).render(views=_VIEWS)) * _GB_PER_MIB
    size = samples.nbytes / 1e9
    return Peak(path.stem, samples.width, samples.height, samples.spp, size, added)


def section(peak: Peak) -> Iterator[str]:
    """Return the page's part on memory."""
    yield "## Memory"
    yield (
        f"GB (10⁹ bytes) for {peak.name}, repeated {REPEATS} times along both axes to {peak.width} x "
        f"{peak.height} pixels with {peak.spp} samples each, on all cores: the samples, and what building "
        "planes and rendering them adds to the process at its peak."
    )
    cells = [f"{value:.2f}" for value in (peak.samples, peak.added, peak.together)]
    yield markdown_table(["", "samples", "build and render", "together"], [["4K", *cells]])
    good = peak.together <= TARGET
    yield f"Target: at most {TARGET:g} GB, samples included. {met(good)}: {peak.together:.2f} GB."
