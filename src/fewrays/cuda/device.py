"""Whether there is a GPU, and what it can do."""

from __future__ import annotations

import importlib
import sys
import warnings
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from fewrays.errors import SampleError

if TYPE_CHECKING:
    from fewrays.cuda.cupy_machine import CupyMachine

__all__ = ["Device", "announce", "find_device", "is_on_card", "pick_device", "require_machine"]

LEAST_CAPABILITY = (7, 0)
"""The oldest compute capability that kernels are written for."""

_DLPACK_CUDA = 2  # DLPack's number for memory of an NVIDIA card


@dataclass(frozen=True)
class Device:
    """A card.

    Parameters
    ----------
    name : str
    capability : (int, int)
        Compute capability.
    memory : int
        Bytes in all.
    multiprocessors : int
    shared_bytes : int
        Shared memory that a block can have.
    cache_bytes : int
        Size of the cache that all multiprocessors share.
    """

    name: str
    capability: tuple[int, int]
    memory: int
    multiprocessors: int
    shared_bytes: int
    cache_bytes: int


@cache
def find_device() -> Device | str:
    """Return the current card, or in words why there is none to use."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # CuPy misses a toolkit that we do not need
            cupy: Any = importlib.import_module("cupy")
    except ImportError:
        return "CuPy is not installed: python3 -m pip install 'fewrays[cuda]'"
    try:
        number = cupy.cuda.runtime.getDevice() if cupy.cuda.runtime.getDeviceCount() else None
    except cupy.cuda.runtime.CUDARuntimeError as error:
        return f"no NVIDIA GPU answers ({error}); check the driver with nvidia-smi"
    if number is None:
        return "no NVIDIA GPU is visible; check the driver with nvidia-smi, and CUDA_VISIBLE_DEVICES"
    found = cupy.cuda.runtime.getDeviceProperties(number)
    device = Device(
        name=found["name"].decode(),
        capability=(int(found["major"]), int(found["minor"])),
        memory=int(found["totalGlobalMem"]),
        multiprocessors=int(found["multiProcessorCount"]),
        shared_bytes=int(found["sharedMemPerBlockOptin"]),
        cache_bytes=int(found["l2CacheSize"]),
    )
    if device.capability < LEAST_CAPABILITY:
        least = ".".join(map(str, LEAST_CAPABILITY))
        return f"{device.name} has compute capability {device.capability}; at least {least} is needed"
    return device


def pick_device(devices: tuple[str, ...], asked: str) -> str:
    """Return the device that a method runs on.

    Parameters
    ----------
    devices : tuple of str
        Those of the method, the one to take without a GPU first.
    asked : str
        One of them, or ``"auto"``: the GPU where the method knows it and there is one, which is said once on
        stderr, else the first.

    Raises
    ------
    SampleError
        For ``"cuda"`` without a GPU.
    """
    if asked == "auto":
        if "cuda" not in devices or isinstance(find_device(), str):
            return devices[0]
        announce()
        return "cuda"
    if asked == "cuda" and isinstance(missing := find_device(), str):
        raise SampleError(missing, field="device")
    return asked


def is_on_card(array: Any) -> bool:
    """Tell whether an array of whatever library is in the memory of an NVIDIA card."""
    if hasattr(array, "__cuda_array_interface__"):
        return True
    return hasattr(array, "__dlpack_device__") and array.__dlpack_device__()[0] == _DLPACK_CUDA


@cache
def announce() -> None:
    """Say once on stderr which card runs the work."""
    device = find_device()
    if isinstance(device, Device):
        print(f"fewrays: running on {device.name}; device='cpu' runs on the processor", file=sys.stderr)


@cache
def require_machine() -> CupyMachine:
    """Return the current card as kernels use it.

    Raises
    ------
    SampleError
        Without one.
    """
    device = find_device()
    if isinstance(device, str):
        raise SampleError(device, field="device")
    from fewrays.cuda.cupy_machine import CupyMachine

    return CupyMachine(device)
