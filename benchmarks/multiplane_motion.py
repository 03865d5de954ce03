"""The multiplane method beside the others on a scene in motion."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from disc_scenes import MOVING, how_to_render_disc, load_disc_scene, rendered
from example_renders import samples_file
from kept_images import KeptImages
from multiplane_quality import OURS, PLAIN, TEMPORAL, Entry, compared
from peers import DENOISER, denoise
from report import markdown_table, met

__all__ = ["SPP", "Moving", "measure_motion", "section", "verdict"]

SPP = (1, 2, 4, 8, 16)


@dataclass(frozen=True)
class Moving:
    """Samples per pixel, and how good everyone's image of them is."""

    spp: int
    entries: dict[str, Entry]


def measure_motion(folder: Path, kept: KeptImages) -> list[Moving]:
    """Let everyone reconstruct whatever has been rendered."""
    return [_measure(folder, spp, kept) for spp in SPP if rendered(folder, [MOVING], spp)]


def _measure(folder: Path, spp: int, kept: KeptImages) -> Moving:
    print(f"{MOVING}, {spp} spp", file=sys.stderr)
    scene = load_disc_scene(folder, MOVING, spp)
    path = samples_file(folder, MOVING, "disc", spp)
    box = fewrays.reconstruct(scene.samples, PLAIN)
    images = {
        PLAIN: box,
        DENOISER: kept.image(DENOISER, path, lambda: denoise(box)),
        TEMPORAL: kept.image(TEMPORAL, path, lambda: fewrays.reconstruct(scene.samples, TEMPORAL)),
        OURS: fewrays.reconstruct(scene.samples, OURS),
    }
    reference = scene.references["box"]
    return Moving(spp, {name: compared(image, reference) for name, image in images.items()})


def section(measured: Sequence[Moving]) -> Iterator[str]:
    """Return the page's part on motion."""
    yield "## Motion"
    yield (
        f"*{MOVING}*, several moving things in front of and behind foliage, all of it through the disc lens: "
        "PSNR in dB, in brackets with the reference's noise taken out, and mean FLIP. Box pixel filter."
    )
    missing = sorted(set(SPP) - {each.spp for each in measured})
    if measured:
        names = list(measured[0].entries)
        rows = [[str(each.spp), *(str(each.entries[name]) for name in names)] for each in measured]
        yield markdown_table(["samples per pixel", *names], rows)
        yield verdict(measured)
    if missing:
        yield f"Not rendered, hence missing: {missing} spp. `{how_to_render_disc([MOVING], missing)}`"


def verdict(measured: Sequence[Moving]) -> str:
    """Say where `TEMPORAL` is better, as measured."""
    behind = []
    for each in measured:
        ours, theirs = each.entries[OURS], each.entries[TEMPORAL]
        if ours.psnr.measured < theirs.psnr.measured or ours.flip > theirs.flip:
            gain = ours.psnr.measured - theirs.psnr.measured
            behind.append(f"{each.spp} spp ({gain:+.2f} dB, FLIP {ours.flip - theirs.flip:+.4f})")
    where = ", ".join(behind) or "every number of samples"
    return f"Target: PSNR and FLIP no worse than those of `{TEMPORAL}`. {met(not behind)} at {where}."
