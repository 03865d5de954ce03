"""Samples from any Mitsuba 3 scene.

Mitsuba's own sensors hide the lens position of a ray, and its ``depth`` AOV is a ray parameter averaged over
the pixel. So this source builds the thin-lens rays itself, asks the scene where they hit and the scene's
integrator how much light comes back:

1. image and lens positions from `fewrays.sources.patterns`;
2. `_Camera.rays`: the ray through both, in world space;
3. ``scene.ray_intersect_preliminary``: planar depth, one per sample;
4. ``integrator.sample``: radiance, the mean of `shading_spp` light paths along that same ray.

Moving scenes go through steps 2 to 4 once for each slice of the shutter interval; see
`fewrays.sources.mitsuba_motion`. How far over the lens a sample's radiance holds is read off the roughness of
what it hit; see `fewrays.sources.mitsuba_gloss`. With `lighting`, area lights are sampled apart
(`fewrays.sources.mitsuba_lights`), and step 4 is done without them (`fewrays.sources.mitsuba_unlit`).

Camera space follows Mitsuba: x to the *left* of the image, y up, z forward. With image coordinates x right
and y down, both change sign, for lens positions as for directions.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, require_option
from fewrays.lens import Lens, LensAperture, Sampling
from fewrays.light_samples import LightSamples
from fewrays.lighting import Lighting
from fewrays.parallel import progress_bar
from fewrays.projection import Projection
from fewrays.samples import SampleBuffer
from fewrays.sources.llvm import find_llvm
from fewrays.sources.mitsuba_gloss import Gloss
from fewrays.sources.mitsuba_lights import FoundLight, LightTracer, View, find_lights
from fewrays.sources.mitsuba_motion import MovingShapes
from fewrays.sources.mitsuba_unlit import Unlit
from fewrays.sources.patterns import check_size, sample_lights, sample_pattern, sample_times

__all__ = ["VARIANTS", "activate", "lens_of", "render"]

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
"""The Mitsuba variants that this source runs on."""

_MAX_PATHS = 2**22  # light paths traced at once; Dr.Jit keeps about 200 bytes for each
_MAX_LIT = 2**18  # camera samples at once that get light samples, at about 1 kB for each
_MAX_SLICES = 65_536
_BACKGROUND_FACTOR = 1000.0  # escaped rays count as this many times farther than the scene's far end

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


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
    with _active_variant(variant, scene) as mi:
        loaded = _load(mi, scene, merge=not motion)
        moving = MovingShapes(mi, loaded, motion) if motion else None
        camera = _Camera.of(mi, loaded, sensor, width, height, lens_radius, focus_distance)
        lens = camera.lens(aperture, sampling or aperture, sigma)
        xy, uv = _pattern(camera, spp, seed, lens)
        chosen = _choose_integrator(mi, loaded, integrator, max_depth)
        view = camera.view(lens)
        lights = find_lights(mi, loaded, view, moving) if lighting else []
        tracer = _Tracer(
            mi=mi,
            scene=loaded,
            camera=camera,
            integrator=chosen,
            shading_spp=shading_spp,
            background_depth=_choose_background(loaded, camera, background_depth, moving),
            moving=moving,
            gloss=Gloss(mi, camera.lens_radius) if bandwidth else None,
            lights=LightTracer(mi, loaded, view, lights, moving) if lights else None,
            unlit=Unlit(mi, loaded, chosen, [light.emitter for light in lights]) if lights else None,
        )
        times = None if moving is None else _slice_times(camera, spp, seed, time_slices)
        luv = _light_points(camera, spp, seed, lights) if lights else None
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
    with _active_variant(variant, scene) as mi:
        camera = _Camera.of(mi, _load(mi, scene), sensor, width, height, lens_radius, focus_distance)
    return camera.lens(aperture, sampling or aperture, sigma)


def _pattern(camera: _Camera, spp: int, seed: int, lens: Lens) -> tuple[Float32, Float32]:
    """Return the whole image's pattern, made in blocks of rows because its intermediates are many."""
    size = (camera.height, camera.width, spp)
    check_size(*size)
    xy, uv = np.empty((*size, 2), np.float32), np.empty((*size, 2), np.float32)
    for rows in _row_blocks(camera, spp):
        xy[slice(*rows)], uv[slice(*rows)] = sample_pattern(
            *size, seed=seed, sampling=lens.sampling, sigma=lens.sigma, rows=rows
        )
    return xy, uv


def _slice_times(camera: _Camera, spp: int, seed: int, slices: int) -> Float32:
    """Return the pattern's times (N,), each moved to the middle of its slice of the shutter interval."""
    size = (camera.height, camera.width, spp)
    times = np.empty(size, np.float32)
    for rows in _row_blocks(camera, spp):
        continuous = sample_times(*size, seed=seed, rows=rows)
        times[slice(*rows)] = (np.floor(continuous * slices) + 0.5) / slices
    return times.reshape(-1)


def _light_points(camera: _Camera, spp: int, seed: int, lights: Sequence[FoundLight]) -> Float32:
    """Return the pattern's points on every light, (N, L, 2), in [-1, 1]² or the unit disc."""
    size = (camera.height, camera.width, spp)
    points = np.empty((*size, len(lights), 2), np.float32)
    for number, light in enumerate(lights):
        shape: Sampling = "disc" if light.area.shape == "disc" else "square"
        for rows in _row_blocks(camera, spp):
            points[slice(*rows), :, :, number] = sample_lights(
                *size, seed=seed, light=number, sampling=shape, rows=rows
            )
    return points.reshape(-1, len(lights), 2)


def _row_blocks(camera: _Camera, spp: int) -> Iterator[tuple[int, int]]:
    step = max(1, 2**20 // (camera.width * spp))
    for first in range(0, camera.height, step):
        yield first, min(first + step, camera.height)


@dataclasses.dataclass(frozen=True)
class _Camera:
    """A thin-lens camera in numbers.

    ``pixels`` is the focal length in pixels (pixels per unit of ``tan``), ``centre`` the image position of
    the optical axis, ``to_world`` a rigid 4 x 4 transform.
    """

    width: int
    height: int
    pixels: float
    centre: tuple[float, float]
    to_world: Float64
    near: float
    far: float
    time: float
    lens_radius: float
    focus_distance: float
    medium: Any

    @classmethod
    def of(
        cls,
        mi: ModuleType,
        scene: Any,
        index: int,
        width: int | None,
        height: int | None,
        lens_radius: float | None,
        focus_distance: float | None,
    ) -> _Camera:
        sensors = scene.sensors()
        if not 0 <= index < len(sensors):
            raise SampleError(
                f"the scene has {len(sensors)} sensors, numbered from 0; got {index}", field="sensor"
            )
        sensor = sensors[index]
        kind = {"PerspectiveCamera": "perspective", "ThinLensCamera": "thinlens"}.get(sensor.class_name())
        if kind is None:
            raise SampleError(
                f"{sensor.class_name()} is not supported; use a 'perspective' or 'thinlens' sensor",
                field="sensor",
            )
        parameters = mi.traverse(sensor)
        if kind == "thinlens":
            lens_radius = _number(parameters["aperture_radius"]) if lens_radius is None else lens_radius
            focus_distance = (
                _number(parameters["focus_distance"]) if focus_distance is None else focus_distance
            )
        radius, focus = _check_lens(lens_radius, focus_distance)
        size, window = _film(sensor.film(), width, height)
        pixels = 0.5 * size[0] / math.tan(math.radians(_number(parameters["x_fov"])) / 2)
        offset = [
            _number(parameters[f"principal_point_offset_{axis}"]) if kind == "perspective" else 0.0
            for axis in "xy"
        ]
        centre = tuple(size[k] * (0.5 - offset[k]) - window[k] for k in range(2))
        return cls(
            width=int(window[2]),
            height=int(window[3]),
            pixels=pixels,
            centre=(centre[0], centre[1]),
            to_world=np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4),
            near=float(sensor.near_clip()),
            far=float(sensor.far_clip()),
            time=float(sensor.shutter_open()),
            lens_radius=radius,
            focus_distance=focus,
            medium=sensor.get_medium(),
        )

    def lens(self, aperture: LensAperture, sampling: Sampling, sigma: float) -> Lens:
        blur = self.pixels * self.lens_radius
        return Lens(-blur, blur / self.focus_distance, aperture, sampling, sigma)

    def view(self, lens: Lens) -> View:
        return View(Projection((self.pixels, self.pixels), self.centre), lens, self.to_world)

    def rays(self, xy: Float32, uv: Float32) -> tuple[Float32, Float32]:
        """Return where rays cross the near plane and their directions, both (N, 3), in world space.

        Directions have unit length along the optical axis, so a step along them is a step in planar depth.
        """
        on_lens = self.lens_radius * uv.astype(np.float64)
        direction = np.ones((len(xy), 3))
        direction[:, :2] = (self.centre - xy.astype(np.float64)) / self.pixels + on_lens / self.focus_distance
        origin = np.zeros((len(xy), 3))
        origin[:, :2] = -on_lens
        origin += self.near * direction
        rotation, position = self.to_world[:3, :3], self.to_world[:3, 3]
        return (origin @ rotation.T + position).astype(np.float32), (direction @ rotation.T).astype(
            np.float32
        )

    def screen_motion(self, displacement: Float64) -> Float32:
        """Return changes (N, 3) of (x w, y w, w) as the lens centre sees them, in pixels times depth units.

        Such a change is the same from wherever the point starts, because x w, y w and w are linear in the
        point's position (temporal, section 3.1).
        """
        left, up, forward = (displacement @ self.to_world[:3, :3]).T
        x, y = self.centre
        return np.stack(
            [x * forward - self.pixels * left, y * forward - self.pixels * up, forward], axis=-1
        ).astype(np.float32)


@dataclasses.dataclass(frozen=True)
class _Tracer:
    """Traces primary samples in batches of bounded size, moving ones slice of time by slice of time."""

    mi: ModuleType
    scene: Any
    camera: _Camera
    integrator: Any
    shading_spp: int
    background_depth: float
    moving: MovingShapes | None
    gloss: Gloss | None
    lights: LightTracer | None
    unlit: Unlit | None

    def trace(
        self,
        xy: Float32,
        uv: Float32,
        times: Float32 | None,
        luv: Float32 | None,
        seed: int,
        progress: bool,
    ) -> dict[str, Float32]:
        """Return ``depth`` (N,) and ``color`` (N, 3) of samples, and what else they have.

        They are at `xy` and `uv`, both (N, 2). `times` (N,) come with moving shapes, and are few different
        ones; then there is ``motion`` (N, 3). With `gloss` there is ``bandwidth`` (N,). With `lights` and
        points `luv` (N, L, 2) on them, ``color`` is without their light, and there is what
        `LightTracer.trace` returns.
        """
        import drjit as dr

        count = len(xy)
        arrays: dict[str, Float32] = {}
        posing = contextlib.nullcontext() if self.moving is None else self.moving.posing()
        with posing, progress_bar(count, "render", show=progress, unit="sample") as bar:
            for part, time, entropy in self._parts(count, times):
                points = None if luv is None else luv[part]
                batch = self._trace_batch(xy[part], uv[part], time, points, [seed, *entropy])
                for name, values in batch.items():
                    if name not in arrays:
                        arrays[name] = np.empty((count, *values.shape[1:]), np.float32)
                    arrays[name][part] = values
                bar.update(len(batch["depth"]))
        # Dr.Jit keeps its memory, and work that is still queued when the interpreter ends can crash it.
        dr.sync_thread()
        dr.flush_malloc_cache()
        return arrays

    def _parts(
        self, count: int, times: Float32 | None
    ) -> Iterator[tuple[slice | npt.NDArray[np.intp], float, tuple[int, ...]]]:
        """Cut samples into numbered parts of bounded size, and pose the scene for each as it comes up.

        Each comes with its time over the shutter.
        """
        size = max(1, _MAX_PATHS // self.shading_spp)
        if self.lights is not None:
            size = min(size, _MAX_LIT)
        if self.moving is None or times is None:
            for number, first in enumerate(range(0, count, size)):
                yield slice(first, min(first + size, count)), 0.0, (number,)
            return
        order = np.argsort(times, kind="stable")
        values, starts = np.unique(times[order], return_index=True)
        for index, (time, members) in enumerate(zip(values, np.split(order, starts[1:]), strict=True)):
            self.moving.pose(float(time))
            for number, first in enumerate(range(0, len(members), size)):
                yield members[first : first + size], float(time), (index, number)

    def _trace_batch(
        self, xy: Float32, uv: Float32, time: float, luv: Float32 | None, entropy: Sequence[int]
    ) -> dict[str, Float32]:
        import drjit as dr

        mi, camera = self.mi, self.camera
        seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
        origin, direction = camera.rays(xy, uv)
        length = np.linalg.norm(direction, axis=1).astype(np.float32)
        ray = mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f((direction / length[:, None]).T), camera.time, [])
        ray.maxt = mi.Float((camera.far - camera.near) * length)
        hit = self.scene.ray_intersect_preliminary(ray, True)
        depth = dr.select(hit.is_valid(), camera.near + hit.t / mi.Float(length), self.background_depth)

        radiance = self._radiance(ray, hit, seed, len(xy))
        dr.eval(depth, radiance, hit)  # or else block_sum would trace all paths once for each channel
        mean = dr.block_sum(radiance, self.shading_spp) / self.shading_spp
        arrays = {"depth": depth.numpy(), "color": mean.numpy().T}
        if self.moving is not None:
            arrays["motion"] = camera.screen_motion(self.moving.displacement(hit, ray))
        if self.gloss is not None:
            arrays["bandwidth"] = self.gloss.bandwidth(hit, ray, arrays["depth"])
        if self.lights is not None and luv is not None:
            arrays |= self.lights.trace(hit, ray, xy, uv, arrays["depth"], time, luv)
        return arrays

    def _radiance(self, ray: Any, hit: Any, seed: int, count: int) -> Any:
        """Return the radiance of `shading_spp` light paths along each ray."""
        import drjit as dr

        mi = self.mi
        sampler = mi.load_dict({"type": "multijitter", "sample_count": self.shading_spp})
        if sampler.sample_count() != self.shading_spp:  # it only makes near-square grids
            sampler = mi.load_dict({"type": "independent", "sample_count": self.shading_spp})
        sampler.set_samples_per_wavefront(self.shading_spp)
        sampler.seed(seed, count * self.shading_spp)
        paths = mi.RayDifferential3f(
            dr.repeat(ray.o, self.shading_spp), dr.repeat(ray.d, self.shading_spp), self.camera.time, []
        )
        paths.maxt = dr.repeat(ray.maxt, self.shading_spp)
        if self.unlit is not None:
            dr.eval(hit)
            index = dr.repeat(dr.arange(mi.UInt32, count), self.shading_spp)
            same = dr.gather(mi.PreliminaryIntersection3f, hit, index)
            return self.unlit.sample(sampler, same, paths)
        return mi.Color3f(self.integrator.sample(self.scene, sampler, paths, self.camera.medium)[0])


def _film(
    film: Any, width: int | None, height: int | None
) -> tuple[tuple[int, int], tuple[int, int, int, int]]:
    """Return the size of the whole film and its crop window (x, y, width, height), both in output pixels."""
    size = (int(film.size()[0]), int(film.size()[1]))
    crop = (*(int(v) for v in film.crop_offset()), *(int(v) for v in film.crop_size()))
    if width is None and height is None:
        return size, (crop[0], crop[1], crop[2], crop[3])
    for name, value in (("width", width), ("height", height)):
        if value is not None and value < 1:
            raise SampleError(f"expected at least 1, got {value}", field=name)
    if crop != (0, 0, *size):
        raise SampleError(
            "the film has a crop window, which only makes sense at the film's own size: "
            "leave out width and height, or remove the crop window",
            field="width" if width is not None else "height",
        )
    if width is None:
        assert height is not None
        width = max(1, round(height * size[0] / size[1]))
    if height is None:
        height = max(1, round(width * size[1] / size[0]))
    return (width, height), (0, 0, width, height)


def _check_lens(lens_radius: float | None, focus_distance: float | None) -> tuple[float, float]:
    if lens_radius is None and focus_distance is None:
        return 0.0, 1.0  # a pinhole: every depth is in focus
    if lens_radius is None:
        raise SampleError("the perspective sensor has no lens: give lens_radius as well", field="lens_radius")
    if focus_distance is None:
        raise SampleError(
            "the perspective sensor has no lens: give focus_distance as well", field="focus_distance"
        )
    if not (math.isfinite(lens_radius) and lens_radius >= 0):
        raise SampleError(f"expected a finite number >= 0, got {lens_radius!r}", field="lens_radius")
    if math.isnan(focus_distance) or focus_distance <= 0:
        raise SampleError(
            f"expected a positive number or inf, got {focus_distance!r}", field="focus_distance"
        )
    return float(lens_radius), float(focus_distance)


def _choose_background(
    scene: Any, camera: _Camera, given: float | None, moving: MovingShapes | None
) -> float:
    """Return the depth of rays that hit nothing: finite, and behind everything that can be hit."""
    box = scene.bbox()
    far = camera.near
    if box.valid():
        points = np.array([[float(box.corner(i)[k]) for k in range(3)] for i in range(8)])
        if moving is not None:
            points = np.concatenate([points, moving.end_points()])
        depths = (points - camera.to_world[:3, 3]) @ camera.to_world[:3, 2]
        far = max(far, min(float(depths.max()), camera.far))
    if given is None:
        focus = camera.focus_distance if math.isfinite(camera.focus_distance) else 0.0
        return _BACKGROUND_FACTOR * max(far, focus)
    if not (math.isfinite(given) and given > 0):
        raise SampleError(f"expected a positive, finite number, got {given!r}", field="background_depth")
    if given < far:
        raise SampleError(
            f"expected at least {far:g}, where the scene ends as seen from the camera; got {given:g}",
            field="background_depth",
        )
    return float(given)


def _choose_integrator(mi: ModuleType, scene: Any, given: Any, max_depth: int | None) -> Any:
    if given is not None and max_depth is not None:
        raise SampleError("give either integrator or max_depth", field="max_depth")
    if max_depth is not None:
        if max_depth < 1:
            raise SampleError(f"expected at least 1 (emitted light only), got {max_depth}", field="max_depth")
        given = {"type": "path", "max_depth": max_depth}
    if given is None:
        chosen = scene.integrator()
    elif isinstance(given, Mapping):
        try:
            chosen = mi.load_dict(dict(given))
        except (RuntimeError, TypeError) as error:
            raise SampleError(f"Mitsuba cannot load it: {error}", field="integrator") from error
    else:
        chosen = given
    # The differentiable integrators sample derivatives along with radiance, through another signature.
    if not isinstance(chosen, mi.SamplingIntegrator) or isinstance(chosen, mi.CppADIntegrator):
        name = chosen.class_name() if hasattr(chosen, "class_name") else type(chosen).__name__
        raise SampleError(
            f"{name} does not just trace paths from the camera; choose another, such as {{'type': 'path'}}",
            field="integrator",
        )
    return chosen


def _load(mi: ModuleType, scene: Any, *, merge: bool = True) -> Any:
    """Load a scene unless it is loaded; Mitsuba merges meshes of one material unless told not to."""
    if isinstance(scene, mi.Scene):
        return scene
    file = scene if isinstance(scene, (str, Path)) else None
    if file is not None and not Path(file).is_file():
        raise SampleError("no such file", file=file)
    if file is None and not isinstance(scene, Mapping):
        raise SampleError(
            f"expected an XML file, a dictionary or a mitsuba.Scene, got {type(scene).__name__}",
            field="scene",
        )
    try:
        options = {} if merge else {"optimize": False}
        loaded = mi.load_dict(dict(scene), **options) if file is None else mi.load_file(str(file), **options)
    except (RuntimeError, TypeError) as error:
        raise SampleError(f"Mitsuba cannot load it: {error}", file=file, field="scene") from error
    if not isinstance(loaded, mi.Scene):
        raise SampleError(f"expected a scene, got {type(loaded).__name__}", file=file, field="scene")
    return loaded


def activate(variant: str | None = None) -> str:
    """Activate a Mitsuba variant that this source runs on, after making sure that it can work.

    `render` does so by itself. Call this before building scenes from Mitsuba objects such as transforms.

    Parameters
    ----------
    variant : {"llvm_ad_rgb", "cuda_ad_rgb"}, optional
        The active variant where it is one of these; otherwise CUDA where there is a GPU, else LLVM.

    Returns
    -------
    str
        The variant that is now active.

    Raises
    ------
    SampleError
        For an unknown variant, and when there is no LLVM library that Mitsuba can use.
    ImportError
        When Mitsuba is not installed.
    """
    mi = _import_mitsuba()
    active = mi.variant()
    wanted = _default_variant(mi, active) if variant is None else variant
    if wanted not in VARIANTS:
        raise SampleError(f"expected one of {', '.join(VARIANTS)}; got {wanted!r}", field="variant")
    if wanted not in mi.variants():
        raise SampleError(
            f"this build of Mitsuba has no {wanted}; it has {', '.join(mi.variants())}", field="variant"
        )
    if wanted != active:
        if wanted.startswith("llvm"):
            find_llvm()
        mi.set_variant(wanted)
    return wanted


@contextlib.contextmanager
def _active_variant(wanted: str | None, scene: Any) -> Iterator[ModuleType]:
    """Activate a variant, and bring back the caller's afterwards."""
    mi = _import_mitsuba()
    before = mi.variant()
    chosen = activate(wanted)
    try:
        owner = getattr(scene, "variant_name", None)
        if callable(owner) and owner() != chosen:
            raise SampleError(
                f"the scene was loaded under {owner()}: load it after mitsuba.set_variant({chosen!r})",
                field="scene",
            )
        yield mi
    finally:
        if before not in (None, chosen):
            mi.set_variant(before)


def _import_mitsuba() -> ModuleType:
    try:
        import mitsuba as mi
    except ImportError as error:
        raise ImportError('mitsuba is not installed; pip install "fewrays[mitsuba]" provides it') from error
    module: ModuleType = mi
    return module


def _default_variant(mi: ModuleType, active: str | None) -> str:
    if active in VARIANTS:
        return str(active)
    if "cuda_ad_rgb" in mi.variants():
        import drjit as dr

        if dr.has_backend(dr.JitBackend.CUDA):
            return "cuda_ad_rgb"
    return "llvm_ad_rgb"


def _number(value: Any) -> float:
    """Return a scalar or a Dr.Jit array of one element as a float."""
    return float(np.asarray(value).reshape(-1)[0])
