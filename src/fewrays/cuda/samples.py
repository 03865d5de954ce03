"""`DeviceSamples`: samples in a card's memory, such as those of a renderer that runs there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fewrays.cuda.device import require_machine
from fewrays.cuda.machine import Machine
from fewrays.errors import SampleError
from fewrays.lens import Lens
from fewrays.samples import SampleBuffer

__all__ = ["SAMPLE_FIELDS", "DeviceSamples"]

SAMPLE_FIELDS = {
    **dict.fromkeys(("xy", "uv", "depth", "color", "time", "motion", "bandwidth"), "*f4"),
    "samples": "i8",
    "c0": "f4",
    "c1": "f4",
}
"""``DeviceSamples`` in ``native/cuda/device_samples.h``, as `fewrays.cuda.kernel.Kernel` describes it."""

_CHANNELS = {"xy": 2, "uv": 2, "depth": None, "color": 3, "time": None, "motion": 3, "bandwidth": None}
_LENS_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class DeviceSamples:
    """What `SampleBuffer` is on the host. Make one with `of_arrays` or `of_buffer`.

    Parameters
    ----------
    xy, uv : array of float32, (H, W, S, 2)
    depth : array of float32, (H, W, S)
    color : array of float32, (H, W, S, 3)
    lens : Lens
    time : array of float32, (H, W, S), optional
    motion : array of float32, (H, W, S, 3), optional
        Only where anything moves, and then with `time`.
    bandwidth : array of float32, (H, W, S), optional
        As `SampleBuffer.bandwidth`.
    """

    xy: Any
    uv: Any
    depth: Any
    color: Any
    lens: Lens
    time: Any = None
    motion: Any = None
    bandwidth: Any = None

    @classmethod
    def of_buffer(cls, machine: Machine, samples: SampleBuffer) -> DeviceSamples:
        """Copy samples to the card."""
        moving = samples.motion is not None and bool(samples.motion.any())
        names = [name for name in samples.field_names() if moving or name != "motion"]
        arrays = {name: machine.on_device(getattr(samples, name), np.float32) for name in names}
        return cls(lens=samples.lens, **arrays)

    @classmethod
    def of_arrays(
        cls,
        *,
        xy: Any,
        uv: Any,
        depth: Any,
        color: Any,
        lens: Lens,
        time: Any = None,
        motion: Any = None,
        bandwidth: Any = None,
        check: bool = True,
        machine: Machine | None = None,
    ) -> DeviceSamples:
        """Take arrays that are on the card already; those that are float32 and contiguous are not copied.

        Parameters
        ----------
        xy, uv, depth, color, lens, time, motion, bandwidth
            As for `SampleBuffer`; of CuPy, PyTorch, Mitsuba's CUDA variants or whatever else has
            ``__cuda_array_interface__`` or ``__dlpack__``, or of the host.
        check : bool
            Look for values that no renderer means, which waits for the card.
        machine : Machine, optional
            The current GPU when omitted.

        Raises
        ------
        SampleError
            For shapes that do not go together, impossible values, and without a GPU.
        """
        machine = machine or require_machine()
        given = {"xy": xy, "uv": uv, "depth": depth, "color": color}
        if motion is not None and time is None:
            raise SampleError("motion needs the samples' times: give time as well", field="motion")
        optional = {"time": time, "motion": motion, "bandwidth": bandwidth}
        given |= {name: array for name, array in optional.items() if array is not None}
        arrays = {name: machine.on_device(array, np.float32) for name, array in given.items()}
        _check_shapes(arrays)
        if check:
            _check_values(machine, arrays)
        return cls(lens=lens, **arrays)

    def to_buffer(self, machine: Machine | None = None) -> SampleBuffer:
        """Copy them to the host."""
        machine = machine or require_machine()
        names = [name for name in _CHANNELS if getattr(self, name) is not None]
        return SampleBuffer(lens=self.lens, **{name: machine.on_host(getattr(self, name)) for name in names})

    def with_lens(self, lens: Lens) -> DeviceSamples:
        """Return the samples as they would be, had they been traced through another lens.

        As `SampleBuffer.with_lens`: each ray keeps its lens position and the surface point that it hit, and
        its radiance the part of the lens over which it holds.
        """
        if (lens.c0, lens.c1) == (self.lens.c0, self.lens.c1):
            return replace(self, lens=lens)
        # As `Lens.slope`, which takes arrays of the host alone.
        now, then = (each.c0 / self.depth + each.c1 for each in (lens, self.lens))
        shear = now - then
        xy = self.xy + shear[..., None] * self.uv
        return replace(self, lens=lens, xy=xy, bandwidth=self._bandwidth_through(lens))

    def _bandwidth_through(self, lens: Lens) -> Any:
        """Return `bandwidth` in the units of another lens, as `SampleBuffer` does."""
        if self.bandwidth is None or self.lens.c0 in (0, lens.c0):
            return self.bandwidth
        ratio = np.float32(abs(lens.c0 / self.lens.c0))
        if ratio == 0:
            return self.bandwidth * np.float32(np.inf)
        return (self.bandwidth / ratio).clip(np.finfo(np.float32).tiny)

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
    def count(self) -> int:
        """Samples in all."""
        return int(self.depth.size)

    def arguments(self) -> dict[str, Any]:
        """Return what kernels take, by `SAMPLE_FIELDS`."""
        arrays = {name: getattr(self, name) for name in _CHANNELS}
        return arrays | {"samples": self.count, "c0": self.lens.c0, "c1": self.lens.c1}


def _check_shapes(arrays: dict[str, Any]) -> None:
    shape = arrays["depth"].shape
    if len(shape) != 3 or min(shape) < 1:
        raise SampleError(f"expected shape (H, W, S), none of them 0, got {shape}", field="depth")
    for name, array in arrays.items():
        channels = _CHANNELS[name]
        expected = shape if channels is None else (*shape, channels)
        if array.shape != expected:
            raise SampleError(
                f"expected shape {expected} to go with depth's {shape}, got {array.shape}", field=name
            )


def _check_values(machine: Machine, arrays: dict[str, Any]) -> None:
    """Count what is impossible in all arrays at once, and wait once."""
    xp = machine.xp
    good = {name: xp.isfinite(array) for name, array in arrays.items() if name != "bandwidth"}
    good["depth"] &= arrays["depth"] > 0
    good["uv"] &= xp.abs(arrays["uv"]) <= 1 + _LENS_TOLERANCE
    if "time" in arrays:
        good["time"] &= (arrays["time"] >= 0) & (arrays["time"] <= 1)
    if "bandwidth" in arrays:
        good["bandwidth"] = arrays["bandwidth"] > 0
    bad = machine.on_host(xp.stack([(~each).sum() for each in good.values()]))
    wanted = {"depth": "positive and finite", "bandwidth": "positive"}
    wanted |= {"uv": "in [-1, 1]", "time": "in [0, 1]"}
    for name, count in zip(good, bad.tolist(), strict=True):
        if count:
            raise SampleError(
                f"{count} of {arrays[name].size} values are not {wanted.get(name, 'finite')}; mend the "
                "renderer's output, or make a SampleBuffer with nan='drop'",
                field=name,
            )
