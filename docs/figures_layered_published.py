"""Figures and numbers of `layered-published.md`.

Makes every picture and prints every table of the page, from scenes that need no renderer::

    python docs/figures_layered_published.py            # everything, some minutes
    python docs/figures_layered_published.py discs      # one part

The truth of a scene is an image of many samples, or exact where the scene is a plane of waves. Unless a table
says otherwise: 8 samples per pixel, a Gaussian lens of sigma 1/3 sampled uniformly over its square, as in the
paper, and PSNR after clip to [0, 1] and gamma 2.2. Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import tyro
from PIL import Image as Pillow

from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.display import Panel, error_picture, tone_map
from fewrays.layered_published import PublishedOptions
from fewrays.layered_published import plan as published_plan
from fewrays.layered_published import reference as published_reference
from fewrays.layered_published.filters import FilterRule, LayerFilter
from fewrays.layered_published.partitions import Partitions
from fewrays.method import Image
from fewrays.sources.analytic import (
    Plane,
    checker,
    constant,
    disc,
    exact_waves,
    reference,
    sample,
    smooth_noise,
)
from figure_drawing import (
    BLUE,
    GREY,
    ORANGE,
    PAPER,
    Plot,
    difference,
    enlarge,
    layer_colors,
    visible_opacity,
    write,
)
from figure_maker import maker
from figure_measures import (
    PUBLISHED,
    by_layers,
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
    at_slope,
    floor_samples,
    floor_truth,
    green_lost,
    leaves,
    leaves_samples,
    leaves_truth,
    make_lens,
    square_wave,
    two_discs,
    two_discs_samples,
    wide_leaves,
)
from figure_slice import draw_slice

# The method with a rule of its own, run by its NumPy definition.


@dataclass(frozen=True)
class UnboundedWeights(FilterRule):
    """Importance samples divided by their density, whatever comes out."""

    def filter(self, c_min: float, c_max: float) -> LayerFilter:
        """Return the filter of a layer."""
        uniform = FilterRule(**{**vars(self), "sampling": "square"}).filter(c_min, c_max)
        return replace(uniform, falloff=uniform.falloff - 0.5 / self.sampling_sigma**2)


def published_rule(lens: Lens) -> FilterRule:
    """Return the published method's filter rule with its default options."""
    options = PublishedOptions()
    return FilterRule.for_lens(lens, "sheared", sigma_pix=options.sigma_pix, max_sigma_x=options.max_sigma_x)


def published_with(samples: SampleBuffer, rule: FilterRule) -> Image:
    """Reconstruct with the published method's default options and another filter rule."""
    options = PublishedOptions()
    partitions = Partitions.of_constant_energy(
        options.partitions,
        sigma_u=rule.sigma_u,
        sigma_x=options.partition_sigma_x,
        bin_size=options.bin_size,
    )
    plan = published_plan.Plan(
        height=samples.height,
        width=samples.width,
        tile=options.tile,
        ring=options.ring,
        partitions=partitions,
        rule=rule,
        max_layers=None,
        slots=np.full(partitions.count, -1, np.int32),
    )
    image = np.zeros((samples.height, samples.width, 3), np.float32)
    for tile in range(plan.tile_count):
        row, column, height, width = plan.tile_rectangle(tile)
        pixels, _ = published_reference.reconstruct_tile(samples, plan, tile, None)
        image[row : row + height, column : column + width] = pixels
    return image


# Parts of the page.


def epipolar() -> None:
    """Draw a slice of the light field, its samples, and one layer's samples after scattering."""
    eta = published_rule(LENS).filter(-12, -12).eta
    titles = (
        f"The front layer's hits (red) and holes (grey), moved to x - eta u with eta = {eta:.1f}",
        "the object leans a little; a blur along x alone finishes the filter",
    )
    write("layered-published-epipolar", draw_slice(eta, titles))


def filters() -> None:
    """Work the filter of a layer with slopes from 2 to 6 px out in numbers, and draw it."""
    c_min, c_max, sigma_u, sigma_pix = 2.0, 6.0, 1 / 3, 0.5
    band_u, band_pix = 1 / (2 * np.pi * sigma_u), 1 / (2 * np.pi * sigma_pix)
    width = band_u * (1 / c_min - 1 / c_max)
    c_avg, sigma_x = 2 * c_min * c_max / (c_min + c_max), 1 / (np.pi * width)
    gamma = np.hypot(sigma_u, sigma_x / c_avg)
    eta = sigma_x**2 / (c_avg * gamma**2)
    rule = published_rule(LENS)
    ours = rule.filter(c_min, c_max)
    rows: list[tuple[str, str, str]] = [
        (
            "band limits",
            "Ω_u = 1/(2π σ_u), Ω_pix = 1/(2π σ_pix)",
            f"{band_u:.4f} per lens unit, {band_pix:.4f} per px",
        ),
        ("width of the parallelogram", "Eq. 12: W", f"{width:.5f} per px"),
        ("central slope", "Eq. 13: c_avg", f"{c_avg:.3f} px"),
        ("extent along x", "Eq. 16: σ_x = 1/(π W)", f"{sigma_x:.3f} px"),
        ("extent over the lens", "Eq. 22: σ'_u = γ", f"{gamma:.4f} lens units"),
        ("shear", "Eq. 22: η", f"{eta:.4f} px per lens unit"),
        ("extent of the blur", "Eq. 22: σ'_x = σ_x σ_u / γ", f"{sigma_x * sigma_u / gamma:.4f} px"),
        (
            "the same from `filters.py`",
            "η, σ'_x, σ'_u",
            f"{ours.eta:.4f}, {ours.variance**0.5:.4f}, {(2 * ours.falloff) ** -0.5:.4f}",
        ),
    ]
    small, wide = rule.filter(0.25, 1.25), rule.filter(-3.0, 5.0)
    rows += [
        (
            "small shear, slopes 0.25 to 1.25",
            "Eq. 27, 29: η', σ''_u",
            f"{small.eta:.2f} px, {(2 * small.falloff) ** -0.5:.2f} lens units",
        ),
        (
            "wide wedge, slopes -3 to 5",
            "Eq. 11: η, σ_x, σ_u",
            f"{wide.eta:.0f}, {wide.variance**0.5:.1f} px, {(2 * wide.falloff) ** -0.5:.3f}",
        ),
    ]
    print_table("filters: a layer with slopes from 2 to 6 px", ("quantity", "formula", "value"), rows)

    write(
        "layered-published-filter",
        [[_wedge(c_min, c_max, band_u, band_pix, width, c_avg), *_kernels(c_avg, sigma_x, gamma, eta)]],
    )


def _wedge(c_min: float, c_max: float, band_u: float, band_pix: float, width: float, c_avg: float) -> Panel:
    plot = Plot(270, 270, (-0.36, 0.36), (-0.62, 0.62))
    for sign in (-1, 1):
        tip = [plot.at(sign * band_u / c, sign * band_u) for c in (c_min, c_max)]
        plot.draw.polygon([plot.at(0, 0), *tip], (255, 205, 150))
    plot.line([(-1, 0), (1, 0)], GREY, 1)
    plot.line([(0, -1), (0, 1)], GREY, 1)
    box = [(-band_pix, -band_u), (band_pix, -band_u), (band_pix, band_u), (-band_pix, band_u)]
    plot.line([*box, box[0]], BLUE, 2)
    edge = [(s * band_u / c_avg + t * width / 2, s * band_u) for s, t in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
    plot.line([*edge, edge[0]], ORANGE, 2)
    plot.text(0.01, 0.57, "frequency of u", size=13)
    plot.text(0.17, -0.06, "of x", size=13)
    plot.text(0.04, -0.41, "lens and pixel", BLUE, 14)
    plot.text(-0.3, 0.41, "sheared", ORANGE, 14)
    return Panel(plot.picture(), "Frequencies, C from 2 to 6 px", "shaded: where the layer's light is")


def _kernels(c_avg: float, sigma_x: float, gamma: float, eta: float) -> list[Panel]:
    """Draw the kernel twice: the first factors' lines of constant argument, then the second's."""
    side, x_span, u_span = 270, 6.0, 2.0
    x, u = np.meshgrid(np.linspace(-x_span, x_span, 2 * side), np.linspace(u_span, -u_span, 2 * side))
    kernel = np.exp(-0.5 * (x / sigma_x) ** 2 - 0.5 * ((u - x / c_avg) * 3) ** 2)
    shade = (1 - kernel[..., None]) * np.array(PAPER) + kernel[..., None] * np.array((90, 130, 190))
    panels = []
    for title, note, lines in (
        (
            "Eq. 15: extent in x, then a shear in u",
            f"N(x; {sigma_x:.1f} px) N(u - x / {c_avg:.1f}; 1/3)",
            [((-x_span, -x_span / c_avg), (x_span, x_span / c_avg))],
        ),
        (
            "Eq. 23: extent in u, then a shear in x",
            f"N(x - {eta:.2f} u; {sigma_x / 3 / gamma:.2f} px) N(u; {gamma:.2f})",
            [((-eta * u_span, -u_span), (eta * u_span, u_span))],
        ),
    ):
        plot = Plot(side, side, (-x_span, x_span), (-u_span, u_span))
        plot.image.paste(Pillow.fromarray(shade.astype(np.uint8)))
        for rim in (-1, 1):
            plot.line([(-x_span, rim), (x_span, rim)], GREY, 1)
        plot.text(-5.75, 1.2, "lens rim, u = 1", GREY, 13)
        for line in lines:
            plot.line(line, ORANGE, 2)
        plot.text(-5.75, 1.75, "u", size=14)
        plot.text(5.2, -1.75, "x", size=14)
        panels.append(Panel(plot.picture(), title, note))
    return panels


def partitions() -> None:
    """Show the boundaries between partitions, and what narrower partitions gain."""
    rows: list[list[object]] = []
    truths = {"floor": floor_truth(), "leaves": leaves_truth()}
    inputs = {"floor": floor_samples(), "leaves": leaves_samples()}
    for count, extent in ((15, 8.0), (25, 16.0)):
        table = Partitions.of_constant_energy(count, sigma_u=1 / 3, sigma_x=extent, bin_size=0.5)
        used = (table.first_bin + 1 + np.flatnonzero(np.diff(table.table.astype(int)))) * 0.5
        one_side = ", ".join(f"{b:g}" for b in sorted(used[used > 0], reverse=True))
        row: list[object] = [f"{count}, {extent:g} px", one_side]
        for scene, samples in inputs.items():
            image, aovs = reconstruct(
                samples, PUBLISHED, aovs=True, partitions=count, partition_sigma_x=extent
            )
            row += [quality(image, truths[scene]), float(aovs["layer_count"].mean())]
        rows.append(row)
    head = ("partitions a side, partition_sigma_x", "boundaries of C on either side, px")
    print_table("partitions", (*head, "floor, dB", "layers", "leaves, dB", "layers"), rows)


def discs() -> None:
    """Measure what averaging opacity costs: one disc before another, both out of focus (Figures 6 to 8)."""
    rows, panels = [], []
    for name, slope, front_radius in (
        ("as in Figure 6", 24.0, 14.0),
        ("lens half as wide", 12.0, 14.0),
        ("front disc half as wide", 24.0, 7.0),
    ):
        images = two_discs(slope, front_radius)
        truth = images["truth"]
        images["published"] = reconstruct(two_discs_samples(slope, front_radius), PUBLISHED)
        for key, source in (("predicted", "Eq. 37, from each disc's own image"), ("published", "published")):
            rows.append((name, source, *green_lost(truth, images[key])))
        shown = [
            *(tone_map(images[key]) for key in ("truth", "predicted", "published")),
            difference(images["published"], truth, 2),
        ]
        captions = (name, "Eq. 37 predicts", "published, 16 spp", "difference, doubled")
        panels.append([Panel(enlarge(p, 2), title) for p, title in zip(shown, captions, strict=True)])
    head = ("scene", "image", "worst loss", "mean abs. error", "light lost in all")
    print_table("discs: the green disc behind, in % of its radiance", head, rows)
    write("layered-published-discs", panels)


def importance() -> None:
    """Compare importance-sampled lenses with and without a bound on the weights."""
    lens, truth, rows = make_lens("gaussian", "gaussian"), leaves_truth(), []
    samples = sample(leaves(), lens, 128, 192, SPP)
    unbounded = UnboundedWeights(**vars(published_rule(lens)))
    for name, image in (
        ("published, Gaussian, weights at most 1", reconstruct(samples, PUBLISHED)),
        ("published, Gaussian, density divided out", published_with(samples, unbounded)),
        ("published, uniform over the square", reconstruct(leaves_samples(), PUBLISHED)),
        ("box, Gaussian", reconstruct(samples, "box")),
        ("box, uniform over the square", reconstruct(leaves_samples(), "box")),
        ("layered, Gaussian", by_layers(samples)),
        ("layered, uniform over the square", by_layers(leaves_samples())),
    ):
        rows.append((name, quality(image, truth), rms_error(image, truth)))
    print_table(
        "importance: leaves by lens sampling",
        ("method, sampling of u, v", "PSNR, dB", "RMS error, % of white"),
        rows,
    )


def joined() -> None:
    """Trade layers for time (Figure 16), and show the layers and their number (Figure 15)."""
    samples, truth = leaves_samples(), leaves_truth()
    rows: list[tuple[object, ...]] = []
    panels = []
    counts = (1, 2, 3, 4, 5, None)
    times = relative_times(wide_leaves(), [{"max_layers": n} for n in counts], len(counts) - 1, PUBLISHED)
    for count, ratio in zip(counts, times, strict=True):
        image, aovs = reconstruct(samples, PUBLISHED, aovs=True, max_layers=count)
        mean, psnr = float(aovs["layer_count"].mean()), quality(image, truth)
        rows.append((count or "no limit", mean, psnr, f"{ratio:.2f}"))
        if count in (1, 2, 3, None):
            title = f"max_layers={count}, {mean:.1f} layers on average"
            panels.append(Panel(enlarge(tone_map(inner(image)), 3), title, f"{psnr:.1f} dB"))
    head = ("max_layers", "mean layers per tile", "PSNR, dB", "CPU time")
    print_table("joined: the trade of max_layers", head, rows)
    write("layered-published-max-layers", [panels[:2], panels[2:]])

    count_map = aovs["layer_count"] / aovs["layer_opacity"].shape[2]
    grey = np.repeat((255 * count_map).astype(np.uint8)[..., None], 3, axis=2)
    most, least = int(aovs["layer_count"].max()), int(aovs["layer_count"].min())
    color = layer_colors(visible_opacity(aovs["layer_opacity"]))
    write(
        "layered-published-aovs",
        [
            [
                Panel(enlarge(tone_map(image), 2), "image"),
                Panel(
                    enlarge(tone_map(color), 2),
                    "which layer a pixel shows",
                    "red in front, green in focus, blue behind",
                ),
            ],
            [
                Panel(enlarge(grey, 2), "layer_count", f"tiles of 32 px, {least} (dark) to {most} layers"),
                Panel(enlarge(error_picture(tone_map(image), tone_map(truth)), 2), "error against the truth"),
            ],
        ],
    )


def widths() -> None:
    """Measure the published widths and bins: a checkerboard in focus, planes of waves out of focus."""
    rows: list[list[object]] = []
    for size in (6.0, 6.4):
        planes = [Plane(at_slope(0), checker(size))]
        truth = reference(planes, LENS, 96, 96, spp=TRUTH_SPP)
        board = sample(planes, LENS, 96, 96, SPP)
        images = {"published": reconstruct(board, PUBLISHED), "layered": by_layers(board)}
        rows.append([f"checkerboard of {size:g} px in focus", *(quality(i, truth) for i in images.values())])
    for slope in (0.7, 1.4, 2.0, 3.0, 6.0, 12.0, 24.0):
        texture = smooth_noise(6, seed=3)
        exact = exact_waves(texture, at_slope(slope), LENS, 128, 128)
        samples = sample([Plane(at_slope(slope), texture)], LENS, 128, 128, SPP)
        rows.append(
            [
                f"smooth noise, C = {slope:g} px",
                *(quality(reconstruct(samples, method), exact, 40) for method in (PUBLISHED, "layered")),
            ]
        )
    print_table("widths: PSNR in dB", ("scene", *images), rows)

    window = np.s_[36:66, 36:66]
    shown = [Panel(enlarge(tone_map(truth[window]), 7), "truth")]
    for name, image in images.items():
        shown.append(Panel(enlarge(tone_map(image[window]), 7), name, f"{quality(image, truth):.1f} dB"))
    write("layered-published-focus", [shown])


def ring() -> None:
    """Measure circles of confusion that reach beyond the ring of samples around a tile."""
    rows: list[tuple[object, ...]] = []
    runs: list[tuple[str, dict[str, Any]]] = [
        (PUBLISHED, {}),
        (PUBLISHED, {"ring": 48, "max_sigma_x": 24.0}),
        ("layered", {}),
    ]
    for slope in (6, 12, 24, 36, 60, 90):
        texture = square_wave(256)
        samples = sample([Plane(at_slope(slope), texture)], LENS, 256, 320, SPP)
        exact = exact_waves(texture, at_slope(slope), LENS, 256, 320)
        edge = [rms_error(reconstruct(samples, method, **options), exact, 96) for method, options in runs]
        planes = [
            Plane(at_slope(-slope), constant(0.1), disc((80, 80), 30)),
            Plane(at_slope(0), checker(8)),
        ]
        samples, truth = sample(planes, LENS, 160, 160, SPP), reference(planes, LENS, 160, 160, spp=TRUTH_SPP)
        cover = [rms_error(reconstruct(samples, method, **options), truth, 24) for method, options in runs]
        rows.append((slope, *(f"{e:.2f}" for e in (*edge, *cover))))
    names = ("published, ring 16", "ring 48", "layered")
    print_table(
        "ring: large blur, RMS error in % of white",
        ("C (cover: -C), px", *(f"{what}: {name}" for what in ("bars", "cover") for name in names)),
        rows,
    )


def joined_seams() -> None:
    """Measure whether the error jumps more across tile borders than elsewhere as layers are joined."""
    rows = []
    for count in (1, 2, 3, None):
        images = [reconstruct(s, PUBLISHED, max_layers=count) for s in (floor_samples(), leaves_samples())]
        ratios = (seam_ratio(images[0], floor_truth()), seam_ratio(images[1], leaves_truth()))
        rows.append((count or "no limit", *(f"{ratio:.2f}" for ratio in ratios)))
    print_table(
        "joined_seams: jumps of the error across tile borders over jumps elsewhere",
        ("max_layers", "floor", "leaves"),
        rows,
    )


PARTS: dict[str, Callable[[], None]] = {
    part.__name__: part
    for part in (epipolar, filters, partitions, discs, importance, joined, widths, ring, joined_seams)
}

if __name__ == "__main__":
    tyro.cli(maker(PARTS, "layered-published.md"))
