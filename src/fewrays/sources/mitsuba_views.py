"""Pinhole views of any Mitsuba 3 scene: what one point of the lens sees, and what lies behind that.

The input of *dynamic* (Yu, Wang and Yu 2010) is one such view with its depth; its second depth layer comes
from rays that start beyond the first hit, as in depth peeling [1]_. The mean of many views from points spread
over the lens is the accumulation buffer [2]_, the paper's baseline.

Colours are means over the pixel, antialiased, as renderers write them. Depths are those of the pixel's
centre alone: a mean of depths would lie on no surface.

References
----------
.. [1] C. Everitt. "Interactive order-independent transparency". Nvidia, 2001.
.. [2] P. Haeberli, K. Akeley. "The accumulation buffer". SIGGRAPH 1990. DOI:10.1145/97879.97913
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.errors import require_option
from fewrays.lens import Lens
from fewrays.parallel import progress_bar
from fewrays.sources.mitsuba import activate, lens_of

__all__ = ["PinholeViews"]

Float32 = npt.NDArray[np.float32]

_MAX_PATHS = 2**22  # traced at once
_MAX_SPP = 2**16
_SKIPS = 8  # insides of closed things that the second layer may pass, one after the other
_TEST_SPP = 16  # light paths that tell whether it is dark
_DARK = 0.02  # of the mean radiance, up to which it is


class PinholeViews:
    """A scene as the points of its lens see it.

    Parameters
    ----------
    scene : mitsuba.Scene
        Loaded under the variant that `fewrays.sources.mitsuba.activate` gives, with a ``thinlens`` or
        ``perspective`` sensor whose film has no crop window.
    spp : int
        Light paths per pixel.
    lens_radius, focus_distance : float, optional
        In scene units; the ``thinlens`` sensor's own unless given.
    sensor : int
        Which of the scene's sensors to use.
    progress : bool
        Show a progress bar on stderr for work over two seconds.

    Raises
    ------
    SampleError, ImportError
        As `fewrays.sources.mitsuba.lens_of`.
    """

    def __init__(
        self,
        scene: Any,
        *,
        spp: int = 64,
        lens_radius: float | None = None,
        focus_distance: float | None = None,
        sensor: int = 0,
        progress: bool = False,
    ) -> None:
        require_option("spp", spp, 1 <= spp <= _MAX_SPP, f"from 1 to {_MAX_SPP}")
        activate()
        self.lens: Lens = lens_of(
            scene, lens_radius=lens_radius, focus_distance=focus_distance, sensor=sensor
        )
        self._mi = _mitsuba()
        self._scene, self._sensor = scene, scene.sensors()[sensor]
        self._width, self._height = (int(side) for side in self._sensor.film().size())
        self._spp, self._progress = spp, progress

    def view(self, uv: tuple[float, float] = (0.0, 0.0), *, seed: int = 0) -> Float32:
        """Return the image ``(H, W, 3)`` that a point of the lens sees, the focal plane in register."""
        pixels = self._pixels()
        color = self._shade(uv, pixels, np.zeros(len(pixels), np.float32), seed, self._spp)
        return color.reshape(self._height, self._width, 3)

    def layers(self, *, separation: float = 0.1, seed: int = 0) -> tuple[DepthLayer, DepthLayer]:
        """Return what the lens centre sees, and what lies behind it.

        Parameters
        ----------
        separation : float
            How much farther than the first layer the second one begins, as a share of the first depth: the
            far side of a thin leaf would not be worth a layer.
        seed : int
            Another seed gives independent noise.

        Returns
        -------
        front, behind : DepthLayer
            Infinitely deep where a ray leaves the scene. The one behind is transparent where no light was
            found.

        Raises
        ------
        SampleError
            For a separation out of range.
        """
        require_option("separation", separation, 0 < separation <= 10, "above 0 and up to 10")
        pixels = self._pixels()
        shape = (self._height, self._width)
        depth = self._depth(pixels, np.zeros(len(pixels), np.float32))
        front = DepthLayer(self.view(seed=seed), depth.reshape(shape))
        starts, lit = self._behind(pixels, depth, separation, seed + 1)
        color = self._shade((0.0, 0.0), pixels, starts, seed + 2, self._spp)
        color[~lit] = 0
        behind = np.where(lit, self._depth(pixels, starts), np.inf).astype(np.float32)
        alpha = lit.astype(np.float32).reshape(shape)
        return front, DepthLayer(color.reshape(*shape, 3), behind.reshape(shape), alpha)

    def _behind(
        self, pixels: Float32, front: Float32, separation: float, seed: int
    ) -> tuple[Float32, npt.NDArray[np.bool_]]:
        """Return from which depths (N,) rays see what lies behind the first hit, and whether they do.

        Where next to no light comes back the ray is inside of something closed, which no other point of the
        lens would see: it starts anew beyond the wall.
        """
        starts = np.where(np.isfinite(front), front * np.float32(1 + separation), np.float32(0))
        inside = np.flatnonzero(np.isfinite(front))
        for skip in range(_SKIPS):
            color = self._shade((0.0, 0.0), pixels[inside], starts[inside], seed + skip, _TEST_SPP)
            depth = self._depth(pixels[inside], starts[inside])
            if skip == 0:
                dark = _DARK * float(color.mean())
            stays = (color.mean(axis=-1) <= dark) & np.isfinite(depth)
            starts[inside[stays]] = depth[stays] * np.float32(1 + separation / 10)
            inside = inside[stays]
            if inside.size == 0:
                break
        lit = np.ones(len(pixels), bool)
        lit[inside] = False
        return starts, lit

    def _depth(self, pixels: Float32, starts: Float32) -> Float32:
        """Return the planar depths (N,) of the first hits beyond `starts` (N,) at the pixels' centres."""
        import drjit as dr

        ray, cosine = self._rays((0.0, 0.0), self._mi.Point2f((pixels + 0.5).T), self._mi.Float(starts))
        hit = self._scene.ray_intersect_preliminary(ray, True)
        start = dr.maximum(self._mi.Float(starts), self._sensor.near_clip())
        return np.asarray(dr.select(hit.is_valid(), start + hit.t * cosine, math.inf).numpy(), np.float32)

    def _shade(
        self, uv: tuple[float, float], pixels: Float32, starts: Float32, seed: int, spp: int
    ) -> Float32:
        """Return the mean radiance (N, 3) of light paths over pixels (N, 2), beyond `starts` (N,)."""
        color = np.empty((len(pixels), 3), np.float32)
        step = max(1, _MAX_PATHS // spp)
        with progress_bar(len(pixels), "view", show=self._progress, unit="pixel") as bar:
            for number, first in enumerate(range(0, len(pixels), step)):
                part = slice(first, first + step)
                entropy = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
                color[part] = self._radiance(uv, pixels[part], starts[part], entropy, spp)
                bar.update(len(color[part]))
        return color

    def _radiance(
        self, uv: tuple[float, float], pixels: Float32, starts: Float32, seed: int, spp: int
    ) -> Float32:
        import drjit as dr

        mi = self._mi
        sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        if sampler.sample_count() != spp:  # it only makes near-square grids
            sampler = mi.load_dict({"type": "independent", "sample_count": spp})
        sampler.set_samples_per_wavefront(spp)
        sampler.seed(seed, len(pixels) * spp)
        within = sampler.next_2d()
        corner = dr.repeat(mi.Point2f(pixels.T), spp)
        ray, _ = self._rays(uv, corner + within, dr.repeat(mi.Float(starts), spp))
        integrator, medium = self._scene.integrator(), self._sensor.get_medium()
        radiance = mi.Color3f(integrator.sample(self._scene, sampler, mi.RayDifferential3f(ray), medium)[0])
        dr.eval(radiance)
        mean = dr.block_sum(radiance, spp) / spp
        return np.asarray(mean.numpy().T, np.float32)

    def _pixels(self) -> Float32:
        """Return the upper left corners (N, 2) of all pixels."""
        columns, rows = np.meshgrid(np.arange(self._width), np.arange(self._height))
        return np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float32)

    def _rays(self, uv: tuple[float, float], position: Any, starts: Any) -> tuple[Any, Any]:
        """Return rays from a lens point through image positions, and the cosines with the optical axis.

        The sensor gives the ray through the lens centre; the one from elsewhere meets it in the focal plane.
        Rays start at the planar depths `starts`. Camera space has x to the left of the image and y up.
        """
        import drjit as dr

        mi = self._mi
        central, _ = self._sensor.sample_ray(
            self._sensor.shutter_open(),
            0.5,
            position / mi.Point2f(self._width, self._height),
            mi.Point2f(0.5),
        )
        world = self._sensor.world_transform()
        left, up, forward = (world @ mi.Vector3f(*axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
        eye = world @ mi.Point3f(0)
        inverse_focus = -self.lens.c1 / self.lens.c0 if self.lens.c0 else 0.0
        offset = -(left * uv[0] + up * uv[1]) * self._lens_radius()
        direction = central.d / dr.dot(central.d, forward) - offset * inverse_focus
        cosine = dr.rcp(dr.norm(direction))
        start = dr.maximum(starts, self._sensor.near_clip())
        ray = mi.Ray3f(eye + offset + direction * start, direction * cosine, central.time, [])
        return ray, cosine

    def _lens_radius(self) -> float:
        """Return the lens radius in scene units: c0 is that times the focal length in pixels."""
        fov = float(np.asarray(self._mi.traverse(self._sensor)["x_fov"]).reshape(-1)[0])
        return -self.lens.c0 * math.tan(math.radians(fov) / 2) / (0.5 * self._width)


def _mitsuba() -> ModuleType:
    import mitsuba as mi

    module: ModuleType = mi
    return module
