"""What each option of the multiplane method does to quality and time: one changed at a time."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import fewrays
from disc_scenes import DiscScene
from fewrays.multiplane import BuildOptions, MultiplaneOptions
from report import markdown_table
from scores import Score, score

__all__ = ["VALUES", "Variant", "measure_variants", "section", "variants"]

VALUES: Mapping[str, Sequence[Any]] = {
    "thickness": (0.25, 0.5, 0.7, 1.0, 2.0),
    "linear_to": (2.0, 4.0, 8.0, 16.0, 32.0),
    "cells": (1, 2, 3),
    "fine_to": (0.0, 0.7, 1.4, 4.0),
    "memory": (0.0, 25.0, 50.0),
    "prior": (0.03, 0.1, 0.3, 1.0, 3.0),
    "along_edges": (0.0, 1.0, 4.0, 8.0),
    "smoothing": (0.0, 0.16, 0.24, 0.4, 0.64),
    "motion_cell": (0.75, 1.5, 3.0, 6.0),
    "views": (16, 32, 64, 128, 256, 512),
}
"""Values to try, by option; that of the method as it is may be among them."""


@dataclass(frozen=True)
class Variant:
    """An option's value, the scores of all scenes, and mean CPU seconds to build and to render."""

    option: str
    value: Any
    scores: Sequence[Score]
    build: float
    render: float


def variants(scenes: Sequence[DiscScene], values: Mapping[str, Sequence[Any]]) -> list[Variant]:
    """Measure the method as it is, and then with every value that differs from it."""
    default = MultiplaneOptions()
    measured = [_measure(scenes, "as it is", "")]
    for option, tried in values.items():
        measured += [_measure(scenes, option, value) for value in tried if value != getattr(default, option)]
    return measured


def measure_variants(scenes: Sequence[DiscScene]) -> list[Variant]:
    """Measure `VALUES`."""
    return variants(scenes, VALUES)


def _measure(scenes: Sequence[DiscScene], option: str, value: Any) -> Variant:
    print(f"multiplane, {option} {value}", file=sys.stderr)
    changed = {} if option == "as it is" else {option: value}
    of_build = {field.name for field in dataclasses.fields(BuildOptions)}
    building = {name: value for name, value in changed.items() if name in of_build}
    rendering = {name: value for name, value in changed.items() if name not in of_build}
    scores, build, render = [], 0.0, 0.0
    for scene in scenes:
        start = time.process_time()
        planes = fewrays.Multiplane.build(scene.samples, threads=1, **building)
        built = time.process_time()
        image = planes.render(threads=1, **rendering)
        render += (time.process_time() - built) / len(scenes)
        build += (built - start) / len(scenes)
        scores.append(score(image, scene.references["box"]))
    return Variant(option, value, scores, build, render)


def section(scenes: Sequence[DiscScene], measured: Sequence[Variant]) -> Iterator[str]:
    """Return the page's part on options."""
    base, *others = measured
    yield "## What each option does"
    yield (
        "One option changed at a time: PSNR in dB with the reference's noise taken out and the difference "
        "from the method as it is, and CPU seconds on one thread, means of the scenes in single calls. "
        "[multiplane.md](multiplane.md#options) says what the options are."
    )
    rows = [["as it is", *(f"{each.corrected:.2f}" for each in base.scores), *_seconds(base)]]
    for variant in others:
        cells = [
            f"{one.corrected:.2f} ({one.corrected - own.corrected:+.2f})"
            for one, own in zip(variant.scores, base.scores, strict=True)
        ]
        rows.append([f"{variant.option} {variant.value:g}", *cells, *_seconds(variant)])
    defaults = MultiplaneOptions()
    options = dict.fromkeys(variant.option for variant in others)
    yield "As it is: " + ", ".join(f"`{name}` {getattr(defaults, name):g}" for name in options) + "."
    yield markdown_table(["", *(scene.label for scene in scenes), "build, s", "render, s"], rows)


def _seconds(variant: Variant) -> list[str]:
    return [f"{variant.build:.2f}", f"{variant.render:.2f}"]
