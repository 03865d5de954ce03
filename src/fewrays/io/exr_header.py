"""Reading and writing OpenEXR headers within stated bounds.

The OpenEXR library answers a damaged file with 0 parts or with allocations that its header merely claims.
So the header is read here first, and its sizes are compared with the file's length before anything else
happens. Only what fewrays uses is understood: one part, scan lines or tiles, flat or deep.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO

from fewrays.errors import SampleError
from fewrays.io.files import MAX_DEFLATE_RATIO, read_exactly
from fewrays.samples import MAX_IMAGE_SIZE

__all__ = [
    "COMPRESSIONS",
    "LINES_PER_CHUNK",
    "Channel",
    "ExrHeader",
    "format_header",
    "read_header",
    "read_offsets",
]

_MAGIC = b"\x76\x2f\x31\x01"
_TILED, _LONG_NAMES, _DEEP, _MULTIPART = 0x200, 0x400, 0x800, 0x1000
_MAX_HEADER_BYTES = 1 << 20
_SLACK = 1 << 20  # bytes that a tiny file may claim whatever its length

COMPRESSIONS = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")
"""Compression by its number in the file."""

LINES_PER_CHUNK = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)
"""Scan lines in one chunk of a flat image, by compression."""

_PIXEL_BYTES = (4, 2, 4)  # uint, half, float


@dataclass(frozen=True)
class Channel:
    """One entry of the channel list; `dtype` as NumPy writes it."""

    name: str
    dtype: str

    @property
    def itemsize(self) -> int:
        """Bytes of one value."""
        return int(self.dtype[-1])


@dataclass(frozen=True)
class ExrHeader:
    """What fewrays needs of a header.

    Parameters
    ----------
    deep : bool
        Whether the only part is deep.
    tile : tuple of int or None
        Width and height of its tiles; None for scan lines.
    origin : tuple of int
        (x, y) of the data window's first pixel.
    width, height : int
        Size of the data window, within the cap of `fewrays.samples`.
    channels : tuple of Channel
        In the order of the file.
    compression : int
        Index into `COMPRESSIONS`.
    attributes : mapping of str to int, float or str
        The attributes of these types.
    """

    deep: bool
    tile: tuple[int, int] | None
    origin: tuple[int, int]
    width: int
    height: int
    channels: tuple[Channel, ...]
    compression: int
    attributes: Mapping[str, int | float | str]

    @property
    def sample_bytes(self) -> int:
        """Bytes of one sample of every channel."""
        return sum(channel.itemsize for channel in self.channels)


def read_header(file: BinaryIO, length: int) -> ExrHeader:
    """Read the header and leave `file` where the offset table starts.

    Parameters
    ----------
    file : binary file
        At its start.
    length : int
        Length of the file in bytes.

    Raises
    ------
    SampleError
        Naming the attribute that is missing, malformed or over its cap.
    """
    data = file.read(min(length, _MAX_HEADER_BYTES))
    if data[:4] != _MAGIC:
        raise SampleError(f"is not an OpenEXR file: it starts with {data[:4]!r}")
    if len(data) < 8:
        raise SampleError(f"ends after {len(data)} bytes", field="version")
    version = struct.unpack_from("<I", data, 4)[0]
    if version & 0xFF != 2 or version & ~(0xFF | _TILED | _LONG_NAMES | _DEEP | _MULTIPART):
        raise SampleError(f"expected OpenEXR version 2, got {version:#x}", field="version")
    if version & _MULTIPART:
        raise SampleError(
            "holds several parts; save the one that you want to a file of its own", field="version"
        )
    raw, end = _split_attributes(data)
    file.seek(end)
    return _understand(raw, deep=bool(version & _DEEP), tiled=bool(version & _TILED))


def _split_attributes(data: bytes) -> tuple[dict[str, tuple[str, bytes]], int]:
    """Return the attributes as ``{name: (type, value)}`` and where the header ends."""
    attributes: dict[str, tuple[str, bytes]] = {}
    at = 8
    while True:
        name, at = _read_name(data, at, "attribute name")
        if not name:
            return attributes, at
        kind, at = _read_name(data, at, f"type of {name}")
        if at + 4 > len(data):
            raise SampleError("the header ends too early", field=name)
        size = struct.unpack_from("<i", data, at)[0]
        at += 4
        if not 0 <= size <= len(data) - at:
            raise SampleError(
                f"claims {size} bytes; the header has at most {len(data) - at} left", field=name
            )
        if name in attributes:
            raise SampleError("occurs twice", field=name)
        attributes[name] = (kind, data[at : at + size])
        at += size


def _read_name(data: bytes, at: int, what: str) -> tuple[str, int]:
    end = data.find(b"\0", at, at + 256)
    if end < 0:
        raise SampleError("the header ends too early, or holds a name of over 255 bytes", field=what)
    name = _text(data[at:end], what)
    if not name.isprintable():
        raise SampleError(f"{name!r} is not a name", field=what)
    return name, end + 1


def _text(data: bytes, what: str) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise SampleError(f"{data[:40]!r} is not text", field=what) from None


def _understand(raw: dict[str, tuple[str, bytes]], *, deep: bool, tiled: bool) -> ExrHeader:
    x0, y0, x1, y1 = _fixed(raw, "dataWindow", "box2i", "<4i")
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if not (1 <= width <= MAX_IMAGE_SIZE and 1 <= height <= MAX_IMAGE_SIZE):
        raise SampleError(
            f"{width} x {height} pixels; the cap is {MAX_IMAGE_SIZE} a side", field="dataWindow"
        )
    (compression,) = _fixed(raw, "compression", "compression", "<B")
    if compression >= len(COMPRESSIONS):
        raise SampleError(
            f"number {compression} is not supported; save with ZIP or ZIPS", field="compression"
        )
    attributes = {name: value for name in raw if (value := _value(raw, name)) is not None}
    kind = attributes.get("type")
    if deep and (tiled or kind != "deepscanline"):
        raise SampleError(f"expected 'deepscanline', got {kind!r}; save as scan lines", field="type")
    if not deep and kind not in (None, "scanlineimage", "tiledimage"):
        raise SampleError(f"{kind!r} contradicts the version field, which says flat", field="type")
    if not deep and kind is not None and (kind == "tiledimage") != tiled:
        raise SampleError(f"{kind!r} contradicts the version field", field="type")
    return ExrHeader(
        deep, _tile(raw) if tiled else None, (x0, y0), width, height, _channels(raw), compression, attributes
    )


def _fixed(raw: dict[str, tuple[str, bytes]], name: str, kind: str, layout: str) -> tuple[int, ...]:
    if name not in raw:
        raise SampleError("is missing from the header", field=name)
    found, value = raw[name]
    if found != kind or len(value) != struct.calcsize(layout):
        raise SampleError(f"expected a {kind}, got {len(value)} bytes of {found!r}", field=name)
    return struct.unpack(layout, value)


def _value(raw: dict[str, tuple[str, bytes]], name: str) -> int | float | str | None:
    """Return an attribute as a number or text, or None for other types."""
    kind, value = raw[name]
    layouts = {"int": "<i", "float": "<f", "double": "<d"}
    if kind == "string":
        return _text(value, name)
    if kind not in layouts:
        return None
    if len(value) != struct.calcsize(layouts[kind]):
        raise SampleError(f"expected a {kind}, got {len(value)} bytes", field=name)
    number: int | float = struct.unpack(layouts[kind], value)[0]
    return number


def _tile(raw: dict[str, tuple[str, bytes]]) -> tuple[int, int]:
    width, height, mode = _fixed(raw, "tiles", "tiledesc", "<IIB")
    if mode != 0:
        raise SampleError("holds a mip map; save a single level", field="tiles")
    if not (1 <= width <= 4096 and 1 <= height <= 4096):
        raise SampleError(f"{width} x {height} pixels; the cap is 4096 a side", field="tiles")
    return width, height


def _channels(raw: dict[str, tuple[str, bytes]]) -> tuple[Channel, ...]:
    if "channels" not in raw:
        raise SampleError("is missing from the header", field="channels")
    kind, data = raw["channels"]
    if kind != "chlist":
        raise SampleError(f"expected a chlist, got {kind!r}", field="channels")
    channels: list[Channel] = []
    at = 0
    while at < len(data) - 1:
        name, at = _read_name(data, at, "channels")
        if at + 16 > len(data):
            raise SampleError(f"the list ends inside {name!r}", field="channels")
        pixel_type, _, x_sampling, y_sampling = struct.unpack_from("<iIii", data, at)
        at += 16
        if not 0 <= pixel_type < len(_PIXEL_BYTES):
            raise SampleError(f"unknown pixel type {pixel_type}", field=f"channel {name}")
        if (x_sampling, y_sampling) != (1, 1):
            raise SampleError(f"is subsampled by {x_sampling} x {y_sampling}", field=f"channel {name}")
        channels.append(Channel(name, ("<u4", "<f2", "<f4")[pixel_type]))
    if not channels or data[at:] != b"\0" or len({channel.name for channel in channels}) != len(channels):
        raise SampleError("the list is empty, has no end or names a channel twice", field="channels")
    return tuple(channels)


def read_offsets(file: BinaryIO, header: ExrHeader, length: int, count: int) -> tuple[int, ...]:
    """Read the table of `count` chunk offsets that follows the header.

    Raises
    ------
    SampleError
        When the file is too short for the table, an offset lies outside the file (as in a file whose writer
        was interrupted), or the image is larger than a file of this length can hold.
    """
    size = header.width * header.height * header.sample_bytes
    if not header.deep and size > length * MAX_DEFLATE_RATIO + _SLACK:
        raise SampleError(
            f"{header.width} x {header.height} pixels take {size} bytes, "
            f"more than a file of {length} bytes can hold",
            field="dataWindow",
        )
    if count * 8 > length - file.tell():
        raise SampleError(f"claims {count} chunks; the file has {length} bytes", field="chunk table")
    offsets = struct.unpack(f"<{count}Q", read_exactly(file, 8 * count, "chunk table"))
    first = file.tell()
    for index, offset in enumerate(offsets):
        if not first <= offset < length:
            raise SampleError(
                f"chunk {index} lies at byte {offset} of {length}: the file was cut or never finished",
                field="chunk table",
            )
    return offsets


def format_header(header: ExrHeader) -> bytes:
    """Return the bytes of the header of a deep scan-line part.

    The data window starts at 0. Attributes become ``int``, ``string``, and ``double`` when their name has a
    prefix (``fewrays/c0``) but ``float`` when it is one of OpenEXR's own (``focus``).
    """
    window = struct.pack("<4i", 0, 0, header.width - 1, header.height - 1)
    channels = b"".join(
        channel.name.encode()
        + b"\0"
        + struct.pack("<iIii", ("<u4", "<f2", "<f4").index(channel.dtype), 0, 1, 1)
        for channel in header.channels
    )
    standard = {
        "channels": ("chlist", channels + b"\0"),
        "chunkCount": ("int", struct.pack("<i", header.height)),
        "compression": ("compression", struct.pack("<B", header.compression)),
        "dataWindow": ("box2i", window),
        "displayWindow": ("box2i", window),
        "lineOrder": ("lineOrder", b"\0"),
        "pixelAspectRatio": ("float", struct.pack("<f", 1)),
        "screenWindowCenter": ("v2f", struct.pack("<2f", 0, 0)),
        "screenWindowWidth": ("float", struct.pack("<f", 1)),
        "type": ("string", b"deepscanline"),
        "version": ("int", struct.pack("<i", 1)),
    }
    extra = {name: _encode(name, value) for name, value in header.attributes.items()}
    body = b"".join(
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
        for name, (kind, value) in sorted((standard | extra).items())
    )
    return _MAGIC + struct.pack("<I", 2 | _DEEP) + body + b"\0"


def _encode(name: str, value: int | float | str) -> tuple[str, bytes]:
    if isinstance(value, str):
        return "string", value.encode()
    if isinstance(value, int):
        return "int", struct.pack("<i", value)
    # Attributes that OpenEXR itself defines are float; ours are double, so that coefficients stay exact.
    return ("double", struct.pack("<d", value)) if "/" in name else ("float", struct.pack("<f", value))
