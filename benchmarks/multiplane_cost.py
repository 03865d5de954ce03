"""What planes cost: CPU seconds to build and to look at, beside other methods, and with any blur radius."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from peers import DENOISER, denoise_filter
from report import markdown_table, met
from timing import Timing, spread, time_in_turns

__all__ = ["FACTORS", "Blur", "Cost", "measure_blur", "measure_cost", "section"]

BUILD = "multiplane, build"
TARGETS = {BUILD: 1.0, "multiplane, 128 views": 0.6, "multiplane, 32 views": 0.2}
"""CPU seconds on one thread, foliage at 8 samples per pixel."""
FACTORS = (1, 4, 16)
GROWTH_TARGET = 1.5
"""CPU time per view with all slopes times the largest factor, over that with the slopes as they are."""
_VIEWS = (128, 32)
_MIB = 2**20


@dataclass(frozen=True)
class Cost:
    """What samples take on one thread.

    Parameters
    ----------
    name : str
        Of the samples.
    timings : dict of str to Timing
        By what was done.
    plane_count : int
    bytes_per_pixel : float
        Of the planes in memory.
    file_bytes_per_pixel : float
        Of the file that holds them.
    """

    name: str
    timings: dict[str, Timing]
    plane_count: int
    bytes_per_pixel: float
    file_bytes_per_pixel: float


@dataclass(frozen=True)
class Blur:
    """Timings of 128 views with all slopes times a factor: of the same planes, and of planes built anew."""

    factor: int
    same_planes: Timing
    anew: Timing
    build: Timing
    bytes_per_pixel: float


def measure_cost(name: str, samples: fewrays.SampleBuffer, repetitions: int) -> Cost:
    """Time planes and everyone else in turns, on one thread."""
    print(f"cost: {name}", file=sys.stderr)
    planes = fewrays.Multiplane.build(samples)
    calls: dict[str, Callable[[], object]] = {BUILD: lambda: fewrays.Multiplane.build(samples, threads=1)}
    for views in _VIEWS:
        calls[f"multiplane, {views} views"] = _render(planes, planes.lens, views)
    for method in ("layered", "temporal"):
        calls[method] = _reconstruct(samples, method)
    calls[DENOISER] = denoise_filter(fewrays.reconstruct(samples, "box"), 1)
    timings = dict(zip(calls, time_in_turns(list(calls.values()), repetitions), strict=True))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kept.planes"
        planes.save(path)
        size = path.stat().st_size
    pixels = planes.width * planes.height
    return Cost(name, timings, planes.maps.plane_count, planes.nbytes / pixels, size / pixels)


def _reconstruct(samples: fewrays.SampleBuffer, method: str) -> Callable[[], object]:
    return lambda: fewrays.reconstruct(samples, method, threads=1)


def _render(planes: fewrays.Multiplane, lens: fewrays.Lens, views: int) -> Callable[[], object]:
    return lambda: planes.render(lens, views=views, threads=1)


def measure_blur(samples: fewrays.SampleBuffer, repetitions: int) -> list[Blur]:
    """Time views of planes, and of samples, whose slopes have been multiplied."""
    print(f"cost: slopes times {FACTORS}", file=sys.stderr)
    own = fewrays.Multiplane.build(samples)
    wide = [samples.refocus(aperture_scale=factor) for factor in FACTORS]
    anew = [fewrays.Multiplane.build(each) for each in wide]
    calls = [_render(own, each.lens, _VIEWS[0]) for each in wide]
    calls += [_render(planes, planes.lens, _VIEWS[0]) for planes in anew]
    calls += [_build(each) for each in wide]
    timings = time_in_turns(calls, repetitions)
    count, pixels = len(FACTORS), samples.width * samples.height
    by_call = timings[:count], timings[count : 2 * count], timings[2 * count :]
    sizes = [planes.nbytes / pixels for planes in anew]
    return [Blur(*each) for each in zip(FACTORS, *by_call, sizes, strict=True)]


def _build(samples: fewrays.SampleBuffer) -> Callable[[], object]:
    return lambda: fewrays.Multiplane.build(samples, threads=1)


def section(cost: Cost, blurs: Sequence[Blur], repetitions: int) -> Iterator[str]:
    """Return the page's part on time."""
    yield "## Time"
    yield (
        f"CPU seconds on one thread for {cost.name}, 640 x 360 pixels, medians of {repetitions} rounds in "
        "which everyone takes turns (in brackets the range). Planes are built once and rendered for every "
        f"image; the others do all of their work for every image. {DENOISER} runs on the plain average."
    )
    yield markdown_table(
        ["", "CPU, s"], [[name, spread(timing.cpu)] for name, timing in cost.timings.items()]
    )
    yield (
        f"There are {cost.plane_count} planes; they take {cost.bytes_per_pixel:.0f} bytes per pixel, and "
        f"{cost.file_bytes_per_pixel:.0f} in a file. The samples take "
        "32 bytes each."
    )
    yield "\n".join(
        f"- Target: {name} in at most {target:g} s. "
        f"{met(cost.timings[name].cpu_median <= target)}: {cost.timings[name].cpu_median:.2f} s."
        for name, target in TARGETS.items()
    )
    yield "## Any blur radius"
    yield (
        "The same with all slopes, hence all circles of confusion, so many times as large: the planes as "
        "they are, looked at through a larger lens; and planes built anew of samples that are taken to come "
        "through the larger lens, which makes no picture but shows what large blur costs. CPU milliseconds "
        "per view, and seconds to build."
    )
    head = ["slopes", "same planes, ms/view", "built anew, ms/view", "building, s", "bytes per pixel"]
    rows = [
        [
            f"x {b.factor}",
            f"{1e3 * b.same_planes.cpu_median / _VIEWS[0]:.2f}",
            f"{1e3 * b.anew.cpu_median / _VIEWS[0]:.2f}",
            spread(b.build.cpu),
            f"{b.bytes_per_pixel:.0f}",
        ]
        for b in blurs
    ]
    yield markdown_table(head, rows)
    ratios = [
        blurs[-1].same_planes.cpu_median / blurs[0].same_planes.cpu_median,
        blurs[-1].anew.cpu_median / blurs[0].anew.cpu_median,
    ]
    yield (
        f"Target: with slopes times {FACTORS[-1]} a view takes at most {GROWTH_TARGET:g} times as long. "
        f"{met(max(ratios) <= GROWTH_TARGET)}: {ratios[0]:.2f} times for the same planes, "
        f"{ratios[1]:.2f} for those built anew."
    )
