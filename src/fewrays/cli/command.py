"""What the commands share: how they are built from arguments, the lens flags, and outputs checked early."""

from __future__ import annotations

import textwrap
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeVar

import tyro
from tyro.conf import DisallowNone, Positional, arg

from fewrays.errors import SampleError
from fewrays.io import FORMATS, load
from fewrays.io.images import IMAGE_FORMATS
from fewrays.lens import Lens, LensAperture, Sampling
from fewrays.samples import SampleBuffer

__all__ = [
    "IMAGE_SUFFIXES",
    "SAMPLE_SUFFIXES",
    "Command",
    "InputFlags",
    "SamplesFile",
    "Stopwatch",
    "build",
    "check_output",
    "report",
    "report_file",
    "stopwatch",
]

SAMPLE_SUFFIXES = tuple(extension for form in FORMATS for extension in form.extensions)
IMAGE_SUFFIXES = tuple(form.extension for form in IMAGE_FORMATS)

SamplesFile = Annotated[Positional[Path], arg(metavar="SAMPLES")]
"""A positional argument that names a file of samples."""


class Command(ABC):
    """One command: a frozen dataclass whose fields are flags."""

    examples: ClassVar[tuple[str, ...]]
    """Complete command lines, shown by ``--help``."""

    @abstractmethod
    def run(self) -> None:
        """Do what the command says."""

    @classmethod
    def summary(cls) -> str:
        """Return the first line of the docstring."""
        return (cls.__doc__ or "").strip().splitlines()[0]

    @classmethod
    def description(cls) -> str:
        """Return the text at the top of ``--help``: the docstring up to its parameters, then the examples."""
        text = textwrap.dedent((cls.__doc__ or "").split("Parameters\n")[0].replace("\n    ", "\n")).strip()
        return text + "\n\nexamples:\n" + "\n".join(f"  {example}" for example in cls.examples)


C = TypeVar("C", bound=Command)


def build(kind: type[C], arguments: Sequence[str], *, prog: str) -> C:
    """Parse arguments into a command.

    Raises
    ------
    SampleError
        From options that find themselves out of range.
    SystemExit
        From the parser: after ``--help`` with status 0, for wrong flags with status 2.
    """

    def parse() -> C:
        return tyro.cli(
            kind,
            args=list(arguments),
            prog=prog,
            description=kind.description(),
            config=(DisallowNone,),
        )

    # The parser itself reports whatever goes wrong, in boxes, and ends the program. Options that refuse their
    # values shall give the same plain error here as in Python: it is looked up behind the parser's exit.
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            return parse()
    except SystemExit as stop:
        cause: BaseException | None = stop
        while cause is not None:
            if isinstance(cause, SampleError):
                raise cause from None
            cause = cause.__context__
    return parse()  # once more, aloud


@dataclass(frozen=True)
class InputFlags:
    """How samples are read, and the lens that they are looked at through.

    Parameters
    ----------
    aperture
        What the image integrates over; replaces what the file says.
    sampling
        The density that the lens positions were drawn from; version 1.3 files do not say.
    sigma
        Standard deviation of Gaussian aperture and sampling, in lens radii.
    focus_distance
        Refocus: depth of the focal plane in scene units, 'inf' allowed.
    aperture_scale
        Factor on the lens radius; 0 gives a pinhole.
    nan
        What to do with samples that hold a NaN or an infinity.
    header
        The header of a version 1.3 file, where it is not FILE.header.
    """

    aperture: LensAperture | None = None
    sampling: Sampling | None = None
    sigma: float | None = None
    focus_distance: float | None = None
    aperture_scale: float = 1.0
    nan: Literal["reject", "drop"] = "reject"
    header: Path | None = None

    def load(self, path: Path) -> SampleBuffer:
        """Load samples and look at them through the lens that the flags describe."""
        samples = load(
            path,
            aperture=self.aperture,
            sampling=self.sampling,
            sigma=self.sigma,
            nan=self.nan,
            progress=True,
            **({} if self.header is None else {"header": self.header}),
        )
        if self.focus_distance is None and self.aperture_scale == 1:
            return samples
        return samples.refocus(self.focus_distance, self.aperture_scale)

    def lens_for(self, lens: Lens, path: Path) -> Lens:
        """Return the lens that the flags describe, for a file that holds no samples.

        Parameters
        ----------
        lens : Lens
            What the file says.
        path : path
            The file, for messages.

        Raises
        ------
        SampleError
            For flags that say how samples are read, and values out of range.
        """
        for name in ("sampling", "nan", "header"):
            if getattr(self, name) != getattr(InputFlags, name):
                raise SampleError("is for samples, of which this file has none", file=path, field=name)
        aperture, sigma = self.aperture or lens.aperture, lens.sigma if self.sigma is None else self.sigma
        own = replace(lens, aperture=aperture, sigma=sigma)
        return own.refocus(self.focus_distance, self.aperture_scale)


def check_output(path: Path, suffixes: Sequence[str]) -> None:
    """Refuse an output path before the work that it is for, not after.

    Raises
    ------
    SampleError
        For an unknown extension, a directory that does not exist, or a directory in the file's place.
    """
    if not path.name.lower().endswith(tuple(suffixes)):
        raise SampleError(f"cannot write this kind of file; use {', '.join(suffixes)}", file=path)
    if not path.parent.is_dir():
        raise SampleError(f"the directory {path.parent} does not exist", file=path)
    if path.is_dir():
        raise SampleError("is a directory", file=path)


class Stopwatch:
    """Seconds that a `stopwatch` block took."""

    seconds = 0.0


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Measure the wall time of a block."""
    watch = Stopwatch()
    start = time.perf_counter()
    yield watch
    watch.seconds = time.perf_counter() - start


def report(what: str, samples: SampleBuffer, watch: Stopwatch, path: Path) -> None:
    """Print the one line that says what was done with samples, how long it took and where the result is."""
    report_file(what, f"{samples.width} x {samples.height}, {samples.spp} spp", watch, path)


def report_file(what: str, size: str, watch: Stopwatch, path: Path) -> None:
    """Print the line of `report` for a source of that size, given in words."""
    print(f"{what}: {size}, {watch.seconds:.2f} s -> {path} ({path.stat().st_size / 2**20:.1f} MiB)")
