"""Scenes under lamps, and samples of them, for those who light samples on a GPU."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays import Lighting, LightSamples, SampleBuffer
from fewrays.sources.analytic_shadows import (
    Disc,
    HalfPlane,
    Lamp,
    Rectangle,
    Scene,
    aimed,
    box,
    render_lit,
)
from fewrays.sources.opaque_shapes import Shape
from lit_buffers import LIGHTS, light_with, lighting_of, lit_buffer
from shadow_scenes import FLOOR, GREEN, WARM, aside, level

__all__ = ["KINDS", "PLATE", "SCENES", "samples_of", "scene_of", "textured", "with_lights"]

BOARD = level(0.6, HalfPlane((0, 0), (1, 0.3)), seen=False)
PLATE = level(0.7, Disc((0, 0), 0.4))
LID = level(1.0, Rectangle((0, 0), (4, 4)), seen=False)
SHIFTED = aimed((1, 4, 1), (0, 0, 0), (0.5, 0.5), motion=(1.0, 0.2, -0.5), radiance=(10, 8, 6))


def scene_of(
    shapes: Sequence[Shape], lamps: Sequence[Lamp] = (WARM,), *, lens_radius: float = 0.0, size: int = 12
) -> Scene:
    camera = aside(size, size + 3, lens_radius=lens_radius)
    return Scene(camera, [FLOOR, *shapes], lamps, unlit=(0.01, 0.02, 0.03))


SCENES = {
    "half-plane": scene_of([BOARD]),
    "disc": scene_of([PLATE]),
    "lid": scene_of([LID]),
    "box": scene_of(box((0, 0, 0), (0.5, 0.4), 0.7, turn=30.0)),
    "two lamps": scene_of([PLATE], (WARM, GREEN)),
    "moving lamp": scene_of([PLATE], (SHIFTED,)),
    "moving disc": scene_of([replace(PLATE, motion=(0.6, 0.2, 0.1))], (WARM, GREEN)),
    "passing disc": scene_of([replace(PLATE, motion=(0.4, 8.0, 0.0))]),
    "defocus": scene_of(box((0, 0, 0), (0.5, 0.4), 0.7), (GREEN,), lens_radius=0.3),
}


def with_lights(
    samples: SampleBuffer, change: Callable[[int, LightSamples], dict[str, npt.NDArray[Any]]]
) -> SampleBuffer:
    """Change fields of each lamp's light samples."""
    old = lighting_of(samples)
    lights = [light_with(each, **change(number, each)) for number, each in enumerate(old.lights)]
    lighting = Lighting(old.projection, old.normal, old.depth_gradient, old.unlit, lights)
    return replace(samples, lighting=lighting)


def textured(samples: SampleBuffer) -> SampleBuffer:
    """Let the radiance of all lamps vary over them."""

    def waves(_: int, each: LightSamples) -> dict[str, npt.NDArray[Any]]:
        return {"radiance": each.radiance * (1 + 0.8 * np.sin(3 * each.luv[..., :1] + [0, 1, 2]))}

    return with_lights(samples, waves)


def even(samples: SampleBuffer) -> SampleBuffer:
    """Let all lamps' radiance be the same everywhere."""
    return with_lights(samples, lambda _, each: {"radiance": np.full_like(each.radiance, 3.0)})


def samples_of(kind: str, spp: int = 3) -> SampleBuffer:
    """Samples of one of the scenes, under textured lamps if its name ends so; or random ones."""
    if kind.startswith("random"):
        if "moving" not in kind:
            samples = replace(lit_buffer((5, 6, 3), lights=LIGHTS[:1], moving=False), time=None)
            return even(samples) if "even" in kind else samples
        samples = lit_buffer((5, 6, 3))
        motion = np.random.default_rng(1).normal(size=samples.color.shape).astype(np.float32)
        return replace(samples, motion=motion)
    samples = render_lit(SCENES[kind.removesuffix(", textured")], spp)
    return textured(samples) if kind.endswith("textured") else samples


KINDS = (*SCENES, "disc, textured", "moving disc, textured", "random", "random, even", "random, moving")
