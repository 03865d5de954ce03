"""An image with depth: what a pinhole camera sees first, or next behind that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, first_index

__all__ = ["DepthLayer"]

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DepthLayer:
    """An RGB+Z image, one layer of what lies along the rays of a pinhole camera.

    Parameters
    ----------
    color : array_like, (H, W, 3)
        Linear radiance, multiplied by alpha, as OpenEXR stores it. Of any finite size: HDR stays HDR.
    depth : array_like, (H, W)
        Planar depth, > 0, in the lens's units; ``inf`` for a background without distance.
    alpha : array_like, (H, W), optional
        Opacity in [0, 1]; opaque everywhere when omitted. Where it is 0, the layer shows nothing and its
        depth is of no account.

    Raises
    ------
    SampleError
        For shapes that differ or are empty, colours that are not finite, depths that are NaN, zero or
        negative where there is something to see, and opacities outside [0, 1].
    """

    color: Float32
    depth: Float32
    alpha: Float32 | None = None

    def __post_init__(self) -> None:
        color = _as_float32(self.color, "color")
        if color.ndim != 3 or color.shape[2] != 3 or color.size == 0:
            raise SampleError(f"expected shape (H, W, 3), not empty; got {color.shape}", field="color")
        _require_all(np.isfinite(color), color, "color", "finite radiance")
        depth = _as_float32(self.depth, "depth")
        _require_shape(depth, color, "depth")
        alpha = None
        visible = np.ones(depth.shape, bool)
        if self.alpha is not None:
            alpha = _as_float32(self.alpha, "alpha")
            _require_shape(alpha, color, "alpha")
            _require_all((alpha >= 0) & (alpha <= 1), alpha, "alpha", "opacities from 0 to 1")
            visible = alpha > 0
        _require_all(
            (depth > 0) | ~visible,
            depth,
            "depth",
            'depths > 0 (invalid_depth="background" takes others for background)',
        )
        for name, value in (("color", color), ("depth", depth), ("alpha", alpha)):
            object.__setattr__(self, name, value)

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.depth.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.depth.shape[1])


def _as_float32(value: npt.ArrayLike, field: str) -> Float32:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            raise TypeError
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(array, np.float32)
    except (TypeError, ValueError):
        raise SampleError(f"expected an array of real numbers, got {value!r:.80}", field=field) from None


def _require_shape(array: Float32, color: Float32, field: str) -> None:
    if array.shape != color.shape[:2]:
        raise SampleError(
            f"expected shape {color.shape[:2]}, as the colour's; got {array.shape}", field=field
        )


def _require_all(good: npt.NDArray[np.bool_], values: Float32, field: str, expected: str) -> None:
    if not good.all():
        index = first_index(~good)
        raise SampleError(
            f"expected {expected}; {np.count_nonzero(~good)} values are not, the first is "
            f"{values[index]} at {index}",
            field=field,
        )
