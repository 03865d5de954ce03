"""Time on a GPU, between events that the card records itself."""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.method import Image

__all__ = ["DenoiserOnGpu", "TimedMachine", "milliseconds"]

_WARM_UP = 3  # runs that do not count


def _cupy() -> Any:
    return importlib.import_module("cupy")


def milliseconds(run: Callable[[], object], repetitions: int) -> list[float]:
    """Time runs on the current stream, after some that do not count."""
    cuda = _cupy().cuda
    times = []
    for number in range(_WARM_UP + repetitions):
        before, after = cuda.Event(), cuda.Event()
        before.record()
        run()
        after.record()
        after.synchronize()
        if number >= _WARM_UP:
            times.append(float(cuda.get_elapsed_time(before, after)))
    return times


class TimedMachine:
    """A machine that passes everything on and notes how long each kernel takes.

    Parameters
    ----------
    machine : Machine
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self.xp = machine.xp
        self.cache_bytes = machine.cache_bytes
        self.shared_bytes = machine.shared_bytes
        self.address = machine.address
        self.on_device = machine.on_device
        self.on_host = machine.on_host
        self.fetch = machine.fetch
        self.kernels: dict[str, list[tuple[Any, Any]]] = {}

    def launch(
        self, kernel: Kernel, grid: tuple[int, int, int], *, shared_bytes: int = 0, **arguments: Any
    ) -> None:
        """Start a kernel between two events."""
        before, after = _cupy().cuda.Event(), _cupy().cuda.Event()
        before.record()
        self._machine.launch(kernel, grid, shared_bytes=shared_bytes, **arguments)
        after.record()
        self.kernels.setdefault(kernel.name, []).append((before, after))

    def clear(self) -> None:
        """Forget what was noted."""
        self.kernels.clear()

    def medians(self, repetitions: int) -> dict[str, float]:
        """Return the median milliseconds that each kernel takes in a run, of those that count."""
        found = {}
        for name, events in self.kernels.items():
            launches = len(events) // (_WARM_UP + repetitions)
            taken = [_cupy().cuda.get_elapsed_time(before, after) for before, after in events]
            runs = np.array(taken).reshape(-1, launches).sum(axis=1)[_WARM_UP:]
            found[name] = statistics.median(runs.tolist())
        return found


class DenoiserOnGpu:
    """Open Image Denoise on the same card, with its images in the card's memory.

    Parameters
    ----------
    image : ndarray, (H, W, 3)
        Linear radiance, float32.
    """

    def __init__(self, image: Image) -> None:
        oidn: Any = importlib.import_module("pyoidn")
        self.available = bool(oidn.Device.is_cuda_available(0))
        if not self.available:
            return
        height, width, _ = image.shape
        self._device = oidn.Device(oidn.OIDN_DEVICE_TYPE_CUDA)
        self._device.commit()
        self._images = [
            oidn.Buffer(self._device, image.nbytes, storage=oidn.OIDN_STORAGE_DEVICE) for _ in range(2)
        ]
        self._images[0].write(0, image.nbytes, image)
        self._filter = oidn.Filter(self._device, "RT")
        for name, buffer in zip(("color", "output"), self._images, strict=True):
            self._filter.set_image(name, buffer, oidn.OIDN_FORMAT_FLOAT3, width, height)
        self._filter.set_bool("hdr", True)
        self._filter.set_quality(oidn.OIDN_QUALITY_HIGH)
        self._filter.commit()

    def milliseconds(self, repetitions: int) -> list[float]:
        """Time the filter: it runs on a stream of its own, so by the clock, from start until it is done."""
        times = []
        for number in range(_WARM_UP + repetitions):
            before = time.perf_counter()
            self._filter.execute()
            self._device.wait()
            if number >= _WARM_UP:
                times.append(1e3 * (time.perf_counter() - before))
        if (problem := self._device.get_error()) is not None:
            raise RuntimeError(f"Open Image Denoise: {problem}")
        return times
