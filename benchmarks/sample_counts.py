"""How quality grows with samples per pixel, and how many plain averaging would need for the same.

The mean squared error of an average falls as one over the number of samples. That law is checked on the
samples there are, and then carries the error of the largest buffer to that of the reconstruction.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from contenders import OURS, PLAIN, PUBLISHED, RIVALS, make_image, pixel_filter_of
from example_renders import SAMPLINGS, Reference, how_to_render, load_references, samples_file
from fewrays.pixel_filter import PixelFilterShape
from foundation import COMMIT, foundation_file
from report import markdown_table
from scores import Score, score

__all__ = ["SPP", "PlainLaw", "SampleCounts", "measure_counts", "plain_law", "section"]

SPP = (1, 2, 4, 8, 16)
_FIRST = f"{OURS}, commit {COMMIT}"
_LENS_NAMES = {"square": "*square*", "gaussian": "*aperture*"}


@dataclass(frozen=True)
class PlainLaw:
    """How the error of plain averaging falls with samples per pixel.

    Parameters
    ----------
    spp : int
        Of the largest buffer measured.
    error : float
        Its mean squared error after gamma 2.2, without the reference's noise.
    exponent : float
        Least-squares slope of log error over log spp of all buffers; -1 is the law. ``nan`` for one.
    last_exponent : float
        That of the two largest buffers.
    """

    spp: int
    error: float
    exponent: float
    last_exponent: float

    def needed(self, error: float) -> float:
        """Return the samples per pixel at which plain averaging has this error, if the law holds."""
        return self.spp * self.error / error if error > 0 else math.inf

    @property
    def cells(self) -> list[str]:
        """Both exponents as a table shows them: nothing where one buffer does not make a line."""
        return ["" if math.isnan(e) else f"{e:.2f}" for e in (self.exponent, self.last_exponent)]


@dataclass(frozen=True)
class SampleCounts:
    """A scene's scores by samples per pixel.

    Parameters
    ----------
    scene : str
        Its name.
    scores : mapping
        ``scores[algorithm][spp]`` of square samples; what has not been rendered is left out.
    plain : mapping
        ``plain[sampling][spp]`` of the average of each pixel's samples.
    """

    scene: str
    scores: Mapping[str, Mapping[int, Score]]
    plain: Mapping[str, Mapping[int, Score]]


def measure_counts(folder: Path, scene: str) -> SampleCounts:
    """Measure every number of samples per pixel that has been rendered."""
    references = load_references(folder, scene)
    scores: dict[str, dict[int, Score]] = {algorithm: {} for algorithm in RIVALS}
    plain: dict[str, dict[int, Score]] = {sampling: {} for sampling in SAMPLINGS}
    for spp in SPP:
        for sampling in SAMPLINGS:
            path = samples_file(folder, scene, sampling, spp)
            if not path.exists():
                continue
            print(f"{scene}, {sampling} sampling, {spp} spp", file=sys.stderr)
            samples = fewrays.load(path)
            plain[sampling][spp] = _score_of(PLAIN, samples, references)
            if sampling == "square":
                for algorithm in RIVALS:
                    scores[algorithm][spp] = _score_of(algorithm, samples, references)
        first = foundation_file(folder, scene, spp)
        if first.exists():
            image = fewrays.load_image(first)
            scores.setdefault(_FIRST, {})[spp] = score(image, references[pixel_filter_of(OURS)])
    return SampleCounts(scene, scores, plain)


def _score_of(
    algorithm: str, samples: fewrays.SampleBuffer, references: Mapping[PixelFilterShape, Reference]
) -> Score:
    return score(make_image(algorithm, samples), references[pixel_filter_of(algorithm)])


def plain_law(scores: Mapping[int, Score]) -> PlainLaw:
    """Return the law through the largest number of samples per pixel, and how well the others follow it.

    Raises
    ------
    ValueError
        Without any score.
    """
    points = [(math.log(spp), math.log(scores[spp].error)) for spp in sorted(scores)]
    largest = max(scores)
    return PlainLaw(largest, scores[largest].error, _slope(points), _slope(points[-2:]))


def _slope(points: Sequence[tuple[float, float]]) -> float:
    """Slope of the straight line that fits points best."""
    if len(points) < 2:
        return math.nan
    x, y = zip(*points, strict=True)
    return statistics.linear_regression(x, y).slope


def section(measured: Sequence[SampleCounts]) -> Iterator[str]:
    """Return the page's part on samples per pixel."""
    yield "## Samples per pixel"
    yield (
        "PSNR in dB after clip to [0, 1] and gamma 2.2 of images of *square* samples; in brackets with the "
        "reference's noise taken out. Every image is compared with the reference of its own pixel filter. "
        f"The first version, commit `{COMMIT}`, joins where its images have been made as told above."
    )
    yield (
        "Below it, how many samples per pixel plain averaging (`box`) needs for the PSNR of "
        f"`{OURS}` and `{PUBLISHED}`: once of *square* samples, once of the *aperture* samples that suit it "
        "better. That is an extrapolation: the mean squared error of the largest buffer that was rendered, "
        "less the reference's noise, is taken to fall as 1/spp from there. The exponents beside it say how "
        "well that law holds where it can be checked, for all buffers and the two largest: -1 is the law; "
        "where the error falls more steeply, because positions are stratified, the number is too large, and "
        "where it falls less steeply, because whites that are clipped and few samples of weight hide errors, "
        "it is too small."
    )
    for counts in measured:
        yield f"### {counts.scene.capitalize()}"
        yield _score_table(counts)
        yield _needed_table(counts)
        missing = _missing(counts)
        if missing:
            yield f"Not rendered, hence missing: {missing}."


def _score_table(counts: SampleCounts) -> str:
    rows = [[name, *(_cell(row.get(spp)) for spp in SPP)] for name, row in counts.scores.items()]
    return markdown_table(["PSNR, dB", *(f"{spp} spp" for spp in SPP)], rows)


def _needed_table(counts: SampleCounts) -> str:
    rows = []
    for sampling, scores in counts.plain.items():
        if not scores:
            continue
        law = plain_law(scores)
        for algorithm in (PUBLISHED, OURS):
            found = counts.scores[algorithm]
            needed = [f"{law.needed(found[spp].error):.0f}" if spp in found else "missing" for spp in SPP]
            rows.append([f"{algorithm} = box of {_LENS_NAMES[sampling]}", *needed, *law.cells])
    head = [
        "samples per pixel that averaging needs",
        *(f"at {spp} spp" for spp in SPP),
        "exponent",
        "of the last two",
    ]
    return markdown_table(head, rows)


def _cell(found: Score | None) -> str:
    return "missing" if found is None else str(found)


def _missing(counts: SampleCounts) -> str:
    """Name what has not been rendered, and the command."""
    missing = sorted({spp for scores in counts.plain.values() for spp in SPP if spp not in scores})
    if not missing:
        return ""
    listed = ", ".join(f"{spp} spp" for spp in missing)
    return f"{listed}. Make it with `{how_to_render([counts.scene], missing)} --reference-spp 0`"
