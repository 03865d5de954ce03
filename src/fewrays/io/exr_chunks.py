"""One chunk of a deep scan-line OpenEXR file: one line of pixels, packed and unpacked.

fewrays reads and writes these itself because the OpenEXR bindings make a NumPy object of every pixel and
channel (about ten times the memory of the samples) and trust the sizes in the file. A chunk holds the line
number, three sizes, the running sample counts of the line's pixels, and the samples, channel after channel.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.io.files import check_deflate_ratio, read_exactly

__all__ = ["DEEP_COMPRESSIONS", "DeepChunk", "pack_chunk", "read_chunk"]

DEEP_COMPRESSIONS = ("none", "rle", "zips")
"""The compressions of deep files, by their number."""

_HEAD = struct.Struct("<i3Q")
_LEVEL = 4  # of zlib, OpenEXR's own default


@dataclass(frozen=True)
class DeepChunk:
    """Where one line of pixels lies in the file, and how many samples each pixel has.

    Parameters
    ----------
    y : int
        Line number in the coordinates of the data window.
    counts : ndarray of int64, (W,)
        Samples of each pixel.
    start, packed, size : int
        Position of the samples in the file, their bytes there, and their bytes unpacked.
    """

    y: int
    counts: npt.NDArray[np.int64]
    start: int
    packed: int
    size: int

    def read(self, file: BinaryIO, compression: int) -> npt.NDArray[np.uint8]:
        """Return the unpacked bytes of the line's samples."""
        file.seek(self.start)
        return _unpack(read_exactly(file, self.packed, f"line {self.y}"), self.size, compression, self.y)


def read_chunk(
    file: BinaryIO, offset: int, length: int, width: int, sample_bytes: int, compression: int
) -> DeepChunk:
    """Read a chunk's head and sample counts, and check its sizes against each other and the file.

    Parameters
    ----------
    file : binary file
        The file, `length` bytes long.
    offset : int
        Where the chunk starts.
    width : int
        Pixels of the line.
    sample_bytes : int
        Bytes of one sample of every channel.
    compression : int
        Index into `DEEP_COMPRESSIONS`.

    Raises
    ------
    SampleError
        When the sizes disagree with each other or with the file's length.
    """
    file.seek(offset)
    y, table_bytes, packed, size = _HEAD.unpack(read_exactly(file, _HEAD.size, "chunk head"))
    line = f"line {y}"
    start = offset + _HEAD.size + table_bytes
    if start + packed > length:
        raise SampleError(
            f"takes {table_bytes} + {packed} bytes, past the file's end at {length}", field=line
        )
    check_deflate_ratio(4 * width, table_bytes, line)
    check_deflate_ratio(size, packed, line)
    table = _unpack(read_exactly(file, table_bytes, line), 4 * width, compression, y)
    running = table.view("<i4").astype(np.int64)
    counts = running - np.concatenate([[0], running[:-1]])
    if counts.min() < 0:
        raise SampleError("the running sample counts fall", field=line)
    total = int(counts.sum())
    if total * sample_bytes != size:
        raise SampleError(f"{total} samples of {sample_bytes} bytes do not take {size} bytes", field=line)
    return DeepChunk(y, counts, start, packed, size)


def pack_chunk(y: int, counts: npt.NDArray[np.int64], data: bytes, compression: int) -> bytes:
    """Return the bytes of a chunk: the inverse of `read_chunk` and `DeepChunk.read`."""
    table = _pack(np.cumsum(counts).astype("<i4").tobytes(), compression)
    packed = _pack(data, compression)
    return _HEAD.pack(y, len(table), len(packed), len(data)) + table + packed


def _pack(data: bytes, compression: int) -> bytes:
    if compression == DEEP_COMPRESSIONS.index("none"):
        return data
    raw = np.frombuffer(data, np.uint8)
    split = np.concatenate([raw[0::2], raw[1::2]])
    # Differences are stored around 128; a line's first byte is stored as it is.
    split[1:] = np.diff(split) + np.uint8(128)
    packed = zlib.compress(split.tobytes(), _LEVEL)
    return packed if len(packed) < len(data) else data  # what does not shrink is stored as it is


def _unpack(packed: bytes, size: int, compression: int, y: int) -> npt.NDArray[np.uint8]:
    if len(packed) == size:  # stored as it is
        return np.frombuffer(packed, np.uint8)
    if compression == DEEP_COMPRESSIONS.index("none") or len(packed) > size:
        raise SampleError(f"stores {len(packed)} bytes for {size}", field=f"line {y}")
    plain = (
        _inflate(packed, size)
        if compression == DEEP_COMPRESSIONS.index("zips")
        else _run_lengths(packed, size)
    )
    if len(plain) != size:
        raise SampleError(f"its compressed data is damaged: {len(plain)} bytes of {size}", field=f"line {y}")
    split = np.frombuffer(plain, np.uint8)
    split = np.cumsum(split, dtype=np.uint8) - (np.arange(size) * 128).astype(np.uint8)
    result = np.empty(size, np.uint8)
    result[0::2], result[1::2] = split[: (size + 1) // 2], split[(size + 1) // 2 :]
    return result


def _inflate(packed: bytes, size: int) -> bytes:
    """Return at most ``size + 1`` bytes; fewer when the stream is damaged."""
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(packed, size + 1)
    except zlib.error:
        return b""
    return plain if stream.eof else b""


def _run_lengths(packed: bytes, size: int) -> bytes:
    """Undo OpenEXR's run-length code: -n starts n literal bytes, n repeats the next byte n + 1 times."""
    plain = bytearray()
    at = 0
    while at < len(packed) and len(plain) <= size:
        code = packed[at]
        if code >= 128:
            plain += packed[at + 1 : at + 257 - code]
            at += 257 - code
        else:
            plain += packed[at + 1 : at + 2] * (code + 1)
            at += 2
    return bytes(plain)
