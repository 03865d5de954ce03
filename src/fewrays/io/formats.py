"""What a sample file format is: the record that each format module fills in, and what passes through it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, require_known_options
from fewrays.lighting import AreaLight, Lighting, LightSamples, Projection
from fewrays.samples import MAX_IMAGE_SIZE, MAX_SAMPLES, SampleBuffer

__all__ = ["Format", "StoredLight", "StoredLighting", "StoredSamples", "check_size", "warn_of_lighting"]


@dataclass(frozen=True)
class StoredLight:
    """What a file says of one light.

    Parameters
    ----------
    light : mapping of str
        The fields of its `AreaLight`.
    arrays : mapping of str to ndarray
        The arrays of its `LightSamples` by name.
    """

    light: Mapping[str, Any]
    arrays: Mapping[str, npt.NDArray[np.floating]]


@dataclass(frozen=True)
class StoredLighting:
    """What a file says of area lights, before validation.

    Parameters
    ----------
    projection : mapping of str
        The fields of `Projection`.
    arrays : mapping of str to ndarray
        The arrays of a `Lighting` by name.
    lights : sequence of StoredLight
        One for each light.
    """

    projection: Mapping[str, Any]
    arrays: Mapping[str, npt.NDArray[np.floating]]
    lights: Sequence[StoredLight]

    def build(self, nan: Literal["reject", "drop"]) -> Lighting:
        """Validate it; errors name fields as ``lighting.normal`` or ``light0.lxy``."""
        lights = []
        for number, stored in enumerate(self.lights):
            with _prefixed(f"light{number}."):
                light = AreaLight(**stored.light)
                lights.append(LightSamples(light, **stored.arrays, nan=nan))
        with _prefixed("lighting."):
            return Lighting(Projection(**self.projection), **self.arrays, lights=lights, nan=nan)


@contextmanager
def _prefixed(prefix: str) -> Iterator[None]:
    """Put what a field belongs to before its name in errors."""
    try:
        yield
    except SampleError as error:
        raise SampleError(error.problem, file=error.file, field=f"{prefix}{error.field or ''}") from None


@dataclass(frozen=True)
class StoredSamples:
    """What a file says, before overrides and validation.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        The arrays of a `SampleBuffer` by name, in its shapes.
    lens : mapping of str to float or str
        The fields of `fewrays.Lens` that the file states; at least ``c0`` and ``c1``.
    lighting : StoredLighting, optional
        Area lights and their samples.
    """

    arrays: Mapping[str, npt.NDArray[np.floating]]
    lens: Mapping[str, float | str] = field(default_factory=dict)
    lighting: StoredLighting | None = None


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
        require_known_options(options, known, f"{self.name} files")


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


def warn_of_lighting(samples: SampleBuffer, path: Path) -> None:
    """Warn if samples are about to lose their lights because a format has no place for them."""
    if samples.lighting is not None:
        warnings.warn(
            f"{path.name}: lights and light samples are not written, only the colours that they make, so "
            "that shadows will be as noisy as those are; save as .npz to keep them, or leave them out with "
            "dataclasses.replace(samples, lighting=None)",
            stacklevel=4,
        )
