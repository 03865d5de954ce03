"""``fewrays planes``: samples in, a file of planes out, of which images are made quickly."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import ClassVar

from tyro.conf import OmitArgPrefixes

from fewrays.cli.command import Command, InputFlags, SamplesFile, check_output, report, stopwatch
from fewrays.multiplane import BuildOptions, Multiplane
from fewrays.multiplane.preparation import PREPARATION
from fewrays.parallel import Execution
from fewrays.reconstruct import find_method, shaded_for

__all__ = ["Planes"]


@dataclass(frozen=True)
class Planes(Command):
    """Build the planes of the multiplane method once, for any number of images.

    'reconstruct' and 'refocus' take the file in the place of samples; 'info' shows what is in it. For images
    focused far from where the samples were, build with a large --fine-to.

    Parameters
    ----------
    samples
        The samples: .npz, version 1.3 (.tlfr, .bin, .txt), or deep .exr.
    out
        The file of planes to write: .planes.
    threads
        Threads to use; all usable cores when omitted. The result does not depend on it.
    shadows
        Reconstruct soft shadows where samples come with light samples; '--no-shadows' takes them as they are.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays planes samples.npz --out scene.planes",
        "fewrays planes samples.npz --out scene.planes --fine-to 20",
    )

    samples: SamplesFile
    out: Path
    threads: int | None = None
    shadows: bool = True
    input: OmitArgPrefixes[InputFlags] = field(default_factory=InputFlags)
    options: OmitArgPrefixes[BuildOptions] = field(default_factory=BuildOptions)

    def run(self) -> None:
        """Load, build, save."""
        check_output(self.out, (PREPARATION.extension,))
        samples = self.input.load(self.samples)
        execution = Execution(threads=self.threads, progress=True, shadows=self.shadows)
        with stopwatch() as watch:
            samples = shaded_for(find_method("multiplane"), samples, self.options, execution)
            planes = Multiplane.build(samples, **asdict(self.options), threads=self.threads, progress=True)
        planes.save(self.out)
        report("planes", samples, watch, self.out)
