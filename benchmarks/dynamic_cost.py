"""What depth of field from one picture costs: preparation, warping and synthesis, by views (Table 1)."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynamic_scenes import VIEWS, PinholeScene
from fewrays.dynamic import DefocusOptions, DepthLayer, kernel, make_light_field
from fewrays.lens import Lens
from fewrays.parallel import Execution
from fewrays.sources.analytic_pinhole import pinhole
from report import markdown_table, met
from workloads import LEAF_LENS, leaf_stack

__all__ = ["SIZE", "Cost", "Workload", "enlarged", "leaves", "measure_cost", "section", "verdict"]

SIZE = (720, 1280)
TARGET = 25.0
"""Nanoseconds of one core per pixel and view."""
_LINEAR = 1.1  # times that a view may cost among many of what it costs among few


@dataclass(frozen=True)
class Workload:
    """Layers ``(H, W)`` seen through a lens."""

    name: str
    layers: Sequence[DepthLayer]
    lens: Lens


@dataclass(frozen=True)
class Cost:
    """CPU seconds on one thread, medians, of one workload at one number of views."""

    workload: Workload
    views: int
    preparation: float
    warping: float
    synthesis: float

    @property
    def nanoseconds(self) -> float:
        """Of the views, per pixel and view."""
        return (self.warping + self.synthesis) / self.workload.layers[0].depth.size / self.views * 1e9


def leaves(height: int, width: int) -> Workload:
    """Return planes of scattered leaves before and behind the focal plane, and a wall."""
    lens = Lens(LEAF_LENS.c0, LEAF_LENS.c1)
    layer = pinhole(leaf_stack(height, width), lens, height, width, spp=4)
    return Workload("planes of leaves", [layer], lens)


def enlarged(scene: PinholeScene, factor: int, *, both: bool = False) -> Workload:
    """Return a scene with every pixel repeated, and blurred by as many more pixels."""
    layers = [scene.front, scene.behind] if both else [scene.front]
    lens = Lens(factor * scene.lens.c0, factor * scene.lens.c1)
    name = scene.name + (", two layers" if both else "")
    return Workload(name, [_repeated(layer, factor) for layer in layers], lens)


def _repeated(layer: DepthLayer, factor: int) -> DepthLayer:
    color, depth = (a.repeat(factor, axis=0).repeat(factor, axis=1) for a in (layer.color, layer.depth))
    alpha = None if layer.alpha is None else layer.alpha.repeat(factor, axis=0).repeat(factor, axis=1)
    return DepthLayer(color, depth, alpha)


def measure_cost(workload: Workload, repetitions: int) -> list[Cost]:
    """Time one thread at every number of views in turn, after one round that does not count."""
    taken: dict[int, list[tuple[float, float, float]]] = {views: [] for views in VIEWS}
    for number in range(repetitions + 1):
        for views, rounds in taken.items():
            seconds = _once(workload, views)
            if number > 0:
                rounds.append(seconds)
    return [
        Cost(workload, views, *(statistics.median(each) for each in zip(*rounds, strict=True)))
        for views, rounds in taken.items()
    ]


def _once(workload: Workload, views: int) -> tuple[float, float, float]:
    execution = Execution(threads=1)
    start = time.process_time()
    field = make_light_field(workload.layers, workload.lens, DefocusOptions(views=views), execution)
    sums = np.zeros((field.height, field.width, 5), np.float32)
    stages = kernel.synthesize(field, sums, execution)
    whole = time.process_time() - start
    return whole - stages.warping - stages.synthesis, stages.warping, stages.synthesis


def section(costs: Sequence[Sequence[Cost]], repetitions: int) -> Iterator[str]:
    """Write the page's part."""
    height, width = costs[0][0].workload.layers[0].depth.shape
    yield "## Time"
    yield (
        f"CPU seconds on one thread at {width} x {height}, medians of {repetitions} rounds, as in the "
        "paper's Table 1: *preparation* does not depend on the number of views (edges, what lies behind "
        "them, blur between views), *warping* finds out what every view sees, *synthesis* looks it up and "
        "blends. The rendered scenes are those of the other tables with every pixel repeated, and blurred by "
        "twice as many pixels."
    )
    head = ["", "views", "preparation, s", "warping, s", "synthesis, s", "ns per pixel and view"]
    rows = [
        [
            cost.workload.name,
            str(cost.views),
            f"{cost.preparation:.3f}",
            f"{cost.warping:.3f}",
            f"{cost.synthesis:.3f}",
            f"{cost.nanoseconds:.1f}",
        ]
        for by_views in costs
        for cost in by_views
    ]
    yield markdown_table(head, rows)
    yield verdict(costs)


def verdict(costs: Sequence[Sequence[Cost]]) -> str:
    """Say whether the targets are met."""
    lines = []
    for by_views in costs:
        name, most = by_views[0].workload.name, max(cost.nanoseconds for cost in by_views)
        growth = by_views[-1].nanoseconds / by_views[0].nanoseconds
        lines.append(
            f"- {name}: at most {TARGET:g} ns of one core per pixel and view. {met(most <= TARGET)}: "
            f"{most:.1f} at most. Cost linear in views. {met(growth <= _LINEAR)}: a view costs "
            f"{growth:.2f} times as much among {by_views[-1].views} as among {by_views[0].views}."
        )
    return "\n".join(lines)
