"""Finding an LLVM that Mitsuba can use.

Mitsuba's LLVM variants load LLVM's shared library when they are activated. On x86, a release before 17 ends
the process in the middle of the first kernel ("Cannot select: … fminimum"), and Dr.Jit's own search takes
whatever it meets first. So this module looks first.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import sys
from pathlib import Path

from fewrays.errors import SampleError

__all__ = ["MIN_VERSION", "find_llvm"]

MIN_VERSION = 17
"""First LLVM release whose x86 code generator knows all that Mitsuba's kernels use."""

_VARIABLE = "DRJIT_LIBLLVM_PATH"

_FOLDERS = {
    "linux": (
        "/usr/lib/*-linux-gnu",
        "/usr/lib/llvm-*/lib",
        "/usr/lib64",
        "/usr/lib64/llvm*/lib*",
        "/usr/lib",
        "/usr/local/lib",
        "/usr/local/lib64",
    ),
    "darwin": ("/opt/homebrew/opt/llvm*/lib", "/usr/local/opt/llvm*/lib"),
}


def find_llvm() -> Path | None:
    """Make sure that Mitsuba will load an LLVM that works, before it loads any.

    Keeps the library that the environment variable ``DRJIT_LIBLLVM_PATH`` names when it is new enough;
    otherwise looks in the usual places and sets the variable to the newest.

    Returns
    -------
    Path or None
        The library; None on systems where Dr.Jit's own search has to do.

    Raises
    ------
    SampleError
        When there is no LLVM, or only releases that end the process.
    """
    named = os.environ.get(_VARIABLE)
    if named:
        path = Path(named)
        if not path.is_file():
            raise SampleError(f"names {named}, which does not exist; {_advice()}", field=_VARIABLE)
        _require(path, llvm_version(path))
        return path
    if sys.platform not in _FOLDERS:
        return None
    found = {path: llvm_version(path) for path in _candidates()}
    if not found:
        raise SampleError(f"found no LLVM shared library, which the llvm variants need; {_advice()}")
    newest = max(found, key=lambda path: (found[path] or 0, path.name))
    _require(newest, found[newest])
    os.environ[_VARIABLE] = str(newest)
    return newest


def llvm_version(path: Path) -> int | None:
    """Return the major version of an LLVM library from its name, or by asking it; None if neither tells."""
    match = re.fullmatch(r"libLLVM(?:-C)?[-.]?(?:so\.|dylib\.)?(\d+).*", path.resolve().name)
    if match and int(match.group(1)) > 1:  # libLLVM.so.1 numbers the interface, not the release
        return int(match.group(1))
    try:
        library = ctypes.CDLL(str(path))
        major = ctypes.c_uint(0)
        library.LLVMGetVersion(ctypes.byref(major), None, None)  # since LLVM 16
    except (OSError, AttributeError):
        return None
    return major.value


def _candidates() -> set[Path]:
    folders = [folder for pattern in _FOLDERS[sys.platform] for folder in Path("/").glob(pattern[1:])]
    if conda := os.environ.get("CONDA_PREFIX"):
        folders.append(Path(conda) / "lib")
    names = ("libLLVM*.dylib",) if sys.platform == "darwin" else ("libLLVM*.so", "libLLVM*.so.*")
    return {
        path.resolve() for folder in folders for name in names for path in folder.glob(name) if path.is_file()
    }


def _require(path: Path, version: int | None) -> None:
    # Only the x86 code generator lacks the operation.
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return
    if version is None:
        raise SampleError(f"cannot tell which LLVM release {path} is; {_advice()}", field=_VARIABLE)
    if version < MIN_VERSION:
        raise SampleError(
            f"{path} is LLVM {version}, with which Mitsuba would abort this process; {_advice()}",
            field=_VARIABLE,
        )


def _advice() -> str:
    return (
        f"install LLVM {MIN_VERSION} or newer (Debian, Ubuntu: apt install libllvm19; "
        f"conda install -c conda-forge libllvm19; macOS: brew install llvm) and, where it is not found by "
        f"itself, set {_VARIABLE} to the shared library, such as /usr/lib/x86_64-linux-gnu/libLLVM.so.19.1"
    )
