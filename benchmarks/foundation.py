"""What the layered method has gained over its first version, on the same samples and the same references.

The first version cannot be built from this tree, so that its images are made once and lie by the renders.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from contenders import OURS
from example_renders import Reference
from fewrays.method import Image
from report import markdown_table, met
from scores import Score, score

__all__ = ["COMMIT", "Gain", "foundation_file", "measure_gain", "section", "verdict"]

COMMIT = "5410918"
TARGET = 1.5  # dB on average


@dataclass(frozen=True)
class Gain:
    """A scene's scores by the first version and by this one."""

    scene: str
    before: Score
    now: Score

    @property
    def measured(self) -> float:
        """In dB, against the references as they are."""
        return self.now.measured - self.before.measured

    @property
    def corrected(self) -> float:
        """In dB, with the references' noise taken out."""
        return self.now.corrected - self.before.corrected


def foundation_file(folder: Path, scene: str, spp: int) -> Path:
    """Return where the first version's image of a scene's square samples lies."""
    return folder / f"{scene}_foundation_{spp}spp.exr"


def measure_gain(folder: Path, scene: str, spp: int, image: Image, reference: Reference) -> Gain | None:
    """Compare this version's image with the first version's; None where that one has not been made."""
    path = foundation_file(folder, scene, spp)
    if not path.exists():
        return None
    return Gain(scene, score(fewrays.load_image(path), reference), score(image, reference))


def section(gains: Sequence[Gain], scenes: Sequence[str], spp: int) -> Iterator[str]:
    """Return the page's part on the first version.

    Parameters
    ----------
    gains : sequence of Gain
        Of the scenes whose image by the first version was there.
    scenes : sequence of str
        All that were asked for.
    spp : int
        Samples per pixel.
    """
    yield "## What it gains over its first version"
    yield (
        f"`{OURS}` as of commit `{COMMIT}`, the first version, and now: *square* samples, {spp} per pixel, "
        "against the same references. PSNR in dB after clip to [0, 1] and gamma 2.2, in brackets with the "
        "references' noise taken out. The first version's images are made once, from the same buffers, by "
        f"`git checkout {COMMIT}` and then, for each scene, `fewrays reconstruct "
        f"examples/renders/<scene>_square_{spp}spp.npz -o examples/renders/<scene>_foundation_{spp}spp.exr`."
    )
    if gains:
        rows = [[g.scene, str(g.before), str(g.now), _gain(g.measured, g.corrected)] for g in gains]
        average = [statistics.fmean(g.measured for g in gains), statistics.fmean(g.corrected for g in gains)]
        rows.append(["average", "", "", _gain(*average)])
        yield markdown_table(["scene", "first version", "now", "gain"], rows)
    missing = [scene for scene in scenes if all(gain.scene != scene for gain in gains)]
    if missing:
        yield f"Not judged: the first version's images are missing for {', '.join(missing)}."
    else:
        yield verdict(gains)


def verdict(gains: Sequence[Gain]) -> str:
    """Say whether the gain reaches the target on average, and whether any scene lost."""
    average = statistics.fmean(gain.measured for gain in gains)
    worst = min(gains, key=lambda gain: gain.measured)
    good = average >= TARGET and worst.measured >= 0
    return (
        f"Target: at least {TARGET:+.1f} dB on average, and none worse. {met(good)}: {average:+.2f} dB on "
        f"average, least on {worst.scene} ({worst.measured:+.2f} dB)."
    )


def _gain(measured: float, corrected: float) -> str:
    return f"{measured:+.2f} ({corrected:+.2f})"
