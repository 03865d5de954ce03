"""Flat OpenEXR files of any renderer: all channels of all parts, by name.

The official bindings decode; sizes are compared with the file's length first, and the parts that came back
with those that the header lists, because a file that was cut short is read without complaint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from fewrays.errors import SampleError
from fewrays.io.files import MAX_DEFLATE_RATIO, open_file
from fewrays.samples import MAX_IMAGE_SIZE

__all__ = ["FlatExr", "Window", "is_deep", "open_flat"]

_DEEP_FLAG = 0x800
_SLACK = 1 << 20  # bytes that a tiny file may claim whatever its length


@dataclass(frozen=True)
class Window:
    """Where the stored pixels lie in the picture that the camera took.

    Parameters
    ----------
    width, height : int
        Of the stored pixels (data window).
    full_width : int
        Width of the whole picture (display window), which the angle of view spans.
    centre : (float, float)
        Where the optical axis meets the stored pixels, x and y; outside of them in a crop at the side.
    """

    width: int
    height: int
    full_width: int
    centre: tuple[float, float]

    @classmethod
    def of_boxes(cls, data: Sequence[Sequence[int]], display: Sequence[Sequence[int]]) -> Window:
        """Return the window of OpenEXR's boxes, each of the first and the last pixel."""
        (x0, y0), (x1, y1) = data
        (left, top), (right, bottom) = display
        centre = ((left + right + 1) / 2 - x0, (top + bottom + 1) / 2 - y0)
        return cls(int(x1 - x0 + 1), int(y1 - y0 + 1), int(right - left + 1), centre)

    @classmethod
    def whole(cls, width: int, height: int) -> Window:
        """Return the window of a picture that is stored in full."""
        return cls(width, height, width, (width / 2, height / 2))

    def check(self) -> None:
        """Raise a `SampleError` for a size out of range."""
        if not (1 <= self.width <= MAX_IMAGE_SIZE and 1 <= self.height <= MAX_IMAGE_SIZE):
            raise SampleError(
                f"{self.width} x {self.height} pixels; the cap is {MAX_IMAGE_SIZE} a side", field="dataWindow"
            )
        if not 1 <= self.full_width <= MAX_IMAGE_SIZE:
            raise SampleError(f"{self.full_width} pixels wide", field="displayWindow")


@dataclass(frozen=True)
class FlatExr:
    """What a flat file holds.

    Parameters
    ----------
    path : Path
        The file.
    channels : mapping of str to (int, str)
        Part number and name in it of every channel, by the name with its layer: where a file has several
        parts, their names are layers.
    windows : tuple of Window
        One for each part.
    numbers : mapping of str to float
        Attributes of the first part that are numbers.
    """

    path: Path
    channels: Mapping[str, tuple[int, str]]
    windows: tuple[Window, ...]
    numbers: Mapping[str, float]

    def read(self, names: Sequence[str]) -> list[npt.NDArray[Any]]:
        """Return the pixels ``(H, W)`` of channels, as they are stored.

        Raises
        ------
        SampleError
            For a damaged file.
        """
        try:
            with OpenEXR.File(str(self.path), separate_channels=True) as file:
                parts = [part.channels for part in file.parts]
                planes = [
                    np.array(parts[part][name].pixels)
                    for part, name in (self.channels[full] for full in names)
                ]
        except Exception as error:  # whatever the library trips over in a damaged file
            raise SampleError(
                f"is damaged or was cut short: {error or type(error).__name__}", file=self.path
            ) from None
        for name, plane in zip(names, planes, strict=True):
            window = self.window(name)
            if plane.shape != (window.height, window.width):
                raise SampleError(
                    f"expected {window.width} x {window.height} pixels, got shape {plane.shape}",
                    file=self.path,
                    field=f"channel {name}",
                )
        return planes

    def window(self, name: str) -> Window:
        """Return the window of a channel."""
        return self.windows[self.channels[name][0]]


def is_deep(path: Path) -> bool:
    """Tell whether an OpenEXR file holds deep samples, by the version field."""
    with open_file(path) as (file, _):
        head = file.read(8)
    return len(head) == 8 and bool(int.from_bytes(head[4:], "little") & _DEEP_FLAG)


def open_flat(path: Path) -> FlatExr:
    """Read the headers of a flat OpenEXR file.

    Raises
    ------
    SampleError
        For a file that is none, or claims more pixels than a file of its length can hold.
    """
    with open_file(path) as (_, length):
        headers = _headers(path)
        windows = tuple(_window(header) for header, _ in headers)
        size = sum(
            w.width * w.height * 2 * len(names) for w, (_, names) in zip(windows, headers, strict=True)
        )
        if size > length * MAX_DEFLATE_RATIO + _SLACK:
            raise SampleError(
                f"claims {size} bytes of pixels, more than a file of {length} bytes can hold",
                field="dataWindow",
            )
    channels = {
        _full_name(header, name, len(headers)): (number, name)
        for number, (header, names) in enumerate(headers)
        for name in names
    }
    numbers = {
        name: float(value)
        for name, value in headers[0][0].items()
        if isinstance(value, (int, float)) and math.isfinite(value)
    }
    return FlatExr(path, channels, windows, numbers)


def _headers(path: Path) -> list[tuple[dict[str, Any], list[str]]]:
    """Return each part's header and the names of its channels."""
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            headers = [
                (dict(part.header), [channel.name for channel in part.header["channels"]])
                for part in file.parts
            ]
    except Exception as error:  # whatever the library trips over in a damaged file
        raise SampleError(f"is not a readable OpenEXR file: {error or type(error).__name__}") from None
    if not headers:
        raise SampleError("holds no image")
    return headers


def _window(header: Mapping[str, Any]) -> Window:
    window = Window.of_boxes(header["dataWindow"], header["displayWindow"])
    window.check()
    return window


def _full_name(header: Mapping[str, Any], channel: str, parts: int) -> str:
    """Return a channel's name with its layer, which several writers leave to the name of the part."""
    part = str(header.get("name", ""))
    if parts == 1 or not part or channel.lower().startswith(f"{part.lower()}."):
        return channel
    return f"{part}.{channel}"
