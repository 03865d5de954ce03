"""Depth of field from one picture with depth, against references: by views, and what each part gains.

This is what the paper's Figures 8 to 10 show, in numbers, with its two rivals: blur of the image by the
circle of confusion, and the accumulation of as many pinhole renders as there are views.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dynamic_scenes import VIEWS, PinholeScene
from fewrays.baselines.gather import gather_blur
from fewrays.dynamic import DepthLayer, defocus
from fewrays.method import Image
from fewrays.metrics import flip, psnr_display
from report import markdown_table

__all__ = [
    "PUBLISHED",
    "SHOWN",
    "VARIANTS",
    "Quality",
    "gains_section",
    "give_depth_of_field",
    "measure_gains",
    "measure_views",
    "views_section",
]

PUBLISHED: dict[str, Any] = {
    "lens_points": "halton",
    "prefilter": "mipmap",
    "fill_reach": 0,
    "split_edges": False,
    "growth": 1,
}
"""The method as the paper has it."""

VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "edges not taken apart": {"split_edges": False},
    "nothing carried on behind edges": {"fill_reach": 0},
    "the paper's mip pyramid": {"prefilter": "mipmap"},
    "no blur between the views": {"prefilter": "none"},
    "Halton points": {"lens_points": "halton"},
    "as published": PUBLISHED,
}

SHOWN = 36
"""Views in pictures and comparisons: the paper's default."""

_PINHOLE, _GATHER, _ACCUMULATED = "pinhole", "blur by circle of confusion", "pinhole renders, accumulated"
_PUBLISHED, _ONE, _TWO = "dynamic, as published", "**dynamic**", "**dynamic, with the layer behind**"


@dataclass(frozen=True)
class Quality:
    """PSNR in dB after clip to [0, 1] and gamma 2.2, and mean FLIP."""

    psnr: float
    flip: float

    @classmethod
    def of(cls, image: Image, scene: PinholeScene) -> Quality:
        """Compare an image with the scene's reference."""
        return cls(psnr_display(image, scene.reference.image), flip(image, scene.reference.image))

    def __str__(self) -> str:
        return f"{self.psnr:.2f} · {self.flip:.4f}"


def give_depth_of_field(scene: PinholeScene, *, layers: int = 1, **options: Any) -> Image:
    """Run the method on a scene's first layer, or on both."""
    behind: Sequence[DepthLayer] = [scene.behind] if layers == 2 else []
    return defocus(scene.front.color, scene.front.depth, scene.lens, behind=behind, **options)


def measure_views(scene: PinholeScene) -> dict[str, dict[int, Quality]]:
    """Measure everyone at every number of views; those without views are the same at all."""
    print(f"{scene.name}: views", file=sys.stderr)
    measured: dict[str, dict[int, Quality]] = {
        name: dict.fromkeys(VIEWS, Quality.of(image, scene))
        for name, image in (
            (_PINHOLE, scene.front.color),
            (_GATHER, gather_blur(scene.front.color, scene.front.depth, scene.lens)),
        )
    }
    measured[_ACCUMULATED] = {n: Quality.of(image, scene) for n, image in scene.accumulated.items()}
    for name, layers, options in ((_PUBLISHED, 1, PUBLISHED), (_ONE, 1, {}), (_TWO, 2, {})):
        measured[name] = {
            n: Quality.of(give_depth_of_field(scene, layers=layers, views=n, **options), scene) for n in VIEWS
        }
    return measured


def views_section(measured: Mapping[str, Mapping[str, Mapping[int, Quality]]]) -> Iterator[str]:
    """Say how good everyone is, scene by scene."""
    yield "## Views"
    yield (
        "PSNR in dB and FLIP by the number of views, as in the paper's Table 1 and Figure 9. *Accumulated* "
        "is the mean of that many pinhole renders from the first points of a Halton sequence over the lens, "
        "each rendered anew with 8 light paths per pixel; all others see one pinhole render of 64 paths. "
        "*As published* has the paper's Halton points, mip pyramid and support growth, and leaves out "
        "rays without data. The layer behind is a depth peel."
    )
    for scene, by_name in measured.items():
        rows = [[name, *(str(by_views[n]) for n in VIEWS)] for name, by_views in by_name.items()]
        yield markdown_table([scene, *(f"{n} views" for n in VIEWS)], rows)
    yield verdict(measured)


def verdict(measured: Mapping[str, Mapping[str, Mapping[int, Quality]]]) -> str:
    """Sum up, at the paper's number of views, what is gained over the baselines."""
    lines = []
    for scene, by_name in measured.items():
        ours = by_name[_ONE][SHOWN]
        gains = [
            f"{ours.psnr - by_name[rival][SHOWN].psnr:+.2f} dB against {rival.replace('*', '')}"
            for rival in (_GATHER, _ACCUMULATED, _PUBLISHED)
        ]
        behind = by_name[_TWO][SHOWN].psnr - ours.psnr
        lines.append(f"- {scene}, {SHOWN} views: {', '.join(gains)}; {behind:+.2f} dB with the layer behind.")
    return "\n".join(lines)


def measure_gains(scene: PinholeScene) -> dict[str, Quality]:
    """Measure variants of the method, from one layer."""
    print(f"{scene.name}: gains", file=sys.stderr)
    return {name: Quality.of(give_depth_of_field(scene, **o), scene) for name, o in VARIANTS.items()}


def gains_section(measured: Mapping[str, Mapping[str, Quality]]) -> Iterator[str]:
    """Say what each part gains."""
    yield "## What each part gains"
    yield (
        f"One thing changed at a time, {SHOWN} views, one layer: PSNR in dB and FLIP. "
        "[dynamic.md](dynamic.md) explains the parts."
    )
    rows = [[name, *(str(by_name[name]) for by_name in measured.values())] for name in VARIANTS]
    yield markdown_table(["", *measured], rows)
