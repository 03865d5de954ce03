"""What soft shadows from four samples per pixel achieve and cost.

    python examples/render.py excavator --variants still --spp 4 --reference-spp 1024
    python examples/render.py excavator --variants moving --spp 4 --reference-spp 512
    python benchmarks/shadows.py

Variants that have not been rendered are left out; `lit_scenes.how_to_render_lit` has the commands for all,
and for the frames of the moving lamp. Needs ``fewrays[bench]``. Writes ``docs/shadows-results.md`` and
pictures in ``docs/images/``. The parts can be made one by one; then the page has only these. With
``--keep FOLDER`` everyone's images are kept there, and another run does not wait for them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import shadows_cost
import shadows_flicker
import shadows_options
import shadows_penumbra
import shadows_pictures
import shadows_quality
from kept_images import KeptImages
from lit_scenes import load_lit, rendered_variants
from page_parts import Part, make_page, parse_page_options
from peers import require_bench

_TIMED, _VARIED = "moving_defocused", "still"


def main() -> None:
    """Measure, and write the page."""
    options = parse_page_options(__doc__, PARTS, kept="everyone's images")
    require_bench()
    make_page("shadows", introduction(), PARTS, options, first="cost")


def introduction() -> Iterator[str]:
    """Say what the page is about."""
    yield "# Results of soft shadows"
    yield (
        "What becomes of the light and shadow of area lights at four samples per pixel, what it costs, and "
        "where it falls short. [shadows.md](shadows.md) says how it works. Made by a benchmark, not by hand."
    )
    yield (
        "PSNR is of the image after clip to [0, 1] and gamma 2.2; more is better, as less is of FLIP. "
        "References are brute-force averages with noise of their own."
    )


def quality_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure everyone on every variant that has been rendered."""
    yield from shadows_quality.section(shadows_quality.measure_lit(options.renders, KeptImages(options.keep)))


def pictures_part(options: argparse.Namespace) -> Iterator[str]:
    """Draw the rendered variants."""
    scenes = [load_lit(options.renders, name) for name in rendered_variants(options.renders)]
    yield "## Pictures"
    yield (
        "All with one exposure. The magnified parts are chosen by rule: where the most pixels are half lit, "
        "where light changes most quickly, and where the denoiser and where ours err most."
    )
    images = options.out / "images"
    for name, shown in shadows_pictures.draw_all(scenes, images, KeptImages(options.keep)).items():
        yield f"![{shown}](images/{name})"


def penumbra_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure and draw penumbrae of known shape."""
    name = "shadows-profiles.png"
    measured = shadows_penumbra.measure_penumbrae()
    shadows_penumbra.draw_profiles(measured, options.out / "images" / name)
    yield from shadows_penumbra.section(measured, f"images/{name}")


def flicker_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure flicker under a moving lamp."""
    yield from shadows_flicker.section(
        shadows_flicker.measure_flicker(options.renders, KeptImages(options.keep))
    )


def cost_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure time."""
    scene = load_lit(options.renders, _TIMED)
    yield from shadows_cost.section(
        shadows_cost.measure_cost(scene, options.repetitions), options.repetitions
    )


def options_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure what options do."""
    scene = load_lit(options.renders, _VARIED)
    yield from shadows_options.section(scene, shadows_options.measure_options(scene))


PARTS: dict[str, Part] = {
    "quality": quality_part,
    "pictures": pictures_part,
    "penumbra": penumbra_part,
    "flicker": flicker_part,
    "cost": cost_part,
    "options": options_part,
}


if __name__ == "__main__":
    main()
