"""What the multiplane method achieves and costs: rendered scenes, known truths, time and memory.

    python examples/render.py --spp 1 4 8 16
    python examples/render.py --aperture disc --spp 1 4 8 16
    python examples/render.py butterflies --aperture disc --spp 1 2 4 8 16
    python benchmarks/multiplane.py

Needs ``fewrays[bench]``. Writes ``docs/multiplane-results.md`` and pictures in ``docs/images/``. The parts
can be made one by one; then the page has only these. With ``--keep FOLDER`` the images of other methods are
kept there, and another run does not wait for them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import multiplane_bokeh
import multiplane_cost
import multiplane_discs
import multiplane_memory
import multiplane_motion
import multiplane_parameters
import multiplane_pictures
import multiplane_quality
from disc_scenes import MOVING, STILL, load_disc_scene, rendered
from example_renders import SCENES, samples_file
from kept_images import KeptImages
from page_parts import Part, make_page, parse_page_options
from peers import require_bench

_SPP = 8  # of what is timed and varied


def main() -> None:
    """Measure, and write the page."""
    options = parse_page_options(__doc__, PARTS, kept="images of other methods")
    require_bench()
    make_page("multiplane", introduction(), PARTS, options, first="memory")


def introduction() -> Iterator[str]:
    """Say what the page is about."""
    yield "# Results of the multiplane method"
    yield (
        'What `method="multiplane"` makes of a few samples per pixel, what it costs, and where it falls '
        "short. [multiplane.md](multiplane.md) says how it works. Made by a benchmark, not by hand."
    )
    yield (
        "PSNR is of the image after clip to [0, 1] and gamma 2.2; more is better, as less is of FLIP. "
        "Rendered scenes are 640 x 360 pixels. Their references are brute-force averages with noise of their "
        "own, so every PSNR is given as measured and, in brackets, with that noise subtracted from the mean "
        "squared error."
    )


def quality_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure everyone on every example that has been rendered."""
    wanted = multiplane_quality.find_rendered(options.renders, multiplane_quality.SPP)
    rows = multiplane_quality.measure_rows(options.renders, wanted, KeptImages(options.keep))
    yield from multiplane_quality.section(rows)


def motion_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure everyone on the moving scene."""
    yield from multiplane_motion.section(
        multiplane_motion.measure_motion(options.renders, KeptImages(options.keep))
    )


def discs_part(options: argparse.Namespace) -> Iterator[str]:  # noqa: ARG001
    """Measure the layered paper's failure case."""
    yield from multiplane_discs.section(multiplane_discs.measure_discs())


def cost_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure time."""
    scene = load_disc_scene(options.renders, STILL, _SPP)
    cost = multiplane_cost.measure_cost(scene.label, scene.samples, options.repetitions)
    blurs = multiplane_cost.measure_blur(scene.samples, options.repetitions)
    yield from multiplane_cost.section(cost, blurs, options.repetitions)


def memory_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure memory."""
    load_disc_scene(options.renders, STILL, _SPP)
    path = samples_file(options.renders, STILL, "disc", _SPP)
    yield from multiplane_memory.section(multiplane_memory.measure_memory(path))


def parameters_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure what each option does."""
    names = rendered(options.renders, (*SCENES, MOVING), _SPP)
    scenes = [load_disc_scene(options.renders, name, _SPP) for name in names]
    yield from multiplane_parameters.section(scenes, multiplane_parameters.measure_variants(scenes))


def bokeh_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure and draw lights behind leaves."""
    name = "multiplane-bokeh.png"
    truth, found = multiplane_bokeh.measure_bokeh()
    multiplane_bokeh.draw(options.out / "images" / name, truth, found)
    yield from multiplane_bokeh.section(found, f"images/{name}")


def pictures_part(options: argparse.Namespace) -> Iterator[str]:
    """Draw rendered scenes, planes, and other lenses."""
    renders, images, kept = options.renders, options.out / "images", KeptImages(options.keep)
    yield "## Pictures"
    yield (
        f"{_SPP} samples per pixel through the disc lens. The magnified parts are chosen by rule: where "
        "Open Image Denoise errs most, where `temporal` does, and where `multiplane` does."
    )
    multiplane_pictures.draw_before_and_after(renders, images / "multiplane-hero.png", _SPP)
    for scene in (STILL, MOVING):
        name = f"multiplane-{scene}.png"
        multiplane_pictures.draw_comparison(renders, images / name, scene, _SPP, kept)
        yield f"![{scene}: average, Open Image Denoise, temporal, multiplane, reference](images/{name})"
    shown = multiplane_pictures.draw_one_sample(renders, images / "multiplane-one-sample.png", kept)
    yield f"One sample per pixel, {', '.join(shown)}:"
    yield "![one sample per pixel: averaged, denoised, ours, reference](images/multiplane-one-sample.png)"
    count = multiplane_pictures.draw_planes(renders, images / "multiplane-planes.png")
    yield f"Six of the {count} planes of *{STILL}*: opacity above, radiance below."
    yield "![opacity and radiance of six planes](images/multiplane-planes.png)"
    multiplane_pictures.draw_rack_focus(renders, images / "multiplane-refocus.png")
    yield f"*{STILL}* from one set of planes, 128 views each: other foci, lens radii and apertures."
    yield "![twelve images of the same planes](images/multiplane-refocus.png)"


PARTS: dict[str, Part] = {
    "quality": quality_part,
    "motion": motion_part,
    "discs": discs_part,
    "bokeh": bokeh_part,
    "pictures": pictures_part,
    "cost": cost_part,
    "memory": memory_part,
    "parameters": parameters_part,
}


if __name__ == "__main__":
    main()
