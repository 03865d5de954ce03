"""The camera of a picture with depth, from what is known of it: lens data, a blur in pixels, or the file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fewrays.errors import SampleError, require_option
from fewrays.io.rgbz import RgbzImage
from fewrays.lens import Lens

__all__ = ["CameraFlags", "depth_at"]


@dataclass(frozen=True)
class CameraFlags:
    """The lens that the picture is looked at through: one of --f-number, --lens-radius, --max-coc.

    Parameters
    ----------
    f_number
        Focal length over aperture diameter; needs --focal-length.
    focal_length
        In millimetres.
    sensor_width
        In millimetres; that of the whole picture, not of a crop.
    fov
        Horizontal angle of view in degrees, instead of --focal-length.
    units_per_metre
        Scene units in one metre, for --f-number: 100 where the scene is in centimetres.
    lens_radius
        Radius of the lens in scene units; needs --fov or --focal-length.
    max_coc
        Radius in pixels of the circle of confusion at infinity, for the first focus distance.
    aperture_scale
        Factor on the lens radius; 0 gives the pinhole's picture back.
    """

    f_number: float | None = None
    focal_length: float | None = None
    sensor_width: float = 36.0
    fov: float | None = None
    units_per_metre: float = 1.0
    lens_radius: float | None = None
    max_coc: float | None = None
    aperture_scale: float = 1.0

    def __post_init__(self) -> None:
        given = [name for name in ("f_number", "lens_radius", "max_coc") if getattr(self, name) is not None]
        if len(given) > 1:
            raise SampleError(f"give only one of {', '.join(given)}", field=given[1])
        if self.fov is not None and self.focal_length is not None:
            raise SampleError("give either fov or focal_length", field="fov")
        if self.f_number is not None and self.focal_length is None:
            raise SampleError(
                "needs focal_length in millimetres; where only the blur matters give max_coc in pixels",
                field="f_number",
            )
        if self.lens_radius is not None and self.fov is None and self.focal_length is None:
            raise SampleError("needs fov or focal_length", field="lens_radius")
        if self.max_coc is not None:
            good = math.isfinite(self.max_coc) and self.max_coc > 0
            require_option("max_coc", self.max_coc, good, "in pixels, above 0")
        for name in ("focal_length", "sensor_width"):
            value = getattr(self, name)
            good = value is None or (math.isfinite(value) and value > 0)
            require_option(name, value, good, "in millimetres, above 0")
        require_option("fov", self.fov, self.fov is None or 0 < self.fov < 180, "above 0 and below 180")

    @property
    def focal_widths(self) -> float | None:
        """Focal length in image widths; None where nothing is known of the angle of view."""
        if self.fov is not None:
            return 0.5 / math.tan(math.radians(self.fov) / 2)
        return None if self.focal_length is None else self.focal_length / self.sensor_width

    def lens(self, picture: RgbzImage, focus_distance: float | None) -> Lens:
        """Return the lens, focused at a distance in scene units or, without one, as the file says.

        Raises
        ------
        SampleError
            When the flags and the file do not determine a lens.
        """
        own = None if picture.lens is None else Lens(*picture.lens)
        if focus_distance is None:
            focus_distance = None if own is None or own.c0 == 0 else own.focus_distance
        if focus_distance is None:
            raise SampleError(
                "say what is in focus: --focus-distance in scene units, or --focus-at with a pixel",
                field="focus_distance",
            )
        positive = focus_distance > 0
        require_option("focus_distance", focus_distance, positive, "above 0, as a focus distance is")
        return self._unfocused(picture, own, focus_distance).refocus(focus_distance, self.aperture_scale)

    def _unfocused(self, picture: RgbzImage, own: Lens | None, focus_distance: float) -> Lens:
        """Return a lens of the right radius, focused anywhere."""
        if self.max_coc is not None:
            if not math.isfinite(focus_distance):
                raise SampleError("needs a finite focus distance: at infinity it is 0", field="max_coc")
            return Lens(-self.max_coc * focus_distance, self.max_coc)
        if self.f_number is not None or self.lens_radius is not None:
            return Lens.thin_lens(
                picture.full_width,
                focus_distance=focus_distance,
                fov=self.fov,
                focal_length=self.focal_length,
                sensor_width=self.sensor_width,
                lens_radius=self.lens_radius,
                f_number=self.f_number,
                units_per_metre=self.units_per_metre,
            )
        if own is None:
            raise SampleError(
                "say how large the blur is: --f-number with --focal-length, --lens-radius with --fov, or "
                "--max-coc in pixels",
                field="lens",
            )
        return own


def depth_at(picture: RgbzImage, column: int, row: int) -> float:
    """Return the depth that the picture has in a pixel, in scene units: what autofocus focuses on.

    Raises
    ------
    SampleError
        For a pixel outside the picture, or one that shows only transparent nothing.
    """
    height, width = picture.size
    if not (0 <= column < width and 0 <= row < height):
        raise SampleError(
            f"pixel ({column}, {row}) lies outside the picture of {width} x {height}", field="focus_at"
        )
    for layer in picture.layers:
        if layer.alpha is None or layer.alpha[row, column] >= np.float32(0.5):
            return float(layer.depth[row, column])
    raise SampleError(f"nothing opaque is in pixel ({column}, {row})", field="focus_at")
