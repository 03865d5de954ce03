"""A Mitsuba sensor as a thin-lens camera in numbers: its lens, its rays, and what motion looks like from it.

Camera space follows Mitsuba: x to the *left* of the image, y up, z forward. With image coordinates x right
and y down, both change sign, for lens positions as for directions.
"""

from __future__ import annotations

import dataclasses
import math
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.lens import Lens, LensAperture, Sampling
from fewrays.projection import Projection
from fewrays.sources.mitsuba_lights import View

__all__ = ["Camera"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Camera:
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
    ) -> Camera:
        """Read the sensor of that index, at the size and with the lens that users ask for.

        Raises
        ------
        SampleError
            For an index, a kind of sensor, a size or a lens that there is not or that makes no sense.
        """
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
        """Return the lens in pixels."""
        blur = self.pixels * self.lens_radius
        return Lens(-blur, blur / self.focus_distance, aperture, sampling, sigma)

    def view(self, lens: Lens) -> View:
        """Return what light samples need of this camera and lens."""
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


def _number(value: Any) -> float:
    """Return a scalar or a Dr.Jit array of one element as a float."""
    return float(np.asarray(value).reshape(-1)[0])
