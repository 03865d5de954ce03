"""How work is spread over threads, reported and cancelled.

Native kernels work on a range of tiles, in one thread, with the interpreter lock released. Everything about
threads is here. Each tile writes its own part of the output, so results do not depend on the thread count.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

from tqdm import tqdm

from fewrays.cuda.machine import Machine
from fewrays.errors import SampleError, require_option

__all__ = ["Execution", "map_ranges", "progress_bar", "usable_cores"]

_PROGRESS_DELAY = 2.0  # seconds that work may take before its progress bar appears


@dataclass(frozen=True)
class Execution:
    """Where and how a method runs.

    Parameters
    ----------
    device : str
        ``"cpu"``, ``"reference"`` or ``"cuda"``.
    threads : int, optional
        Threads to use; all usable cores when omitted.
    progress : bool
        Show a progress bar on stderr for work that takes over two seconds.
    aovs : bool
        Produce the method's further outputs as well.
    shadows : bool
        Reconstruct light and shadow of area lights, where samples come with light samples.
    output : {"host", "device"}
        Where images that a GPU makes are returned: copied to the host, or in its own memory. Images that
        the processor makes are on the host.
    """

    device: str = "cpu"
    threads: int | None = None
    progress: bool = False
    aovs: bool = False
    shadows: bool = True
    output: str = "host"

    def __post_init__(self) -> None:
        if self.threads is not None and self.threads < 1:
            raise SampleError(f"expected at least 1, got {self.threads}", field="threads")
        require_option("output", self.output, self.output in ("host", "device"), "out of host, device")

    def deliver(self, machine: Machine, image: Any) -> Any:
        """Return a GPU's image where it is wanted."""
        return machine.on_host(image) if self.output == "host" else image


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def progress_bar(total: int, label: str, *, show: bool, unit: str = "it") -> tqdm:
    """Return a bar on stderr that appears once the work has taken two seconds; none when it is a file."""
    return tqdm(
        total=total,
        desc=label,
        unit=unit,
        delay=_PROGRESS_DELAY,
        disable=None if show else True,
        leave=False,
        file=sys.stderr,
    )


def map_ranges(
    kernel: Callable[[int, int], None],
    count: int,
    execution: Execution,
    *,
    label: str = "",
    bar: tqdm | None = None,
    chunk: int = 8,
) -> None:
    """Call ``kernel(first, last)`` over ranges that cover ``0 … count``, from several threads.

    The first exception cancels what has not started and is raised; so does Ctrl-C. Progress goes to `bar`, or
    to a new one of the given label.
    """
    if bar is None:
        with progress_bar(count, label, show=execution.progress, unit="tile") as bar:
            map_ranges(kernel, count, execution, bar=bar, chunk=chunk)
        return
    ranges = [(first, min(first + chunk, count)) for first in range(0, count, chunk)]
    threads = min(execution.threads or usable_cores(), len(ranges))
    if threads <= 1:
        for first, last in ranges:
            _run_and_report(kernel, first, last, bar)
        return
    with ThreadPoolExecutor(threads, thread_name_prefix="fewrays") as pool:
        futures = [pool.submit(_run_and_report, kernel, first, last, bar) for first, last in ranges]
        try:
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _run_and_report(kernel: Callable[[int, int], None], first: int, last: int, bar: tqdm) -> None:
    kernel(first, last)
    bar.update(last - first)
