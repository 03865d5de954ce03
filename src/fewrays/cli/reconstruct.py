"""``fewrays reconstruct``: samples, or what a method has prepared of them, in; image out.

``--method`` is an ordinary flag, yet it decides which other flags there are: it is looked up first, and the
parser is then built with that method's options dataclass. The flags cannot drift apart from the API.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy.typing as npt
from tyro.conf import OmitArgPrefixes, arg

from fewrays.cli.command import (
    IMAGE_SUFFIXES,
    Command,
    InputFlags,
    SamplesFile,
    check_output,
    report_file,
    stopwatch,
)
from fewrays.cli.methods import DEFAULT_METHOD, provenance
from fewrays.cli.source import open_source
from fewrays.errors import SampleError
from fewrays.io import save_image
from fewrays.parallel import Execution
from fewrays.reconstruct import METHODS, find_method

__all__ = ["Reconstruct"]

Options = TypeVar("Options")


@dataclass(frozen=True)
class Reconstruct(Command, Generic[Options]):
    """Reconstruct a clean image from samples.

    Each method has its own options: 'fewrays reconstruct --method NAME --help' shows them.

    Parameters
    ----------
    samples
        The samples: .npz, version 1.3 (.tlfr, .bin, .txt), or deep .exr. Or the .planes of 'fewrays planes'.
    out
        The image to write: .exr (linear, with provenance in its header), .png (sRGB) or .npy.
    method
        How to reconstruct.
    device
        'cuda' is an NVIDIA GPU, which 'auto' takes where there is one; 'reference' is plain NumPy, slow.
    threads
        Threads to use; all usable cores when omitted. The result does not depend on it.
    exposure
        Brightening of a .png, in stops.
    shadows
        Reconstruct soft shadows where samples come with light samples; '--no-shadows' takes them as they are.
    aovs
        Also write the method's further outputs into this directory, as .exr files.
    """

    examples: ClassVar[tuple[str, ...]] = (
        "fewrays reconstruct samples.npz --out clean.exr",
        "fewrays reconstruct samples.npz --out clean.png --exposure 1 --focus-distance 3.5",
        "fewrays reconstruct samples.npz --out box.exr --method box",
        "fewrays reconstruct scene.planes --out closer.exr --focus-distance 2.5",
    )

    samples: SamplesFile
    out: Path
    method: Annotated[str, arg(metavar="{" + ",".join(METHODS) + "}")] = DEFAULT_METHOD
    device: Literal["auto", "cpu", "reference", "cuda"] = "auto"
    threads: int | None = None
    exposure: float = 0.0
    shadows: bool = True
    aovs: Annotated[Path | None, arg(metavar="DIR")] = None
    input: OmitArgPrefixes[InputFlags] = field(default_factory=InputFlags)
    options: Annotated[OmitArgPrefixes[Options], arg(name="method")] = field(kw_only=True)

    @classmethod
    def description(cls) -> str:
        """Return the text at the top of ``--help``, with the methods and what they are."""
        methods = "\n".join(f"  {name:<22}{method.summary}" for name, method in METHODS.items())
        return f"{super().description()}\n\nmethods:\n{methods}"

    def run(self) -> None:
        """Load, reconstruct, save."""
        check_output(self.out, IMAGE_SUFFIXES)
        if self.exposure and self.out.suffix.lower() != ".png":
            raise SampleError("is for .png; other formats store the radiance itself", field="exposure")
        if self.aovs is not None and self.aovs.exists() and not self.aovs.is_dir():
            raise SampleError("is not a directory", file=self.aovs)
        method = find_method(self.method)
        execution = Execution(
            self.device, self.threads, progress=True, aovs=self.aovs is not None, shadows=self.shadows
        )
        source = open_source(self.samples, method, self.input)
        with stopwatch() as watch:
            result = source.renderer(self.options, execution)(source.lens)
        notes = provenance(method, self.options, source.lens, self.samples)
        save_image(self.out, result.image, exposure=self.exposure, provenance=notes)
        if self.aovs is not None:
            save_aovs(self.aovs, result.aovs, notes)
        report_file(method.name, source.size, watch, self.out)


def save_aovs(directory: Path, aovs: Mapping[str, npt.NDArray[Any]], notes: Mapping[str, str]) -> None:
    """Write each output as ``NAME.exr``, or as ``NAME.00.exr``, ``NAME.01.exr`` and so on per layer.

    Parameters
    ----------
    directory : path
        Made when it does not exist.
    aovs : mapping of str to ndarray
        Shapes ``(H, W)``, ``(H, W, layers)`` or ``(H, W, layers, 3)``.
    notes : mapping
        For the files' headers.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for name, array in aovs.items():
        if array.ndim == 2:
            save_image(directory / f"{name}.exr", array, provenance=notes)
            continue
        for layer in range(array.shape[2]):
            save_image(directory / f"{name}.{layer:02}.exr", array[:, :, layer], provenance=notes)
