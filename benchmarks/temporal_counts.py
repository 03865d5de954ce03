"""Quality by samples per pixel and by reconstruction locations, as in Figure 12 of Lehtinen et al. 2011."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from disc_scenes import MOVING, how_to_render_disc, load_disc_scene, rendered
from fewrays.pixel_filter import PixelFilterShape
from report import markdown_table, met
from scores import Score, score

__all__ = ["BASELINES", "LOCATIONS", "SPP", "Counts", "measure_counts", "section", "verdict"]

SPP = (1, 2, 4, 8, 16)
LOCATIONS = (16, 32, 64, 128, 256)
TARGET = 10.0
"""What 16 samples per pixel and 128 locations shall gain over plain averaging, in dB."""
_JUDGED = (16, 128)
BASELINES: dict[str, PixelFilterShape] = {"box": "box", "axis-aligned": "gaussian", "sheared": "gaussian"}


@dataclass(frozen=True)
class Counts:
    """Scores of a scene, of one number of samples per pixel.

    Parameters
    ----------
    spp : int
        Samples per pixel.
    baselines : mapping
        By method.
    temporal : mapping
        By number of locations.
    """

    spp: int
    baselines: Mapping[str, Score]
    temporal: Mapping[int, Score]


def measure_counts(folder: Path, spps: Sequence[int], locations: Sequence[int]) -> list[Counts]:
    """Reconstruct every number of samples per pixel that has been rendered."""
    return [_measure(folder, spp, locations) for spp in spps if rendered(folder, [MOVING], spp)]


def _measure(folder: Path, spp: int, locations: Sequence[int]) -> Counts:
    print(f"{MOVING}, {spp} spp, {', '.join(map(str, locations))} locations", file=sys.stderr)
    scene = load_disc_scene(folder, MOVING, spp)
    return Counts(
        spp,
        {
            method: score(fewrays.reconstruct(scene.samples, method), scene.references[pixel_filter])
            for method, pixel_filter in BASELINES.items()
        },
        {
            count: score(
                fewrays.reconstruct(scene.samples, "temporal", locations=count), scene.references["box"]
            )
            for count in locations
        },
    )


def section(measured: Sequence[Counts], spps: Sequence[int], locations: Sequence[int]) -> Iterator[str]:
    """Return the page's part on samples and locations."""
    yield "## Samples and locations"
    yield (
        f"PSNR in dB of *{MOVING}* (several moving things in front of and behind foliage, all of it through "
        "the disc lens), in brackets with the reference's noise taken out. `box` is the plain average of "
        "each pixel's samples, which the paper calls axis-aligned filtering; `axis-aligned` is the adaptive "
        "filter of Mehta et al. 2012, and `sheared` that of Egan et al. 2009 with its fall-back. These two "
        "filter pixels by a Gaussian and are compared with a reference that does the same."
    )
    if measured:
        head = ["samples per pixel", *BASELINES, *(f"temporal, {n} locations" for n in locations)]
        rows = [
            [str(row.spp), *map(str, row.baselines.values()), *(str(row.temporal[n]) for n in locations)]
            for row in measured
        ]
        yield markdown_table(head, rows)
    missing = sorted(set(spps) - {row.spp for row in measured})
    if missing:
        command = how_to_render_disc([MOVING], missing)
        yield f"Not rendered, hence missing: {', '.join(map(str, missing))} spp. Make it with `{command}`."
    found = next((row for row in measured if row.spp == _JUDGED[0] and _JUDGED[1] in row.temporal), None)
    yield verdict(found)


def verdict(row: Counts | None) -> str:
    """Say whether the target is met by a row of 16 samples per pixel, if there is one."""
    spp, locations = _JUDGED
    text = (
        f"Target: {spp} samples per pixel and {locations} locations gain at least {TARGET:g} dB over `box`. "
    )
    if row is None:
        return text + "Not measured."
    gain = row.temporal[locations].measured - row.baselines["box"].measured
    corrected = row.temporal[locations].corrected - row.baselines["box"].corrected
    return text + f"{met(gain >= TARGET)}: {gain:+.2f} dB ({corrected:+.2f} dB)."
