"""``fewrays demo``: the shipped samples, reconstructed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from fewrays.cli.command import Command

__all__ = ["Demo"]


@dataclass(frozen=True)
class Demo(Command):
    """Reconstruct the samples that come with fewrays and show what that gains.

    Writes fewrays-demo.png (noisy, reconstructed and reference images with crops and error maps) and
    fewrays-demo.exr (the reconstruction), and prints the measured quality of every method.

    Parameters
    ----------
    out
        Directory to write to; made when it does not exist.
    threads
        Threads to use; all usable cores when omitted.
    """

    examples: ClassVar[tuple[str, ...]] = ("fewrays demo", "fewrays demo --out pictures --threads 2")

    out: Path = Path()
    threads: int | None = None

    def run(self) -> None:
        """Run the demo."""
        from fewrays.demo import run_demo

        run_demo(self.out, threads=self.threads)
