"""Primary samples of a Mitsuba scene: where their rays hit, and how much light comes back."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.parallel import progress_bar
from fewrays.sources.mitsuba_camera import Camera
from fewrays.sources.mitsuba_gloss import Gloss
from fewrays.sources.mitsuba_lights import LightTracer
from fewrays.sources.mitsuba_motion import MovingShapes
from fewrays.sources.mitsuba_unlit import Unlit

__all__ = ["Tracer"]

_MAX_PATHS = 2**22  # light paths traced at once; Dr.Jit keeps about 200 bytes for each
_MAX_LIT = 2**18  # camera samples at once that get light samples, at about 1 kB for each

Float32 = npt.NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Tracer:
    """Traces primary samples in batches of bounded size, moving ones slice of time by slice of time."""

    mi: ModuleType
    scene: Any
    camera: Camera
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
