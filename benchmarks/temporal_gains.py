"""What each part of the temporal method contributes: one option changed at a time."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import fewrays
from disc_scenes import DiscScene
from fewrays.temporal import plan
from report import markdown_table
from scores import Score, score

__all__ = ["VARIANTS", "Variant", "measure_gains", "section"]


@dataclass(frozen=True)
class Variant:
    """A way to run the method: its options, or without the overhang of surfaces, for which there is none."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    overhang: bool = True

    def scored(self, scene: DiscScene) -> Score:
        """Reconstruct a scene and compare it with its reference."""
        changed: AbstractContextManager[object] = nullcontext()
        if not self.overhang:
            changed = patch.object(plan, "_OVERHANG", 0.0)
        with changed:
            image = fewrays.reconstruct(scene.samples, "temporal", **self.options)
        return score(image, scene.references["box"])


VARIANTS = (
    Variant("as it is"),
    Variant("no smoothing", {"smoothing": 0.0}),
    Variant("no correction", {"correction": 0.0}),
    Variant("neither: the paper's mean", {"smoothing": 0.0, "correction": 0.0}),
    Variant("no overhang", overhang=False),
    Variant("R as measured, factor 1", {"radius_scale": 1.0}),
    Variant("R, factor 1.35", {"radius_scale": 1.35}),
    Variant("R, factor 2.2", {"radius_scale": 2.2}),
    Variant("tent of 0.7 R", {"tent_scale": 0.7}),
    Variant("tent of 1.4 R", {"tent_scale": 1.4}),
    Variant("nearest sample", {"tent_scale": 0.0}),
)
"""The first is the method as it is."""


def measure_gains(scenes: Sequence[DiscScene], variants: Sequence[Variant]) -> dict[str, list[Score]]:
    """Return every variant's scores by its name, one for each scene."""
    measured: dict[str, list[Score]] = {}
    for variant in variants:
        print(f"temporal, {variant.name}", file=sys.stderr)
        measured[variant.name] = [variant.scored(scene) for scene in scenes]
    return measured


def section(scenes: Sequence[DiscScene], measured: Mapping[str, Sequence[Score]]) -> Iterator[str]:
    """Return the page's part on what the method is made of."""
    yield "## What each part gains"
    yield (
        "One thing changed at a time: PSNR in dB with the reference's noise taken out, and the difference "
        "from the method as it is, 128 locations. The parts are those that `docs/temporal.md` explains."
    )
    base, *others = measured.items()
    rows = [[base[0], *(f"{each.corrected:.2f}" for each in base[1])]]
    for name, scores in others:
        cells = [
            f"{one.corrected:.2f} ({one.corrected - at_best.corrected:+.2f})"
            for one, at_best in zip(scores, base[1], strict=True)
        ]
        rows.append([name, *cells])
    yield markdown_table(["", *(scene.label for scene in scenes)], rows)
