"""What the temporal method achieves and costs: rendered scenes with defocus and motion, and known truths.

    python examples/render.py foliage --aperture disc --spp 8 16
    python examples/render.py butterflies --aperture disc --spp 1 2 4 8 16
    python benchmarks/temporal.py

Needs ``fewrays[bench]``. Writes ``docs/temporal-results.md`` and its pictures in ``docs/images/``. The parts
can be made one by one; then the page has only these. Renders of *serpent* and *citadel* join where there are
any.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import temporal_cost
import temporal_counts
import temporal_edges
import temporal_gains
import temporal_highlights
import temporal_peers
import temporal_pictures
from disc_scenes import MOVING, SCENES, STILL, load_disc_scene, rendered
from page_parts import Part, make_page, parse_page_options
from peers import require_bench

_PEER_SPP = (8, 16)


def main() -> None:
    """Measure, and write the page and the pictures."""
    options = parse_page_options(__doc__, PARTS)
    require_bench()
    make_page("temporal", introduction(), PARTS, options, first="cost")


def introduction() -> Iterator[str]:
    """Say what the page is about."""
    yield "# Results of the temporal method"
    yield (
        'What `method="temporal"` makes of a few samples per pixel where things are out of focus, in motion, '
        "or both, what it costs, and where it falls short. [temporal.md](temporal.md) says how it works. "
        "Made by a benchmark, not by hand."
    )
    yield (
        "PSNR is of the image after clip to [0, 1] and gamma 2.2; more is better, as less is of FLIP. "
        "Rendered scenes are 640 x 360 pixels, seen through a disc lens, with the box pixel filter unless it "
        "says otherwise. Their references are brute-force averages with noise of their own, so every PSNR is "
        "given as measured and, in brackets, with that noise subtracted from the mean squared error."
    )


def counts_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure quality by samples and locations."""
    spps, locations = temporal_counts.SPP, temporal_counts.LOCATIONS
    measured = temporal_counts.measure_counts(options.renders, spps, locations)
    yield from temporal_counts.section(measured, spps, locations)


def peers_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure everyone, and draw the scenes."""
    scenes = [
        name
        for name in SCENES
        if name in (STILL, MOVING) or all(rendered(options.renders, [name], spp) for spp in _PEER_SPP)
    ]
    images = options.out / "images"
    yield from temporal_peers.measure_all(options.renders, images, scenes, _PEER_SPP)


def gains_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure what each part of the method gains."""
    scenes = [load_disc_scene(options.renders, *which) for which in ((STILL, 8), (STILL, 16), (MOVING, 8))]
    yield from temporal_gains.section(scenes, temporal_gains.measure_gains(scenes, temporal_gains.VARIANTS))


def cost_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure time and memory, and count how locations are resolved."""
    still, moving = (load_disc_scene(options.renders, name, 8) for name in (STILL, MOVING))
    size = (still.samples.height, still.samples.width)
    workloads = [
        temporal_cost.Workload(still.label, still.samples, judged=True),
        temporal_cost.Workload(moving.label, moving.samples),
        temporal_cost.simple_scene(*size, 8),
    ]
    costs = [temporal_cost.measure_cost(workload, options.repetitions) for workload in workloads]
    counted = [(each.name, temporal_cost.count_locations(each.samples)) for each in workloads]
    yield from temporal_cost.section(counted, costs, options.repetitions)


def edges_part(options: argparse.Namespace) -> Iterator[str]:  # noqa: ARG001
    """Measure silhouettes."""
    outlines = temporal_edges.measure_outlines(temporal_edges.CASES, temporal_edges.SPP)
    yield from temporal_edges.section(outlines)


def highlights_part(options: argparse.Namespace) -> Iterator[str]:
    """Measure highlights, and draw them."""
    name = "temporal-highlights.png"
    truth, highlights = temporal_highlights.measure_highlights()
    temporal_highlights.draw(options.out / "images" / name, truth, highlights)
    yield from temporal_highlights.section(highlights, f"images/{name}")


def pictures_part(options: argparse.Namespace) -> Iterator[str]:
    """Draw one sample per pixel, other foci and other shutters."""
    images = options.out / "images"
    shown = temporal_pictures.draw_one_sample(options.renders, images / "temporal-one-sample.png")
    yield "## One sample per pixel"
    yield (
        f"The least input there is, on {', '.join(shown)}: through the disc lens where that has been "
        "rendered, else through the Gaussian one. 128 locations."
    )
    yield "![one sample per pixel: averaged, reconstructed, reference](images/temporal-one-sample.png)"
    temporal_pictures.draw_rack_focus(options.renders, images / "temporal-refocus.png")
    yield "## Focused anew"
    yield (
        f"*{STILL}*, 8 samples per pixel: the same samples, reconstructed with the focus moved from the "
        "front to the back in equal steps of 1 / distance, and with other apertures. No ray is traced again. "
        "`fewrays refocus` writes such sequences."
    )
    yield "![nine reconstructions of the same samples](images/temporal-refocus.png)"
    temporal_pictures.draw_shutters(options.renders, images / "temporal-shutter.png")
    yield "## Other shutters"
    yield (
        f"*{MOVING}*, 8 samples per pixel: the shutter open for the whole interval of the samples, for its "
        "first half, and for an instant; and with next to no aperture, which leaves a pinhole's image."
    )
    yield "![four reconstructions of the same samples](images/temporal-shutter.png)"


PARTS: dict[str, Part] = {
    "counts": counts_part,
    "peers": peers_part,
    "gains": gains_part,
    "cost": cost_part,
    "edges": edges_part,
    "highlights": highlights_part,
    "pictures": pictures_part,
}


if __name__ == "__main__":
    main()
