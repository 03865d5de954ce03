"""Peak memory of a call, native code included."""

from __future__ import annotations

import ctypes
import ctypes.util
import multiprocessing
import resource
import sys
from collections.abc import Callable

__all__ = ["extra_memory"]


def extra_memory(call: Callable[[], object]) -> float:
    """Return by how many MiB a call raises the resident memory of this process, at its peak.

    The call is made in a forked child: its peak starts from what the parent holds now, not from what the
    parent once held. Fork before any library has started threads.

    Raises
    ------
    RuntimeError
        When the call fails in the child.
    """
    _give_back_freed()
    context = multiprocessing.get_context("fork")
    answers = context.SimpleQueue()

    def run() -> None:
        before = _peak()
        call()
        answers.put(_peak() - before)

    child = context.Process(target=run)
    child.start()
    child.join()
    if child.exitcode != 0:
        raise RuntimeError(f"the measured call failed with exit code {child.exitcode}")
    return float(answers.get())


def _give_back_freed() -> None:
    """Give memory that was freed back to the system, lest the call reuse it unseen; only glibc can."""
    library = ctypes.util.find_library("c") if sys.platform == "linux" else None
    trim = getattr(ctypes.CDLL(library), "malloc_trim", None) if library else None
    if trim is not None:
        trim(0)


def _peak() -> float:
    """Largest resident size so far in MiB; the system gives bytes on macOS, KiB elsewhere."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
