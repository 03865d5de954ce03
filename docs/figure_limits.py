"""Known limits of the layered method, measured: a part of `figures_layered.py`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fewrays import reconstruct
from fewrays.display import Panel, tone_map
from fewrays.sources.analytic import (
    Plane,
    checker,
    constant,
    disc,
    half_plane,
    reference,
    sample,
    smooth_noise,
)
from figure_drawing import enlarge, write
from figure_measures import BORDER, PUBLISHED, by_layers, print_table, quality, rms_error
from figure_scenes import (
    LENS,
    SPP,
    TRUTH_SPP,
    at_slope,
    green_lost,
    leaves_samples,
    leaves_truth,
    make_lens,
    two_discs,
    two_discs_samples,
)


def limits() -> None:
    """Measure the known limits: shaped highlights, edges that move apart, noise in focus, borders."""
    _aperture()
    _discs_left()

    rows: list[tuple[object, ...]] = []
    for slope in (0, 1, 2, 4, 8, 16):
        planes = [Plane(at_slope(slope), smooth_noise(8, seed=4))]
        samples, truth = sample(planes, LENS, 96, 96, SPP), reference(planes, LENS, 96, 96, spp=TRUTH_SPP)
        noise = np.random.default_rng(0).normal(0, 0.1, (*samples.depth.shape, 1)).astype(np.float32)
        noisy = replace(samples, color=samples.color + noise)
        rows.append(
            (slope, *(f"{rms_error(reconstruct(noisy, m), truth, 32):.2f}" for m in ("box", "layered")))
        )
    print_table(
        "limits: shading noise of 10 % of white in every sample, RMS error in % of white",
        ("C in px", "box", "layered"),
        rows,
    )

    image, truth = by_layers(leaves_samples()), leaves_truth()
    ring = np.ones(image.shape[:2], bool)
    ring[BORDER:-BORDER, BORDER:-BORDER] = False
    error = [
        100 * float(np.sqrt(np.square(image - truth)[where].mean())) for where in (ring, np.logical_not(ring))
    ]
    print(
        f"\n### limits: borders\n\n{error[0]:.2f} % within {BORDER} px of the border, {error[1]:.2f} % inside"
    )
    _highlights()


def _aperture() -> None:
    """Show what becomes of a disc: a bright spot, and a texture."""
    lens = make_lens("disc", "disc")
    wide = make_lens("gaussian", "gaussian", 0.25).refocus(aperture_scale=2.0)  # sigma 1/2, ends at 4 sigma
    spot = [Plane(at_slope(14), constant(0.0)), Plane(at_slope(12), constant(5.0), disc((32, 32), 4))]
    texture = [Plane(at_slope(12), checker(24))]
    rows, panels = [], []
    for name, planes, height in (("bright spot", spot, 64), ("checkerboard of 24 px", texture, 96)):
        image = by_layers(sample(planes, lens, height, height, 16))
        truths = [reference(planes, one, height, height, spp=TRUTH_SPP) for one in (lens, wide)]
        rows.append((name, *(quality(image, truth) for truth in truths)))
        if height == 64:
            shown = (truths[0], truths[1], image)
            captions = ("truth, disc", "truth, Gaussian lens", "layered, disc lens")
            panels = [Panel(enlarge(tone_map(p, 0.5), 4), c) for p, c in zip(shown, captions, strict=True)]
    print_table(
        "limits: a disc aperture, PSNR in dB, C = 12 px, 16 spp",
        ("scene", "against the disc", "against the Gaussian"),
        rows,
    )
    write("layered-aperture", [panels])


def _discs_left() -> None:
    """Measure what is left of the error of Figure 6, with more parts and with many samples."""
    rows: list[tuple[object, ...]] = []
    truth = two_discs(24, 14)["truth"]
    for spp in (16, 128):
        samples = two_discs_samples(24, 14, spp)
        for name, image in (
            ("published", reconstruct(samples, PUBLISHED)),
            *((f"aperture_parts={n}", by_layers(samples, aperture_parts=n)) for n in (1, 7, 19)),
        ):
            rows.append((f"{spp} spp", name, *green_lost(truth, image)))
    print_table(
        "limits: the green disc behind, in % of its radiance",
        ("samples", "image", "worst loss", "mean abs. error", "light lost in all"),
        rows,
    )


def _highlights() -> None:
    """Bright spots behind the edge of a strongly blurred cover."""
    cover = Plane(at_slope(-20), constant(0.15, 0.25, 0.1), half_plane((32, 0), (-1.0, 0.0)))
    black = Plane(at_slope(12), constant(0.02))
    rows: list[tuple[object, ...]] = []
    truths, images = [], []
    rest = reference([cover, black], LENS, 64, 64, spp=TRUTH_SPP)
    for offset in (-10, 0, 10):
        spot = Plane(at_slope(11.9), constant(60.0), disc((32 + offset, 32), 1.5))
        planes = [cover, spot, black]
        truth = reference(planes, LENS, 64, 64, spp=4 * TRUTH_SPP)
        row: list[object] = [f"{offset:+d} px"]
        for method in ("box", PUBLISHED, "layered"):
            runs = [reconstruct(sample(planes, LENS, 64, 64, SPP, seed=seed), method) for seed in range(16)]
            light = [100 * float((run - rest).sum() / (truth - rest).sum() - 1) for run in runs]
            row.append(f"{np.mean(light):+.0f} ± {np.std(light):.0f}")
        truths.append(Panel(enlarge(tone_map(truth, -0.5), 4), f"spot at {offset:+d} px, truth"))
        images.append(Panel(enlarge(tone_map(runs[0], -0.5), 4), "layered, 8 spp"))
        rows.append(tuple(row))
    print_table(
        "limits: a spot of radiance 60 behind a blurred edge, light gained or lost in % over 16 seeds",
        ("place of the spot", "box", "published", "layered"),
        rows,
    )
    write("layered-highlights", [truths, images])
