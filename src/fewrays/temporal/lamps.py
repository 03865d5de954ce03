"""Light samples as a light field that the temporal method can read (temporal, section 5).

Seen along the rays of an area light, the light is a lens and the plane Π an image. So light samples are put
into a `SampleBuffer` of their own: image positions are places on Π, lens positions are points of the light,
and the colour is the radiance that the light emits along the ray. Hierarchy, reprojection and surfaces then
work on them as they do on camera samples. Four things differ:

- Π has no pixels. Lengths count in units of the *density*, the distance between light samples that belong to
  neighbouring pixels, which differs from place to place (`fewrays.temporal.view_light`).
- Π may be moved to any distance by ``lx' = lx d'/d + a lu (1 - d'/d)``. It is put where the samples are on
  average, where depths come out of slopes with the least rounding.
- A lens unit is the larger half size of the light, for both axes.
- Samples whose ray ended at a blocker serve as well as the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.lens import Lens
from fewrays.light_samples import LightSamples
from fewrays.lighting import Lighting
from fewrays.samples import OFF_IMAGE, SampleBuffer
from fewrays.sources.patterns import concentric
from fewrays.temporal.locations import places

__all__ = ["Lamp", "facing_normals", "make_lamps"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

_U_STEP, _V_STEP = 0.7548776662466927, 0.5698402909980532  # powers of the plastic number


@dataclass(frozen=True, eq=False)
class Lamp:
    """An area light with its samples, one for each camera sample.

    Parameters
    ----------
    light : AreaLight
        Its plane Π is where `field` has its image.
    field : SampleBuffer
        Light samples as seen along the light's rays, in world units on Π.
    density : ndarray of float32, (N,)
        World units on Π per pixel; 0 for camera samples without a light sample.
    arrives : ndarray of bool, (N,)
        Whether a light sample ends at its camera sample's point.
    reflectance : ndarray of float32, (N, 3)
        Of the camera samples' points, in 1/sr.
    """

    light: AreaLight
    field: SampleBuffer
    density: Float32
    arrives: npt.NDArray[np.bool_]
    reflectance: Float32

    @property
    def lens_unit(self) -> float:
        """World units that a lens unit stands for."""
        return float(self.light.half_size.max())

    @property
    def uniform_radiance(self) -> Float32 | None:
        """Radiance ``(3,)`` of all light samples, if it is the same."""
        radiance = self.field.color.reshape(-1, 3)[self.density > 0]
        return radiance[0].copy() if (radiance == radiance[0]).all() else None

    def points(self, count: int) -> Float64:
        """Return well spread light points, one for each of `count` views, ``(count, 2)`` in lens units.

        As with times and offsets (`fewrays.temporal.locations`), places in an additive recurrence: along both
        axes they fall one into each of `count` equal parts, and any run of views has well spread ones.
        """
        square = np.stack([places(count, _U_STEP), places(count, _V_STEP)], axis=-1)
        spread = 2 * square - 1
        if self.light.shape == "disc":
            spread = concentric(spread)
        return spread * (self.light.half_size / self.lens_unit)


def make_lamps(samples: SampleBuffer, lighting: Lighting) -> list[Lamp]:
    """Prepare the lights of a buffer.

    Parameters
    ----------
    samples : SampleBuffer
    lighting : Lighting
        That of the samples.

    Returns
    -------
    list of Lamp
        Of the lights that shine on anything.
    """
    return [
        _make_lamp(samples, light, lighting.arrives(samples, number))
        for number, light in enumerate(lighting.lights)
        if light.density.any()
    ]


def _make_lamp(samples: SampleBuffer, light: LightSamples, arrives: npt.NDArray[np.bool_]) -> Lamp:
    there = light.density > 0
    old = light.light.plane_distance
    plane = replace(light.light, plane_distance=float(np.median(light.depth[there])))
    nearer = plane.plane_distance / old
    unit = float(plane.half_size.max())
    start = light.luv * plane.half_size.astype(np.float64)
    xy = light.lxy * nearer + start * (1 - nearer)
    motion = None
    if light.motion is not None:
        motion = light.motion * np.array([nearer, nearer, 1.0])
        motion[~there] = 0.0
    field = SampleBuffer(
        xy=np.where(there[..., None], xy, OFF_IMAGE),
        uv=np.where(there[..., None], start / unit, 0.0),
        depth=np.where(there, light.depth, plane.plane_distance),
        color=light.radiance,
        lens=Lens(-unit * plane.plane_distance, unit, sampling="square"),
        time=None if motion is None else samples.time,
        motion=motion,
    )
    density = (light.density * nearer).astype(np.float32).reshape(-1)
    return Lamp(
        light=plane,
        field=field,
        density=density,
        arrives=arrives.reshape(-1),
        reflectance=light.reflectance.reshape(-1, 3),
    )


def facing_normals(samples: SampleBuffer, lighting: Lighting) -> Float32:
    """Return the normals of the tangent planes at the camera samples' points.

    Parameters
    ----------
    samples : SampleBuffer
    lighting : Lighting
        That of the samples.

    Returns
    -------
    ndarray of float32, (N, 3)
        Unit normals in camera space that point away from the camera.
    """
    depth = samples.depth.astype(np.float64)
    gradient = lighting.depth_gradient.astype(np.float64)
    projection = lighting.projection
    across = -gradient * np.array(projection.focal)
    along = depth + (gradient * (samples.at_center() - np.array(projection.center))).sum(axis=-1)
    normal = np.concatenate([across, along[..., None]], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    return normal.reshape(-1, 3).astype(np.float32)
