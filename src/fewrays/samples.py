"""`SampleBuffer`: the samples that a renderer traced, and the lens they were traced through.

Every source produces one, every method takes one. It validates itself once, on construction, so that the
methods behind it can trust every number.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import numpy.typing as npt

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
from fewrays.lens import Lens
from fewrays.lighting import Lighting

__all__ = ["MAX_IMAGE_SIZE", "MAX_SAMPLES", "OFF_IMAGE", "SampleBuffer"]

MAX_IMAGE_SIZE = 65_536
"""Largest width and height in pixels that fewrays accepts."""

MAX_SAMPLES = 2**31
"""Largest number of samples in one buffer."""

_LENS_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False, init=False, repr=False)
class SampleBuffer:
    """Samples of a light field, ``S`` per pixel.

    Arrays are converted to C-contiguous float32 and are not copied when they already are. A sample belongs
    to the pixel that ``xy`` lies in, whatever its place in the arrays; keeping each sample in its own pixel's
    place makes every method faster. Positions outside the image are legal: they serve as a guard band.

    Parameters
    ----------
    xy : array_like, (H, W, S, 2)
        Image positions in pixels; pixel (row i, column j) covers ``[j, j+1) x [i, i+1)``, y points down.
    uv : array_like, (H, W, S, 2)
        Lens positions in ``[-1, 1]²``; the rim of the lens is at radius 1.
    depth : array_like, (H, W, S)
        Planar camera-space depth, positive and finite. Give the background a large finite depth.
    color : array_like, (H, W, S, 3)
        Linear scene-referred RGB radiance; not clamped.
    lens : Lens
        The lens that the samples were traced through.
    time : array_like, (H, W, S), optional
        Time in ``[0, 1]`` over the shutter interval.
    motion : array_like, (H, W, S, 3), optional
        Change over the whole shutter of the homogeneous screen position ``(x w, y w, w)``, ``w`` = depth,
        seen from the lens centre, in pixels times depth units. Needs `time`.
    bandwidth : array_like, (H, W, S), optional
        How far over the lens a sample's radiance holds: the standard deviation, in lens units, of a Gaussian
        on the (u, v) plane around the sample's lens position (temporal, section 6). Positive; infinite, which
        only this field may be, where the surface is matte and looks the same from the whole lens.
    lighting : Lighting, optional
        Area lights, with a light sample for each of these samples and each light. `color` then is
        `Lighting.color`: it holds all light, for the methods that know nothing of lights.
    nan : {"reject", "drop"}
        What to do with samples that hold a NaN, or an infinity where none is legal: raise, or drop them with
        a warning. Their light samples are dropped with them, and samples whose light samples were dropped
        are dropped too.

    Raises
    ------
    SampleError
        Naming the field, the index and the value of the first thing that is wrong.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> pixels = np.stack(np.meshgrid(np.arange(4), np.arange(3)), axis=-1)[:, :, None, :]
    >>> samples = SampleBuffer(
    ...     xy=pixels + rng.random((3, 4, 8, 2)),
    ...     uv=rng.uniform(-1, 1, (3, 4, 8, 2)),
    ...     depth=np.full((3, 4, 8), 5.0),
    ...     color=np.ones((3, 4, 8, 3)),
    ...     lens=Lens(-10.0, 2.0, sampling="square"),
    ... )
    >>> samples
    SampleBuffer(4 x 3 pixels, 8 spp, lens=Lens(c0=-10.0, c1=2.0, ...), still)
    """

    CHANNELS: ClassVar[dict[str, int | None]] = {
        "xy": 2,
        "uv": 2,
        "depth": None,
        "color": 3,
        "time": None,
        "motion": 3,
        "bandwidth": None,
    }
    """Each array's length along the axis after (H, W, S), if there is one."""

    OPTIONAL: ClassVar[tuple[str, ...]] = ("time", "motion", "bandwidth")
    """The arrays that there need not be."""

    xy: Float32
    uv: Float32
    depth: Float32
    color: Float32
    lens: Lens
    time: Float32 | None = None
    motion: Float32 | None = None
    bandwidth: Float32 | None = None
    lighting: Lighting | None = None

    def __init__(
        self,
        xy: npt.ArrayLike,
        uv: npt.ArrayLike,
        depth: npt.ArrayLike,
        color: npt.ArrayLike,
        lens: Lens,
        time: npt.ArrayLike | None = None,
        motion: npt.ArrayLike | None = None,
        bandwidth: npt.ArrayLike | None = None,
        lighting: Lighting | None = None,
        *,
        nan: Literal["reject", "drop"] = "reject",
    ) -> None:
        if not isinstance(lens, Lens):
            raise SampleError(f"expected a fewrays.Lens, got {type(lens).__name__}", field="lens")
        check_nan_option(nan)
        if motion is not None and time is None:
            raise SampleError("motion needs the samples' times: give time as well", field="motion")

        given = {"xy": xy, "uv": uv, "depth": depth, "color": color, "time": time, "motion": motion}
        given["bandwidth"] = bandwidth
        arrays = {name: as_float32(name, value) for name, value in given.items() if value is not None}
        _check_size(arrays["depth"])
        check_shapes(arrays, self.CHANNELS, arrays["depth"].shape)
        if lighting is not None:
            _check_lighting(lighting, arrays)
        arrays, lighting = _drop_unusable(arrays, lighting, drop=nan == "drop")
        _check_values(arrays, lens)
        object.__setattr__(self, "lens", lens)
        object.__setattr__(self, "lighting", lighting)
        for name in given:
            object.__setattr__(self, name, arrays.get(name))

    def field_names(self) -> tuple[str, ...]:
        """Names of the arrays that this buffer holds, without those of `lighting`."""
        return tuple(name for name in self.CHANNELS if getattr(self, name) is not None)

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return int(self.depth.shape[0])

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return int(self.depth.shape[1])

    @property
    def spp(self) -> int:
        """Samples per pixel."""
        return int(self.depth.shape[2])

    @property
    def nbytes(self) -> int:
        """Bytes that the arrays take, those of `lighting` included."""
        own: int = sum(getattr(self, name).nbytes for name in self.field_names())
        return own + (0 if self.lighting is None else self.lighting.nbytes)

    def slope(self) -> Float32:
        """Signed circle-of-confusion radius of every sample, ``(H, W, S)`` in pixels."""
        return self.lens.slope(self.depth).astype(np.float32, copy=False)

    def at_center(self, rows: slice = slice(None)) -> npt.NDArray[np.float64]:
        """Image positions at which the lens centre sees what samples of some rows hit, ``(H, W, S, 2)``."""
        slope = self.lens.slope(self.depth[rows].astype(np.float64))
        return np.asarray(self.xy[rows] - slope[..., None] * self.uv[rows], np.float64)

    def with_lens(self, lens: Lens) -> SampleBuffer:
        """Return the samples as they would be, had they been traced through another lens.

        Each ray keeps its lens position and the surface point that it hit. The lens centre sees that point
        where it did; the ray's image position becomes ``xy + (C'(depth) - C(depth)) uv``. Samples may leave
        their pixels and the image. Arrays that do not change are shared.

        A bandwidth is a distance on the lens in units of its radius: a lens of twice the radius halves the
        number. It becomes infinite with a pinhole, all of whose positions are one point; from a pinhole,
        where a lens unit measures nothing, it stays as it is.

        What `lighting` says is about the surface points, or seen from the lens centre: it stays.

        Parameters
        ----------
        lens : Lens
            The other lens, in the same image.

        Returns
        -------
        SampleBuffer
        """
        if (lens.c0, lens.c1) == (self.lens.c0, self.lens.c1):
            return replace(self, lens=lens)
        shear = lens.slope(self.depth) - self.slope()
        xy = self.xy + shear[..., None] * self.uv
        return replace(self, lens=lens, xy=xy, bandwidth=self._bandwidth_through(lens))

    def refocus(self, focus_distance: float | None = None, aperture_scale: float = 1.0) -> SampleBuffer:
        """Return the samples for a lens focused elsewhere or of another radius (temporal, section 6).

        Parameters
        ----------
        focus_distance, aperture_scale
            As for `Lens.refocus`.

        Returns
        -------
        SampleBuffer
            See `with_lens`. A changed radius keeps each ray's visibility, although from its new place on the
            lens another surface may be in front.
        """
        return self.with_lens(self.lens.refocus(focus_distance, aperture_scale))

    def _bandwidth_through(self, lens: Lens) -> Float32 | None:
        """Return `bandwidth` in the units of another lens, ``c0`` being proportional to the lens radius."""
        if self.bandwidth is None or self.lens.c0 in (0, lens.c0):
            return self.bandwidth
        with np.errstate(divide="ignore", over="ignore", under="ignore"):
            scaled = self.bandwidth / np.float32(abs(lens.c0 / self.lens.c0))
        least = np.finfo(np.float32).tiny  # what is narrower than float32 can say stays positive
        result: Float32 = np.maximum(scaled, least)
        return result

    def __repr__(self) -> str:
        return (
            f"SampleBuffer({self.width} x {self.height} pixels, {self.spp} spp, "
            f"lens=Lens(c0={self.lens.c0:.6}, c1={self.lens.c1:.6}, ...), "
            f"{'still' if self.motion is None else 'moving'}"
            f"{'' if self.lighting is None else f', {_count_lights(self.lighting)}'})"
        )


_PARKED = {"xy": OFF_IMAGE, "depth": 1.0, "bandwidth": 1.0}


def _count_lights(lighting: Lighting) -> str:
    count = len(lighting.lights)
    return "1 light" if count == 1 else f"{count} lights"


def _check_size(depth: Float32) -> None:
    if depth.ndim != 3:
        raise SampleError(f"expected shape (H, W, S), got {depth.shape}", field="depth")
    height, width, spp = depth.shape
    if min(depth.shape) < 1:
        raise SampleError(
            f"expected at least one pixel and one sample, got shape {depth.shape}", field="depth"
        )
    if max(height, width) > MAX_IMAGE_SIZE or depth.size > MAX_SAMPLES:
        raise SampleError(
            f"{width} x {height} pixels with {spp} spp is over the cap of {MAX_IMAGE_SIZE} pixels a side and "
            f"{MAX_SAMPLES} samples; reconstruct it in parts",
            field="depth",
        )


def _check_lighting(lighting: Lighting, arrays: Arrays) -> None:
    if not isinstance(lighting, Lighting):
        raise SampleError(f"expected a fewrays.Lighting, got {type(lighting).__name__}", field="lighting")
    shape = arrays["depth"].shape
    if lighting.shape != shape:
        raise SampleError(
            f"expected shape {shape} to go with depth's, got {lighting.shape}: one light sample for each "
            "sample",
            field="lighting",
        )
    if lighting.moves and "time" not in arrays:
        raise SampleError(
            "lights or what they shine on move, which needs the samples' times: give time as well",
            field="lighting",
        )


def _drop_unusable(
    arrays: Arrays, lighting: Lighting | None, *, drop: bool
) -> tuple[Arrays, Lighting | None]:
    """Reject samples with NaN or infinities that are not legal, or park them off the image."""
    shape = arrays["depth"].shape
    bad = find_unusable(arrays, shape, drop=drop, may_be_infinite=("bandwidth",))
    if lighting is not None:
        unlit = lighting.dropped()
        if (bad & ~unlit).any():
            lighting = lighting.drop(bad)
        bad |= unlit & ~(arrays["xy"] == OFF_IMAGE).all(axis=-1)
    if bad.any():
        warnings.warn(
            f"dropped {int(bad.sum())} of {bad.size} samples that hold NaN or infinity", stacklevel=4
        )
        arrays = park(arrays, bad, _PARKED)
    return arrays, lighting


def _check_values(arrays: dict[str, Float32], lens: Lens) -> None:
    check_range("depth", arrays["depth"], lambda d: d > 0, "depth must be positive")
    check_range(
        "uv",
        arrays["uv"],
        lambda uv: np.abs(uv) <= 1 + _LENS_TOLERANCE,
        "lens positions lie in [-1, 1]: divide by the lens radius",
    )
    if lens.sampling == "disc":
        rim = (1 + _LENS_TOLERANCE) ** 2
        check_range(
            "uv",
            arrays["uv"],
            lambda uv: np.square(uv[..., 0]) + np.square(uv[..., 1]) <= rim,
            "lies outside the unit disc although lens.sampling is 'disc'; is it 'square' or 'gaussian'?",
        )
    if "time" in arrays:
        check_range(
            "time", arrays["time"], lambda t: (t >= 0) & (t <= 1), "times lie in [0, 1] over the shutter"
        )
    if "bandwidth" in arrays:
        check_range(
            "bandwidth",
            arrays["bandwidth"],
            lambda b: b > 0,
            "a standard deviation on the lens is positive; infinite means matte",
        )
    with np.errstate(over="ignore"):
        slope = lens.slope(arrays["depth"])
    check_range(
        "depth",
        slope,
        np.isfinite,
        "its slope c0 / depth + c1 overflows: the depth is too small",
        arrays["depth"],
    )
