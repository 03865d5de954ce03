"""A machine that is no GPU: kernels compiled for the CPU, whose threads run one after the other."""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.source import kernel_folder

__all__ = ["ORDERS", "POISON", "PhasesMachine", "compile_phases"]

ORDERS = (0, 1, 2)
"""In which threads and blocks run: forwards, backwards, and jumping about."""

POISON = 0xCD
"""What the bytes of memory hold that nobody has written."""


@cache
def compile_phases(program: str) -> ctypes.CDLL:
    """Compile a file of kernels as C++; ``FEWRAYS_PHASES_FLAGS`` adds flags, such as those of a sanitizer."""
    compiler = os.environ.get("CXX") or next(filter(shutil.which, ("c++", "g++", "clang++")), None)
    assert compiler, "tests of kernels need a C++20 compiler"
    folder = Path(tempfile.mkdtemp(prefix="fewrays-phases-"))
    try:
        library = folder / f"{program}.so"
        flags = ["-std=c++20", "-O1", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror"]
        flags += ["-ffp-contract=off", *shlex.split(os.environ.get("FEWRAYS_PHASES_FLAGS", ""))]
        source = kernel_folder() / f"{program}.cu"
        command = [*shlex.split(compiler), *flags, "-x", "c++", str(source), "-o", str(library)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return ctypes.CDLL(str(library))
    finally:
        shutil.rmtree(folder)  # a library that is loaded needs no file


class PoisonedNumPy:
    """NumPy whose new arrays hold poison where they are empty, as a GPU's hold what was there before."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def empty(self, shape: Any, dtype: Any = np.float32) -> Any:
        """Return an array that is full of poison."""
        array = np.empty(shape, dtype)
        array.view(np.uint8).fill(POISON)
        return array

    def empty_like(self, array: Any) -> Any:
        """Return another such array of the same shape and type."""
        return self.empty(array.shape, array.dtype)


class PhasesMachine:
    """A `fewrays.cuda.machine.Machine`.

    Parameters
    ----------
    order : int
        One of `ORDERS`.
    cache_bytes : int
        What the machine says of its cache.
    shared_bytes : int
        Shared memory that a block can have.
    """

    xp: Any = PoisonedNumPy()

    def __init__(self, order: int = 0, cache_bytes: int = 50 << 20, shared_bytes: int = 227 << 10) -> None:
        self.order = order
        self.cache_bytes = cache_bytes
        self.shared_bytes = shared_bytes
        self.launches: list[str] = []

    def launch(
        self, kernel: Kernel, grid: tuple[int, int, int], *, shared_bytes: int = 0, **arguments: Any
    ) -> None:
        """Run a kernel."""
        library = compile_phases(kernel.program)
        assert getattr(library, f"{kernel.name}_threads")() == kernel.threads
        assert getattr(library, f"{kernel.name}_argument_bytes")() == kernel.layout.itemsize
        assert max(grid[1:]) <= 65535
        assert shared_bytes <= self.shared_bytes
        record = kernel.pack(arguments, self.address)
        self.launches.append(kernel.name)
        run = getattr(library, kernel.name)
        run(ctypes.c_void_p(record.ctypes.data), *grid, self.order, shared_bytes)

    def address(self, array: Any) -> int:
        """Return where an array begins."""
        return int(array.ctypes.data)

    def on_device(self, array: Any, dtype: Any) -> Any:
        """Return an array of that type, contiguous."""
        return np.ascontiguousarray(array, dtype)

    def on_host(self, array: Any) -> Any:
        """Return the array."""
        return array

    def fetch(self, array: Any) -> Callable[[], Any]:
        """Return what gives the array."""
        return lambda: array
