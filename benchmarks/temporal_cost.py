"""What happens at the locations of a temporal reconstruction, and what they cost in time and memory."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.parallel import Execution
from fewrays.sources.analytic import sample
from fewrays.temporal import TemporalOptions, kernel, make_plan
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.plan import Plan
from fewrays.temporal.statistics import Statistics
from memory import extra_memory
from peers import DENOISER, denoise_filter
from report import markdown_table, met
from timing import Timing, spread, time_in_turns
from workloads import leaf_stack

__all__ = ["Cost", "Workload", "count_locations", "measure_cost", "section", "simple_scene", "verdict"]

TIME_TARGET = 0.3
"""Microseconds of CPU per location, on the foliage scene and one thread."""
MEMORY_TARGET = 64.0
"""Bytes per sample, of the buffer and the hierarchy over it."""
_LENS = fewrays.Lens(-40.0, 10.0)  # as that of the planes of leaves, with a disc for its aperture


@dataclass(frozen=True)
class Workload:
    """Samples by name; `judged` where the target of time holds for them."""

    name: str
    samples: fewrays.SampleBuffer
    judged: bool = False


@dataclass(frozen=True)
class Cost:
    """What a workload takes on one thread.

    Parameters
    ----------
    workload : Workload
    locations : int
        Of the whole image.
    hierarchy : Timing
        Of building the tree alone.
    views : Timing
        Of that and of reconstructing all locations.
    whole : Timing
        Of all that the method does: measuring R, smoothing and correction as well.
    denoiser : Timing
        Open Image Denoise on the plain average of the same samples.
    tree_bytes : int
        Of the hierarchy.
    peak : float
        What the whole adds to the process at its peak, in MiB.
    """

    workload: Workload
    locations: int
    hierarchy: Timing
    views: Timing
    whole: Timing
    denoiser: Timing
    tree_bytes: int
    peak: float

    @property
    def microseconds(self) -> float:
        """CPU time per location, without the hierarchy's."""
        return 1e6 * (self.views.cpu_median - self.hierarchy.cpu_median) / self.locations

    @property
    def bytes_per_sample(self) -> tuple[float, float]:
        """Bytes per sample of the buffer, and of the hierarchy."""
        samples = self.workload.samples
        return samples.nbytes / samples.depth.size, self.tree_bytes / samples.depth.size


def simple_scene(height: int, width: int, spp: int) -> Workload:
    """Return samples of two planes of a few leaves before a wall, all out of focus."""
    planes = leaf_stack(height, width, planes=2, seed=2)
    return Workload(f"wall and leaves, {spp} spp", sample(planes, _LENS, height, width, spp))


def count_locations(samples: fewrays.SampleBuffer) -> Statistics:
    """Say how the locations of an image are resolved."""
    plan = make_plan(samples, TemporalOptions())
    return kernel.reconstruct_tiles(samples, plan, _bands(samples, plan), Execution())


def measure_cost(workload: Workload, repetitions: int) -> Cost:
    """Time the parts of a reconstruction and the denoiser in turns, on one thread."""
    print(f"cost: {workload.name}", file=sys.stderr)
    samples = workload.samples
    peak = extra_memory(lambda: fewrays.reconstruct(samples, "temporal", threads=1))
    plan = make_plan(samples, TemporalOptions())
    image = fewrays.reconstruct(samples, "box")
    one = Execution(threads=1)
    calls: list[Callable[[], object]] = [
        lambda: Hierarchy(samples, plan.rule),
        lambda: kernel.reconstruct_tiles(samples, plan, _bands(samples, plan), one),
        lambda: fewrays.reconstruct(samples, "temporal", threads=1),
        denoise_filter(image, 1),
    ]
    timings = time_in_turns(calls, repetitions)
    locations = samples.height * samples.width * plan.locations.count
    hierarchy, views, whole, denoiser = timings
    tree_bytes = Hierarchy(samples, plan.rule).nbytes
    return Cost(workload, locations, hierarchy, views, whole, denoiser, tree_bytes, peak)


def _bands(samples: fewrays.SampleBuffer, plan: Plan) -> npt.NDArray[np.float32]:
    return np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)


def section(
    counted: Sequence[tuple[str, Statistics]], costs: Sequence[Cost], repetitions: int
) -> Iterator[str]:
    """Return the page's part on locations."""
    yield "## What happens at the locations"
    yield (
        "How the surface that a location shows was found, in % of the locations, 128 per pixel, and how many "
        "surfaces were looked at on the way. *One surface* and *all quadrants* are the two early-outs of the "
        "paper's section 3.3, which it says handle over 90 %; *merged* counts surfaces of too few samples, "
        "0.3 to 0.5 % there."
    )
    yield statistics_table(counted)
    yield "## Time and memory"
    yield (
        f"CPU seconds on one thread, medians of {repetitions} rounds (in brackets the range), of 128 "
        "locations per pixel. *Hierarchy* is the tree alone; *views* is all reconstruction locations, the "
        "tree built before them included; *whole* is `fewrays.reconstruct`, which measures R, smooths and "
        f"corrects as well. {DENOISER} runs on the plain average in the same rounds. *Per location* is the "
        "difference of views and hierarchy."
    )
    yield _time_table(costs)
    yield (
        "Memory in bytes per sample, and what the whole reconstruction adds to the process at its peak, "
        "working memory, refinement and output included."
    )
    yield _memory_table(costs)
    yield verdict(costs)


def statistics_table(counted: Sequence[tuple[str, Statistics]]) -> str:
    """Return the table of how locations were resolved."""
    head = [
        "", "surfaces", "one surface", "all quadrants", "early-outs", "a triangle", "the last", "empty",
        "beyond R", "merged",
    ]  # fmt: skip
    rows = []
    for name, s in counted:
        parts = (s.single, s.quadrants, s.single + s.quadrants, s.covered, s.last, s.empty, s.wide, s.merged)
        shares = [f"{100 * part / s.locations:.2f}" for part in parts]
        rows.append([name, f"{s.surfaces / s.locations:.2f}", *shares])
    return markdown_table(head, rows)


def _time_table(costs: Sequence[Cost]) -> str:
    head = [
        "",
        "hierarchy, s",
        "views, s",
        "whole, s",
        f"{DENOISER}, s",
        "locations, millions",
        "per location, µs",
    ]
    rows = [
        [
            cost.workload.name,
            *(spread(timing.cpu) for timing in (cost.hierarchy, cost.views, cost.whole, cost.denoiser)),
            f"{cost.locations / 1e6:.1f}",
            f"{cost.microseconds:.3f}",
        ]
        for cost in costs
    ]
    return markdown_table(head, rows)


def _memory_table(costs: Sequence[Cost]) -> str:
    rows = []
    for cost in costs:
        buffer, tree = cost.bytes_per_sample
        rows.append(
            [cost.workload.name, f"{buffer:.1f}", f"{tree:.1f}", f"{buffer + tree:.1f}", f"{cost.peak:.0f}"]
        )
    return markdown_table(["", "buffer", "hierarchy", "together", "peak, MiB"], rows)


def verdict(costs: Sequence[Cost]) -> str:
    """Say where the targets of time and memory are met."""
    slow = [f"{c.workload.name} ({c.microseconds:.2f})" for c in costs if c.microseconds > TIME_TARGET]
    judged_slow = any(c.workload.judged and c.microseconds > TIME_TARGET for c in costs)
    large = [
        f"{c.workload.name} ({sum(c.bytes_per_sample):.0f})"
        for c in costs
        if sum(c.bytes_per_sample) > MEMORY_TARGET
    ]
    judged = ", ".join(c.workload.name for c in costs if c.workload.judged)
    return "\n".join(
        [
            f"- Target: at most {TIME_TARGET:g} µs of CPU per location on {judged}. {met(not judged_slow)}; "
            f"above it: {', '.join(slow) or 'none'}.",
            f"- Target: at most {MEMORY_TARGET:g} bytes per sample, buffer and hierarchy together. "
            f"{met(not large)} on {', '.join(large) or 'every workload'}.",
        ]
    )
