"""What the dynamic method makes of one picture with depth, and what it costs.

    python examples/pinhole.py --views 12 24 36 48 64
    python examples/render.py --aperture disc --spp 8
    python benchmarks/dynamic.py

Needs ``fewrays[bench]``. Writes ``docs/dynamic-results.md`` and its pictures in ``docs/images/``. The parts
can be made one by one; then the page has only these.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial

import dynamic_cost
import dynamic_pictures
import dynamic_quality
from dynamic_scenes import SCENES, PinholeScene, load_pinhole_scene, require_pinhole_renders
from page_parts import make_page, parse_page_options
from peers import require_bench

ScenesPart = Callable[[list[PinholeScene], argparse.Namespace], Iterator[str]]
"""A part of scenes that all parts share."""


def main() -> None:
    """Measure, and write the page and the pictures."""
    options = parse_page_options(__doc__, PARTS, repeated="at each number of views")
    require_bench()
    require_pinhole_renders(options.renders, SCENES)
    scenes = [load_pinhole_scene(options.renders, name) for name in SCENES]
    parts = {name: partial(part, scenes) for name, part in PARTS.items()}
    make_page("dynamic", introduction(scenes), parts, options)


def introduction(scenes: list[PinholeScene]) -> Iterator[str]:
    """Say what the page is about."""
    yield "# Results of the dynamic method"
    yield (
        "What `fewrays.defocus` makes of one pinhole render with depth, beside blur by the circle of "
        "confusion and the accumulation of many pinhole renders. [dynamic.md](dynamic.md) says how it works. "
        "Made by a benchmark, not by hand."
    )
    height, width = scenes[0].front.depth.shape
    noise = ", ".join(f"{scene.reference.noise_psnr:.1f} dB on {scene.name}" for scene in scenes)
    yield (
        "PSNR is of the image after clip to [0, 1] and gamma 2.2; more is better, as less is of FLIP. Scenes "
        f"are {width} x {height} pixels, HDR. References are ray traced through the disc lens, with the box "
        f"pixel filter; their own noise is at {noise}."
    )


def views_part(scenes: list[PinholeScene], options: argparse.Namespace) -> Iterator[str]:  # noqa: ARG001
    """Measure quality by views."""
    measured = {scene.name: dynamic_quality.measure_views(scene) for scene in scenes}
    yield from dynamic_quality.views_section(measured)


def pictures_part(scenes: list[PinholeScene], options: argparse.Namespace) -> Iterator[str]:
    """Draw the scenes."""
    yield "## Pictures"
    yield (
        "Whole images, crops (where blur by the circle of confusion errs most, where the reference has the "
        "most detail, and where the method with the layer behind errs most) and errors, as in the paper's "
        "Figures 8 and 10."
    )
    images = options.out / "images"
    for scene in scenes:
        name = dynamic_pictures.draw_rivals(scene, images)
        yield f"![{scene.name}: rivals, the method, the reference](images/{name})"
    dynamic_pictures.draw_before_and_after(scenes[1], images / "dynamic-hero.png")
    dynamic_pictures.draw_pull(scenes[0], images / "dynamic-pull.png")
    yield "## A focus pull"
    yield (
        f"*{scenes[0].name}*, from one render with the layer behind: six of the frames that `fewrays defocus "
        "--to` writes, in equal steps of 1 / distance."
    )
    yield "![six foci of the same render](images/dynamic-pull.png)"


def gains_part(scenes: list[PinholeScene], options: argparse.Namespace) -> Iterator[str]:  # noqa: ARG001
    """Measure what each part of the method gains."""
    yield from dynamic_quality.gains_section(
        {scene.name: dynamic_quality.measure_gains(scene) for scene in scenes}
    )


def cost_part(scenes: list[PinholeScene], options: argparse.Namespace) -> Iterator[str]:
    """Measure time."""
    factor = dynamic_cost.SIZE[0] // scenes[0].front.height
    workloads = [
        dynamic_cost.leaves(*dynamic_cost.SIZE),
        dynamic_cost.enlarged(scenes[0], factor),
        dynamic_cost.enlarged(scenes[0], factor, both=True),
    ]
    costs = [dynamic_cost.measure_cost(workload, options.repetitions) for workload in workloads]
    yield from dynamic_cost.section(costs, options.repetitions)


PARTS: dict[str, ScenesPart] = {
    "views": views_part,
    "pictures": pictures_part,
    "gains": gains_part,
    "cost": cost_part,
}


if __name__ == "__main__":
    main()
