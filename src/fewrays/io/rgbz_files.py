"""Depth in a file of its own: ``.exr``, ``.npy``, or ``.png`` of 16 bits."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image

from fewrays.errors import SampleError
from fewrays.io.files import check_deflate_ratio, open_file, read_exactly
from fewrays.io.npy_header import read_array, read_header
from fewrays.io.rgbz_channels import DepthKind, find_depth
from fewrays.io.rgbz_exr import open_flat
from fewrays.samples import MAX_IMAGE_SIZE

__all__ = ["DEPTH_SUFFIXES", "load_depth"]

DEPTH_SUFFIXES = (".exr", ".npy", ".png")
_SIGNATURE = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"


def load_depth(path: Path, channel: str | None = None) -> tuple[npt.NDArray[Any], DepthKind]:
    """Read a depth map as it is stored.

    Parameters
    ----------
    path : Path
        ``.exr`` (its only channel, or found as `fewrays.io.rgbz_channels.find_depth` does), ``.npy`` of shape
        (H, W), or grey ``.png`` of 16 bits, whose values 0 to 65535 want a scale.
    channel : str, optional
        The channel of an ``.exr``.

    Returns
    -------
    values : ndarray, (H, W)
    kind : {"planar", "distance", "inverse"}
        What the channel's name says.

    Raises
    ------
    SampleError
        For another kind of file, or a damaged one.
    """
    loaders = {".exr": _load_exr, ".npy": _load_npy, ".png": _load_png}
    loader = loaders.get(path.suffix.lower())
    if loader is None:
        raise SampleError(f"depth comes as {', '.join(DEPTH_SUFFIXES)}", file=path)
    try:
        return loader(path, channel)
    except SampleError as error:
        raise (error if error.file else error.in_file(path)) from None


def _load_exr(path: Path, channel: str | None) -> tuple[npt.NDArray[Any], DepthKind]:
    flat = open_flat(path)
    names = list(flat.channels)
    if channel is None and len(names) == 1:
        return flat.read(names)[0], "planar"
    if channel is None and {name.upper() for name in names} in ({"R", "G", "B"}, {"R", "G", "B", "A"}):
        channel = "R"  # depth written as a grey picture
    found = find_depth(names, channel)
    return flat.read([found.name])[0], found.kind


def _load_npy(path: Path, channel: str | None) -> tuple[npt.NDArray[Any], DepthKind]:  # noqa: ARG001
    with open_file(path) as (file, length):
        header = read_header(file, "depth")
        if header.dtype.kind not in "fiu" or len(header.shape) != 2:
            raise SampleError(
                f"expected real numbers of shape (H, W), got {header.dtype} of {header.shape}", field="depth"
            )
        if header.nbytes != length - header.length:
            raise SampleError(
                f"shape {header.shape} of {header.dtype} takes {header.nbytes} bytes, the file has "
                f"{length - header.length}",
                field="depth",
            )
        return read_array(file, header, "depth"), "planar"


def _load_png(path: Path, channel: str | None) -> tuple[npt.NDArray[Any], DepthKind]:  # noqa: ARG001
    with open_file(path) as (file, length):
        head = read_exactly(file, len(_SIGNATURE) + 10, "PNG header")
        if head[: len(_SIGNATURE)] != _SIGNATURE:
            raise SampleError("is not a PNG file")
        width, height, bits, color_type = struct.unpack_from(">IIBB", head, len(_SIGNATURE))
        if (bits, color_type) != (16, 0):
            raise SampleError(
                f"expected grey of 16 bits, got {bits} bits (colour type {color_type}): 8 bits are too few "
                "for depth",
                field="IHDR",
            )
        if not (1 <= width <= MAX_IMAGE_SIZE and 1 <= height <= MAX_IMAGE_SIZE):
            raise SampleError(f"{width} x {height} pixels; the cap is {MAX_IMAGE_SIZE} a side", field="IHDR")
        check_deflate_ratio(width * height * 2, length, "IHDR")
        file.seek(0)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)  # checked above
                with PIL.Image.open(file, formats=["PNG"]) as picture:
                    values = np.asarray(picture).astype(np.uint16)
        except Exception as error:  # whatever the decoder trips over in a damaged file
            raise SampleError(f"is not a readable PNG: {error or type(error).__name__}") from None
    return values, "planar"
