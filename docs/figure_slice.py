"""A slice of the light field, as layered.md and layered-published.md draw it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow

from fewrays.display import Panel, tone_map
from fewrays.sources.analytic import (
    Plane,
    checker,
    constant,
    trace,
)
from figure_drawing import INK, ORANGE, Plot
from figure_scenes import LENS, SPP, Floats, at_slope


def draw_slice(eta: float, titles: tuple[str, str]) -> list[list[Panel]]:
    """Draw a slice of the light field, its samples, and what becomes of them as the front layer sees them.

    It moves them by `eta` pixels per lens unit; `titles` say what that picture shows.
    """
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
    sampled = Plot(width, height, (0, span), (-1, 1))
    scattered = Plot(width, height, (0, span), (-1, 1))
    shown = tone_map(color[None].astype(np.float32))[0].tolist()
    for x_i, u_i, color_i, front_i in zip(few_x, few_u, shown, front, strict=True):
        sampled.dot(x_i, u_i, tuple(color_i), 3)
        scattered.dot(x_i - eta * u_i, u_i, tuple(color_i) if front_i else (205, 206, 210), 3)
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
