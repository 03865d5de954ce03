"""What light and shadow cost beyond the camera's reconstruction: CPU seconds on one thread."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import fewrays
from lit_scenes import LitScene
from report import markdown_table, met
from timing import Timing, spread, time_in_turns

__all__ = ["Cost", "measure_cost", "section"]

TARGET = 3.0
"""CPU time of camera and light together, in units of the camera's alone."""

_CAMERA = "temporal, noisy shadows"
_SHADE = "shading the samples"
_PUBLISHED = "temporal, light at locations"
_BOTH = "shading the samples, then temporal"
_LOCATIONS = 128


@dataclass(frozen=True)
class Cost:
    """Timings of a variant by what was done, and its width and height."""

    label: str
    timings: dict[str, Timing]
    width: int
    height: int

    @property
    def locations(self) -> int:
        """How many an image has."""
        return self.width * self.height * _LOCATIONS


def measure_cost(scene: LitScene, repetitions: int) -> Cost:
    """Time the camera's reconstruction alone, shading, and light at locations, in turns."""
    print(f"cost: {scene.label}", file=sys.stderr)
    samples = scene.samples
    calls: dict[str, Callable[[], object]] = {
        _CAMERA: lambda: fewrays.reconstruct(samples, "temporal", shadows=False, threads=1),
        _SHADE: lambda: fewrays.shade(samples, threads=1),
        _PUBLISHED: lambda: fewrays.reconstruct(samples, "temporal", light_at="locations", threads=1),
    }
    timings = dict(zip(calls, time_in_turns(list(calls.values()), repetitions), strict=True))
    return Cost(scene.label, timings, samples.width, samples.height)


def section(cost: Cost, repetitions: int) -> Iterator[str]:
    """Return the page's part on time."""
    camera, shade, published = (cost.timings[name].cpu_median for name in (_CAMERA, _SHADE, _PUBLISHED))
    yield "## Time"
    yield (
        f"CPU seconds on one thread for *{cost.label}*, {cost.width} x {cost.height} pixels, {_LOCATIONS} "
        "locations and as many light points per pixel, one lamp: median and range over rounds in which all "
        f"take turns ({repetitions}; loaded machine: others ran on it). Microseconds are for each location."
    )
    rows = [
        [name, spread(timing.cpu), _micro(timing.cpu_median, cost), f"{timing.cpu_median / camera:.2f}"]
        for name, timing in cost.timings.items()
    ]
    both = camera + shade
    rows.append([_BOTH, f"{both:.3f}", _micro(both, cost), f"{both / camera:.2f}"])
    yield markdown_table(["", "CPU, s", "µs", "of the camera's alone"], rows)
    for name, seconds in ((_BOTH, both), (_PUBLISHED, published)):
        yield (
            f"Target: camera and light in {TARGET:g} times the time of the camera alone, {name}. "
            f"{met(seconds <= TARGET * camera)}: {seconds / camera:.2f} times."
        )


def _micro(seconds: float, cost: Cost) -> str:
    return f"{1e6 * seconds / cost.locations:.2f}"
