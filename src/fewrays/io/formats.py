"""What a sample file format is: the record that each format module fills in, and what passes through it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.samples import MAX_IMAGE_SIZE, MAX_SAMPLES

__all__ = ["Format", "StoredSamples", "check_size"]


@dataclass(frozen=True)
class StoredSamples:
    """What a file says, before overrides and validation.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        The arrays of a `SampleBuffer` by name, in its shapes.
    lens : mapping of str to float or str
        The fields of `fewrays.Lens` that the file states; at least ``c0`` and ``c1``.
    """

    arrays: Mapping[str, npt.NDArray[np.floating]]
    lens: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Format:
    """A sample file format.

    Parameters
    ----------
    name : str
        What users call it.
    extensions : tuple of str
        Lower case, with the dot; the format is chosen by them.
    load : callable
        ``load(path, progress, **options) -> StoredSamples``.
    save : callable
        ``save(path, samples, overwrite, progress, **options)``.
    load_options, save_options : tuple of str
        Names of the keyword options that `load` and `save` take.
    """

    name: str
    extensions: tuple[str, ...]
    load: Callable[..., StoredSamples]
    save: Callable[..., None]
    load_options: tuple[str, ...] = ()
    save_options: tuple[str, ...] = ()

    def check_options(self, options: Mapping[str, Any], known: tuple[str, ...]) -> None:
        """Raise a `SampleError` for an option that this format does not take."""
        for name in options:
            if name not in known:
                raise SampleError(f"{self.name} files take {', '.join(known) or 'no options'}", field=name)


def check_size(height: int, width: int, spp: int, field: str) -> None:
    """Raise unless the size that a file claims is positive and within the caps of `fewrays.samples`."""
    if min(height, width, spp) < 1:
        raise SampleError(
            f"expected positive sizes, got {width} x {height} pixels with {spp} spp", field=field
        )
    if max(height, width) > MAX_IMAGE_SIZE or height * width * spp > MAX_SAMPLES:
        raise SampleError(
            f"{width} x {height} pixels with {spp} spp is over the cap of {MAX_IMAGE_SIZE} pixels a side and "
            f"{MAX_SAMPLES} samples",
            field=field,
        )
