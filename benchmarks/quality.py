"""How close each method comes to the reference on the example scenes, beside Open Image Denoise.

    python examples/render.py
    python benchmarks/quality.py

Needs ``fewrays[bench]``. Writes ``docs/quality.md`` and its pictures in ``docs/images/``. An image is always
compared with the reference of its own pixel filter; samples are both those that the layered paper asks for
(lens positions uniform over the square) and those that suit averaging best (drawn from the aperture).
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
import foundation
import sample_counts
from contenders import BEST, BEST_OPTIONS, OURS, PLAIN, pixel_filter_of
from example_renders import SAMPLINGS, SCENES, Scene, load_scene, require_match, require_renders
from fewrays.display import Candidate, save_picture
from fewrays.method import Image
from fewrays.metrics import Comparison, compare
from fewrays.pixel_filter import PixelFilterShape
from peers import DENOISER, denoise, require_bench
from pictures import hero, scene_sheet
from report import ROOT, markdown_table, met, provenance, write_page
from scores import decibels, without_noise

TARGETS = {DENOISER: 5.0, PLAIN: 12.0}
"""What the headline method shall gain, in dB over the others on the same samples."""
HERO = "foliage"
SAMPLING_NAMES = {"square": "square", "gaussian": "aperture"}
FILTER_NAMES: dict[PixelFilterShape, str] = {"gaussian": "Gaussian, σ = 0.5 px", "box": "box, 1 px"}


@dataclass(frozen=True)
class Entry:
    """An image ``(H, W, 3)`` made of samples of one lens sampling, and how good it is.

    Parameters
    ----------
    algorithm : str
        A method's name, or the denoiser's.
    sampling : str
        How the samples' lens positions were drawn.
    pixel_filter : {"gaussian", "box"}
        The pixel filter of the image, and of the reference that it was compared with.
    image : ndarray, (H, W, 3)
        Linear radiance.
    quality : Comparison
        As measured.
    corrected : float
        PSNR after gamma 2.2 in dB, less what the reference's noise adds to the error.
    """

    algorithm: str
    sampling: str
    pixel_filter: PixelFilterShape
    image: Image
    quality: Comparison
    corrected: float


@dataclass(frozen=True)
class Margin:
    """What the headline method gains over another on one scene, in dB: as measured, and corrected."""

    measured: float
    corrected: float


def main() -> None:
    """Measure, and write the page and the pictures."""
    options = parse_options()
    require_bench()
    require_renders(options.renders, options.scenes, options.spp)
    images = options.out / "images"
    images.mkdir(parents=True, exist_ok=True)
    measured: dict[str, list[Entry]] = {}
    sections, gains = [], []
    for name in options.scenes:
        scene = load_scene(options.renders, name, options.spp)
        entries = list(measure(scene, options.renders))
        measured[name] = entries
        sections.append(scene_section(scene, entries))
        draw(scene, entries, images)
        gains.append(gain(options.renders, scene, entries))
    counts = [sample_counts.measure_counts(options.renders, name) for name in options.scenes]
    write_page(
        options.out / "quality.md",
        *introduction(options.spp),
        provenance(f"python benchmarks/quality.py --scenes {' '.join(options.scenes)} --spp {options.spp}"),
        "## What the layered method gains",
        *headline(measured),
        *foundation.section([g for g in gains if g], options.scenes, options.spp),
        *sample_counts.section(counts),
        *sections,
    )
    print(options.out / "quality.md")


def parse_options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--renders", type=Path, default=ROOT / "examples" / "renders")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES), metavar="SCENE")
    parser.add_argument("--spp", type=int, default=8, help="samples per pixel (8)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for the page (docs)")
    return parser.parse_args()


def measure(scene: Scene, folder: Path) -> Iterator[Entry]:
    """Yield every method's image of a scene and the denoiser's, for both lens samplings."""
    for sampling in SAMPLINGS:
        samples = scene.samples[sampling]
        for method in reversed(fewrays.METHODS.values()):
            print(f"{scene.name}, {sampling} sampling: {method.name}", file=sys.stderr)
            image = fewrays.reconstruct(samples, method.name)
            yield entry(scene, method.name, sampling, pixel_filter_of(method.name), image)
            if method.name == OURS:
                best = fewrays.reconstruct(samples, OURS, **BEST_OPTIONS)
                yield entry(scene, BEST, sampling, pixel_filter_of(OURS), best)
            if method.name == PLAIN:
                require_match(folder, scene, image)
                yield entry(scene, DENOISER, sampling, "box", denoise(image))


def entry(scene: Scene, algorithm: str, sampling: str, pixel_filter: PixelFilterShape, image: Image) -> Entry:
    """Compare an image with the reference of its pixel filter."""
    reference = scene.references[pixel_filter]
    quality = compare(image, reference.image)
    corrected = without_noise(quality.psnr_display, reference.noise_psnr)
    return Entry(algorithm, sampling, pixel_filter, image, quality, corrected)


def gain(folder: Path, scene: Scene, entries: Sequence[Entry]) -> foundation.Gain | None:
    """Compare the headline method's image with that of its first version, if that is there."""
    ours = find(entries, OURS, "square")
    spp = scene.samples["square"].spp
    return foundation.measure_gain(folder, scene.name, spp, ours.image, scene.references[ours.pixel_filter])


def find(entries: Sequence[Entry], algorithm: str, sampling: str) -> Entry:
    """Return the entry of an algorithm and a sampling."""
    return next(e for e in entries if (e.algorithm, e.sampling) == (algorithm, sampling))


def margin(
    entries: Sequence[Entry], other: str, other_sampling: str, ours_sampling: str = "square"
) -> Margin:
    """Return what the headline method gains over another algorithm's image of the same scene."""
    ours, theirs = find(entries, OURS, ours_sampling), find(entries, other, other_sampling)
    return Margin(ours.quality.psnr_display - theirs.quality.psnr_display, ours.corrected - theirs.corrected)


def introduction(spp: int) -> Iterator[str]:
    """Say what was measured against what."""
    yield "# Quality"
    yield (
        f"Every method, and {DENOISER}, on the example scenes at {spp} samples per pixel, through a Gaussian "
        "lens (σ = 1/3 of its radius). Made by a benchmark, not by hand."
    )
    yield (
        "**Same truth for everyone.** An image is compared with a reference of its own pixel filter: the "
        f"box filter for the plain average of each pixel's samples (`{PLAIN}`) and for {DENOISER}, which is "
        "given that average; the Gaussian of σ = 0.5 px for the others. References are brute-force averages "
        "and have noise of their own, stated as the PSNR that it leaves. No image can measure noticeably "
        "better than that, however good it is, and the noise is larger under the narrower box filter. The "
        "column *noise taken out* therefore repeats the PSNR after gamma 2.2 with the reference's noise "
        "subtracted from the mean squared error; the other columns are as measured."
    )
    yield (
        "**Same samples for everyone.** The layered paper spreads lens positions uniformly over the square "
        "around the lens (*square*) and weighs them by the aperture. That wastes samples of plain averaging, "
        f"hence also of {DENOISER}, for which positions drawn from the aperture itself (*aperture*) are "
        "better. Both are shown, at equal samples per pixel."
    )
    yield (
        f"**The peer at its best.** {DENOISER} runs at high quality in HDR mode. It knows neither depth nor "
        "lens positions: it is the tool that users have today, not an algorithm for the same input."
    )
    yield (
        "**Pictures** are of the *square* samples. Their reference has the Gaussian pixel filter; the plain "
        f"average and {DENOISER}'s image have the box filter, so that a part of their error maps in sharp "
        "places is the difference of the filters. The figures above the images are free of that."
    )


def headline(measured: dict[str, list[Entry]]) -> Iterator[str]:
    """Tabulate the margins, and say which targets are met."""
    yield (
        f"PSNR after clip to [0, 1] and gamma 2.2: `{OURS}` on *square* samples minus the other in dB, as "
        "measured, and in brackets with the references' noise taken out."
    )
    columns = [
        (f"minus {DENOISER}, same samples", DENOISER, "square"),
        (f"minus {PLAIN}, same samples", PLAIN, "square"),
        (f"minus {DENOISER}, aperture samples", DENOISER, "gaussian"),
        (f"minus {PLAIN}, aperture samples", PLAIN, "gaussian"),
    ]
    margins = {
        scene: [margin(entries, other, sampling) for _, other, sampling in columns]
        for scene, entries in measured.items()
    }
    rows = [
        [scene, *(f"{m.measured:+.2f} ({m.corrected:+.2f})" for m in values)]
        for scene, values in margins.items()
    ]
    yield markdown_table(["scene", *(head for head, _, _ in columns)], rows)
    verdicts = [
        verdict(head, TARGETS[other], {s: margin(e, other, sampling) for s, e in measured.items()})
        for head, other, sampling in columns[:2]
    ]
    both = fair_verdict({s: margin(e, DENOISER, "gaussian", "gaussian") for s, e in measured.items()})
    yield "\n".join([*verdicts, both])


def verdict(label: str, target: float, margins: dict[str, Margin]) -> str:
    """Say on which scenes a target in dB is met, as measured; and where taking noise out changes that."""
    missed = [f"{scene} ({m.measured:+.2f} dB)" for scene, m in margins.items() if m.measured < target]
    text = f"- Target, {label}: at least {target:+.0f} dB. "
    text += f"{met(not missed)} on {', '.join(missed) or 'every scene'}."
    changed = [scene for scene, m in margins.items() if (m.measured < target) != (m.corrected < target)]
    if changed:
        text += f" With the references' noise taken out the answer differs for {', '.join(changed)}."
    return text


def fair_verdict(margins: dict[str, Margin]) -> str:
    """Say what is gained where both have the samples that suit averaging best."""
    values = ", ".join(f"{scene} {m.measured:+.2f} ({m.corrected:+.2f})" for scene, m in margins.items())
    return (
        f"- With *aperture* samples for both, `{OURS}` minus {DENOISER} in dB: {values}. There is no target "
        "for this one."
    )


def scene_section(scene: Scene, entries: Sequence[Entry]) -> str:
    """Return a scene's part of the page: its references, its table, its picture."""
    references = "; ".join(
        f"{FILTER_NAMES[pixel_filter]}: {reference.noise_psnr:.1f} dB"
        for pixel_filter, reference in scene.references.items()
    )
    size = scene.samples["square"]
    head = [
        "image", "samples", "pixel filter", "PSNR, γ 2.2", "noise taken out",
        "PSNR, linear", "relMSE", "SSIM", "FLIP",
    ]  # fmt: skip
    return "\n\n".join(
        [
            f"## {scene.name.capitalize()}",
            f"{size.width} x {size.height} pixels. References of {scene.references['box'].spp} samples per "
            f"pixel; the PSNR that their noise leaves: {references}.",
            markdown_table(head, [table_row(e) for e in entries]),
            f"![{scene.name}: box image, {DENOISER}, {OURS}, reference](images/{scene.name}.png)",
        ]
    )


def table_row(row: Entry) -> list[str]:
    """Return the cells of an entry."""
    quality = row.quality
    return [
        row.algorithm,
        SAMPLING_NAMES[row.sampling],
        row.pixel_filter.replace("gaussian", "Gaussian"),
        f"{quality.psnr_display:.2f} dB",
        decibels(row.corrected) + (" dB" if math.isfinite(row.corrected) else ""),
        f"{quality.psnr:.2f} dB",
        f"{quality.relmse:.4f}",
        f"{quality.ssim:.4f}",
        f"{quality.flip:.4f}",
    ]


def draw(scene: Scene, entries: Sequence[Entry], folder: Path) -> None:
    """Write a scene's comparison sheet, and the picture for the top of the README when it is that scene."""
    noisy, denoised, clean = (find(entries, name, "square") for name in (PLAIN, DENOISER, OURS))
    spp = scene.samples["square"].spp
    reference = scene.references[clean.pixel_filter]
    candidates = [
        Candidate(noisy.image, f"{spp} samples per pixel, averaged", caption(noisy)),
        Candidate(denoised.image, DENOISER, caption(denoised)),
        Candidate(clean.image, f"the same samples, {OURS}", caption(clean)),
    ]
    note = f"{reference.spp} samples per pixel, noise {reference.noise_psnr:.1f} dB"
    sheet = scene_sheet(candidates, Candidate(reference.image, "reference", note))
    save_picture(folder / f"{scene.name}.png", sheet)
    if scene.name == HERO:
        after = Candidate(clean.image, "the same samples, fewrays")
        save_picture(folder / "hero.png", hero(candidates[0], after, reference.image))


def caption(row: Entry) -> str:
    """Return an entry's quality in one line."""
    return f"PSNR {row.quality.psnr_display:.1f} dB · FLIP {row.quality.flip:.3f}"


if __name__ == "__main__":
    main()
