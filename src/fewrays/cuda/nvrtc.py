"""Compiles kernels for a compute capability without a card, by NVIDIA's run-time compiler.

It comes as a wheel of its own (``nvidia-cuda-nvrtc-cu12``) and needs no driver.
"""

from __future__ import annotations

import ctypes
import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path

from fewrays.errors import SampleError

__all__ = ["Resources", "compile_program", "find_nvrtc"]

_PACKAGE = "nvidia.cuda_nvrtc"
_FUNCTION = re.compile(r"Compiling entry function '(\w+)'")
_SPILLS = re.compile(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads")
_USED = re.compile(r"Used (\d+) registers(?:.*?(\d+) bytes smem)?")


@dataclass(frozen=True)
class Resources:
    """What a kernel takes of a multiprocessor.

    Parameters
    ----------
    name : str
    registers : int
        Of a thread.
    shared_bytes : int
        Of a block.
    stack_bytes, spill_bytes : int
        Of a thread, in local memory; spills are stores and loads together.
    """

    name: str
    registers: int
    shared_bytes: int
    stack_bytes: int
    spill_bytes: int


def find_nvrtc() -> ctypes.CDLL:
    """Load the compiler.

    Raises
    ------
    SampleError
        Where it is not installed.
    """
    try:
        found = importlib.util.find_spec(_PACKAGE)
    except ModuleNotFoundError:
        found = None
    folders = [] if found is None else [Path(place) for place in found.submodule_search_locations or ()]
    patterns = ("lib/libnvrtc.so.*", "bin/nvrtc64_*.dll")
    for path in sorted(path for folder in folders for pattern in patterns for path in folder.glob(pattern)):
        return ctypes.CDLL(str(path))
    raise SampleError("NVRTC is not installed: python3 -m pip install nvidia-cuda-nvrtc-cu12", field="nvrtc")


def compile_program(
    text: str, name: str, architecture: str = "sm_90", options: tuple[str, ...] = ()
) -> list[Resources]:
    """Compile a file of kernels to machine code.

    Parameters
    ----------
    text : str
        CUDA C++ that includes nothing.
    name : str
        For messages.
    architecture : str
        ``"sm_90"`` for compute capability 9.0.
    options : tuple of str
        Of the compiler, besides.

    Returns
    -------
    list of Resources
        Of every kernel, by name.

    Raises
    ------
    SampleError
        With the compiler's messages, where the text is wrong.
    """
    nvrtc = find_nvrtc()
    program = ctypes.c_void_p()
    status = nvrtc.nvrtcCreateProgram(ctypes.byref(program), text.encode(), name.encode(), 0, None, None)
    if status != 0:
        raise SampleError(f"NVRTC could not begin (status {status})", field=name)
    try:
        flags = [option.encode() for option in (*options, f"-arch={architecture}", "--ptxas-options=-v")]
        status = nvrtc.nvrtcCompileProgram(program, len(flags), (ctypes.c_char_p * len(flags))(*flags))
        log = _log_of(nvrtc, program)
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))
    if status != 0:
        raise SampleError(f"does not compile for {architecture}:\n{log}", field=name)
    return read_log(log)


def _log_of(nvrtc: ctypes.CDLL, program: ctypes.c_void_p) -> str:
    size = ctypes.c_size_t()
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    buffer = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, buffer)
    return buffer.value.decode(errors="replace")


def read_log(log: str) -> list[Resources]:
    """Return what the assembler's report says of each kernel."""
    found = []
    for part in re.split(r"(?=Compiling entry function)", log)[1:]:
        name, spills, used = _FUNCTION.search(part), _SPILLS.search(part), _USED.search(part)
        if not (name and spills and used):
            raise SampleError(f"the assembler's report is of an unknown form:\n{part}", field="nvrtc")
        stack, stores, loads = map(int, spills.groups())
        found.append(Resources(name[1], int(used[1]), int(used[2] or 0), stack, stores + loads))
    return sorted(found, key=lambda each: each.name)
