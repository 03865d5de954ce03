"""Figures and numbers of `layered.md` and `layered-published.md`.

Makes every picture and prints every table of the two pages, from scenes that need no renderer::

    python docs/figures.py            # everything, several minutes
    python docs/figures.py parts      # one part

The truth of a scene is an image of many samples, or exact where the scene is a plane of waves. Unless a table
says otherwise: 8 samples per pixel, a Gaussian lens of sigma 1/3 sampled uniformly over its square, as in the
paper, and PSNR after clip to [0, 1] and gamma 2.2. Borders, where samples are missing, are not measured.
"""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
import tyro
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.color import srgb_decode, srgb_encode
from fewrays.display import Panel, error_picture, save_picture, sheet, tone_map
from fewrays.layered import LayeredOptions, kernel
from fewrays.layered import plan as layered_plan
from fewrays.layered.aperture import ApertureParts
from fewrays.layered_published import PublishedOptions
from fewrays.layered_published import plan as published_plan
from fewrays.layered_published import reference as published_reference
from fewrays.layered_published.filters import FilterRule, LayerFilter
from fewrays.layered_published.partitions import Partitions
from fewrays.lens import LensAperture, Sampling
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.parallel import Execution
from fewrays.sources.analytic import (
    Mask,
    Plane,
    Texture,
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

by_layers = partial(reconstruct, method="layered")
"""The method that the pages are about."""

IMAGES = Path(__file__).parent / "images"
SPP, TRUTH_SPP, BORDER = 8, 256, 16
PUBLISHED = "layered-published"

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

PAPER: Color = (250, 250, 247)
INK: Color = (32, 34, 40)
GREY: Color = (150, 152, 158)
ORANGE: Color = (214, 96, 12)
BLUE: Color = (24, 110, 190)
GREEN: Color = (40, 140, 70)


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


def make_lens(
    aperture: LensAperture = "gaussian", sampling: Sampling = "square", sigma: float = 1 / 3
) -> Lens:
    """Return a lens for which every slope between -400 and 100 pixels has a depth."""
    return Lens(-500.0, 100.0, aperture, sampling, sigma)


def cpu_seconds(run: Callable[[], object], repetitions: int) -> float:
    """Return the least CPU time of several runs."""
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def relative_times(
    samples: SampleBuffer, choices: Sequence[dict[str, Any]], base: int, method: str = "layered"
) -> list[float]:
    """Return the CPU time of each choice of options over that of the one at index `base`, on one thread."""
    rounds = [
        [cpu_seconds(lambda: reconstruct(samples, method, threads=1, **chosen), 1) for chosen in choices]  # noqa: B023
        for _ in range(6)
    ]
    best = np.min(rounds, axis=0)
    return [float(seconds / best[base]) for seconds in best]


def seam_ratio(image: Image, truth: Image) -> float:
    """How much more the error jumps from pixel to pixel across borders of 32 px than elsewhere."""
    jump = np.abs(np.diff(inner(image - truth), axis=1)).mean(axis=(0, 2))
    border = (np.arange(len(jump)) + BORDER + 1) % 32 == 0
    return float(jump[border].mean() / jump[~border].mean())


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


@cache
def wide_leaves() -> SampleBuffer:
    """Return samples of the leaves, repeated over an image that is large enough to measure times."""
    planes = leaves()
    for i, plane in enumerate(planes):
        planes[i] = replace(plane, color=repeated(plane.color), mask=plane.mask and repeated(plane.mask))
    return sample(planes, LENS, 384, 576, SPP)


def repeated(function: Callable[[Floats], Any]) -> Callable[[Floats], Any]:
    """Return a texture or mask repeated every 160 pixels along both axes."""
    return lambda xy: function(np.mod(xy, 160))


@cache
def floor_truth() -> Image:
    """Return the true image of `floor`."""
    return reference(floor(), LENS, 96, 96, spp=TRUTH_SPP)


@cache
def floor_samples() -> SampleBuffer:
    """Return samples of `floor`."""
    return sample(floor(), LENS, 96, 96, SPP)


def two_discs_planes(slope: float, front_radius: float) -> list[Plane]:
    """Return a red disc before a green one, both out of focus, before black (the paper's Figure 6)."""
    return [
        Plane(at_slope(-slope), constant(1.0, 0.0, 0.0), disc((48, 48), front_radius)),
        Plane(at_slope(slope), constant(0.0, 1.0, 0.0), disc((48, 48), 14)),
        Plane(at_slope(30), constant(0.0)),
    ]


def two_discs_samples(slope: float, front_radius: float, spp: int = 16) -> SampleBuffer:
    """Return samples of the two discs."""
    return sample(two_discs_planes(slope, front_radius), LENS, 96, 96, spp)


@cache
def two_discs(slope: float, front_radius: float) -> dict[str, Image]:
    """Return the true image of the two discs, and the one that Eq. 37 predicts from each disc's own image."""
    planes = two_discs_planes(slope, front_radius)
    red, green = (reference([plane, planes[2]], LENS, 96, 96, spp=2 * TRUTH_SPP) for plane in planes[:2])
    return {
        "truth": reference(planes, LENS, 96, 96, spp=2 * TRUTH_SPP),
        "predicted": red + (1 - red[..., :1]) * green,
    }


def _loss(truth: Image, image: Image) -> tuple[float, float, float]:
    """Largest loss, mean absolute error and lost light of the green disc, in percent."""
    loss = 100 * (truth - image)[..., 1]
    return float(loss.max()), float(np.abs(loss).mean()), float(loss.sum() / truth[..., 1].sum())


def moved(plane: Plane, by: float) -> Plane:
    """Return a plane moved right and down by some pixels."""
    color, mask = plane.color, plane.mask
    shifted: Texture = lambda xy: color(xy - by)  # noqa: E731
    return Plane(plane.depth, shifted, None if mask is None else lambda xy: mask(xy - by))


def square_wave(period: float, harmonics: int = 15) -> Waves:
    """Return soft-edged bars as a sum of waves, whose blurred image is exact."""
    order = 2 * np.arange(harmonics) + 1
    weight = 4 / np.pi * np.sinc(order / (2 * harmonics)) / order
    frequency = np.stack([order / period, np.zeros(harmonics)], axis=-1)
    amplitude = 0.4 * weight[:, None] * np.ones(3)
    return Waves(np.full(3, 0.5), amplitude, frequency, np.full(harmonics, -np.pi / 2))


# The published method with a rule of its own, run by its NumPy definition.


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


# The layered method with one idea taken out.


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
    """Write a sheet of panels to ``images/<name>.png``."""
    IMAGES.mkdir(exist_ok=True)
    path = IMAGES / f"{name}.png"
    page = sheet(rows)
    save_picture(path, page)
    print(f"\n{path.name}: {page.width} x {page.height}, {path.stat().st_size / 1000:.0f} kB")


def difference(image: Image, truth: Image, factor: float) -> Picture:
    """Return the difference of two images, magnified, around grey."""
    return np.asarray(255 * np.clip(0.5 + factor * (image - truth), 0, 1), np.uint8)


def layer_colors(shares: npt.NDArray[np.floating]) -> Image:
    """Mix one colour per layer by the layers' shares of each pixel, (H, W, L)."""
    place = np.linspace(0, 1, shares.shape[2])[:, None]
    palette = np.hstack(
        [np.clip(1 - 2 * place, 0, 1), 1 - np.abs(2 * place - 1), np.clip(2 * place - 1, 0, 1)]
    )
    return np.asarray(shares @ palette, np.float32)


def visible_opacity(opacity: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Return what each layer shows of itself, from opacities front to back."""
    behind = np.cumprod(1 - opacity, axis=2)
    result: npt.NDArray[np.floating] = opacity * np.concatenate(
        [np.ones_like(behind[..., :1]), behind[..., :-1]], axis=2
    )
    return result


def _epipolar(*, full_shear: bool) -> list[list[Panel]]:
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
    eta = -12.0 if full_shear else published_rule(LENS).filter(-12, -12).eta
    sampled = Plot(width, height, (0, span), (-1, 1))
    scattered = Plot(width, height, (0, span), (-1, 1))
    shown = tone_map(color[None].astype(np.float32))[0].tolist()
    for x_i, u_i, color_i, front_i in zip(few_x, few_u, shown, front, strict=True):
        sampled.dot(x_i, u_i, tuple(color_i), 3)
        scattered.dot(x_i - eta * u_i, u_i, tuple(color_i) if front_i else (205, 206, 210), 3)
    if full_shear:
        titles = ("The front layer's hits (red) and holes (grey), moved to x - C u with C = -12",
                  "as the lens centre sees them: the object stands upright")  # fmt: skip
    else:
        titles = (f"The front layer's hits (red) and holes (grey), moved to x - eta u with eta = {eta:.1f}",
                  "the object leans a little; a blur along x alone finishes the filter")  # fmt: skip
    return [
        [
            Panel(
                dense.picture(),
                "A slice of the light field",
                "image position x to the right, lens position u upwards",
            )
        ],
        [Panel(sampled.picture(), "What the renderer traced: 8 samples per pixel")],
        [Panel(scattered.picture(), *titles)],
    ]


# Parts of layered.md.


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
    write("layered-epipolar", _epipolar(full_shear=True))

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
            rows.append((f"{spp} spp", name, *_loss(truth, image)))
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


# Parts of layered-published.md.


def epipolar() -> None:
    """Draw a slice of the light field, its samples, and one layer's samples after scattering."""
    write("layered-published-epipolar", _epipolar(full_shear=False))


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
            rows.append((name, source, *_loss(truth, images[key])))
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


LAYERED_PARTS = (
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
PUBLISHED_PARTS = (epipolar, filters, partitions, discs, importance, joined, widths, ring, joined_seams)
PARTS: dict[str, Callable[[], None]] = {part.__name__: part for part in (*LAYERED_PARTS, *PUBLISHED_PARTS)}


def maker(parts: Mapping[str, Callable[[], None]], pages: str) -> Callable[..., None]:
    """Return a command that runs parts by their names, or all, and prints how long each takes."""

    def main(names: tuple[str, ...] = (), /) -> None:
        print(f"commit {commit()}")
        for name in names or parts:
            start = time.perf_counter()
            parts[name]()
            print(f"({name}: {time.perf_counter() - start:.0f} s)")

    main.__doc__ = f"""Make the figures and tables of {pages}.

    Parameters
    ----------
    names
        Names of parts; all when omitted.
    """
    return main


def commit() -> str:
    """Return the commit of the checkout that this file lies in."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    run = subprocess.run(command, cwd=IMAGES.parent, capture_output=True, text=True, check=False)
    return run.stdout.strip() or "unknown"


if __name__ == "__main__":
    tyro.cli(maker(PARTS, "layered.md and layered-published.md"))
