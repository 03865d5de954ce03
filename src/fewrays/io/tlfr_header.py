"""The header of the 2011 sample buffer format, version 1.3.

    Version 1.3
    Width 962
    Height 543
    Samples per pixel 16
    Motion model: perspective
    CoC coefficients (coc radius = C0/w+C1): -15.242497,19.053122
    Encoding = text
    x,y,z/w,w,u,v,t,r,g,b,a,mv_x,mv_y,mv_w,dwdx,dwdy

Some public writers leave the motion model out, or the encoding: they mean perspective and text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, cast

from fewrays.errors import SampleError
from fewrays.io.formats import check_size

__all__ = ["COLUMNS", "MAX_HEADER_BYTES", "Header", "parse_header"]

COLUMNS = ("x", "y", "z/w", "w", "u", "v", "t", "r", "g", "b", "a", "mv_x", "mv_y", "mv_w", "dwdx", "dwdy")
"""The 16 float32 of a sample, in the order of the file."""

MAX_HEADER_BYTES = 4096
"""Longest header that is read: eight short lines."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_COC = "CoC coefficients (coc radius = C0/w+C1)"


@dataclass(frozen=True)
class Header:
    """What the header says.

    Parameters
    ----------
    width, height : int
        Image size in pixels.
    spp : int
        Samples per pixel.
    c0, c1 : float
        Slope coefficients, as in `fewrays.Lens`.
    motion_model : {"perspective", "affine"}
        What mv_x, mv_y and mv_w mean; see `fewrays.io.tlfr`.
    encoding : {"text", "binary"}
        How the samples are stored.
    """

    width: int
    height: int
    spp: int
    c0: float
    c1: float
    motion_model: Literal["perspective", "affine"] = "perspective"
    encoding: Literal["text", "binary"] = "binary"

    @property
    def count(self) -> int:
        """Number of samples in the file."""
        return self.width * self.height * self.spp

    def format(self) -> str:
        """Return the header's text. Coefficients are written so that they read back exactly."""
        return (
            f"Version 1.3\nWidth {self.width}\nHeight {self.height}\nSamples per pixel {self.spp}\n"
            f"Motion model: {self.motion_model}\n{_COC}: {self.c0!r},{self.c1!r}\n"
            f"Encoding = {self.encoding}\n{','.join(COLUMNS)}\n"
        )


def parse_header(text: str) -> Header:
    """Read a header.

    Parameters
    ----------
    text : str
        The header's lines; what follows the column list is ignored.

    Returns
    -------
    Header

    Raises
    ------
    SampleError
        Naming the line and its value: another version, a missing line, sizes that are not positive or over
        the caps, another order of columns.
    """
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    version = _take(lines, "Version", r"Version\s+(\S+)")[0]
    if version != "1.3":
        raise SampleError(
            f"expected 1.3, got {version!r}; other versions hold other columns", field="Version"
        )
    width = int(_take(lines, "Width", r"Width\s+(\d{1,9})")[0])
    height = int(_take(lines, "Height", r"Height\s+(\d{1,9})")[0])
    spp = int(_take(lines, "Samples per pixel", r"Samples per pixel\s+(\d{1,9})")[0])
    check_size(height, width, spp, "Width, Height, Samples per pixel")
    model = _choice(lines, "Motion model", r"Motion model:\s*(\S+)", ("perspective", "affine"))
    pattern = rf"{re.escape(_COC)}:\s*({_NUMBER})\s*,\s*({_NUMBER})"
    c0, c1 = _take(lines, "CoC coefficients", pattern)
    encoding = _choice(lines, "Encoding", r"Encoding\s*=\s*(\S+)", ("text", "binary"))
    _check_columns(lines)
    return Header(
        width,
        height,
        spp,
        float(c0),
        float(c1),
        cast('Literal["perspective", "affine"]', model),
        cast('Literal["text", "binary"]', encoding),
    )


def _take(lines: list[str], name: str, pattern: str) -> tuple[str, ...]:
    """Remove the next line, which must match `pattern`, and return the pattern's groups."""
    line = lines.pop(0) if lines else ""
    match = re.fullmatch(pattern, line, re.ASCII)
    if match is None:
        raise SampleError(f"expected this header line next, got {line[:80]!r}", field=name)
    return match.groups()


def _choice(lines: list[str], name: str, pattern: str, choices: tuple[str, ...]) -> str:
    """Take an optional line; its first choice when the line is absent."""
    if not (lines and lines[0].startswith(name)):
        return choices[0]
    value = _take(lines, name, pattern)[0]
    if value not in choices:
        raise SampleError(f"expected {' or '.join(choices)}, got {value[:80]!r}", field=name)
    return value


def _check_columns(lines: list[str]) -> None:
    listed = lines[0] if lines else ""
    names = [name.strip() for name in listed.replace("dw/dx", "dwdx").replace("dw/dy", "dwdy").split(",")]
    if names != list(COLUMNS):
        raise SampleError(f"expected {','.join(COLUMNS)}, got {listed[:120]!r}", field="columns")
