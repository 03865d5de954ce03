"""Images with alpha, for compositing: ``.exr`` and ``.npy`` premultiplied, linear; ``.png`` for looking at.

OpenEXR holds colour multiplied by alpha, which is what defocus gives; PNG holds it divided by alpha.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import OpenEXR
import PIL.Image
from PIL.PngImagePlugin import PngInfo

from fewrays.color import srgb_encode
from fewrays.errors import SampleError
from fewrays.io.files import as_path, replace_files

__all__ = ["save_rgba"]

Float32 = npt.NDArray[np.float32]


def save_rgba(
    path: str | os.PathLike[str],
    image: Float32,
    *,
    exposure: float = 0.0,
    provenance: Mapping[str, str] | None = None,
) -> None:
    """Write an image with alpha; the extension says how. The file is complete or not there.

    Parameters
    ----------
    path : str or path
        ``.exr`` or ``.npy`` (float32, unchanged), or ``.png`` (8 bit sRGB).
    image : ndarray, (H, W, 4)
        Linear radiance multiplied by alpha, and alpha in [0, 1].
    exposure : float
        Stops, for ``.png`` only.
    provenance : mapping of str to str, optional
        How the image was made, for the headers of ``.exr`` and ``.png``.

    Raises
    ------
    SampleError
        For another extension or shape, or a file that cannot be written.
    """
    path = as_path(path)
    savers = {".exr": _save_exr, ".png": _save_png, ".npy": _save_npy}
    saver = savers.get(path.suffix.lower())
    if saver is None:
        raise SampleError(f"images with alpha end in {', '.join(savers)}", file=path)
    if image.ndim != 3 or image.shape[2] != 4:
        raise SampleError(f"expected shape (H, W, 4), got {image.shape}", file=path, field="image")
    notes = {str(name): str(value) for name, value in (provenance or {}).items()}
    with replace_files(path) as [temporary]:
        saver(str(temporary), image, exposure, notes)


def _save_exr(name: str, image: Float32, exposure: float, notes: Mapping[str, str]) -> None:  # noqa: ARG001
    header: dict[str, object] = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    header |= {f"fewrays/{key}": value for key, value in notes.items()}
    with OpenEXR.File(header, {"RGBA": np.ascontiguousarray(image, np.float32)}) as file:
        file.write(name)


def _save_png(name: str, image: Float32, exposure: float, notes: Mapping[str, str]) -> None:
    alpha = np.clip(image[..., 3:], 0, 1)
    straight = image[..., :3] / np.where(alpha > 0, alpha, 1)
    with np.errstate(over="ignore"):  # what overflows is brighter than white
        encoded = srgb_encode(straight * np.float32(2.0) ** np.float32(exposure))
    info = PngInfo()
    for key, value in notes.items():
        info.add_itxt(key, value)
    pixels = np.rint(np.concatenate([encoded, alpha], axis=-1) * 255).astype(np.uint8)
    PIL.Image.fromarray(pixels).save(name, format="PNG", pnginfo=info)


def _save_npy(name: str, image: Float32, exposure: float, notes: Mapping[str, str]) -> None:  # noqa: ARG001
    with open(name, "wb") as file:  # noqa: PTH123  # by handle: np.save adds .npy to names
        np.save(file, image, allow_pickle=False)
