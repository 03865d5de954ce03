"""Figures and numbers of `layered.md`.

Makes every picture and prints every table of the page, from scenes that need no renderer::

    python docs/figures_layered.py            # everything, several minutes
    python docs/figures_layered.py parts      # one part

The truth of a scene is an image of many samples, or exact where the scene is a plane of waves. Unless a table
says otherwise: 8 samples per pixel, a Gaussian lens of sigma 1/3 sampled uniformly over its square, as in the
paper, and PSNR after clip to [0, 1] and gamma 2.2. Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro

from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.color import srgb_decode, srgb_encode
from fewrays.display import Panel, error_picture, tone_map
from fewrays.layered import LayeredOptions, kernel
from fewrays.layered import plan as layered_plan
from fewrays.layered.aperture import ApertureParts
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.parallel import Execution
from fewrays.sources.analytic import (
    Plane,
    checker,
    constant,
    disc,
    exact_waves,
    reference,
    sample,
    smooth_noise,
    stripes,
)
from figure_drawing import BLUE, GREEN, GREY, INK, ORANGE, Plot, difference, enlarge, layer_colors, write
from figure_limits import limits
from figure_maker import maker
from figure_measures import (
    PUBLISHED,
    by_layers,
    cpu_seconds,
    inner,
    print_table,
    quality,
    relative_times,
    rms_error,
    seam_ratio,
)
from figure_scenes import (
    LENS,
    SPP,
    TRUTH_SPP,
    Floats,
    at_slope,
    floor,
    floor_samples,
    floor_truth,
    leaves,
    leaves_samples,
    leaves_truth,
    moved,
    scattered_discs,
    two_discs,
    two_discs_samples,
    wide_leaves,
)
from figure_slice import draw_slice


def layered_with(
    samples: SampleBuffer, *, levels: bool = True, by_place: bool = True, threads: int | None = None
) -> Image:
    """Reconstruct with the default options, but without coarse bins or weights by place."""
    options = LayeredOptions()
    plan = layered_plan.Plan.for_samples(samples, **asdict(options))
    if not levels:
        slabs = replace(plan.slabs, levels=np.minimum(plan.slabs.levels, 0))
        plan = replace(plan, slabs=slabs)
    image = np.zeros((plan.height, plan.width, 3), np.float32)
    counts = np.zeros(plan.tile_count, np.int32)
    full_weight = layered_plan.FULL_WEIGHT if by_place else 1e4  # which no bin reaches
    with patch.object(kernel, "FULL_WEIGHT", full_weight):
        kernel.reconstruct_tiles(samples, plan, image, counts, None, Execution(threads=threads))
    return image


def overview() -> None:
    """Show what the method makes of a few samples, beside the others, and measure it by samples per pixel."""
    truth = leaves_truth()
    methods = {"box": "box", "published": PUBLISHED, "layered": "layered"}
    rows: list[list[object]] = []
    for spp in (1, 2, 4, 8, 16):
        samples = sample(leaves(), LENS, 128, 192, spp)
        images = {name: reconstruct(samples, method) for name, method in methods.items()}
        if spp == SPP:
            shown = images
        rows.append([f"{spp} spp", *(quality(image, truth) for image in images.values())])
    print_table("overview: PSNR in dB on the leaves", ("leaves", *methods), rows)

    panels = [
        Panel(enlarge(tone_map(inner(i)), 3), n, f"{quality(i, truth):.1f} dB") for n, i in shown.items()
    ]
    panels.append(Panel(enlarge(tone_map(inner(truth)), 3), "truth", f"{TRUTH_SPP} samples per pixel"))
    write("layered-overview", [panels[:2], panels[2:]])


def centre() -> None:
    """Show a slice of the light field moved to the lens centre, and measure what is left of the noise."""
    titles = (
        "The front layer's hits (red) and holes (grey), moved to x - C u with C = -12",
        "as the lens centre sees them: the object stands upright",
    )
    write("layered-epipolar", draw_slice(-12.0, titles))

    methods = ("box", PUBLISHED, "layered")
    rows: list[tuple[object, ...]] = []
    for slope in (0, 0.7, 1.4, 2, 4, 8, 16, 32):
        planes = [Plane(at_slope(slope), checker(4.4))]
        samples, truth = sample(planes, LENS, 96, 96, SPP), reference(planes, LENS, 96, 96, spp=TRUTH_SPP)
        errors = [rms_error(reconstruct(samples, method), truth, 32) for method in methods]
        texture = smooth_noise(6, seed=3)
        exact = exact_waves(texture, at_slope(slope), LENS, 160, 160)
        samples = sample([Plane(at_slope(slope), texture)], LENS, 160, 160, SPP)
        images = [reconstruct(samples, method) for method in methods[1:]]
        images.append(by_layers(samples, aperture_parts=1))
        psnr = [quality(image, exact, 48) for image in images]
        rows.append((slope, *(f"{e:.2f}" for e in errors), *psnr))
    print_table(
        "centre: checkerboard of 4.4 px, RMS error in % of white; smooth noise, PSNR in dB",
        (
            "C in px",
            *(f"checkerboard: {name}" for name in ("box", "published", "layered")),
            "smooth noise: published",
            "layered",
            "aperture_parts=1",
        ),
        rows,
    )


def spacing() -> None:
    """Lay out the layers, and measure what thinner and thicker ones gain."""
    boundaries = layered_plan.Plan.for_samples(floor_samples(), **asdict(LayeredOptions())).slabs.boundaries
    behind = ", ".join(f"{b:.3g}" for b in boundaries[boundaries > 0])
    print(f"\n### spacing: boundaries behind the focal plane, px\n\n{behind}")

    inputs = {"floor": floor_samples(), "leaves": leaves_samples()}
    truths = {"floor": floor_truth(), "leaves": leaves_truth()}
    rows: list[list[object]] = []
    default = LayeredOptions().layer_spacing
    steps = sorted({0.07, default, 0.14, 0.2, 0.28, 0.4, 0.7, 1.0})
    choices: dict[float, dict[str, Any]] = {step: {"layer_spacing": step} for step in steps}
    for step, options in choices.items():
        row: list[object] = [f"{step:g}{' (default)' if step == default else ''}"]
        for scene, samples in inputs.items():
            image, aovs = by_layers(samples, aovs=True, **options)
            row += [quality(image, truths[scene]), float(aovs["layer_count"].mean())]
        rows.append(row)
    wide = sample(floor(), LENS, 96, 576, SPP)
    times = relative_times(wide, list(choices.values()), steps.index(default))
    for row, ratio in zip(rows, times, strict=True):
        row.append(f"{ratio:.2f}")
    print_table(
        "spacing",
        ("layer_spacing", "floor, dB", "layers", "leaves, dB", "layers", "CPU time, floor"),
        rows,
    )


def levels() -> None:
    """Measure bins that grow with the blur against pixels for everything, with ever larger blur."""
    margin, height, width = 160, 128, 192
    rows: list[list[object]] = []
    all_samples = []
    for factor in (1, 2, 4, 8):
        lens = Lens(factor * LENS.c0, factor * LENS.c1, "gaussian", "square")
        truth = reference(leaves(), lens, height, width, spp=TRUTH_SPP)
        samples = sample(
            [moved(plane, margin) for plane in leaves()], lens, height + 2 * margin, width + 2 * margin, SPP
        )
        all_samples.append(samples)
        images = [reconstruct(samples, PUBLISHED), layered_with(samples, levels=False), by_layers(samples)]
        windows = [inner(image, margin) for image in images]
        rows.append(
            [
                f"x {factor}: -{16 * factor} to {14 * factor} px",
                *(f"{psnr_display(window, truth):.2f}" for window in windows),
                psnr_display(windows[2], windows[1]),
            ]
        )
    runs: list[Callable[[SampleBuffer], object]] = [
        lambda s: layered_with(s, levels=False, threads=1),
        lambda s: by_layers(s, threads=1),
    ]
    times = [
        [cpu_seconds(lambda: run(samples), 3) for run in runs]  # noqa: B023
        for samples in all_samples
    ]
    for row, (plain, ours) in zip(rows, times, strict=True):
        row += [f"{plain / times[0][1]:.2f}", f"{ours / times[0][1]:.2f}"]
    head = ("slopes", "published, dB", "pixels only, dB", "layered, dB", "layered against pixels only, dB")
    print_table("levels", (*head, "CPU time, pixels only", "CPU time, layered"), rows)


def place() -> None:
    """Measure weighing bins by place against weighing them by the samples in them."""
    rows: list[tuple[object, ...]] = []
    for slope in (2, 4, 8, 16, 32):
        planes = [Plane(at_slope(slope), checker(4 * slope**0.5))]
        truth = reference(planes, LENS, 128, 128, spp=2 * TRUTH_SPP)
        row: list[object] = [slope]
        for spp in (2, 8):
            samples = sample(planes, LENS, 128, 128, spp)
            images = (layered_with(samples, by_place=False), by_layers(samples))
            row += [quality(image, truth, 40) for image in images]
        rows.append(tuple(row))
    head = ("C in px", *(f"{spp} spp, {name}" for spp in (2, 8) for name in ("by samples", "by place")))
    print_table("place: checkerboard, PSNR in dB", head, rows)


def parts() -> None:
    """Split the aperture in parts: how well they add up to it, and what they gain."""
    axis = np.linspace(-4, 4, 401)
    u = np.stack(np.meshgrid(axis, axis), axis=-1)
    rows: list[tuple[object, ...]] = []
    inputs = {"leaves": leaves_samples(), "two discs": two_discs_samples(24, 14)}
    truths = {"leaves": leaves_truth(), "two discs": two_discs(24, 14)["truth"]}
    counts = ApertureParts.COUNTS
    times = relative_times(wide_leaves(), [{"aperture_parts": n} for n in counts], 1)
    shown: list[list[Panel]] = [[], [], []]
    for n, ratio in zip(counts, times, strict=True):
        split = ApertureParts.split(1.0, n)
        distance2 = ((u[..., None, :] - split.parts[:, :2].astype(np.float64)) ** 2).sum(axis=-1)
        mixture = np.exp(-0.5 * distance2 / split.sigma**2) @ split.parts[:, 2] / split.sigma**2
        deviation = 100 * np.abs(mixture - np.exp(-0.5 * (u**2).sum(axis=-1))).max()
        images = {name: by_layers(samples, aperture_parts=n) for name, samples in inputs.items()}
        psnr = {name: quality(image, truths[name]) for name, image in images.items()}
        rows.append((n, f"{split.sigma:.2f}", f"{deviation:.1f}", *psnr.values(), f"{ratio:.2f}"))
        if n in (1, 7, 19):
            title = f"{n} part{'s' * (n > 1)}"
            off = {name: difference(inner(image), inner(truths[name]), 4) for name, image in images.items()}
            shown[0].append(Panel(enlarge(off["leaves"], 2), title, f"leaves, {psnr['leaves']:.1f} dB"))
            discs_shown = tone_map(inner(images["two discs"]))
            shown[1].append(Panel(enlarge(discs_shown, 4), f"two discs, {psnr['two discs']:.1f} dB"))
            shown[2].append(Panel(enlarge(off["two discs"], 4)))
    head = (
        "aperture_parts",
        "width of a part in s",
        "worst error of the sum, % of its peak",
        "leaves, dB",
        "two discs, dB",
    )
    print_table("parts", (*head, "CPU time, leaves"), rows)
    shown[0].append(Panel(enlarge(tone_map(inner(truths["leaves"])), 2), "truth"))
    shown[1].append(Panel(enlarge(tone_map(inner(truths["two discs"])), 4), "truth"))
    write("layered-parts", shown)


def covariance() -> None:
    """Compare the covariance of two layers' edges over the lens with its first-order estimate."""
    sigma, pixel = 1 / 3, 0.5
    x = np.linspace(-30, 30, 601)
    rows: list[tuple[object, ...]] = []
    cases = ((-16.0, 14.0), (-16.0, -9.0), (-16.0, 5.0), (8.0, 14.0))
    for n in ApertureParts.COUNTS:
        row: list[object] = [n]
        for front, back in cases:
            truth = _edges_truth(x, front, back, sigma, pixel)
            for order in (0, 1):
                estimate = _edges_estimate(x, front, back, sigma, pixel, n, order)
                row.append(100 * float(np.abs(estimate - truth).max()))
        rows.append(tuple(row))
    head = ("aperture_parts", *(f"C = {f:g}, {b:g}: {o}" for f, b in cases for o in ("means", "first order")))
    print_table("covariance: worst error of what shows behind an edge, in %", head, rows)

    front, back = cases[0]
    plot = Plot(760, 260, (-24, 24), (-0.02, 0.56))
    plot.line([(-24, 0), (24, 0)], GREY, 1)
    for name, color, y, values in (
        ("truth", INK, 0.5, _edges_truth(x, front, back, sigma, pixel)),
        ("product of the means", BLUE, 0.44, _edges_estimate(x, front, back, sigma, pixel, 1, 0)),
        ("first order", ORANGE, 0.38, _edges_estimate(x, front, back, sigma, pixel, 1, 1)),
        ("first order, 7 parts", GREEN, 0.32, _edges_estimate(x, front, back, sigma, pixel, 7, 1)),
    ):
        plot.line(list(zip(x.tolist(), values.tolist(), strict=True)), color, 2)
        plot.text(-23, y, name, color)
    plot.text(10, 0.5, "image position from -24 to 24 px", size=13)
    title = "What shows of a surface behind, whose edge lies under the edge of a cover in front"
    write("layered-covariance", [[Panel(plot.picture(), title, "slopes of -16 and 14 px")]])


def _normal_cdf(x: Floats) -> Floats:
    return np.array([0.5 * math.erfc(-t / math.sqrt(2)) for t in x])


def _edges_truth(x: Floats, front: float, back: float, sigma: float, pixel: float) -> Floats:
    """Mean over the lens of a cover's transmittance times the presence of what is behind it."""
    u, weights = np.polynomial.hermite_e.hermegauss(200)
    values = [
        weight * _normal_cdf((x - front * sigma * t) / pixel) * _normal_cdf(-(x - back * sigma * t) / pixel)
        for t, weight in zip(u, weights / weights.sum(), strict=True)
    ]
    return np.asarray(np.sum(values, axis=0))


def _edges_estimate(
    x: Floats, front: float, back: float, sigma: float, pixel: float, count: int, order: int
) -> Floats:
    """Estimate the same from each part's means and, to first order, their covariance."""
    split = ApertureParts.split(sigma**2, count)
    result = np.zeros_like(x)
    for u, _, weight in split.parts.astype(np.float64):
        passed, present = math.hypot(pixel, front * split.sigma), math.hypot(pixel, back * split.sigma)
        a, b = (x - front * u) / passed, -(x - back * u) / present
        slope_a, slope_b = (np.exp(-0.5 * t**2) / math.sqrt(2 * math.pi) for t in (a, b))
        gradients = -slope_a / passed * slope_b / present
        mean_a, mean_b = _normal_cdf(a), _normal_cdf(b)
        together = mean_a * mean_b + order * split.sigma**2 * front * back * gradients
        bounded = np.clip(together, np.maximum(mean_a + mean_b - 1, 0), np.minimum(mean_a, mean_b))
        result += weight * bounded
    return result


def covered() -> None:
    """Measure what is under a cover that fewer and fewer rays pass (section 7.1.4)."""
    rows: list[tuple[object, ...]] = []
    shown: list[list[Panel]] = [[], [], []]
    for fill in (0.5, 0.8, 0.9, 0.95):
        cover = Plane(at_slope(-12), constant(0.05, 0.12, 0.03), stripes(16, fill=fill, direction=(1, 0.4)))
        row: list[object] = [f"{100 - 100 * fill:.0f} %"]
        for behind in (0, 6):
            planes = [cover, Plane(at_slope(behind), checker(8, (0.2, 0.1, 0.1), (0.9, 0.8, 0.6)))]
            truth = reference(planes, LENS, 96, 128, spp=2 * TRUTH_SPP)
            samples = sample(planes, LENS, 96, 128, SPP)
            images = {name: reconstruct(samples, name) for name in ("box", PUBLISHED, "layered")}
            row += [f"{rms_error(image, truth):.2f}" for image in images.values()]
            if (fill, behind) in ((0.8, 6), (0.9, 0)):
                title = f"{100 - 100 * fill:.0f} % pass, wall at {behind} px"
                shown[0].append(Panel(enlarge(tone_map(inner(truth), 1.0), 4), f"truth: {title}"))
                for line, method in ((shown[1], PUBLISHED), (shown[2], "layered")):
                    picture = enlarge(tone_map(inner(images[method]), 1.0), 4)
                    line.append(Panel(picture, method, f"{quality(images[method], truth):.1f} dB"))
        rows.append(tuple(row))
    names = ("box", "published", "layered")
    head = ("rays that pass", *(f"wall at {b} px: {n}" for b in (0, 6) for n in names))
    print_table("covered: bars of C = -12 px before a wall, RMS error in % of white", head, rows)
    write("layered-covered", shown)


def lights() -> None:
    """Follow a light a thousand times brighter than the scene in four places, and tone-mapped input."""
    rows: list[tuple[object, ...]] = []
    shown: list[list[Panel]] = [[], [], []]
    light = (constant(1000.0), disc((48, 48), 3))
    wall, bars = smooth_noise(8, waves=8, seed=1), stripes(16, direction=(1, 0.5))
    for name, planes in (
        ("in focus", [Plane(at_slope(6), wall), Plane(at_slope(0), *light)]),
        ("out of focus", [Plane(at_slope(14), wall), Plane(at_slope(10), *light)]),
        (
            "behind a cover",
            [Plane(at_slope(8), wall), Plane(at_slope(4), *light), Plane(at_slope(-10), constant(0.2), bars)],
        ),
        ("in front", [Plane(at_slope(0), wall), Plane(at_slope(-10), *light)]),
    ):
        truth = reference(planes, LENS, 96, 96, spp=4 * TRUTH_SPP)
        images: dict[str, list[Image]] = {"box": [], PUBLISHED: [], "layered": []}
        for seed in range(16):
            samples = sample(planes, LENS, 96, 96, SPP, seed=seed)
            for method, runs in images.items():
                runs.append(reconstruct(samples, method))
        row: list[object] = [name]
        for runs in images.values():
            total = np.array([image.sum(dtype=np.float64) for image in runs]) / truth.sum(dtype=np.float64)
            row.append(f"{total.mean():.3f} ± {total.std():.3f}")
        row.append(f"{min(float(image.min()) for image in images['layered']):.2f}")
        rows.append(tuple(row))
        exposure = -math.log2(truth.max())
        for line, (kind, image) in zip(
            shown,
            {"truth": truth, "published": images[PUBLISHED][0], "layered": images["layered"][0]}.items(),
            strict=True,
        ):
            crop = tone_map(image[26:70, 26:70], exposure)
            line.append(Panel(enlarge(crop, 5), f"{name}, {kind}"))
    head = ("light", "box", "published", "layered", "least value, layered")
    print_table("lights: total radiance over the truth's, 16 seeds, radiance 1000", head, rows)
    write("layered-lights", shown)

    planes = [*leaves(), Plane(at_slope(13.9), constant(6.0), scattered_discs(30, 3, 9))]
    truth = reference(planes, LENS, 128, 192, spp=2 * TRUTH_SPP)
    samples = sample(planes, LENS, 128, 192, SPP)
    display = np.round(255 * srgb_encode(samples.color)) / 255
    from_display = srgb_decode(by_layers(replace(samples, color=display.astype(np.float32))))
    print_table(
        "lights: leaves with highlights of radiance 6",
        ("input", "PSNR, dB", "mean radiance / truth"),
        [
            (name, quality(image, truth), f"{inner(image).mean() / inner(truth).mean():.2f}")
            for name, image in (
                ("float, linear", by_layers(samples)),
                ("8 bits, tone-mapped", from_display),
            )
        ],
    )


def seams() -> None:
    """Measure whether the error jumps across tile borders, and whether the tile's size matters."""
    scenes = {
        "floor": (floor_samples(), floor_truth()),
        "leaves": (leaves_samples(), leaves_truth()),
    }
    rows: list[tuple[object, ...]] = []
    for method in (PUBLISHED, "layered"):
        ratios = [seam_ratio(reconstruct(s, method, tile=32), truth) for s, truth in scenes.values()]
        rows.append((f"{method}, tile=32", *(f"{ratio:.2f}" for ratio in ratios)))
    print_table(
        "seams: jumps of the error across tile borders over jumps elsewhere", ("method", *scenes), rows
    )
    print_table(
        "seams: PSNR in dB of tiles of 32 px against tiles of 128 px",
        ("method", *scenes),
        [
            (method, *(
                quality(reconstruct(s, method, tile=32), reconstruct(s, method, tile=128))
                for s, _ in scenes.values()
            ))
            for method in (PUBLISHED, "layered")
        ],
    )  # fmt: skip


def options() -> None:
    """Measure a few combinations of options that make sense."""
    choices: dict[str, dict[str, Any]] = {
        "layer_spacing=0.4, aperture_parts=1": {"layer_spacing": 0.4, "aperture_parts": 1},
        "aperture_parts=1": {"aperture_parts": 1},
        "layer_spacing=0.3": {"layer_spacing": 0.3},
        "(defaults)": {},
        "aperture_parts=13": {"aperture_parts": 13},
        "aperture_parts=19": {"aperture_parts": 19},
        "tile=32": {"tile": 32},
        "tile=256": {"tile": 256},
    }
    times = relative_times(wide_leaves(), list(choices.values()), 3)
    rows = [
        (
            f"`{name}`" if chosen else name,
            quality(by_layers(floor_samples(), **chosen), floor_truth()),
            quality(by_layers(leaves_samples(), **chosen), leaves_truth()),
            f"{ratio:.2f}",
        )
        for (name, chosen), ratio in zip(choices.items(), times, strict=True)
    ]
    print_table("options", ("options", "floor, dB", "leaves, dB", "CPU time, leaves"), rows)


def layers() -> None:
    """Show what each layer adds to the image."""
    samples, truth = leaves_samples(), leaves_truth()
    image, aovs = by_layers(samples, aovs=True)
    opacity = aovs["layer_opacity"]
    occurs = np.flatnonzero(opacity.max(axis=(0, 1)) > 0.01)
    slopes = samples.lens.slope(samples.depth)
    slabs = layered_plan.Plan.for_samples(samples, **asdict(LayeredOptions())).slabs
    panels = [
        Panel(enlarge(tone_map(image), 2), "image"),
        Panel(
            enlarge(tone_map(layer_colors(opacity[..., occurs])), 2),
            "which layers a pixel shows",
            "red in front, green in focus, blue behind",
        ),
        Panel(enlarge(error_picture(tone_map(image), tone_map(truth)), 2), "error against the truth"),
    ]
    for layer in (occurs[0], occurs[1], occurs[3]):
        mean = float(slopes[slabs.of_slope(slopes) == layer].mean())
        radiance = tone_map(aovs["layer_radiance"][:, :, layer])
        panels.append(Panel(enlarge(radiance, 2), f"layer_radiance, C = {mean:.0f} px"))
    write("layered-aovs", [panels[:3], panels[3:]])
    total = aovs["layer_radiance"].sum(axis=2)
    print(f"\nlayers that hold samples: {len(occurs)} of {opacity.shape[2]}")
    print(f"sum of layer_radiance - image: {np.abs(total - image).max():.1e} at most")
    print(f"sum of layer_opacity - 1: {np.abs(opacity.sum(axis=2) - 1).max():.1e} at most")


PARTS: dict[str, Callable[[], None]] = {
    part.__name__: part
    for part in (
        overview,
        centre,
        spacing,
        levels,
        place,
        parts,
        covariance,
        covered,
        lights,
        seams,
        options,
        layers,
        limits,
    )
}

if __name__ == "__main__":
    tyro.cli(maker(PARTS, "layered.md"))
