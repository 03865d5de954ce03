"""Figures and numbers of `layered.md`.

Makes every picture and prints every table of that page, from scenes that need no renderer::

    python docs/figures.py            # everything, a few minutes
    python docs/figures.py discs      # one part

The truth of a scene is an image of many samples, or exact where the scene is a plane of waves. Unless a table
says otherwise: 8 samples per pixel, a Gaussian lens of sigma 1/3 sampled uniformly over its square, as in the
paper, and PSNR after clip to [0, 1] and gamma 2.2. Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tyro
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.color import srgb_decode, srgb_encode
from fewrays.display import Panel, error_picture, save_picture, sheet, tone_map
from fewrays.layered_published import LayeredOptions
from fewrays.layered_published import reference as definition
from fewrays.layered_published.filters import FilterRule, LayerFilter, ScreenKernel, screen_taps
from fewrays.layered_published.partitions import Partitions
from fewrays.layered_published.plan import Plan
from fewrays.lens import Aperture, Sampling
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.sources.analytic import (
    Mask,
    Plane,
    Waves,
    checker,
    constant,
    disc,
    exact_waves,
    half_plane,
    reference,
    sample,
    smooth_noise,
    stripes,
    trace,
)

IMAGES = Path(__file__).parent / "images"
SPP, TRUTH_SPP, BORDER = 8, 256, 16
DEFAULT, PUBLISHED = LayeredOptions(), asdict(LayeredOptions.published())

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

PAPER: Color = (250, 250, 247)
INK: Color = (32, 34, 40)
GREY: Color = (150, 152, 158)
ORANGE: Color = (214, 96, 12)
BLUE: Color = (24, 110, 190)


# Tables and small measures.


def print_table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a Markdown table under a heading."""
    print(f"\n### {title}\n\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(
            "| " + " | ".join(f"{cell:.1f}" if isinstance(cell, float) else str(cell) for cell in row) + " |"
        )


def inner(image: npt.NDArray[Any], border: int = BORDER) -> npt.NDArray[Any]:
    """Return an image without its border."""
    return image[border:-border, border:-border]


def quality(image: Image, truth: Image, border: int = BORDER) -> float:
    """Return the PSNR in dB, without the border."""
    return psnr_display(inner(image, border), inner(truth, border))


def rms_error(image: Image, truth: Image, border: int = BORDER) -> float:
    """Return the root mean square error in percent of white, without the border."""
    return 100 * float(np.sqrt(np.square(inner(image - truth, border), dtype=np.float64).mean()))


def make_lens(aperture: Aperture = "gaussian", sampling: Sampling = "square", sigma: float = 1 / 3) -> Lens:
    """Return a lens for which every slope between -400 and 100 pixels has a depth."""
    return Lens(-500.0, 100.0, aperture, sampling, sigma)


LENS = make_lens()


def at_slope(slope: float) -> float:
    """Return the depth at which `make_lens` has this slope."""
    return LENS.depth(slope)


# Scenes.


def scattered_discs(cell: float, radius: float, seed: int) -> Mask:
    """One disc at a random place in every square cell of a grid, in pixels."""
    offsets = np.random.default_rng(seed).uniform(radius, cell - radius, (32, 32, 2))

    def mask(xy: Floats) -> npt.NDArray[np.bool_]:
        index = np.floor(xy / cell).astype(np.int64)
        center = index * cell + offsets[index[..., 0] % 32, index[..., 1] % 32]
        return np.asarray(np.square(xy - center).sum(axis=-1) < radius**2)

    return mask


def leaves() -> list[Plane]:
    """Blurred leaves before bars in focus before a bright blurred background: much partial occlusion."""

    def within(mask: Mask, left: float, right: float) -> Mask:
        return lambda xy: mask(xy) & (xy[..., 0] >= left) & (xy[..., 0] < right)

    near, middle = scattered_discs(44, 12, 1), scattered_discs(34, 8, 2)
    close, far = scattered_discs(30, 6, 3), scattered_discs(26, 8, 4)
    return [
        Plane(at_slope(-16), checker(9, (0.02, 0.1, 0.02), (0.1, 0.35, 0.05)), within(near, -90, 66)),
        Plane(at_slope(-9), checker(7, (0.05, 0.15, 0.02), (0.3, 0.5, 0.1)), within(middle, -90, 110)),
        Plane(at_slope(-4), checker(5, (0.1, 0.2, 0.05), (0.35, 0.6, 0.15)), within(close, 20, 150)),
        Plane(at_slope(0), checker(6, (0.25, 0.1, 0.05), (0.8, 0.5, 0.3)), stripes(48, fill=0.4)),
        Plane(at_slope(5), checker(5, (0.2, 0.3, 0.5), (0.5, 0.6, 0.7)), within(far, 40, 120)),
        Plane(at_slope(14), checker(20, (0.5, 0.65, 0.9), (1.0, 0.95, 0.8))),
    ]


def floor() -> list[Plane]:
    """Terraces of slopes from 20 at the top to -12 px at the bottom: a slanted surface without gaps."""
    slopes = np.linspace(20, -12, 33)
    texture = smooth_noise(7, waves=6, seed=5)
    far = [Plane(at_slope(slopes[0]), texture)]
    return far + [
        Plane(at_slope(c), texture, half_plane((0, 3.0 * i), (0, 1))) for i, c in enumerate(slopes) if i
    ]


@cache
def leaves_truth() -> Image:
    """Return the true image of `leaves`."""
    return reference(leaves(), LENS, 128, 192, spp=TRUTH_SPP)


@cache
def leaves_samples() -> SampleBuffer:
    """Return samples of `leaves`."""
    return sample(leaves(), LENS, 128, 192, SPP)


def square_wave(period: float, harmonics: int = 15) -> Waves:
    """Return soft-edged bars as a sum of waves, whose blurred image is exact."""
    order = 2 * np.arange(harmonics) + 1
    weight = 4 / np.pi * np.sinc(order / (2 * harmonics)) / order
    frequency = np.stack([order / period, np.zeros(harmonics)], axis=-1)
    amplitude = 0.4 * weight[:, None] * np.ones(3)
    return Waves(np.full(3, 0.5), amplitude, frequency, np.full(harmonics, -np.pi / 2))


# The method with one departure undone that has no option, run by its NumPy definition.


@dataclass(frozen=True)
class CoarseBins(FilterRule):
    """Matched widths on bins of one pixel, whose variance is subtracted as usual."""

    def kernel(self, variance: float, ring: int) -> ScreenKernel:
        """Return the discrete filter."""
        return ScreenKernel(1, screen_taps(max(variance - 1 / 12, 1e-12), ring, exact=True))


@dataclass(frozen=True)
class UnboundedWeights(FilterRule):
    """Importance samples divided by their density, whatever comes out."""

    def filter(self, c_min: float, c_max: float, occlusion: float = 0.0) -> LayerFilter:
        """Return the filter of a layer."""
        uniform = FilterRule(**{**vars(self), "sampling": "square"}).filter(c_min, c_max, occlusion)
        return replace(uniform, falloff=uniform.falloff - 0.5 / self.sampling_sigma**2)


def define(samples: SampleBuffer, kind: type[FilterRule]) -> Image:
    """Reconstruct with a filter rule of another kind and the default options."""
    base = FilterRule.for_lens(
        samples.lens,
        "matched",
        sigma_pix=DEFAULT.sigma_pix,
        max_sigma_x=DEFAULT.max_sigma_x,
        occluded_sigma_x=5 / np.sqrt(samples.spp),
    )
    partitions = Partitions.of_constant_energy(
        DEFAULT.partitions,
        sigma_u=base.sigma_u,
        sigma_x=DEFAULT.partition_sigma_x,
        bin_size=DEFAULT.bin_size,
    )
    plan = Plan(
        height=samples.height,
        width=samples.width,
        tile=DEFAULT.tile,
        ring=DEFAULT.ring,
        partitions=partitions,
        rule=kind(**vars(base)),
        max_layers=None,
        slots=np.full(partitions.count, -1, np.int32),
    )
    image = np.zeros((samples.height, samples.width, 3), np.float32)
    for tile in range(plan.tile_count):
        row, column, height, width = plan.tile_rectangle(tile)
        pixels, _ = definition.reconstruct_tile(samples, plan, tile, None)
        image[row : row + height, column : column + width] = pixels
    return image


# Drawing.


class Plot:
    """A picture with axes, drawn at twice its size so that lines come out smooth."""

    def __init__(
        self,
        width: int,
        height: int,
        x: tuple[float, float],
        y: tuple[float, float],
        background: Color = PAPER,
    ) -> None:
        self.size, self.x, self.y = (2 * width, 2 * height), x, y
        self.image = Pillow.new("RGB", self.size, background)
        self.draw = ImageDraw.Draw(self.image)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return where a point lies in the picture."""
        across = (x - self.x[0]) / (self.x[1] - self.x[0]) * self.size[0]
        return across, (self.y[1] - y) / (self.y[1] - self.y[0]) * self.size[1]

    def line(self, points: Sequence[tuple[float, float]], color: Color, width: int = 2) -> None:
        """Draw a polyline."""
        self.draw.line([self.at(*p) for p in points], color, 2 * width, joint="curve")

    def dot(self, x: float, y: float, color: Color, radius: float = 2.5) -> None:
        """Draw a dot."""
        cx, cy = self.at(x, y)
        r = 2 * radius
        self.draw.ellipse((cx - r, cy - r, cx + r, cy + r), color)

    def text(self, x: float, y: float, text: str, color: Color = INK, size: int = 15) -> None:
        """Write on a light ground, left end at a point."""
        place, font = self.at(x, y), ImageFont.load_default(2 * size)
        left, top, right, bottom = self.draw.textbbox(place, text, font=font, anchor="lm")
        self.draw.rectangle((left - 8, top - 6, right + 8, bottom + 6), PAPER)
        self.draw.text(place, text, color, font=font, anchor="lm")

    def picture(self) -> Picture:
        """Return the picture at its size."""
        half = (self.size[0] // 2, self.size[1] // 2)
        return np.asarray(self.image.resize(half, Pillow.Resampling.LANCZOS))


def enlarge(picture: Picture, factor: int) -> Picture:
    """Magnify by a whole number, each pixel a block."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def write(name: str, rows: Sequence[Sequence[Panel]]) -> None:
    """Write a sheet of panels to ``images/layered-<name>.png``."""
    IMAGES.mkdir(exist_ok=True)
    path = IMAGES / f"layered-{name}.png"
    page = sheet(rows)
    palette = page.quantize(256, dither=Pillow.Dither.NONE) if page.width * page.height > 700_000 else page
    save_picture(path, palette)
    print(f"\n{path.name}: {page.width} x {page.height}, {path.stat().st_size / 1000:.0f} kB")


# Parts.


def epipolar() -> None:
    """Draw a slice of the light field, its samples, and one layer's samples after scattering."""
    width, height, span = 760, 190, 64.0
    planes = [
        Plane(at_slope(-12), constant(0.8, 0.12, 0.08), lambda xy: np.abs(xy[..., 0] - 24) < 7),
        Plane(at_slope(0), checker(4, (0.12, 0.25, 0.12), (0.35, 0.6, 0.3)), lambda xy: xy[..., 0] > 36),
        Plane(at_slope(14), checker(10, (0.1, 0.25, 0.6), (0.45, 0.7, 1.0))),
    ]

    def rays(x: Floats, u: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
        xy = np.stack([x, np.full_like(x, 1.0)], axis=-1)
        color, depth = trace(planes, LENS, xy, np.stack([u, np.zeros_like(u)], axis=-1))
        return color.astype(np.float64), LENS.slope(depth) < -6

    across, up = (np.arange(2 * width) + 0.5) / (2 * width), (np.arange(2 * height) + 0.5) / (2 * height)
    x, u = np.meshgrid(span * across, 1 - 2 * up)
    dense = Plot(width, height, (0, span), (-1, 1))
    dense.image.paste(Pillow.fromarray(tone_map(rays(x, u)[0].astype(np.float32))))
    for slope, center, name_x, name_u, name in (
        (-12, 24, 21, -0.55, "C = -12: leans left"),
        (0, 52, 53, -0.78, "C = 0: in focus"),
        (14, 5, 0.8, 0.8, "C = +14: leans right"),
    ):
        dense.line([(center - slope, -1), (center + slope, 1)], ORANGE, 3)
        dense.text(name_x, name_u, name)
    dense.line([(33, -1), (33, 1)], INK, 3)
    dense.text(34, 0.78, "one pixel: its image is the mean along this line")

    rng, pixels = np.random.default_rng(1), int(span)
    strata = rng.permuted(np.tile(np.arange(SPP), (pixels, 1)), axis=1)
    few_x = (np.arange(pixels)[:, None] + rng.random(strata.shape)).ravel()
    few_u = 2 * ((strata + rng.random(strata.shape)) / SPP).ravel() - 1
    color, front = rays(few_x, few_u)
    eta = FilterRule.for_lens(LENS, "paper", sigma_pix=0.5, max_sigma_x=8.0).filter(-12, -12).eta
    sampled = Plot(width, height, (0, span), (-1, 1))
    scattered = Plot(width, height, (0, span), (-1, 1))
    shown = tone_map(color[None].astype(np.float32))[0].tolist()
    for x_i, u_i, color_i, front_i in zip(few_x, few_u, shown, front, strict=True):
        sampled.dot(x_i, u_i, tuple(color_i), 3)
        scattered.dot(x_i - eta * u_i, u_i, tuple(color_i) if front_i else (205, 206, 210), 3)
    write(
        "epipolar",
        [
            [
                Panel(
                    dense.picture(),
                    "A slice of the light field",
                    "image position x to the right, lens position u upwards",
                )
            ],
            [Panel(sampled.picture(), "What the renderer traced: 8 samples per pixel")],
            [
                Panel(
                    scattered.picture(),
                    f"The front layer's hits (red) and holes (grey), moved to x - eta u with eta = {eta:.1f}",
                    "the object stands upright; a blur along x alone finishes the filter",
                )
            ],
        ],
    )


def filters() -> None:
    """Work the filter of a layer with slopes from 2 to 6 px out in numbers, and draw it."""
    c_min, c_max, sigma_u, sigma_pix = 2.0, 6.0, 1 / 3, 0.5
    band_u, band_pix = 1 / (2 * np.pi * sigma_u), 1 / (2 * np.pi * sigma_pix)
    width = band_u * (1 / c_min - 1 / c_max)
    c_avg, sigma_x = 2 * c_min * c_max / (c_min + c_max), 1 / (np.pi * width)
    gamma = np.hypot(sigma_u, sigma_x / c_avg)
    eta = sigma_x**2 / (c_avg * gamma**2)
    rule = FilterRule.for_lens(LENS, "paper", sigma_pix=sigma_pix, max_sigma_x=8.0)
    paper, matched = rule.filter(c_min, c_max), replace(rule, family="matched").filter(c_min, c_max)
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
            f"{paper.eta:.4f}, {paper.variance**0.5:.4f}, {(2 * paper.falloff) ** -0.5:.4f}",
        ),
        ("matched width", "blur of the same η and lens filter", f"{matched.variance**0.5:.4f} px"),
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
        "filter",
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
    truths = {"floor": reference(floor(), LENS, 96, 96, spp=TRUTH_SPP), "leaves": leaves_truth()}
    inputs = {"floor": sample(floor(), LENS, 96, 96, SPP), "leaves": leaves_samples()}
    for name, count, extent in (
        ("published", 15, 8.0),
        ("default", DEFAULT.partitions, DEFAULT.partition_sigma_x),
    ):
        table = Partitions.of_constant_energy(count, sigma_u=1 / 3, sigma_x=extent, bin_size=0.5)
        used = (table.first_bin + 1 + np.flatnonzero(np.diff(table.table.astype(int)))) * 0.5
        one_side = ", ".join(f"{b:g}" for b in sorted(used[used > 0], reverse=True))
        row: list[object] = [f"{name}: {count}, {extent:g} px", one_side]
        for scene, samples in inputs.items():
            image, aovs = reconstruct(samples, aovs=True, partitions=count, partition_sigma_x=extent)
            row += [quality(image, truths[scene]), float(aovs["layer_count"].mean())]
        rows.append(row)
    head = ("partitions a side, partition_sigma_x", "boundaries of C on either side, px")
    print_table("partitions", (*head, "floor, dB", "layers", "leaves, dB", "layers"), rows)


def discs() -> None:
    """Measure what averaging opacity costs: one disc before another, both out of focus (Figures 6 to 8)."""
    rows, panels = [], []
    sources = {
        "predicted": "Eq. 37, from each disc's own image",
        "unlimited": f"fewrays, occluded_sigma_x={DEFAULT.max_sigma_x:g}",
        "layered": "fewrays",
    }
    for name, scale, front_radius in (
        ("as in Figure 6", 1.0, 14),
        ("lens half as wide", 0.5, 14),
        ("front disc half as wide", 1.0, 7),
    ):
        images = _two_discs(24 * scale, front_radius)
        truth = images["truth"]
        for key in ("predicted", "unlimited", "layered"):
            loss = 100 * (truth - images[key])[..., 1]
            lost = float(loss.sum() / truth[..., 1].sum())
            rows.append((name, sources[key], float(loss.max()), float(np.abs(loss).mean()), lost))
        error = np.clip(0.5 + 2 * (images["layered"] - truth), 0, 1)
        shown = [
            *(tone_map(images[key]) for key in ("truth", "predicted", "layered")),
            (255 * error).astype(np.uint8),
        ]
        captions = (name, "Eq. 37 predicts", "fewrays, 16 spp", "difference, doubled")
        panels.append([Panel(enlarge(p, 2), title) for p, title in zip(shown, captions, strict=True)])
    head = ("scene", "image", "worst loss", "mean abs. error", "light lost in all")
    print_table("discs: the green disc behind, in % of its radiance", head, rows)
    write("discs", panels)


def _two_discs(slope: float, front_radius: float) -> dict[str, Image]:
    """Return the true image, the one that Eq. 37 predicts from each disc's own image, and fewrays'."""
    front = Plane(at_slope(-slope), constant(1.0, 0.0, 0.0), disc((48, 48), front_radius))
    back = Plane(at_slope(slope), constant(0.0, 1.0, 0.0), disc((48, 48), 14))
    black = Plane(at_slope(30), constant(0.0))
    samples = sample([front, back, black], LENS, 96, 96, 16)
    red, green = (reference([plane, black], LENS, 96, 96, spp=2 * TRUTH_SPP) for plane in (front, back))
    return {
        "truth": reference([front, back, black], LENS, 96, 96, spp=2 * TRUTH_SPP),
        "predicted": red + (1 - red[..., :1]) * green,
        "layered": reconstruct(samples),
        "unlimited": reconstruct(samples, occluded_sigma_x=DEFAULT.max_sigma_x),
    }


def widths() -> None:
    """Measure matched widths and fine bins: a checkerboard in focus, planes of waves out of focus."""
    variants: dict[str, Callable[[SampleBuffer], Image]] = {
        "published": lambda s: reconstruct(s, **PUBLISHED),
        "matched, bins of 1 px": lambda s: define(s, CoarseBins),
        "fewrays": reconstruct,
    }
    rows: list[list[object]] = []
    for size in (6.0, 6.4):
        planes = [Plane(at_slope(0), checker(size))]
        truth = reference(planes, LENS, 96, 96, spp=TRUTH_SPP)
        board = sample(planes, LENS, 96, 96, SPP)
        images = {name: run(board) for name, run in variants.items()}
        rows.append([f"checkerboard of {size:g} px in focus", *(quality(i, truth) for i in images.values())])
    for slope in (0.7, 1.4, 2.0, 3.0, 6.0, 12.0, 24.0):
        texture = smooth_noise(6, seed=3)
        exact = exact_waves(texture, at_slope(slope), LENS, 96, 96)
        samples = sample([Plane(at_slope(slope), texture)], LENS, 96, 96, SPP)
        rows.append(
            [
                f"smooth noise, C = {slope:g} px",
                *(quality(run(samples), exact, 24) for run in variants.values()),
            ]
        )
    print_table("widths: PSNR in dB", ("scene", *variants), rows)

    window = np.s_[36:66, 36:66]
    shown = [Panel(enlarge(tone_map(truth[window]), 7), "truth")]
    for name, image in images.items():
        shown.append(Panel(enlarge(tone_map(image[window]), 7), name, f"{quality(image, truth):.1f} dB"))
    write("focus", [shown])


def reach() -> None:
    """Count the taps of a screen-space filter with and without its end at four standard deviations."""
    rule = FilterRule.for_lens(LENS, "matched", sigma_pix=0.5, max_sigma_x=8.0)
    rows = []
    for sigma in (0.5, 1.0, 2.0, 4.0, 8.0):
        kernel = rule.kernel(sigma**2, 16)
        rows.append(
            (
                f"{sigma:g} px",
                kernel.bins_per_pixel,
                2 * kernel.radius + 1,
                2 * 16 * kernel.bins_per_pixel + 1,
            )
        )
    print_table(
        "reach: taps of the blur",
        ("σ of the filter", "bins per pixel", "taps", "taps over the whole ring"),
        rows,
    )


def occluded() -> None:
    """Measure the narrower filters of covered layers on the leaves."""
    truth, rows = leaves_truth(), []
    for spp in (4, 8, 16):
        samples = sample(leaves(), LENS, 128, 192, spp)
        row: list[object] = [f"{spp} spp"]
        row += [
            quality(reconstruct(samples, occluded_sigma_x=limit), truth)
            for limit in (0.5, 1.0, 2.0, 4.0, 8.0)
        ]
        rows.append(
            [*row, quality(reconstruct(samples), truth), quality(reconstruct(samples, **PUBLISHED), truth)]
        )
    head = (
        "leaves",
        *(f"{limit:g} px" for limit in (0.5, 1.0, 2.0, 4.0)),
        "8 px (no limit)",
        "default",
        "published",
    )
    print_table("occluded: PSNR in dB by occluded_sigma_x", head, rows)

    samples = leaves_samples()
    candidates = {
        "8 px (no limit)": reconstruct(samples, occluded_sigma_x=8.0),
        "fewrays": reconstruct(samples),
    }
    panels, errors = [], []
    for name, image in candidates.items():
        panels.append(Panel(enlarge(tone_map(inner(image)), 2), name, f"{quality(image, truth):.1f} dB"))
        errors.append(Panel(enlarge(error_picture(tone_map(inner(image)), tone_map(inner(truth))), 2)))
    panels.append(Panel(enlarge(tone_map(inner(truth)), 2), "truth"))
    write("occluded", [panels, errors])


def aperture() -> None:
    """Show what becomes of a disc: a bright spot, and a texture."""
    lens = make_lens("disc", "disc")
    wide = make_lens("gaussian", "gaussian", 0.25).refocus(aperture_scale=2.0)  # sigma 1/2, ends at 4 sigma
    spot = [Plane(at_slope(14), constant(0.0)), Plane(at_slope(12), constant(5.0), disc((32, 32), 4))]
    texture = [Plane(at_slope(12), checker(24))]
    rows, panels = [], []
    for name, planes, height in (("bright spot", spot, 64), ("checkerboard of 24 px", texture, 96)):
        image = reconstruct(sample(planes, lens, height, height, 16))
        truths = [reference(planes, one, height, height, spp=TRUTH_SPP) for one in (lens, wide)]
        rows.append((name, *(quality(image, truth) for truth in truths)))
        if height == 64:
            shown = (truths[0], truths[1], image)
            captions = ("truth, disc", "truth, Gaussian lens", "fewrays, disc lens")
            panels = [Panel(enlarge(tone_map(p, 0.5), 4), c) for p, c in zip(shown, captions, strict=True)]
    print_table(
        "aperture: PSNR in dB, C = 12 px, 16 spp", ("scene", "against the disc", "against the Gaussian"), rows
    )
    write("aperture", [panels])


def importance() -> None:
    """Compare importance-sampled lenses with and without a bound on the weights."""
    lens, truth, rows = make_lens("gaussian", "gaussian"), leaves_truth(), []
    samples = sample(leaves(), lens, 128, 192, SPP)
    bounded, unbounded = reconstruct(samples), define(samples, UnboundedWeights)
    uniform = reconstruct(leaves_samples())
    for name, image in (
        ("layered, Gaussian, weights at most 1", bounded),
        ("layered, Gaussian, density divided out", unbounded),
        ("layered, uniform over the square", uniform),
        ("box, Gaussian", reconstruct(samples, "box")),
        ("box, uniform over the square", reconstruct(leaves_samples(), "box")),
    ):
        rows.append((name, quality(image, truth), rms_error(image, truth)))
    print_table(
        "importance: leaves by lens sampling",
        ("method, sampling of u, v", "PSNR, dB", "RMS error, % of white"),
        rows,
    )


def hdr() -> None:
    """Compare floating-point radiance with colours tone-mapped to 8 bits before the filter."""
    planes = [*leaves(), Plane(at_slope(13.9), constant(6.0), scattered_discs(30, 3, 9))]
    truth = reference(planes, LENS, 128, 192, spp=2 * TRUTH_SPP)
    samples = sample(planes, LENS, 128, 192, SPP)
    display = np.round(255 * srgb_encode(samples.color)) / 255
    from_display = srgb_decode(reconstruct(replace(samples, color=display.astype(np.float32))))
    images = {"float, linear": reconstruct(samples), "8 bits, tone-mapped": from_display}
    rows = [
        (name, quality(image, truth), float(inner(image).mean() / inner(truth).mean()))
        for name, image in images.items()
    ]
    print_table(
        "hdr: leaves with highlights of radiance 6",
        ("input", "PSNR, dB", "mean radiance / truth"),
        [(n, p, f"{m:.2f}") for n, p, m in rows],
    )
    panels = [Panel(enlarge(tone_map(inner(truth)), 2), "truth")]
    panels += [
        Panel(enlarge(tone_map(inner(i)), 2), n, f"{quality(i, truth):.1f} dB") for n, i in images.items()
    ]
    write("hdr", [panels])


def layers() -> None:
    """Show the layers and their number (Figures 15 and 16), and trade layers for time."""
    samples, truth = leaves_samples(), leaves_truth()
    rows: list[tuple[object, ...]] = []
    panels = []
    limits = (1, 2, 3, 4, 5, None)
    seconds = {limit: _seconds(samples, limit) for limit in limits}
    for limit in limits:
        image, aovs = reconstruct(samples, aovs=True, max_layers=limit)
        mean, psnr = float(aovs["layer_count"].mean()), quality(image, truth)
        rows.append((limit or "no limit", mean, psnr, f"{seconds[limit] / seconds[None]:.2f}"))
        if limit in (1, 2, 3, None):
            title = f"max_layers={limit}, {mean:.1f} layers on average"
            panels.append(Panel(enlarge(tone_map(inner(image)), 3), title, f"{psnr:.1f} dB"))
    head = ("max_layers", "mean layers per tile", "PSNR, dB", "CPU time")
    print_table("layers: the trade of max_layers", head, rows)
    write("max-layers", [panels[:2], panels[2:]])

    image, aovs = reconstruct(samples, aovs=True)
    color, count = _layer_colors(aovs), aovs["layer_count"] / aovs["layer_opacity"].shape[2]
    grey = np.repeat((255 * count).astype(np.uint8)[..., None], 3, axis=2)
    most, least = int(aovs["layer_count"].max()), int(aovs["layer_count"].min())
    write(
        "aovs",
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


def _layer_colors(aovs: dict[str, npt.NDArray[Any]]) -> Image:
    """Composite one colour per layer by the layers' opacities."""
    opacity = aovs["layer_opacity"]
    place = np.linspace(0, 1, opacity.shape[2])[:, None]
    palette = np.hstack(
        [np.clip(1 - 2 * place, 0, 1), 1 - np.abs(2 * place - 1), np.clip(2 * place - 1, 0, 1)]
    )
    behind = np.cumprod(1 - opacity, axis=2)
    visible = opacity * np.concatenate([np.ones_like(behind[..., :1]), behind[..., :-1]], axis=2)
    return np.asarray(visible @ palette, np.float32)


def seams() -> None:
    """Measure whether the error jumps more across tile borders than elsewhere."""
    rows = []
    samples, truth = sample(floor(), LENS, 96, 96, SPP), reference(floor(), LENS, 96, 96, spp=TRUTH_SPP)
    for limit in (1, 2, 3, None):
        on_floor = _seam_ratio(reconstruct(samples, max_layers=limit), truth)
        on_leaves = _seam_ratio(reconstruct(leaves_samples(), max_layers=limit), leaves_truth())
        rows.append((limit or "no limit", f"{on_floor:.2f}", f"{on_leaves:.2f}"))
    print_table(
        "seams: jumps of the error across tile borders over jumps elsewhere",
        ("max_layers", "floor", "leaves"),
        rows,
    )


def _seam_ratio(image: Image, truth: Image) -> float:
    """How much more the error jumps from pixel to pixel across tile borders than elsewhere."""
    jump = np.abs(np.diff(inner(image - truth), axis=1)).mean(axis=(0, 2))
    border = (np.arange(len(jump)) + BORDER + 1) % 32 == 0
    return float(jump[border].mean() / jump[~border].mean())


def _seconds(samples: SampleBuffer, limit: int | None) -> float:
    """Return the least CPU time of several runs."""
    times = []
    for _ in range(15):
        start = time.process_time()
        reconstruct(samples, threads=1, max_layers=limit)
        times.append(time.process_time() - start)
    return min(times)


def limits() -> None:
    """Measure the known limits: large blur, noise by slope, and bright spots behind an edge."""
    rows: list[tuple[object, ...]] = []
    ring: list[dict[str, Any]] = [{}, {"ring": 48, "max_sigma_x": 24.0}]
    for slope in (6, 12, 24, 36, 60, 90):
        texture = square_wave(256)
        samples = sample([Plane(at_slope(slope), texture)], LENS, 192, 256, SPP)
        exact = exact_waves(texture, at_slope(slope), LENS, 192, 256)
        edge = [rms_error(reconstruct(samples, **options), exact, 64) for options in ring]
        planes = [
            Plane(at_slope(-slope), constant(0.1), disc((80, 80), 30)),
            Plane(at_slope(0), checker(8)),
        ]
        samples, truth = sample(planes, LENS, 160, 160, SPP), reference(planes, LENS, 160, 160, spp=TRUTH_SPP)
        cover = [rms_error(reconstruct(samples, **options), truth, 24) for options in ring]
        rows.append((slope, *(f"{e:.2f}" for e in (*edge, *cover))))
    print_table(
        "limits: large blur, RMS error in % of white",
        ("C (cover: -C), px", "edge, ring 16", "edge, ring 48", "cover, ring 16", "cover, ring 48"),
        rows,
    )

    rows = []
    for slope in (0, 1, 2, 4, 8, 16, 32):
        planes = [Plane(at_slope(slope), checker(4.4))]
        samples, truth = sample(planes, LENS, 96, 96, SPP), reference(planes, LENS, 96, 96, spp=TRUTH_SPP)
        box = reconstruct(samples, "box")
        errors = (rms_error(box, truth, 24), rms_error(reconstruct(samples), truth, 24))
        rows.append((slope, *(f"{error:.2f}" for error in errors)))
    print_table(
        "limits: noise on a checkerboard of 4.4 px, RMS error in % of white",
        ("C in px", "box", "fewrays"),
        rows,
    )
    _highlights()


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
        for options in ({}, PUBLISHED):
            runs = [
                reconstruct(sample(planes, LENS, 64, 64, SPP, seed=seed), **options) for seed in range(16)
            ]
            light = [100 * float((run - rest).sum() / (truth - rest).sum() - 1) for run in runs]
            row.append(f"{np.mean(light):+.0f} ± {np.std(light):.0f}")
            if not options:
                truths.append(Panel(enlarge(tone_map(truth, -0.5), 4), f"spot at {offset:+d} px, truth"))
                images.append(Panel(enlarge(tone_map(runs[0], -0.5), 4), "fewrays, 8 spp"))
        rows.append(tuple(row))
    print_table(
        "limits: a spot of radiance 60 behind a blurred edge, light gained or lost in % over 16 seeds",
        ("place of the spot", "fewrays", "published"),
        rows,
    )
    write("highlights", [truths, images])


PARTS: dict[str, Callable[[], None]] = {
    part.__name__: part
    for part in (
        epipolar,
        filters,
        partitions,
        discs,
        widths,
        reach,
        occluded,
        aperture,
        importance,
        hdr,
        layers,
        seams,
        limits,
    )
}


def main(parts: tuple[str, ...] = (), /) -> None:
    """Make the figures and tables of layered.md.

    Parameters
    ----------
    parts
        Names of parts; all when omitted.
    """
    for name in parts or PARTS:
        start = time.perf_counter()
        PARTS[name]()
        print(f"({name}: {time.perf_counter() - start:.0f} s)")


if __name__ == "__main__":
    tyro.cli(main)
