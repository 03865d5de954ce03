"""CPU seconds and memory of every method, beside Open Image Denoise in the same run.

    python benchmarks/speed.py

Needs ``fewrays[bench]`` on Linux or macOS. Writes ``docs/speed.md``. The main workload needs no renderer; the
example scenes join when ``examples/render.py`` has made them. All contenders take turns, so that whatever
else the machine does meets all of them alike.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import blur_radius
import fewrays
import memory_growth
from contenders import BEST, BEST_OPTIONS, OURS, PLAIN
from example_renders import SCENES, samples_file
from fewrays.method import Image
from fewrays.parallel import usable_cores
from memory import extra_memory
from peers import DENOISER, denoise_filter, require_bench
from report import ROOT, markdown_table, met, provenance, write_page
from timing import Timing, spread, time_in_turns
from workloads import count_layers, leaf_planes

WIDTH, HEIGHT, SPP = 1280, 720, 8
LEAVES = "planes of leaves"
TARGETS = {LEAVES: 0.25, "foliage": 0.5}
"""CPU seconds of the headline method over the denoiser's that it shall not exceed, by workload."""
LARGE = "720p"  # folder in that of the renders, for examples of 1280 x 720 pixels


@dataclass(frozen=True)
class Workload:
    """What is reconstructed.

    Parameters
    ----------
    name : str
        For headings.
    samples : SampleBuffer
        What the methods are given.
    box_image : ndarray, (H, W, 3)
        Their average, for the denoiser.
    layers : float
        Mean number of depth layers around a pixel.
    target : float, optional
        CPU seconds of the headline method over the denoiser's that it shall not exceed.
    """

    name: str
    samples: fewrays.SampleBuffer
    box_image: Image
    layers: float
    target: float | None


@dataclass(frozen=True)
class Contender:
    """What is timed: `prepare` sets it up for a workload and threads, and returns the call to be timed."""

    name: str
    prepare: Callable[[Workload, int | None], Callable[[], object]]


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
    large = {scene: path for scene, path in rendered(options.renders).items() if path.parent.name == LARGE}
    sizes = memory_growth.SIZES[: options.sizes]
    peaks = [memory_growth.measure_memory(*each) for each in memory_growth.workloads(sizes, large)]
    workloads = list(make_workloads(options.renders))
    measured = [(workload, measure(workload, options.repetitions)) for workload in workloads]
    grown = [
        growth
        for workload in scalable_workloads(options.renders)
        for growth in blur_radius.measure_growth(workload, options.repetitions)
    ]
    write_page(
        options.out / "speed.md",
        *introduction(options.repetitions),
        provenance(f"python benchmarks/speed.py --repetitions {options.repetitions}"),
        *(section(workload, results) for workload, results in measured),
        *blur_radius.section(grown),
        *memory_growth.section(peaks, usable_cores()),
    )
    print(options.out / "speed.md")


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--renders", type=Path, default=ROOT / "examples" / "renders")
    parser.add_argument("--repetitions", type=int, default=7, help="timed calls of each contender (7)")
    parser.add_argument(
        "--sizes",
        type=int,
        default=len(memory_growth.SIZES),
        help="image sizes for memory, of 720p, 4K and 8K",
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for the page (docs)")
    options = parser.parse_args()
    if options.repetitions < 1:
        parser.error(f"--repetitions must be at least 1, got {options.repetitions}")
    if not 1 <= options.sizes <= len(memory_growth.SIZES):
        parser.error(f"--sizes must be from 1 to {len(memory_growth.SIZES)}, got {options.sizes}")
    return options


def contenders() -> list[Contender]:
    """Return the denoiser, every method, and ours with the options for quality."""
    denoiser = Contender(DENOISER, lambda work, threads: denoise_filter(work.box_image, threads))
    methods = [Contender(name, prepare_method(name)) for name in fewrays.METHODS]
    return [denoiser, methods[0], Contender(BEST, prepare_method(OURS, **BEST_OPTIONS)), *methods[1:]]


def prepare_method(name: str, **options: Any) -> Callable[[Workload, int | None], Callable[[], object]]:
    """Return the `prepare` of a method with some options, the others by default."""

    def prepare(work: Workload, threads: int | None) -> Callable[[], object]:
        return lambda: fewrays.reconstruct(work.samples, name, threads=threads, **options)

    return prepare


def make_workloads(renders: Path) -> Iterator[Workload]:
    """Yield the workloads: planes of leaves, and the example scenes that have been rendered."""
    yield workload(LEAVES.capitalize(), leaf_planes(HEIGHT, WIDTH, SPP), TARGETS[LEAVES])
    for scene, path in rendered(renders).items():
        yield workload(f"Example scene {scene}", fewrays.load(path), TARGETS.get(scene))


def scalable_workloads(renders: Path) -> Iterator[blur_radius.Scalable]:
    """Yield the same workloads for any factor on their slopes."""
    leaves = partial(leaf_planes, HEIGHT, WIDTH, SPP)
    yield blur_radius.Scalable(LEAVES, lambda factor: leaves(aperture_scale=factor))
    for scene, path in rendered(renders).items():
        samples = fewrays.load(path)
        yield blur_radius.Scalable(scene, partial(refocused, samples))


def refocused(samples: fewrays.SampleBuffer, factor: int) -> fewrays.SampleBuffer:
    """Return samples with all slopes times a factor, and every ray where it is."""
    return replace(samples, lens=samples.lens.refocus(aperture_scale=factor))


def rendered(renders: Path) -> dict[str, Path]:
    """Return the example scenes that have been rendered: the large version of a scene if there is one."""
    found = {}
    for scene in SCENES:
        for folder in (renders / LARGE, renders):
            path = samples_file(folder, scene, "square", SPP)
            if path.exists():
                found[scene] = path
                break
    return found


def workload(name: str, samples: fewrays.SampleBuffer, target: float | None) -> Workload:
    """Count the samples' layers, and average them for the denoiser."""
    print(f"{name}: preparing", file=sys.stderr)
    return Workload(name, samples, fewrays.reconstruct(samples, PLAIN), count_layers(samples), target)


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
        "peak, beyond the samples, output and set-up included. *Active layers* are counted as the first "
        "version of the layered method did, whatever the methods do now."
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


def verdict(work: Workload, results: Sequence[Result]) -> Iterator[str]:
    """Say whether the target is met, on a workload that has one."""
    if work.target is None:
        return
    seconds = {result.contender: result for result in results}
    peer = seconds[DENOISER].one.cpu_median
    one, best = seconds[OURS].one.cpu_median / peer, seconds[BEST].one.cpu_median / peer
    options = ", ".join(f"`{name}={value}`" for name, value in BEST_OPTIONS.items())
    text = (
        f"Target: `{OURS}` takes at most {work.target:g} times the CPU seconds of {DENOISER} on one core. "
        f"{met(one <= work.target)}: {one:.2f} times; with {options} {best:.2f} times."
    )
    if (work.samples.width, work.samples.height) != (WIDTH, HEIGHT):
        text += (
            f" The target is stated for {WIDTH} x {HEIGHT} pixels; the samples of that size are missing. "
            f"`{how_to_render_large('foliage')}` makes them."
        )
    yield text


def how_to_render_large(scene: str) -> str:
    """Return the command that renders a scene at the size that the targets are stated for."""
    return (
        f"python examples/render.py {scene} --width {WIDTH} --height {HEIGHT} --sampling square "
        f"--reference-spp 0 --out examples/renders/{LARGE}"
    )


if __name__ == "__main__":
    main()
