"""Seams, popping, lights and large blur: what pictures of quality do not show, on scenes with a known truth.

    python benchmarks/robustness.py

Needs ``fewrays[bench]``, no renderer; the example scenes join where they have been rendered. Writes
``docs/robustness.md`` and its pictures in ``docs/images/``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import large_blur
import lights
import popping
import seams
from fewrays.display import save_picture
from peers import DENOISER, require_bench
from pictures import Curve, light_sheet, line_chart
from report import ROOT, provenance, write_page

Part = Callable[[argparse.Namespace], Iterator[str]]


def main() -> None:
    """Measure, and write the page and the pictures."""
    options = parse_options()
    require_bench()
    (options.out / "images").mkdir(parents=True, exist_ok=True)
    parts = [paragraph for name in options.parts for paragraph in PARTS[name](options)]
    command = "python benchmarks/robustness.py"
    if options.parts != list(PARTS):
        command += f" --parts {' '.join(options.parts)}"
    write_page(options.out / "robustness.md", *introduction(), provenance(command), *parts)
    print(options.out / "robustness.md")


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--renders", type=Path, default=ROOT / "examples" / "renders")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for the page (docs)")
    return parser.parse_args()


def introduction() -> Iterator[str]:
    """Say what the page is about."""
    yield "# Robustness"
    yield (
        "What an average over an image hides: borders of tiles, frames that pop, lights that sparkle or lose "
        "their energy, circles of confusion larger than any tile. Scenes are planes whose truth is known, "
        f"beside the rendered examples; {DENOISER} runs at high quality in HDR mode on the plain average of "
        "the same samples. Made by a benchmark, not by hand."
    )


def seams_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure seams."""
    yield from seams.section(seams.measure_seams(options.renders))


def popping_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure popping, and draw every frame's change."""
    slides = popping.measure_slides()
    charts: dict[str, dict[str, Curve]] = {}
    for slide in slides:
        charts.setdefault(slide.scene, {})[slide.method] = (slide.slopes, 1000 * slide.change)
    save_picture(options.out / "images" / "popping.png", line_chart(charts, "slope, px", "change / 1000"))
    yield from popping.section(slides, "images/popping.png")


def lights_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure lights, and draw them."""
    measured = [lights.measure_light(case) for case in lights.CASES]
    save_picture(options.out / "images" / "lights.png", light_sheet(measured))
    yield from lights.section(measured, "images/lights.png")


def large_blur_part(options: argparse.Namespace) -> Iterator[str]:  # noqa: ARG001
    """Measure large circles of confusion."""
    yield from large_blur.section([large_blur.measure_blur(radius) for radius in large_blur.RADII])


PARTS: dict[str, Part] = {
    "seams": seams_part,
    "popping": popping_part,
    "lights": lights_part,
    "large-blur": large_blur_part,
}


if __name__ == "__main__":
    main()
