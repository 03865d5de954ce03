"""Seconds of calls that take turns, so that whatever else the machine does meets all of them alike."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

__all__ = ["Timing", "spread", "time_in_turns"]


@dataclass(frozen=True)
class Timing:
    """Seconds of one contender's calls, in the order in which they were made."""

    cpu: list[float]
    wall: list[float]

    @property
    def cpu_median(self) -> float:
        """Median of the CPU seconds, over all threads."""
        return statistics.median(self.cpu)

    @property
    def wall_median(self) -> float:
        """Median of the seconds that passed."""
        return statistics.median(self.wall)


def time_in_turns(calls: Sequence[Callable[[], object]], repetitions: int) -> list[Timing]:
    """Time calls, one after the other, `repetitions` times over, after one round that does not count."""
    timings = [Timing([], []) for _ in calls]
    for number in range(repetitions + 1):
        for call, timing in zip(calls, timings, strict=True):
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            if number > 0:
                timing.cpu.append(time.process_time() - cpu)
                timing.wall.append(time.perf_counter() - wall)
    return timings


def spread(seconds: Sequence[float]) -> str:
    """Return median and range."""
    return f"{statistics.median(seconds):.3f} ({min(seconds):.3f} to {max(seconds):.3f})"
