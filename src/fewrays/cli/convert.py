"""``fewrays convert``: samples from one file format into another."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, arg

from fewrays.cli.command import SAMPLE_SUFFIXES, Command, InputFlags, check_output, report, stopwatch
from fewrays.io import save

__all__ = ["Convert"]


@dataclass(frozen=True)
class Convert(Command):
    """Convert samples between file formats, or store them with another lens.

    The extensions name the formats: .npz (native), .tlfr, .bin and .txt (version 1.3 of the 2011 sample
    buffer format, with a .header file), .exr (deep, for compositing packages).

    Parameters
    ----------
    source
        The file to read.
    target
        The file to write; an existing one is replaced.
    compressed
        Deflate a .npz: smaller and slower.
    half
        Store the colour of a .npz as float16.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays convert samples.txt samples.npz --sampling square --aperture gaussian",
        "fewrays convert samples.npz samples.exr",
        "fewrays convert samples.npz small.npz --compressed --half",
    )

    source: Annotated[Positional[Path], arg(metavar="SOURCE")]
    target: Annotated[Positional[Path], arg(metavar="TARGET")]
    compressed: FlagCreatePairsOff[bool] = False
    half: FlagCreatePairsOff[bool] = False
    input: OmitArgPrefixes[InputFlags] = field(default_factory=InputFlags)

    def run(self) -> None:
        """Load, change the lens, save."""
        check_output(self.target, SAMPLE_SUFFIXES)
        options = {name: True for name in ("compressed", "half") if getattr(self, name)}
        with stopwatch() as watch:
            samples = self.input.load(self.source)
            save(self.target, samples, progress=True, **options)
        report("convert", samples, watch, self.target)
