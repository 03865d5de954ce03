"""What a command makes images of: samples, or a file of what a method has prepared of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fewrays.cli.command import InputFlags
from fewrays.errors import SampleError
from fewrays.lens import Lens
from fewrays.method import Method, Preparation, Reconstruction
from fewrays.parallel import Execution
from fewrays.reconstruct import METHODS, fastest_device, run_method, shaded_for
from fewrays.samples import SampleBuffer

__all__ = ["Renderer", "Source", "open_source", "preparing_method"]

Renderer = Callable[[Lens], Reconstruction]
"""Makes the image that one lens sees."""


@dataclass(frozen=True, eq=False)
class Source:
    """What images are made of.

    Parameters
    ----------
    lens : Lens
        What it is looked at through unless something else is asked for.
    height, width : int
        Image size in pixels.
    content : str
        What it is, in a word or two.
    samples : SampleBuffer or None
        The samples, where there are any.
    renderer : callable
        ``renderer(options, execution)`` does what every image has in common and returns a `Renderer`.
    """

    lens: Lens
    height: int
    width: int
    content: str
    samples: SampleBuffer | None
    renderer: Callable[[Any, Execution], Renderer]

    @property
    def size(self) -> str:
        """Image size and content, in words."""
        return f"{self.width} x {self.height}, {self.content}"


def preparing_method(path: Path) -> Method | None:
    """Return the method that writes files of this kind; none for samples."""
    for method in METHODS.values():
        if method.preparation is not None and path.suffix.lower() == method.preparation.extension:
            return method
    return None


def open_source(path: Path, method: Method, flags: InputFlags) -> Source:
    """Load samples, or what a method has prepared, to make images of by a method.

    Raises
    ------
    SampleError
        For files that cannot be used, a file that another method has prepared, and flags that say how
        samples are read where there are none.
    """
    owner = preparing_method(path)
    if owner is None:
        samples = flags.load(path)
        return Source(
            samples.lens,
            samples.height,
            samples.width,
            f"{samples.spp} spp",
            samples,
            lambda options, execution: _renderer_of_samples(samples, method, options, execution),
        )
    if owner is not method:
        raise SampleError(
            f"was prepared for method {owner.name!r}; {method.name!r} needs samples",
            file=path,
            field="method",
        )
    assert owner.preparation is not None
    return _open_prepared(path, owner.preparation, flags)


def _open_prepared(path: Path, preparation: Preparation, flags: InputFlags) -> Source:
    prepared = preparation.load(path)

    def renderer(options: Any, execution: Execution) -> Renderer:
        for field in dataclasses.fields(preparation.options):
            if getattr(options, field.name) != field.default:
                raise SampleError(
                    f"is decided when {preparation.content} are made; this file has them made already",
                    file=path,
                    field=field.name,
                )
        return lambda lens: prepared.reconstruct(lens, options, execution)

    lens = flags.lens_for(prepared.lens, path)
    return Source(lens, prepared.height, prepared.width, preparation.content, None, renderer)


def _renderer_of_samples(
    samples: SampleBuffer, method: Method, options: Any, execution: Execution
) -> Renderer:
    samples = shaded_for(method, samples, options, execution)
    execution = dataclasses.replace(execution, device=fastest_device(method, execution.device))
    if method.preparation is None or execution.device == "reference":
        return lambda lens: run_method(samples.with_lens(lens), method, options, execution)
    prepared = method.preparation.prepare(samples, options, execution)
    return lambda lens: prepared.reconstruct(lens, options, execution)
