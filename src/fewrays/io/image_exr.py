"""Flat images as OpenEXR: float32, linear, with how they were made in the header."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
import OpenEXR

from fewrays.errors import SampleError
from fewrays.io.exr_header import LINES_PER_CHUNK, ExrHeader, read_header, read_offsets
from fewrays.io.files import read_exactly
from fewrays.io.image_format import Image, ImageFormat

__all__ = ["FORMAT", "load", "save"]

_MOST_NAME = 255 - len("fewrays/")


def load(file: BinaryIO, length: int, path: Path) -> npt.NDArray[np.generic]:
    """Read the R, G, B channels, or the only channel, of a flat OpenEXR file.

    The structure is checked first: the library answers damage with 0 parts, or with what the header claims.
    """
    header = read_header(file, length)
    if header.deep:
        raise SampleError("holds deep samples; fewrays.load reads them", field="type")
    names = _wanted(header)
    _check_chunks(file, header, length)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as image:
            planes = [np.array(image.channels()[name].pixels, np.float32) for name in names]
    except Exception as error:  # whatever the library trips over in a damaged file
        raise SampleError(f"is not a readable OpenEXR file: {error or type(error).__name__}") from None
    if any(plane.shape != (header.height, header.width) for plane in planes):
        raise SampleError(f"expected {header.width} x {header.height} pixels", field="dataWindow")
    return np.stack(planes, axis=-1) if len(planes) > 1 else planes[0]


def save(path: Path, image: Image, exposure: float, provenance: Mapping[str, str]) -> None:  # noqa: ARG001
    """Write R, G, B, or Y for a map, with ZIP compression, which is lossless."""
    header: dict[str, object] = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    for name, value in provenance.items():
        if not 0 < len(name.encode()) <= _MOST_NAME or "\0" in name + value:
            raise SampleError(
                f"expected 1 to {_MOST_NAME} bytes without NUL, got {name!r}", field="provenance"
            )
        header[f"fewrays/{name}"] = value
    channels = {"RGB": image} if image.ndim == 3 else {"Y": image}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise SampleError(f"cannot be written: {error}") from None


def _wanted(header: ExrHeader) -> tuple[str, ...]:
    names = [channel.name for channel in header.channels]
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B")
    if len(names) == 1:
        return (names[0],)
    missing = next(name for name in "RGB" if name not in names)
    raise SampleError(f"is missing; the file has {', '.join(names)}", field=f"channel {missing}")


def _check_chunks(file: BinaryIO, header: ExrHeader, length: int) -> None:
    """Raise unless every chunk of the image lies inside the file."""
    if header.tile is not None:
        width, height = header.tile
        count = -(-header.width // width) * -(-header.height // height)
        layout = struct.Struct("<5i")
    else:
        count = -(-header.height // LINES_PER_CHUNK[header.compression])
        layout = struct.Struct("<2i")
    for index, offset in enumerate(read_offsets(file, header, length, count)):
        file.seek(offset)
        size = layout.unpack(read_exactly(file, layout.size, f"chunk {index}"))[-1]
        if not 0 <= size <= length - offset - layout.size:
            raise SampleError(f"claims {size} bytes at {offset} of {length}", field=f"chunk {index}")


FORMAT = ImageFormat(".exr", False, load, save)
