"""CPU seconds and memory of every method, beside Open Image Denoise in the same run.

    python benchmarks/speed.py

Needs ``fewrays[bench]`` on Linux or macOS. Writes ``docs/speed.md``. The main workload needs no renderer; the
example scenes join when ``examples/render.py`` has made them. All contenders take turns, so that whatever
else the machine does meets all of them alike.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from example_renders import SCENES
from fewrays.method import Image
from fewrays.parallel import usable_cores
from memory import extra_memory
from peers import DENOISER, denoise_filter, require_bench
from report import ROOT, markdown_table, provenance, write_page
from workloads import leaf_planes

OURS, PLAIN = "layered", "box"
WIDTH, HEIGHT, SPP = 1280, 720, 8
LAYERS, LAYERS_TOLERANCE = 5.0, 0.5
"""The average number of active layers that the target is stated for."""
TARGET = 1.0
"""CPU seconds of the headline method over the denoiser's that it shall not exceed."""


@dataclass(frozen=True)
class Workload:
    """Samples, their box image ``(H, W, 3)`` for the denoiser, and their mean number of active layers."""

    name: str
    samples: fewrays.SampleBuffer
    box_image: Image
    layers: float


@dataclass(frozen=True)
class Contender:
    """What is timed: `prepare` sets it up for a workload and threads, and returns the call to be timed."""

    name: str
    prepare: Callable[[Workload, int | None], Callable[[], object]]


@dataclass(frozen=True)
class Timing:
    """Seconds of one contender's calls, in the order in which they were made."""

    cpu: list[float]
    wall: list[float]

    @property
    def cpu_median(self) -> float:
        """Median of the CPU seconds, over all threads."""
        return statistics.median(self.cpu)

    @property
    def wall_median(self) -> float:
        """Median of the seconds that passed."""
        return statistics.median(self.wall)


@dataclass(frozen=True)
class Result:
    """A contender's timings with one thread and with all, and the memory that it takes on top, in MiB."""

    contender: str
    one: Timing
    all: Timing
    memory: float


def main() -> None:
    """Measure, and write the page."""
    options = parse_options()
    require_bench()
    workloads = list(make_workloads(options.renders))
    measured = [(workload, measure(workload, options.repetitions)) for workload in workloads]
    write_page(
        options.out / "speed.md",
        *introduction(options.repetitions),
        provenance(f"python benchmarks/speed.py --repetitions {options.repetitions}"),
        *(section(workload, results) for workload, results in measured),
    )
    print(options.out / "speed.md")


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--renders", type=Path, default=ROOT / "examples" / "renders")
    parser.add_argument("--repetitions", type=int, default=7, help="timed calls of each contender (7)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for the page (docs)")
    options = parser.parse_args()
    if options.repetitions < 1:
        parser.error(f"--repetitions must be at least 1, got {options.repetitions}")
    return options


def contenders() -> list[Contender]:
    """Return the denoiser and every method."""
    denoiser = Contender(DENOISER, lambda work, threads: denoise_filter(work.box_image, threads))
    return [denoiser, *(Contender(name, prepare_method(name)) for name in fewrays.METHODS)]


def prepare_method(name: str) -> Callable[[Workload, int | None], Callable[[], object]]:
    """Return the `prepare` of a method with its default options."""

    def prepare(work: Workload, threads: int | None) -> Callable[[], object]:
        return lambda: fewrays.reconstruct(work.samples, name, threads=threads)

    return prepare


def make_workloads(renders: Path) -> Iterator[Workload]:
    """Yield the workloads: planes of leaves, and the example scenes that have been rendered."""
    yield workload("Planes of leaves", leaf_planes(HEIGHT, WIDTH, SPP))
    for scene in SCENES:
        path = renders / f"{scene}_square_{SPP}spp.npz"
        if path.exists():
            yield workload(f"Example scene {scene}", fewrays.load(path))


def workload(name: str, samples: fewrays.SampleBuffer) -> Workload:
    """Measure the samples' layers, and average them for the denoiser."""
    print(f"{name}: preparing", file=sys.stderr)
    _, aovs = fewrays.reconstruct(samples, OURS, aovs=True)
    return Workload(name, samples, fewrays.reconstruct(samples, PLAIN), float(aovs["layer_count"].mean()))


def measure(work: Workload, repetitions: int) -> list[Result]:
    """Measure all contenders: memory first, while this process has no threads; then time, in turns."""
    print(f"{work.name}: measuring", file=sys.stderr)
    entrants = contenders()
    memory = [memory_of(contender, work) for contender in entrants]
    calls = [contender.prepare(work, threads) for contender in entrants for threads in (1, None)]
    timings = iter(time_in_turns(calls, repetitions))
    return [
        Result(contender.name, next(timings), next(timings), extra)
        for contender, extra in zip(entrants, memory, strict=True)
    ]


def memory_of(contender: Contender, work: Workload) -> float:
    """Return the MiB that setting a contender up and calling it once adds to the process at its peak."""
    return extra_memory(lambda: contender.prepare(work, None)())


def time_in_turns(calls: Sequence[Callable[[], object]], repetitions: int) -> list[Timing]:
    """Time calls, one after the other, `repetitions` times over, after one round that does not count."""
    timings = [Timing([], []) for _ in calls]
    for number in range(repetitions + 1):
        for call, timing in zip(calls, timings, strict=True):
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            if number > 0:
                timing.cpu.append(time.process_time() - cpu)
                timing.wall.append(time.perf_counter() - wall)
    return timings


def introduction(repetitions: int) -> Iterator[str]:
    """Say what was measured, and how."""
    yield "# Speed"
    yield (
        f"CPU seconds, summed over all threads, of every method with its default options, and of {DENOISER} "
        "at high quality in HDR mode on the box image of the same samples. Made by a benchmark, not by hand."
    )
    yield (
        f"All contenders take turns in one process: one round to warm up, then {repetitions} that count; "
        f"the figures are medians, in brackets the range. {DENOISER}'s set-up (device, weights) and the box "
        "image that it starts from are not counted. The ratio is of the medians with one thread. *Elapsed* "
        "depends on what else the machine does. *Memory* is what the first call adds to the process at its "
        "peak, beyond the samples, output and set-up included."
    )


def section(work: Workload, results: Sequence[Result]) -> str:
    """Return a workload's part of the page."""
    peer = next(r for r in results if r.contender == DENOISER)
    cores = usable_cores()
    head = [
        "", "CPU s, 1 thread", f"ratio to {DENOISER}",
        f"CPU s, {cores} threads", f"elapsed s, {cores} threads", "memory, MiB",
    ]  # fmt: skip
    rows = [
        [
            result.contender,
            spread(result.one.cpu),
            f"{result.one.cpu_median / peer.one.cpu_median:.2f}",
            spread(result.all.cpu),
            f"{result.all.wall_median:.2f}",
            f"{result.memory:.0f}",
        ]
        for result in results
    ]
    samples = work.samples
    size = f"{samples.width} x {samples.height} pixels, {samples.spp} samples per pixel"
    return "\n\n".join(
        [
            f"## {work.name}",
            f"{size} ({samples.nbytes / 2**20:.0f} MiB), {work.layers:.2f} active layers on average.",
            markdown_table(head, rows),
            *verdict(work, results),
        ]
    )


def spread(seconds: Sequence[float]) -> str:
    """Return median and range."""
    return f"{statistics.median(seconds):.3f} ({min(seconds):.3f} to {max(seconds):.3f})"


def verdict(work: Workload, results: Sequence[Result]) -> Iterator[str]:
    """Say whether the target is met, on a workload of the size that it is stated for."""
    if (work.samples.width, work.samples.height, work.samples.spp) != (WIDTH, HEIGHT, SPP):
        return
    if abs(work.layers - LAYERS) > LAYERS_TOLERANCE:
        yield f"Not judged: the target is stated for {LAYERS:g} ± {LAYERS_TOLERANCE:g} active layers."
        return
    seconds = {result.contender: result for result in results}
    ours, peer = seconds[OURS], seconds[DENOISER]
    one, all_threads = ours.one.cpu_median / peer.one.cpu_median, ours.all.cpu_median / peer.all.cpu_median
    met = "**Met**" if max(one, all_threads) <= TARGET else "**Missed**"
    yield (
        f"Target, at about {LAYERS:g} active layers: `{OURS}` takes no more CPU seconds than {DENOISER}. "
        f"{met}: {one:.2f} times as much with one thread each, {all_threads:.2f} times with all threads."
    )


if __name__ == "__main__":
    main()
