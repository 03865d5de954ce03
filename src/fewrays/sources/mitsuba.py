"""Samples from any Mitsuba 3 scene.

Mitsuba's own sensors hide the lens position of a ray, and its ``depth`` AOV is a ray parameter averaged over
the pixel. So this source builds the thin-lens rays itself, asks the scene where they hit and the scene's
integrator how much light comes back:

1. image and lens positions, from `fewrays.sources.image_pattern`;
2. the ray through both, in world space, from `fewrays.sources.mitsuba_camera`;
3. planar depth, one per sample, by ``scene.ray_intersect_preliminary``;
4. radiance, the mean of `shading_spp` light paths along that same ray, by ``integrator.sample``.

Steps 3 and 4 are `fewrays.sources.mitsuba_tracer`. Moving scenes go through steps 2 to 4 once for each slice
of the shutter interval; see `fewrays.sources.mitsuba_motion`. How far over the lens a sample's radiance holds
is read off the roughness of what it hit; see `fewrays.sources.mitsuba_gloss`. With `lighting`, area lights
are sampled apart (`fewrays.sources.mitsuba_lights`), and step 4 is done without them
(`fewrays.sources.mitsuba_unlit`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, require_option
from fewrays.lens import Lens, LensAperture, Sampling
from fewrays.light_samples import LightSamples
from fewrays.lighting import Lighting
from fewrays.projection import Projection
from fewrays.samples import SampleBuffer
from fewrays.sources.image_pattern import ImagePattern
from fewrays.sources.mitsuba_camera import Camera
from fewrays.sources.mitsuba_gloss import Gloss
from fewrays.sources.mitsuba_lights import FoundLight, LightTracer, find_lights
from fewrays.sources.mitsuba_motion import MovingShapes
from fewrays.sources.mitsuba_scene import choose_background, choose_integrator, load_scene
from fewrays.sources.mitsuba_tracer import Tracer
from fewrays.sources.mitsuba_unlit import Unlit
from fewrays.sources.mitsuba_variants import VARIANTS, activate, active_variant

__all__ = ["VARIANTS", "activate", "lens_of", "render"]

_MAX_SLICES = 65_536

Float32 = npt.NDArray[np.float32]


def render(
    scene: Any,
    *,
    spp: int = 8,
    width: int | None = None,
    height: int | None = None,
    aperture: LensAperture = "disc",
    sampling: Sampling | None = None,
    sigma: float = 1.0 / 3.0,
    lens_radius: float | None = None,
    focus_distance: float | None = None,
    seed: int = 0,
    shading_spp: int = 16,
    max_depth: int | None = None,
    integrator: Any = None,
    background_depth: float | None = None,
    motion: Mapping[str, Any] | None = None,
    time_slices: int = 64,
    bandwidth: bool = False,
    lighting: bool = False,
    sensor: int = 0,
    variant: str | None = None,
    progress: bool = False,
) -> SampleBuffer:
    """Render samples of a Mitsuba 3 scene.

    Parameters
    ----------
    scene : path, dict or mitsuba.Scene
        An XML file, a scene dictionary, or a scene loaded under one of `VARIANTS`.
    spp : int
        Primary samples per pixel, each with a position on the image and on the lens.
    width, height : int, optional
        Image size in pixels; the film's size unless given. One alone keeps the film's aspect ratio. The
        horizontal angle of view stays.
    aperture : {"disc", "gaussian"}
        What the image integrates over; Mitsuba's own lenses are discs.
    sampling : {"disc", "square", "gaussian"}, optional
        How lens positions are drawn; as `aperture` unless given.
    sigma : float
        Standard deviation of the Gaussian, in lens radii.
    lens_radius, focus_distance : float, optional
        In scene units; the ``thinlens`` sensor's own unless given. A ``perspective`` sensor has none: give
        both, or neither for a pinhole camera.
    seed : int
        Another seed gives independent samples.
    shading_spp : int
        Light paths averaged into each sample's radiance. The reconstruction takes radiance for nearly
        noise-free, so raise it for scenes whose light is hard to sample.
    max_depth : int, optional
        Longest light path, in bounces plus one: replaces the integrator by a ``path`` integrator.
    integrator : dict or mitsuba.Integrator, optional
        Replaces the scene's integrator.
    background_depth : float, optional
        Depth of rays that leave the scene; far beyond everything in it unless given.
    motion : mapping, optional
        Where shapes go while the shutter is open, by their identifiers. The scene shows them as the shutter
        opens; each value says where they are when it closes: a 4 x 4 affine transform in world space (array
        or Mitsuba's own) applied to the shape as it stands, or, for meshes, new positions (N, 3) of its
        vertices. In between, every point moves along a straight line at constant speed.
    time_slices : int
        In how many instants the moving shapes are shown; each sample is traced in the one nearest to its
        time, and is given that instant's time. Take more if something travels over more pixels than this.
    bandwidth : bool
        Store how far over the lens each sample's radiance holds, from the roughness of what it hit: for the
        *temporal* method, which then keeps the highlights of glossy things sharp where they are defocused.
    lighting : bool
        Trace one ray more per sample from every rectangle and disc that glows, and store what it meets: for
        soft shadows from few samples. Needs a ``path`` or a ``direct`` integrator and a scene without media;
        such lights may only be shifted by `motion`.
    sensor : int
        Which of the scene's sensors to use.
    variant : {"llvm_ad_rgb", "cuda_ad_rgb"}, optional
        The active variant where it is one of these; otherwise CUDA where there is a GPU, else LLVM.
    progress : bool
        Show a progress bar on stderr for work over two seconds.

    Returns
    -------
    SampleBuffer
        With `spp` samples per pixel, each in its own pixel's place. With times and motion vectors if
        something moves, and with bandwidths and lighting if asked for.

    Raises
    ------
    SampleError
        For parameters out of range, scenes that do not load, sensors and integrators that are not supported,
        and when the LLVM library that Mitsuba needs is missing or too old.
    ImportError
        When Mitsuba is not installed.
    """
    if shading_spp < 1:
        raise SampleError(f"expected at least 1, got {shading_spp}", field="shading_spp")
    require_option("time_slices", time_slices, 1 <= time_slices <= _MAX_SLICES, f"from 1 to {_MAX_SLICES}")
    with active_variant(variant, scene) as mi:
        loaded = load_scene(mi, scene, merge=not motion)
        moving = MovingShapes(mi, loaded, motion) if motion else None
        camera = Camera.of(mi, loaded, sensor, width, height, lens_radius, focus_distance)
        lens = camera.lens(aperture, sampling or aperture, sigma)
        pattern = ImagePattern(camera.height, camera.width, spp, seed)
        xy, uv = pattern.positions(lens)
        chosen = choose_integrator(mi, loaded, integrator, max_depth)
        view = camera.view(lens)
        lights = find_lights(mi, loaded, view, moving) if lighting else []
        tracer = Tracer(
            mi=mi,
            scene=loaded,
            camera=camera,
            integrator=chosen,
            shading_spp=shading_spp,
            background_depth=choose_background(loaded, camera, background_depth, moving),
            moving=moving,
            gloss=Gloss(mi, camera.lens_radius) if bandwidth else None,
            lights=LightTracer(mi, loaded, view, lights, moving) if lights else None,
            unlit=Unlit(mi, loaded, chosen, [light.emitter for light in lights]) if lights else None,
        )
        times = None if moving is None else pattern.slice_times(time_slices)
        luv = pattern.on_lights([light.area for light in lights]) if lights else None
        arrays = tracer.trace(xy.reshape(-1, 2), uv.reshape(-1, 2), times, luv, seed, progress)
    if times is not None:
        arrays["time"] = times
    return _buffer(xy, uv, arrays, lens, view.projection, lights)


def _buffer(
    xy: Float32,
    uv: Float32,
    arrays: dict[str, Float32],
    lens: Lens,
    projection: Projection,
    lights: Sequence[FoundLight],
) -> SampleBuffer:
    """Give arrays (N, ...) the image's shape, and put them where they belong."""
    camera: dict[str, Any] = {}
    parts: list[dict[str, Any]] = [{} for _ in lights]
    for name, array in arrays.items():
        owner, _, field = name.rpartition(".")
        part = parts[int(owner.removeprefix("light"))] if owner else camera
        part[field] = array.reshape(*xy.shape[:3], *array.shape[1:])
    if not lights:
        return SampleBuffer(xy, uv, lens=lens, **camera)
    lighting = Lighting(
        projection,
        normal=camera.pop("normal"),
        depth_gradient=camera.pop("depth_gradient"),
        unlit=camera["color"],
        lights=[LightSamples(light.area, **part) for light, part in zip(lights, parts, strict=True)],
    )
    unlit = SampleBuffer(xy, uv, lens=lens, lighting=lighting, **camera)
    return dataclasses.replace(unlit, color=lighting.color(unlit))


def lens_of(
    scene: Any,
    *,
    width: int | None = None,
    height: int | None = None,
    aperture: LensAperture = "disc",
    sampling: Sampling | None = None,
    sigma: float = 1.0 / 3.0,
    lens_radius: float | None = None,
    focus_distance: float | None = None,
    sensor: int = 0,
    variant: str | None = None,
) -> Lens:
    """Return the lens that `render` would trace a scene through; parameters as there.

    Returns
    -------
    Lens
        In pixels of an image of that size.

    Raises
    ------
    SampleError, ImportError
        As `render`.
    """
    with active_variant(variant, scene) as mi:
        camera = Camera.of(mi, load_scene(mi, scene), sensor, width, height, lens_radius, focus_distance)
    return camera.lens(aperture, sampling or aperture, sigma)
