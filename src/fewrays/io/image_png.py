"""Images as PNG: 8 bit sRGB for looking at, with how they were made in text chunks."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
import PIL.Image
from PIL.PngImagePlugin import PngInfo

from fewrays.color import srgb_decode, srgb_encode
from fewrays.errors import SampleError
from fewrays.io.files import check_deflate_ratio, read_exactly
from fewrays.io.image_format import Image, ImageFormat
from fewrays.samples import MAX_IMAGE_SIZE

__all__ = ["FORMAT", "load", "save"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # values per pixel by colour type
_MOST_KEYWORD = 79  # PNG's own limit


def load(file: BinaryIO, length: int, path: Path) -> npt.NDArray[np.generic]:  # noqa: ARG001
    """Read an 8 bit PNG and decode it to linear light."""
    _check_head(read_exactly(file, len(_SIGNATURE) + 17, "PNG header"), length)
    _check_chunks(file, length)
    file.seek(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)  # the size is checked above
            with PIL.Image.open(file, formats=["PNG"]) as picture:
                pixels = np.asarray(picture.convert("RGBA"))
    except Exception as error:  # whatever the decoder trips over in a damaged file
        raise SampleError(f"is not a readable PNG: {error or type(error).__name__}") from None
    if (pixels[..., 3] != 255).any():
        raise SampleError("has transparent pixels; flatten it first", field="alpha")
    return srgb_decode(pixels[..., :3] / np.float32(255))


def save(path: Path, image: Image, exposure: float, provenance: Mapping[str, str]) -> None:
    """Write an 8 bit sRGB PNG."""
    if image.ndim != 3:
        raise SampleError("a PNG needs three channels; save maps as .exr or .npy", field="image")
    with np.errstate(over="ignore"):  # what overflows is brighter than white
        encoded = srgb_encode(image * np.float32(2.0) ** np.float32(exposure))
    notes = PngInfo()
    for name, value in provenance.items():
        if not (0 < len(name) <= _MOST_KEYWORD and name.isascii() and name.isprintable()):
            raise SampleError(
                f"expected 1 to {_MOST_KEYWORD} ASCII characters, got {name!r}", field="provenance"
            )
        notes.add_itxt(name, value)
    picture = PIL.Image.fromarray(np.rint(encoded * 255).astype(np.uint8))
    with path.open("wb") as file:
        picture.save(file, format="PNG", pnginfo=notes)


def _check_head(head: bytes, length: int) -> None:
    """Check the size that the header claims before the decoder allocates it."""
    if head[: len(_SIGNATURE)] != _SIGNATURE:
        raise SampleError("is not a PNG file")
    width, height, bits, color_type = struct.unpack_from(">IIBB", head, len(_SIGNATURE))
    if not (1 <= width <= MAX_IMAGE_SIZE and 1 <= height <= MAX_IMAGE_SIZE):
        raise SampleError(f"{width} x {height} pixels; the cap is {MAX_IMAGE_SIZE} a side", field="IHDR")
    if color_type not in _SAMPLES or bits > 8:
        raise SampleError(f"expected at most 8 bits, got {bits} (colour type {color_type})", field="IHDR")
    check_deflate_ratio(width * height * _SAMPLES[color_type] * bits // 8, length, "IHDR")


def _check_chunks(file: BinaryIO, length: int) -> None:
    """Raise unless every chunk is whole and its checksum right; the decoder does not look at all of them."""
    at = 8
    kind = b""
    while kind != b"IEND":
        file.seek(at)
        size, kind = struct.unpack(">I4s", read_exactly(file, 8, f"chunk at byte {at}"))
        if size > length - at - 12:
            raise SampleError(f"claims {size} bytes of {length}", field=f"chunk at byte {at}")
        data = read_exactly(file, size + 4, f"chunk at byte {at}")
        if zlib.crc32(kind + data[:-4]) != int.from_bytes(data[-4:], "big"):
            raise SampleError("its checksum is wrong: the file is damaged", field=f"chunk at byte {at}")
        at += size + 12


FORMAT = ImageFormat(".png", True, load, save)
