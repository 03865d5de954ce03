"""What a method's time does when every circle of confusion grows, all else being equal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import fewrays
from contenders import OURS, PUBLISHED
from report import markdown_table, met
from timing import Timing, spread, time_in_turns

__all__ = ["FACTORS", "Growth", "Scalable", "measure_growth", "section", "verdict"]

FACTORS = (1, 2, 4, 8)
TARGET = 1.5
"""CPU seconds with all slopes times the largest factor over those with the slopes as they are."""
_METHODS = (OURS, PUBLISHED)


@dataclass(frozen=True)
class Scalable:
    """A workload whose slopes can be multiplied: `scaled` makes its samples for a factor."""

    name: str
    scaled: Callable[[int], fewrays.SampleBuffer]


@dataclass(frozen=True)
class Growth:
    """Timings of a method on one workload, for each of `FACTORS`."""

    workload: str
    method: str
    timings: tuple[Timing, ...]

    @property
    def ratios(self) -> list[float]:
        """Median CPU seconds over those of the first factor."""
        return [timing.cpu_median / self.timings[0].cpu_median for timing in self.timings]


def measure_growth(workload: Scalable, repetitions: int) -> list[Growth]:
    """Time both methods on one thread, for all factors in turns."""
    print(f"{workload.name}: slopes times {FACTORS}", file=sys.stderr)
    buffers = [workload.scaled(factor) for factor in FACTORS]
    calls = [_call(samples, method) for method in _METHODS for samples in buffers]
    timings = time_in_turns(calls, repetitions)
    count = len(FACTORS)
    return [
        Growth(workload.name, method, tuple(timings[i * count : (i + 1) * count]))
        for i, method in enumerate(_METHODS)
    ]


def _call(samples: fewrays.SampleBuffer, method: str) -> Callable[[], object]:
    return lambda: fewrays.reconstruct(samples, method, threads=1)


def section(grown: Sequence[Growth]) -> Iterator[str]:
    """Return the page's part on any blur radius."""
    yield "## Any blur radius"
    yield (
        "CPU seconds with one thread when all slopes, hence all circles of confusion, are so many times as "
        "large. The planes of leaves are sampled anew through the larger lens; the examples' rays stay where "
        "they are and only get larger slopes, which makes no picture but costs the same. Larger slopes also "
        "spread a scene over more depth layers."
    )
    head = [
        "workload",
        "method",
        *(f"x {factor}" for factor in FACTORS),
        *(f"ratio, x {f}" for f in FACTORS[1:]),
    ]
    rows = [
        [
            growth.workload,
            growth.method,
            *(spread(timing.cpu) for timing in growth.timings),
            *(f"{ratio:.2f}" for ratio in growth.ratios[1:]),
        ]
        for growth in grown
    ]
    yield markdown_table(head, rows)
    yield verdict([growth for growth in grown if growth.method == OURS])


def verdict(grown: Sequence[Growth]) -> str:
    """Say on which workloads the target is met."""
    missed = [f"{g.workload} ({g.ratios[-1]:.2f})" for g in grown if g.ratios[-1] > TARGET]
    return (
        f"Target, slopes times {FACTORS[-1]}: `{OURS}` takes at most {TARGET:g} times the CPU seconds. "
        f"{met(not missed)} on {', '.join(missed) or 'every workload'}."
    )
