"""The card as kernels use it, by CuPy.

Kernels start on CuPy's current stream, which ``with stream:`` chooses, and nothing here waits for them.
Memory comes from CuPy's pool, which keeps what is freed for the next that asks on the same stream: a sequence
of frames of one size allocates once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import cupy
import cupyx
import numpy as np

from fewrays.cuda.device import Device, is_on_card
from fewrays.cuda.kernel import Kernel
from fewrays.cuda.source import OPTIONS, program_text

__all__ = ["CupyMachine"]


class CupyMachine:
    """A `fewrays.cuda.machine.Machine`.

    Parameters
    ----------
    device : Device
    """

    xp: Any = cupy

    def __init__(self, device: Device) -> None:
        self.device = device
        self.cache_bytes = device.cache_bytes
        self.shared_bytes = device.shared_bytes

    def launch(
        self, kernel: Kernel, grid: tuple[int, int, int], *, shared_bytes: int = 0, **arguments: Any
    ) -> None:
        """Start a kernel on the current stream; see `fewrays.cuda.machine.Machine.launch`."""
        record = kernel.pack(arguments, self.address)
        if not all(grid):
            return
        function = _module(kernel.program).get_function(kernel.name)
        if shared_bytes > 0:
            function.max_dynamic_shared_size_bytes = shared_bytes
        function(grid, (kernel.threads, 1, 1), (record,), shared_mem=shared_bytes)

    def address(self, array: Any) -> int:
        """Return where an array begins in the card's memory."""
        return int(array.data.ptr)

    def on_device(self, array: Any, dtype: Any) -> Any:
        """Copy an array to the card, or take it as it is.

        Parameters
        ----------
        array : array_like
            Of NumPy, CuPy, PyTorch, or whatever has ``__cuda_array_interface__`` or ``__dlpack__``.
        dtype : dtype_like

        Returns
        -------
        cupy.ndarray
            C-contiguous. Shares memory with what is on the card already, and of that type.
        """
        if not hasattr(array, "__cuda_array_interface__"):
            array = cupy.from_dlpack(array) if is_on_card(array) else np.asarray(array)
        return cupy.ascontiguousarray(cupy.asarray(array), dtype=dtype)

    def on_host(self, array: Any) -> Any:
        """Copy an array to the host and wait for it."""
        return cupy.asnumpy(array)

    def fetch(self, array: Any) -> Callable[[], Any]:
        """Begin to copy an array to the host; see `fewrays.cuda.machine.Machine.fetch`."""
        copied = cupyx.empty_pinned(array.shape, array.dtype)
        array.get(out=copied, blocking=False)
        done = cupy.cuda.Event(disable_timing=True)
        done.record()

        def wait() -> Any:
            done.synchronize()
            return copied

        return wait


@cache
def _module(program: str) -> Any:
    """Compile a file of kernels for the current card, or find it on disk."""
    return cupy.RawModule(code=program_text(program), options=OPTIONS)
