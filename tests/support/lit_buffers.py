"""Sample buffers with area lights, random but for the geometry: light samples go where camera samples are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fewrays import AreaLight, Lens, Lighting, LightSamples, Projection, SampleBuffer
from fewrays.temporal.view_light import density

Floats = npt.NDArray[np.float64]

LIGHTS = (
    AreaLight((0.3, -3.0, 4.0), (0.8, 0.0, 0.2), (0.1, 0.0, -0.4), plane_distance=2.0),
    AreaLight((-3.0, -3.0, 2.0), (0.0, 0.0, 0.5), (0.3, -0.3, 0.0), "disc", motion=(0.4, 0.0, -0.2)),
)


def lit_buffer(
    shape: tuple[int, int, int] = (3, 4, 2),
    *,
    lights: tuple[AreaLight, ...] = LIGHTS,
    blocked: float = 0.3,
    moving: bool = True,
    seed: int = 0,
) -> SampleBuffer:
    """Make samples of a rough surface that the lights shine on, some of whose light is blocked halfway.

    Parameters
    ----------
    shape : tuple of int
        Height, width and samples per pixel.
    lights : tuple of AreaLight
        One set of light samples for each.
    blocked : float
        Share of the light samples that end before the surface.
    moving : bool
        Whether the first hits move.
    seed : int
        Of all that is random.
    """
    rng = np.random.default_rng(seed)
    height, width, _ = shape
    lens = Lens.thin_lens(width, focus_distance=4.0, lens_radius=0.1, fov=50.0, sampling="square")
    projection = Projection.from_fov(width, height, 50.0)
    corner = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)[:, :, None, :]
    samples = SampleBuffer(
        xy=corner + rng.random((*shape, 2)),
        uv=rng.uniform(-1, 1, (*shape, 2)),
        depth=rng.uniform(3, 5, shape),
        color=np.zeros((*shape, 3)),
        lens=lens,
        time=rng.random(shape),
    )
    normal = rng.normal(size=(*shape, 3)) * 0.3 + [0, -1, -0.5]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    assert samples.time is not None
    seen = samples.xy - lens.slope(samples.depth.astype(np.float64))[..., None] * samples.uv
    gradient = projection.depth_gradient(seen, samples.depth, normal)
    lighting = Lighting(
        projection,
        normal,
        gradient,
        rng.random((*shape, 3)),
        [
            _light_samples(light, projection, seen, samples, gradient, blocked, moving, rng)
            for light in lights
        ],
    )
    return replace(samples, color=lighting.color(samples), lighting=lighting)


def lighting_of(samples: SampleBuffer) -> Lighting:
    """Return the lighting of samples that have one."""
    assert samples.lighting is not None
    return samples.lighting


def light_with(light: LightSamples, **changes: npt.NDArray[np.floating]) -> LightSamples:
    """Return light samples with other values in some fields."""
    return LightSamples(light.light, **{name: getattr(light, name) for name in light.field_names()} | changes)


def _light_samples(
    light: AreaLight,
    projection: Projection,
    seen: Floats,
    samples: SampleBuffer,
    gradient: Floats,
    blocked: float,
    moving: bool,
    rng: np.random.Generator,
) -> LightSamples:
    shape = samples.depth.shape
    assert samples.time is not None
    luv = draw_on_light(light, shape, rng)
    lxy, depth = light.project(projection.points(seen, samples.depth), luv, samples.time)
    behind = depth <= 0
    lxy[behind], depth[behind] = 0, 1
    first = np.where(rng.random(shape) < blocked, depth * rng.uniform(0.2, 0.9, shape), depth)
    rho = density(projection, light, seen, samples.depth, gradient, luv, samples.time)
    rho[rng.random(shape) < 0.1] = 0
    return LightSamples(
        light,
        lxy,
        luv,
        first,
        rng.gamma(1.0, 3.0, (*shape, 3)),
        rho,
        rng.random((*shape, 3)) / np.pi,
        motion=rng.normal(size=(*shape, 3)) if moving else None,
    )


def draw_on_light(light: AreaLight, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Draw positions ``(*shape, 2)`` uniformly from a light's area, in float32's precision."""
    luv = rng.uniform(-1, 1, (*shape, 2))
    if light.shape == "disc":
        radius, angle = np.sqrt(rng.random(shape)), rng.uniform(0, 2 * np.pi, shape)
        luv = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return luv.astype(np.float32).astype(np.float64)
