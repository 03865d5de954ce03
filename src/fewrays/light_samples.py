"""`LightSamples`: what is on the way from an area light to what the camera sees (temporal, section 5).

Every camera sample has one light sample for each light: a point on the light, and what the ray from there
towards the camera sample's point hits first. A shadowed camera sample's ray ends at a blocker; that too is
worth knowing, as the same ray lights the blocker.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.arrays import (
    OFF_IMAGE,
    Arrays,
    Float32,
    as_float32,
    check_nan_option,
    check_range,
    check_shapes,
    find_unusable,
    park,
)
from fewrays.errors import SampleError

__all__ = ["LightSamples"]

_TOLERANCE = 1e-4  # by which positions may lie beyond the light's edge


@dataclass(frozen=True, eq=False, init=False, repr=False)
class LightSamples:
    """One light sample for each camera sample, in its place and at its time.

    Arrays are converted to C-contiguous float32 and are not copied when they already are.

    Parameters
    ----------
    light : AreaLight
        The light that they start from.
    lxy : array_like, (H, W, S, 2)
        Where each ray meets the light's plane Π, in world units; see `fewrays.area_light`.
    luv : array_like, (H, W, S, 2)
        Where it starts, in ``[-1, 1]²``, drawn uniformly from the light's area; on a disc the rim is at
        radius 1.
    depth : array_like, (H, W, S)
        Light-space depth of the first thing that it hits on its way to the camera sample's point: that point
        itself, or a blocker. Positive and finite.
    radiance : array_like, (H, W, S, 3)
        Linear RGB radiance that the light emits along it.
    density : array_like, (H, W, S)
        World units on Π per pixel, ``sqrt |det d(lx, ly) / d(x, y)|`` of the camera sample that it was aimed
        at; `fewrays.temporal.view_light` computes it. 0 where there is no light sample, because the camera
        sample hit nothing or lies behind the light: the other values are then not used.
    reflectance : array_like, (H, W, S, 3)
        The BSDF of the camera sample's point from the light sample's direction to the camera, in 1/sr,
        without the cosine.
    motion : array_like, (H, W, S, 3), optional
        Change over the whole shutter of the homogeneous position ``(lx w, ly w, w)``, `w` = depth, of the
        first hit as the light's centre sees it, the light moving too.
    nan : {"reject", "drop"}
        What to do with light samples that hold a NaN or an infinity: raise, or drop them with a warning.

    Raises
    ------
    SampleError
        Naming the field, the index and the value of the first thing that is wrong.

    Notes
    -----
    A dropped light sample has the density 0 and lies at `OFF_IMAGE` on Π. Its camera sample would be too dark
    without it: a `SampleBuffer` drops it as well.
    """

    CHANNELS: ClassVar[dict[str, int | None]] = {
        "lxy": 2,
        "luv": 2,
        "depth": None,
        "radiance": 3,
        "density": None,
        "reflectance": 3,
        "motion": 3,
    }
    """Each array's length along the axis after (H, W, S), if there is one."""

    light: AreaLight
    lxy: Float32
    luv: Float32
    depth: Float32
    radiance: Float32
    density: Float32
    reflectance: Float32
    motion: Float32 | None = None

    def __init__(
        self,
        light: AreaLight,
        lxy: npt.ArrayLike,
        luv: npt.ArrayLike,
        depth: npt.ArrayLike,
        radiance: npt.ArrayLike,
        density: npt.ArrayLike,
        reflectance: npt.ArrayLike,
        motion: npt.ArrayLike | None = None,
        *,
        nan: Literal["reject", "drop"] = "reject",
    ) -> None:
        if not isinstance(light, AreaLight):
            raise SampleError(f"expected a fewrays.AreaLight, got {type(light).__name__}", field="light")
        check_nan_option(nan)
        given: dict[str, Any] = {
            "lxy": lxy,
            "luv": luv,
            "depth": depth,
            "radiance": radiance,
            "density": density,
        }
        given |= {"reflectance": reflectance, "motion": motion}
        arrays = {name: as_float32(name, value) for name, value in given.items() if value is not None}
        shape = arrays["depth"].shape
        if len(shape) != 3:
            raise SampleError(f"expected shape (H, W, S), got {shape}", field="depth")
        check_shapes(arrays, self.CHANNELS, shape)
        bad = find_unusable(arrays, shape, drop=nan == "drop")
        if bad.any():
            warnings.warn(
                f"dropped {int(bad.sum())} of {bad.size} light samples that hold NaN or infinity",
                stacklevel=2,
            )
            arrays = park(arrays, bad, _PARKED)
        _check_values(arrays, light)
        object.__setattr__(self, "light", light)
        for name in given:
            object.__setattr__(self, name, arrays.get(name))

    def field_names(self) -> tuple[str, ...]:
        """Names of the arrays that there are."""
        return tuple(name for name in self.CHANNELS if getattr(self, name) is not None)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Image height, width and samples per pixel."""
        height, width, spp = self.depth.shape
        return height, width, spp

    @property
    def nbytes(self) -> int:
        """Bytes that the arrays take."""
        return sum(getattr(self, name).nbytes for name in self.field_names())

    @property
    def moves(self) -> bool:
        """Whether the light or what it shines on moves, so that times are needed."""
        return self.light.moves or self.motion is not None

    def dropped(self) -> npt.NDArray[np.bool_]:
        """Tell which ones were dropped, ``(H, W, S)``, not only never there: both have the density 0."""
        return np.asarray((self.density == 0) & (self.lxy == OFF_IMAGE).all(axis=-1))

    def drop(self, bad: npt.NDArray[np.bool_]) -> LightSamples:
        """Return them with some ``(H, W, S)`` dropped."""
        arrays: dict[str, Any] = park(
            {name: getattr(self, name) for name in self.field_names()}, bad, _PARKED
        )
        return replace(self, **arrays)

    def __repr__(self) -> str:
        height, width, spp = self.shape
        return (
            f"LightSamples({width} x {height} pixels, {spp} spp, {self.light.shape} of area "
            f"{self.light.area:.4g}, {'moving' if self.moves else 'still'})"
        )


_PARKED = {"lxy": OFF_IMAGE, "depth": 1.0}


def _check_values(arrays: Arrays, light: AreaLight) -> None:
    check_range("depth", arrays["depth"], lambda d: d > 0, "depth must be positive: in front of the light")
    check_range("density", arrays["density"], lambda rho: rho >= 0, "a density is positive, or 0 for none")
    check_range(
        "luv",
        arrays["luv"],
        lambda luv: np.abs(luv) <= 1 + _TOLERANCE,
        "positions on the light lie in [-1, 1]: divide by its half sizes",
    )
    if light.shape == "disc":
        rim = (1 + _TOLERANCE) ** 2
        check_range(
            "luv",
            arrays["luv"],
            lambda luv: np.square(luv[..., 0]) + np.square(luv[..., 1]) <= rim,
            "lies outside the unit disc although the light's shape is 'disc'; is it a 'rectangle'?",
        )
    largest = light.half_size.max()
    with np.errstate(over="ignore"):
        nearness = np.float32(largest * light.plane_distance) / arrays["depth"]
    check_range(
        "depth",
        nearness,
        np.isfinite,
        "the light is so much larger that its slope overflows: the depth is too small",
        arrays["depth"],
    )
