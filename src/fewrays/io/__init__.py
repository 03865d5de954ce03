"""Files: samples and images by extension.

`load` and `save` know no format by name. Each format is a module with a `Format` record: its extensions,
how it loads and how it saves; a new one joins `FORMATS`.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fewrays.errors import SampleError
from fewrays.io import exr, npz, tlfr
from fewrays.io.files import as_path
from fewrays.io.formats import Format
from fewrays.io.images import load_image, save_image
from fewrays.lens import Lens, LensAperture, Sampling
from fewrays.samples import SampleBuffer

__all__ = ["FORMATS", "load", "load_image", "save", "save_image"]

FORMATS: tuple[Format, ...] = (npz.FORMAT, tlfr.FORMAT, exr.FORMAT)
"""Every sample format; the first one is native."""


def load(
    path: str | os.PathLike[str],
    *,
    aperture: LensAperture | None = None,
    sampling: Sampling | None = None,
    sigma: float | None = None,
    nan: Literal["reject", "drop"] = "reject",
    progress: bool = False,
    **options: Any,
) -> SampleBuffer:
    """Read samples from a file; its extension says which format.

    Parameters
    ----------
    path : str or path
        ``.npz`` (native), ``.tlfr``, ``.bin`` or ``.txt`` (version 1.3 of the 2011 sample buffer format, with
        its ``.header`` file), ``.exr`` (deep scanline OpenEXR).
    aperture, sampling, sigma
        Fields of `fewrays.Lens` that replace what the file says, or say what it does not: a version 1.3 file
        says nothing and counts as ``"disc"``, ``"disc"``, 1/3.
    nan : {"reject", "drop"}
        What to do with samples that hold a NaN or an infinity: raise, or drop them with a warning.
    progress : bool
        Show a progress bar on stderr for work over two seconds.
    **options
        The format's own: ``header=PATH`` for a version 1.3 file whose header lies elsewhere.

    Returns
    -------
    SampleBuffer

    Raises
    ------
    SampleError
        Naming the file, the field and the value that cannot be used.

    Examples
    --------
    >>> samples = load("foliage.txt", sampling="square", aperture="gaussian")  # doctest: +SKIP
    """
    path = as_path(path)
    form = _find_format(path, loading=True)
    form.check_options(options, form.load_options)
    overrides = {"aperture": aperture, "sampling": sampling, "sigma": sigma}
    try:
        stored = form.load(path, progress, **options)
        fields: dict[str, Any] = {**stored.lens, **{k: v for k, v in overrides.items() if v is not None}}
        with np.errstate(all="ignore"):  # absurd numbers overflow on the way to being reported
            lighting = None if stored.lighting is None else stored.lighting.build(nan)
            return SampleBuffer(**stored.arrays, lens=Lens(**fields), lighting=lighting, nan=nan)
    except SampleError as error:
        raise (error if error.file else error.in_file(path)) from None


def save(
    path: str | os.PathLike[str],
    samples: SampleBuffer,
    *,
    overwrite: bool = True,
    progress: bool = False,
    **options: Any,
) -> None:
    """Write samples to a file; its extension says which format.

    The file is complete or not there: it is written under a temporary name and renamed.

    Parameters
    ----------
    path : str or path
        As for `load`.
    samples : SampleBuffer
        What to write.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : bool
        Show a progress bar on stderr for work over two seconds.
    **options
        The format's own. ``.npz``: ``compressed=False``, ``half=False`` (colour as float16). ``.tlfr``,
        ``.bin``, ``.txt``: ``encoding="binary"`` or ``"text"``, instead of what the extension says.
        ``.exr``: ``compression="zips"`` or ``"none"``.

    Warns
    -----
    UserWarning
        For samples with area lights, which only ``.npz`` can hold.

    Raises
    ------
    SampleError
        For an unknown extension or option, an existing file with ``overwrite=False``, samples that the format
        cannot hold, or a file that cannot be written.
    """
    path = as_path(path)
    if not isinstance(samples, SampleBuffer):
        raise SampleError(f"expected a fewrays.SampleBuffer, got {type(samples).__name__}", field="samples")
    form = _find_format(path, loading=False)
    form.check_options(options, form.save_options)
    try:
        form.save(path, samples, overwrite, progress, **options)
    except SampleError as error:
        raise (error if error.file else error.in_file(path)) from None


def _find_format(path: Path, *, loading: bool) -> Format:
    suffix = path.suffix.lower()
    if loading and suffix == ".header":
        raise SampleError(f"is a header; name its data file, {path.with_suffix('').name}", file=path)
    for form in FORMATS:
        if suffix in form.extensions:
            return form
    known = ", ".join(extension for form in FORMATS for extension in form.extensions)
    raise SampleError(f"unknown extension {suffix!r}; sample files end in {known}", file=path)
