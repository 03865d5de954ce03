"""Depth as renderers store it, turned into planar depth.

Three kinds are common. *Planar* depth is measured along the optical axis. *Distance* is the length of the
ray: with the focal length K in pixels and the optical centre at (x0, y0), the pixel centre (x, y) has

    planar = distance / √(1 + ((x - x0)² + (y - y0)²) / K²).

*Inverse* depth is 1 / planar, so that 0 is infinitely far away.

Where nothing was hit, renderers write some huge number, the largest half float, or an infinity: all of these
become infinity here. Pixels that hold no depth at all (NaN, zero, negative) are refused unless they are said
to be background, as they are where a file starts from zeros and only hits are written.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, first_index, require_option
from fewrays.io.rgbz_channels import DepthKind

__all__ = ["FAR", "DepthFormat", "InvalidDepth", "to_planar"]

InvalidDepth = Literal["error", "background"]

FAR = 1e9
"""Depths from here on count as background; most renderers write 1e10 or more there."""

_LARGEST_HALF = 65504.0
_NEAREST = 1e-30  # smaller depths have no finite slope

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class DepthFormat:
    """How a file's depth is to be read.

    Parameters
    ----------
    kind : {"planar", "distance", "inverse"}, optional
        What the values are; what the channel's name says, or else planar, unless given.
    scale : float
        Factor on the file's values that gives scene units, or 1 / scene units for inverse depth; negative for
        cameras that look along -z.
    background : float
        Depths in scene units from which on there is nothing.
    invalid : {"error", "background"}
        What NaN, zero and negative depths are: an error, or background.

    Raises
    ------
    SampleError
        For an unknown kind or treatment, a scale that is 0 or not finite, a background that is not positive.
    """

    kind: DepthKind | None = None
    scale: float = 1.0
    background: float = FAR
    invalid: InvalidDepth = "error"

    def __post_init__(self) -> None:
        kinds = get_args(DepthKind)
        require_option("depth_kind", self.kind, self.kind in (None, *kinds), f"of {', '.join(kinds)}")
        usable = bool(np.isfinite(self.scale)) and self.scale != 0
        require_option("depth_scale", self.scale, usable, "that is finite and not 0")
        require_option("background", self.background, self.background > 0, "above 0")
        treatments = get_args(InvalidDepth)
        require_option("invalid", self.invalid, self.invalid in treatments, f"of {', '.join(treatments)}")


def to_planar(
    values: npt.NDArray[Any],
    form: DepthFormat,
    *,
    focal_pixels: float | None = None,
    centre: tuple[float, float] | None = None,
) -> Float32:
    """Turn stored depth into planar depth.

    Parameters
    ----------
    values : ndarray, (H, W)
        As the file has them.
    form : DepthFormat
        What they mean; its kind counts as planar when it is not given.
    focal_pixels : float, optional
        Focal length in pixels; needed for distances.
    centre : (float, float), optional
        Where the optical axis meets the image, x and y in pixels; the middle unless given.

    Returns
    -------
    ndarray of float32, (H, W)
        In scene units, positive; infinite for the background.

    Raises
    ------
    SampleError
        For NaN, zero or negative depths that are not said to be background, and for distances without a focal
        length.
    """
    if form.kind == "distance" and focal_pixels is None:
        raise SampleError(
            "the depth is the length of rays; give the angle of view (fov, or focal_length and sensor_width) "
            "to turn it into planar depth",
            field="depth_kind",
        )
    with np.errstate(all="ignore"):
        depth = values.astype(np.float64) * form.scale
        if form.kind == "inverse":
            none = depth == 0
            depth = np.where(none, np.inf, 1 / depth)
        elif form.kind == "distance":
            assert focal_pixels is not None
            depth /= _obliqueness(depth.shape, focal_pixels, centre)
        far = (depth >= form.background) | (form.kind != "inverse") & (values == _LARGEST_HALF)
    depth[far] = np.inf
    nothing = ~(depth > _NEAREST)
    if nothing.any() and form.invalid == "error":
        index = first_index(nothing)
        raise SampleError(
            f"{int(nothing.sum())} of {nothing.size} pixels have no depth above 0, the first at column "
            f"{index[1]}, row {index[0]}: {values[index]:g}; where that means that nothing was hit, give "
            "invalid_depth='background'",
            field="depth",
        )
    depth[nothing] = np.inf
    return depth.astype(np.float32)


def _obliqueness(
    shape: tuple[int, ...], focal_pixels: float, centre: tuple[float, float] | None
) -> npt.NDArray[np.float64]:
    """Return the length of each pixel's ray (H, W) over its planar depth."""
    height, width = shape
    x0, y0 = (width / 2, height / 2) if centre is None else centre
    x = (np.arange(width) + 0.5 - x0) / focal_pixels
    y = (np.arange(height) + 0.5 - y0) / focal_pixels
    ratio: npt.NDArray[np.float64] = np.sqrt(1 + np.square(x)[None, :] + np.square(y)[:, None])
    return ratio
