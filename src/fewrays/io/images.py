"""Images by extension: ``.exr``, ``.png``, ``.npy``; each format is a module with an `ImageFormat` record."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, first_index
from fewrays.io import image_exr, image_npy, image_png
from fewrays.io.files import as_path, open_file, replace_files
from fewrays.io.image_format import Image, ImageFormat
from fewrays.samples import MAX_IMAGE_SIZE

__all__ = ["IMAGE_FORMATS", "load_image", "save_image"]

IMAGE_FORMATS: tuple[ImageFormat, ...] = (image_exr.FORMAT, image_png.FORMAT, image_npy.FORMAT)
"""Every image format."""


def save_image(
    path: str | os.PathLike[str],
    image: npt.ArrayLike,
    *,
    exposure: float = 0.0,
    provenance: Mapping[str, str] | None = None,
    overwrite: bool = True,
) -> None:
    """Write an image; the extension says how.

    The file is complete or not there: it is written under a temporary name and renamed.

    Parameters
    ----------
    path : str or path
        ``.exr``: float32, linear, unchanged. ``.png``: 8 bit sRGB for looking at; what is brighter than
        white is clipped. ``.npy``: float32, linear, unchanged.
    image : array_like, (H, W, 3) or (H, W)
        Linear radiance, or a map of one value per pixel (not for ``.png``).
    exposure : float
        Stops, for ``.png`` only: radiance is multiplied by ``2**exposure`` first.
    provenance : mapping of str to str, optional
        How the image was made: method, options, version. Stored as attributes ``fewrays/<name>`` in
        ``.exr`` and as text in ``.png``; ``.npy`` has no place for it.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    SampleError
        For a shape, a value or an extension that cannot be used, or a file that cannot be written.
    """
    path = as_path(path)
    form = _find_format(path)
    if not np.isfinite(exposure):
        raise SampleError(f"expected a finite number of stops, got {exposure}", file=path, field="exposure")
    if exposure != 0 and not form.display:
        raise SampleError("is for .png; this format stores the radiance itself", file=path, field="exposure")
    pixels = _checked(image, path)
    notes = {str(name): str(value) for name, value in (provenance or {}).items()}
    try:
        with replace_files(path, overwrite=overwrite) as [temporary]:
            form.save(temporary, pixels, exposure, notes)
    except SampleError as error:
        raise SampleError(error.problem, file=path, field=error.field) from None


def load_image(path: str | os.PathLike[str]) -> Image:
    """Read an image; the extension says how.

    Parameters
    ----------
    path : str or path
        ``.exr`` (one flat part with channels R, G, B, or a single channel), ``.png`` (8 bit; decoded from
        sRGB to linear light), ``.npy`` (``(H, W, 3)`` or ``(H, W)``).

    Returns
    -------
    ndarray, (H, W, 3) or (H, W)
        float32, linear; two dimensions for a map of one value per pixel.

    Raises
    ------
    SampleError
        For a file that is damaged, of another kind, or holds NaN or infinities.
    """
    path = as_path(path)
    form = _find_format(path)
    with open_file(path) as (file, length):
        return _checked(form.load(file, length, path), path)


def _checked(image: npt.ArrayLike, path: Path) -> Image:
    array = np.asarray(image)
    if array.dtype.kind not in "fiub":
        raise SampleError(f"expected real numbers, got dtype {array.dtype}", file=path, field="image")
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or array.size == 0:
        raise SampleError(f"expected shape (H, W, 3) or (H, W), got {array.shape}", file=path, field="image")
    if max(array.shape) > MAX_IMAGE_SIZE:
        raise SampleError(
            f"shape {array.shape} is over the cap of {MAX_IMAGE_SIZE} pixels a side", file=path, field="image"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = np.ascontiguousarray(array, np.float32)
    finite = np.isfinite(pixels)
    if not finite.all():
        index = first_index(~finite)
        raise SampleError(
            f"{finite.size - int(finite.sum())} values are NaN or infinite, the first at {list(index)}: "
            f"{pixels[index]}",
            file=path,
            field="image",
        )
    return pixels


def _find_format(path: Path) -> ImageFormat:
    suffix = path.suffix.lower()
    for form in IMAGE_FORMATS:
        if suffix == form.extension:
            return form
    known = ", ".join(form.extension for form in IMAGE_FORMATS)
    raise SampleError(f"unknown extension {suffix!r}; images end in {known}", file=path)
