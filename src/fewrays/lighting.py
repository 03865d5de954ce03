"""`Lighting`: what it takes to shade camera samples anew with area lights (temporal, section 5).

The noisy radiance of a camera sample is that of everything but the area lights, plus what its own light
samples bring. A method that knows of lights takes the visibility from many light samples; one that does not
takes the sum, `SampleBuffer.color`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.arrays import (
    Float32,
    as_float32,
    check_nan_option,
    check_range,
    check_shapes,
    find_unusable,
    park,
)
from fewrays.errors import SampleError
from fewrays.light_samples import LightSamples
from fewrays.projection import Projection

if TYPE_CHECKING:
    from fewrays.samples import SampleBuffer

__all__ = ["MAX_LIGHTS", "AreaLight", "LightSamples", "Lighting", "Projection"]

Float64 = npt.NDArray[np.float64]

MAX_LIGHTS = 64
"""Largest number of area lights beside one buffer of samples."""

_ROUNDING = 1e-5
"""Share of a point's distance by which renderers may mistake its depth: some hundred roundings of float32."""

_LENGTH_TOLERANCE = 1e-3  # of normals
_BLOCK = 1 << 18  # samples shaded at a time


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Lighting:
    """Area lights, and how the camera samples' surfaces look at them.

    Arrays are converted to C-contiguous float32 and are not copied when they already are. Camera samples that
    hit nothing have the normal (0, 0, -1), the gradient 0, and light samples of density 0.

    Parameters
    ----------
    projection : Projection
        How the lens centre sees camera space.
    normal : array_like, (H, W, S, 3)
        Unit shading normals in camera space, on the side that the camera sees.
    depth_gradient : array_like, (H, W, S, 2)
        Depth units per pixel along x and y that the tangent plane of the surface has where the lens centre
        sees it.
    unlit : array_like, (H, W, S, 3)
        Linear RGB radiance without the direct light of `lights`: emission, other lights, indirect light.
    lights : sequence of LightSamples
        At least one, at most `MAX_LIGHTS`.
    nan : {"reject", "drop"}
        What to do with camera samples that hold a NaN or an infinity here: raise, or drop their light samples
        with a warning.

    Raises
    ------
    SampleError
        Naming the field, the index and the value of the first thing that is wrong.

    Notes
    -----
    A camera sample is dropped for all lights or for none.

    Examples
    --------
    A white matte wall of four pixels, of which one is in the shadow of something halfway to the light. The
    light samples come from the light's centre:

    >>> from fewrays import AreaLight, Lens, Lighting, LightSamples, Projection, SampleBuffer
    >>> from fewrays.temporal.view_light import density
    >>> projection = Projection.from_fov(4, 1, fov=40.0)
    >>> light = AreaLight(center=(0, -1, 0), half_u=(0, 0.2, 0), half_v=(0.2, 0, 0))
    >>> light.normal.tolist()
    [0.0, 0.0, -1.0]

    That faces away from the wall, so u and v change places:

    >>> light = AreaLight(light.center, light.half_v, light.half_u, plane_distance=5.0)
    >>> xy = np.array([[[[0.5, 0.5]], [[1.5, 0.5]], [[2.5, 0.5]], [[3.5, 0.5]]]])
    >>> wall, none = np.full((1, 4, 1), 5.0), np.zeros((1, 4, 1, 2))
    >>> lxy, depth = light.project(projection.points(xy, wall), none)
    >>> depth[0, 2] /= 2
    >>> white = np.ones((1, 4, 1, 3))
    >>> rho = density(projection, light, xy, wall, none)
    >>> rays = LightSamples(light, lxy, none, depth, 1000 * white, rho, white / np.pi)
    >>> lighting = Lighting(projection, white * [0, 0, -1], none, 0 * white, [rays])
    >>> samples = SampleBuffer(xy, none, wall, 0 * white, Lens(-1.0, 0.2))
    >>> [f"{radiance:.2f}" for radiance in lighting.direct(samples, 0)[0, :, 0, 0]]
    ['1.64', '1.85', '0.00', '1.64']
    >>> samples = SampleBuffer(xy, none, wall, lighting.color(samples), samples.lens, lighting=lighting)
    >>> samples
    SampleBuffer(4 x 1 pixels, 1 spp, lens=Lens(c0=-1.0, c1=0.2, ...), still, 1 light)
    """

    CHANNELS: ClassVar[dict[str, int | None]] = {"normal": 3, "depth_gradient": 2, "unlit": 3}
    """Each array's length along the axis after (H, W, S), if there is one."""

    projection: Projection
    normal: Float32
    depth_gradient: Float32
    unlit: Float32
    lights: tuple[LightSamples, ...]

    def __init__(
        self,
        projection: Projection,
        normal: npt.ArrayLike,
        depth_gradient: npt.ArrayLike,
        unlit: npt.ArrayLike,
        lights: tuple[LightSamples, ...] | list[LightSamples],
        *,
        nan: Literal["reject", "drop"] = "reject",
    ) -> None:
        if not isinstance(projection, Projection):
            raise SampleError(
                f"expected a fewrays.Projection, got {type(projection).__name__}", field="projection"
            )
        check_nan_option(nan)
        lights = _check_lights(lights)
        shape = lights[0].shape
        given = {"normal": normal, "depth_gradient": depth_gradient, "unlit": unlit}
        arrays = {name: as_float32(name, value) for name, value in given.items()}
        check_shapes(arrays, self.CHANNELS, shape)
        bad = find_unusable(arrays, shape, drop=nan == "drop")
        if bad.any():
            warnings.warn(
                f"dropped {int(bad.sum())} of {bad.size} samples whose normal, depth gradient or unlit "
                "radiance holds NaN or infinity",
                stacklevel=2,
            )
        for light in lights:
            bad |= light.dropped()
        if bad.any():
            arrays = park(arrays, bad, _PARKED)
            lights = tuple(light if light.dropped()[bad].all() else light.drop(bad) for light in lights)
        check_range(
            "normal",
            np.sqrt(np.square(arrays["normal"]).sum(axis=-1)),
            lambda length: np.abs(length - 1) <= _LENGTH_TOLERANCE,
            "is the length; normals have the length 1",
        )
        object.__setattr__(self, "projection", projection)
        object.__setattr__(self, "lights", lights)
        for name, array in arrays.items():
            object.__setattr__(self, name, array)

    def field_names(self) -> tuple[str, ...]:
        """Names of the arrays, without those of the lights."""
        return tuple(self.CHANNELS)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Image height, width and samples per pixel."""
        return self.lights[0].shape

    @property
    def nbytes(self) -> int:
        """Bytes that the arrays take, those of the lights included."""
        own: int = sum(getattr(self, name).nbytes for name in self.field_names())
        return own + sum(light.nbytes for light in self.lights)

    @property
    def moves(self) -> bool:
        """Whether a light or what it shines on moves, so that times are needed."""
        return any(light.moves for light in self.lights)

    def dropped(self) -> npt.NDArray[np.bool_]:
        """Tell whose light samples were dropped, ``(H, W, S)``."""
        return self.lights[0].dropped()

    def drop(self, bad: npt.NDArray[np.bool_]) -> Lighting:
        """Return it with the light samples of some camera samples ``(H, W, S)`` dropped."""
        arrays: dict[str, Any] = park(
            {name: getattr(self, name) for name in self.field_names()}, bad, _PARKED
        )
        lights = tuple(light.drop(bad) for light in self.lights)
        return replace(self, **arrays, lights=lights)

    def points(self, samples: SampleBuffer, rows: slice = slice(None)) -> Float64:
        """Return the points that camera samples hit.

        Parameters
        ----------
        samples : SampleBuffer
            The samples that this belongs to.
        rows : slice
            Rows of the image.

        Returns
        -------
        ndarray, (H, W, S, 3)
            In camera space.
        """
        return self.projection.points(samples.at_center(rows), samples.depth[rows])

    def arrives(self, samples: SampleBuffer, light_number: int) -> npt.NDArray[np.bool_]:
        """Tell which light samples get to the points that they were aimed at, ``(H, W, S)``.

        A ray gets there if it does not end before the point's light-space depth, but for rounding.

        Parameters
        ----------
        samples : SampleBuffer
            The samples that this belongs to.
        light_number : int
            Which of `lights`.
        """
        result = np.empty(self.shape, bool)
        for rows in self._blocks():
            local, reach = self._receivers(samples, light_number, rows)
            light = self.lights[light_number]
            result[rows] = (light.density[rows] > 0) & (light.depth[rows] >= local[..., 2] - reach)
        return result

    def direct(self, samples: SampleBuffer, light_number: int, *, occluded: bool = True) -> Float32:
        """Return the radiance that the light samples of one light bring.

        It is the estimate of the direct light by one point of the light, for points drawn uniformly from its
        area A,

            reflectance * max(n . ω, 0) * max(-ω . n_light, 0) / r² * A * radiance,

        where ω is the direction from the camera sample's point to the light's and r their distance; or 0
        where the ray does not arrive.

        Parameters
        ----------
        samples : SampleBuffer
            The samples that this belongs to.
        light_number : int
            Which of `lights`.
        occluded : bool
            Whether rays that do not arrive bring nothing; otherwise they bring what they would if they did.

        Returns
        -------
        ndarray of float32, (H, W, S, 3)
        """
        light = self.lights[light_number]
        result = np.empty((*self.shape, 3), np.float32)
        light_up = self.arrives(samples, light_number) if occluded else light.density > 0
        for rows in self._blocks():
            local, _ = self._receivers(samples, light_number, rows)
            start = light.luv[rows] * light.light.half_size
            to_light = np.concatenate([start - local[..., :2], -local[..., 2:]], axis=-1)
            cosine = (self.normal[rows] * (to_light @ light.light.axes)).sum(axis=-1)
            # Both cosines still hold a factor r, which makes r to the fourth.
            squared = np.maximum(np.square(to_light).sum(axis=-1), np.finfo(np.float64).tiny)
            geometry = np.maximum(cosine, 0) * np.maximum(local[..., 2], 0) / squared**2
            weight = np.where(light_up[rows], geometry * light.light.area, 0.0)
            result[rows] = weight[..., None] * light.radiance[rows] * light.reflectance[rows]
        return result

    def color(self, samples: SampleBuffer) -> Float32:
        """Return what `SampleBuffer.color` has to be, ``(H, W, S, 3)``: `unlit` and all direct light."""
        result = self.unlit.copy()
        for number in range(len(self.lights)):
            result += self.direct(samples, number)
        return result

    def _receivers(self, samples: SampleBuffer, light_number: int, rows: slice) -> tuple[Float64, Float64]:
        """Return camera samples' points in light space, and by how much their depth may be off."""
        light = self.lights[light_number].light
        time = 0.0 if samples.time is None else samples.time[rows]
        points = self.points(samples, rows)
        local = light.to_light_space(points, time)
        # What is subtracted is rounded before, in whatever coordinates the renderer has.
        extent = np.linalg.norm(points, axis=-1) + np.linalg.norm(light.centers(time), axis=-1)
        return local, _ROUNDING * extent

    def _blocks(self) -> list[slice]:
        """Divide the rows so that what is in work stays small."""
        height, width, spp = self.shape
        rows = max(1, _BLOCK // (width * spp))
        return [slice(first, first + rows) for first in range(0, height, rows)]

    def __repr__(self) -> str:
        height, width, spp = self.shape
        return f"Lighting({width} x {height} pixels, {spp} spp, {len(self.lights)} lights)"


_PARKED = {"normal": np.array([0.0, 0.0, -1.0])}


def _check_lights(lights: object) -> tuple[LightSamples, ...]:
    if not isinstance(lights, tuple | list) or not all(isinstance(each, LightSamples) for each in lights):
        kinds = [type(each).__name__ for each in lights] if isinstance(lights, tuple | list) else lights
        raise SampleError(f"expected a sequence of fewrays.LightSamples, got {kinds!r}", field="lights")
    if not 1 <= len(lights) <= MAX_LIGHTS:
        raise SampleError(f"expected 1 to {MAX_LIGHTS} lights, got {len(lights)}", field="lights")
    for number, light in enumerate(lights):
        if light.shape != lights[0].shape:
            raise SampleError(
                f"expected shape {lights[0].shape} as in lights[0], got {light.shape}",
                field=f"lights[{number}]",
            )
    return tuple(lights)
