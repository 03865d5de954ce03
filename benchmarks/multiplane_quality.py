"""The multiplane method beside the others: every example, both lenses, few to many samples per pixel.

Every image is compared with the reference of its own pixel filter. The layered method only has the Gaussian
filter and lens; it is met there by multiplane images of the same planes, rendered under that filter.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import fewrays
from example_renders import SCENES, Reference, load_references, samples_file
from fewrays.method import Image
from fewrays.metrics import flip
from fewrays.pixel_filter import PixelFilterShape
from kept_images import KeptImages
from peers import DENOISER, denoise
from report import markdown_table, met
from sample_counts import plain_law
from scores import Score, score

__all__ = ["OURS", "SPP", "Entry", "Row", "find_rendered", "measure_rows", "section", "verdicts"]

Sampling = Literal["disc", "gaussian", "square"]

SPP = (1, 4, 8, 16)
OURS, OURS_GAUSSIAN = "multiplane", "multiplane, Gaussian filter"
PLAIN, LAYERED, TEMPORAL = "box", "layered", "temporal"
LENSES: dict[Sampling, str] = {
    "disc": "disc",
    "gaussian": "Gaussian",
    "square": "Gaussian, square samples",
}
"""How lens positions were drawn, and what tables call it."""
FILTERS: dict[str, PixelFilterShape] = {
    PLAIN: "box",
    DENOISER: "box",
    TEMPORAL: "box",
    OURS: "box",
    LAYERED: "gaussian",
    OURS_GAUSSIAN: "gaussian",
}
"""Who is compared, and under which pixel filter."""
LEAD = 4.5
"""What our image of foliage through the disc lens shall gain over the denoiser's, in dB."""
_JUDGED_FROM = 4  # samples per pixel
_LEAD_SCENE, _LEAD_SPP = "foliage", (8, 16)


@dataclass(frozen=True)
class Entry:
    """How good an image is: PSNR, and mean FLIP."""

    psnr: Score
    flip: float

    def __str__(self) -> str:
        return f"{self.psnr} · {self.flip:.4f}"


@dataclass(frozen=True)
class Row:
    """A scene through a lens, of so many samples per pixel, and how good everyone's image of it is."""

    scene: str
    sampling: Sampling
    spp: int
    entries: Mapping[str, Entry]

    @property
    def label(self) -> str:
        """Scene, lens and samples per pixel."""
        return f"{self.scene}, {LENSES[self.sampling]}, {self.spp} spp"


def find_rendered(folder: Path, spps: Sequence[int]) -> list[tuple[str, Sampling, int]]:
    """Return what has been rendered, with references: scene, sampling and samples per pixel."""
    return [
        (scene, sampling, spp)
        for scene in SCENES
        for sampling in LENSES
        for spp in spps
        if samples_file(folder, scene, sampling, spp).exists()
        and (folder / f"{_reference_name(scene, sampling)}_reference.json").exists()
    ]


def measure_rows(folder: Path, wanted: Sequence[tuple[str, Sampling, int]], kept: KeptImages) -> list[Row]:
    """Let everyone make an image of each, and compare it with the reference of its pixel filter."""
    return [_measure(folder, *each, kept) for each in wanted]


def _measure(folder: Path, scene: str, sampling: Sampling, spp: int, kept: KeptImages) -> Row:
    print(f"{scene}, {LENSES[sampling]}, {spp} spp", file=sys.stderr)
    path = samples_file(folder, scene, sampling, spp)
    references = load_references(folder, _reference_name(scene, sampling))
    images = make_images(path, kept)
    entries = {name: compared(image, references[FILTERS[name]]) for name, image in images.items()}
    return Row(scene, sampling, spp, entries)


def _reference_name(scene: str, sampling: Sampling) -> str:
    return f"{scene}_disc" if sampling == "disc" else scene


def make_images(path: Path, kept: KeptImages) -> dict[str, Image]:
    """Return everyone's image of a file of samples; the layered method's only of a Gaussian lens."""
    samples = fewrays.load(path)
    box = fewrays.reconstruct(samples, PLAIN)
    others: dict[str, Callable[[], Image]] = {
        DENOISER: lambda: denoise(box),
        TEMPORAL: lambda: fewrays.reconstruct(samples, TEMPORAL),
    }
    if samples.lens.aperture == "gaussian":
        others[LAYERED] = lambda: fewrays.reconstruct(samples, LAYERED)
    images = {PLAIN: box} | {name: kept.image(name, path, make) for name, make in others.items()}
    planes = fewrays.Multiplane.build(samples)
    images[OURS] = planes.render()
    images[OURS_GAUSSIAN] = planes.render(pixel_filter="gaussian")
    return images


def compared(image: Image, reference: Reference) -> Entry:
    """Compare an image with its reference."""
    return Entry(score(image, reference), flip(image, reference.image))


def section(rows: Sequence[Row]) -> Iterator[str]:
    """Return the page's part on quality, and on what plain averaging would need."""
    yield "## Quality"
    yield (
        "PSNR in dB, in brackets with the reference's noise taken out, and mean FLIP. Every image is "
        f"compared with the reference of its own pixel filter: the 1-px box for `{PLAIN}`, {DENOISER}, "
        f"`{TEMPORAL}` and `{OURS}`, the Gaussian of σ = 0.5 px for `{LAYERED}` and the last column, which "
        f"is another image of the same planes. {DENOISER} runs at high quality in HDR mode on the plain "
        f"average. `{LAYERED}` has no disc lens. Of the Gaussian lens there are samples whose lens positions "
        "were drawn from the aperture, which suits averaging best, and *square* ones, spread evenly over "
        "±3 σ as the layered paper has them."
    )
    if not rows:
        yield "Not rendered."
        return
    table = [[row.label, *(str(row.entries.get(name, "")) for name in FILTERS)] for row in rows]
    yield markdown_table(["", *FILTERS], table)
    yield from verdicts(rows)
    yield from _plain_section(rows)


def verdicts(rows: Sequence[Row]) -> Iterator[str]:
    """Say where the targets are met, as measured."""
    judged = [row for row in rows if row.spp >= _JUDGED_FROM]
    behind = [text for row in judged for text in _behind(row)]
    where = f" at {'; '.join(behind)}" if behind else f" in all {len(judged)} rows"
    yield (
        f"Target: from {_JUDGED_FROM} samples per pixel on a better PSNR and FLIP than everyone else under "
        f"the same filter. {met(not behind)}{where}."
    )
    leads = {
        row.spp: (row.entries[OURS].psnr, row.entries[DENOISER].psnr)
        for row in rows
        if (row.scene, row.sampling) == (_LEAD_SCENE, "disc") and row.spp in _LEAD_SPP
    }
    gains = [
        f"{ours.measured - theirs.measured:+.2f} ({ours.corrected - theirs.corrected:+.2f}) dB at {spp}"
        for spp, (ours, theirs) in leads.items()
    ]
    good = all(ours.measured - theirs.measured >= LEAD for ours, theirs in leads.values())
    sharp = all(ours.corrected - theirs.corrected >= LEAD for ours, theirs in leads.values())
    text = f"Target: {LEAD:+g} dB over {DENOISER} on {_LEAD_SCENE} through the disc lens. "
    if not leads:
        yield text + "Not measured."
        return
    differs = "" if good == sharp else f"; with the references' noise taken out: {met(sharp)}"
    yield text + f"{met(good)}: {', '.join(gains)} spp{differs}."


def _behind(row: Row) -> Iterator[str]:
    """Name whoever has a better image in a row than ours of the same pixel filter."""
    for ours in (OURS, OURS_GAUSSIAN):
        for name, entry in row.entries.items():
            if name == ours or FILTERS[name] != FILTERS[ours]:
                continue
            own = row.entries[ours]
            psnr, visible = entry.psnr.measured - own.psnr.measured, own.flip - entry.flip
            worse = [
                text
                for text, lead in ((f"{psnr:.2f} dB", psnr), (f"FLIP {visible:.4f}", visible))
                if lead > 0
            ]
            if worse:
                yield f"{row.label} ({name} by {' and '.join(worse)})"


def _plain_section(rows: Sequence[Row]) -> Iterator[str]:
    """Say how many samples per pixel plain averaging would need for the same."""
    yield "## What plain averaging would need"
    yield (
        f"Samples per pixel at which `{PLAIN}` would have the PSNR of `{OURS}`, the reference's noise taken "
        "out of both. Extrapolated: the mean squared error of the largest buffer is taken to fall as 1/spp "
        "from there. The exponents say how well that law holds between the buffers there are (all, and the "
        "two largest): -1 is the law; where the error falls more steeply the number is too large."
    )
    spps = sorted({row.spp for row in rows})
    table = []
    for scene, sampling in dict.fromkeys((row.scene, row.sampling) for row in rows):
        own = {row.spp: row.entries for row in rows if (row.scene, row.sampling) == (scene, sampling)}
        law = plain_law({spp: entries[PLAIN].psnr for spp, entries in own.items()})
        needed = [f"{law.needed(own[spp][OURS].psnr.error):.0f}" if spp in own else "" for spp in spps]
        table.append([f"{scene}, {LENSES[sampling]}", *needed, *law.cells])
    head = ["", *(f"as {OURS} at {spp} spp" for spp in spps), "exponent", "of the last two"]
    yield markdown_table(head, table)
