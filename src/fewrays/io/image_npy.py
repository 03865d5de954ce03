"""Images as ``.npy``: the array itself, float32."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.io.image_format import Image, ImageFormat
from fewrays.io.npy_header import read_array, read_header

__all__ = ["FORMAT", "load", "save"]


def load(file: BinaryIO, length: int, path: Path) -> npt.NDArray[np.generic]:  # noqa: ARG001
    """Read a ``.npy`` file of real numbers; never unpickles."""
    header = read_header(file, "image")
    if header.dtype.kind not in "fiub":
        raise SampleError(f"expected real numbers, got dtype {header.dtype}", field="image")
    if header.nbytes != length - header.length:
        raise SampleError(
            f"shape {header.shape} of {header.dtype} takes {header.nbytes} bytes, the file has "
            f"{length - header.length}",
            field="image",
        )
    return read_array(file, header, "image")


def save(path: Path, image: Image, exposure: float, provenance: Mapping[str, str]) -> None:  # noqa: ARG001
    """Write a ``.npy`` file."""
    with path.open("wb") as file:
        np.save(file, image, allow_pickle=False)


FORMAT = ImageFormat(".npy", False, load, save)
