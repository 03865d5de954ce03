"""The file of planes, ``.planes``: a short description in JSON, and tables and blocks in one zlib stream.

::

    16 bytes  "FEWRAYS-PLANES", carriage return, line feed
    uint32    version, 2
    uint32    length of the description in bytes
    JSON      {"height": …, "width": …, "lens": {…}, "planes": K}
    zlib      tables, then blocks

All numbers are little-endian. The tables are those of `Shear`, `Maps` and `Grid`, in the order of `_TABLES`,
and one bit for each place of a block, the first in the highest of a byte: whether there is one. So where
blocks lie takes no numbers that could be wrong.

Blocks come plane by plane in runs of at most 64. The half-precision numbers of a run are turned into others
that deflate better and lose nothing (`_encode`), and stored as all their upper bytes and then all their lower
ones:

- the cells in the order in which they lie in the image, as the difference modulo 2^16 from the one to the
  left, in the first column from the one above;
- the last column and row, which repeat those of the neighbouring blocks, as the difference from these.

On planes of foliage, 8 samples per pixel, the file has 0.47 of the size of the planes in memory. Deflating
the numbers as they are gives 0.71, in no less time. Level 6 takes half as much time again for 2 %.
"""

from __future__ import annotations

import dataclasses
import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from fewrays import _native
from fewrays.errors import SampleError, first_index
from fewrays.io.files import as_path, check_deflate_ratio, open_file, read_exactly, replace_files
from fewrays.io.formats import check_size
from fewrays.lens import Lens
from fewrays.multiplane.maps import BLOCK, Grid, Maps, Shear, number_blocks
from fewrays.parallel import progress_bar

__all__ = ["load_maps", "save_maps"]

Bools = npt.NDArray[np.bool_]
Bytes = npt.NDArray[np.uint8]
Float64 = npt.NDArray[np.float64]
Halves = npt.NDArray[np.uint16]
Indices = npt.NDArray[np.int32]

_MAGIC = b"FEWRAYS-PLANES\r\n"  # a transfer that changes line ends damages it
_VERSION = 2
_LEVEL = 4  # of zlib
_MOST_HEADER = 4096  # bytes
_MOST_PLANES = 2**15 - 1
_MOST_PLACES = 2**28  # for blocks
_FREE_PLACES = 2**20  # that a file of any length may have: 5 MB
_FARTHEST = 2.0**22  # pixels
_LARGEST_SCALE = 2.0**100  # sums of many planes stay finite
_RUN = 64  # blocks
_CHUNK = 2**16  # bytes of the file read at a time

_INFINITE = 0x7C00  # halves from here on are no numbers
_ONE = 0x3C00

_TABLES: dict[str, tuple[str, int]] = {
    "slope": ("<f8", 1),
    "motion": ("<f8", 2),
    "scale": ("<f8", 1),
    "cells": ("<i4", 1),
    "corner": ("<i4", 2),
    "shape": ("<i4", 2),
}
"""Type and columns of the tables, in the order of the file."""

_EDGES: tuple[tuple[Any, Any], ...] = (
    (np.s_[..., :-1, -1], np.s_[..., :-1, 0]),  # the last column: the first of the block to the right
    (np.s_[..., -1, :-1], np.s_[..., 0, :-1]),  # the last row: the first of the block below
    (np.s_[..., -1, -1], np.s_[..., 0, 0]),  # the last cell: the first of the block below that to the right
)
"""What of a block repeats others, and what of them it repeats."""


def save_maps(path: str | Path, maps: Maps, *, progress: bool = False) -> None:
    """Write planes to a file; see `Multiplane.save`.

    Needs little memory beside the planes.

    Parameters
    ----------
    path : str or Path
        The file; it appears complete or not at all.
    maps : Maps
        What to write.
    progress : bool
        Show a progress bar for work over two seconds.

    Raises
    ------
    SampleError
        When the planes exceed what `load_maps` accepts, or the file cannot be written.
    """
    _check_tables(maps.shear, maps.scale, maps.grid)
    kept = maps.slots >= 0
    with (
        replace_files(as_path(path)) as [temporary],
        temporary.open("wb") as file,
        progress_bar(maps.halves.nbytes, "save", show=progress, unit="B") as bar,
    ):
        file.write(_describe(maps))
        deflate = zlib.compressobj(_LEVEL)
        for name, (dtype, _) in _TABLES.items():
            owner = next(part for part in (maps.shear, maps, maps.grid) if hasattr(part, name))
            table = getattr(owner, name)
            file.write(deflate.compress(table.astype(dtype).tobytes()))
        file.write(deflate.compress(np.packbits(kept).tobytes()))
        for blocks, neighbours in _blocks_by_plane(maps.grid, kept, maps.halves):
            for first in range(0, len(blocks), _RUN):
                run = _encode(blocks, neighbours, slice(first, first + _RUN))
                file.write(deflate.compress(run.data))
                bar.update(run.nbytes)
        file.write(deflate.flush())


def load_maps(path: str | Path, *, progress: bool = False) -> Maps:
    """Read planes from a file; see `Multiplane.load`.

    Needs little memory beside the planes. What native code relies on is checked: it reads blocks where the
    tables say that they are.

    Parameters
    ----------
    path : str or Path
        The file.
    progress : bool
        Show a progress bar for work over two seconds.

    Returns
    -------
    Maps

    Raises
    ------
    SampleError
        For anything but a complete, consistent file of version 2. Sizes are compared with the length of the
        file and with these caps before anything is allocated: 65 536 pixels a side, 32 767 planes within
        2^22 pixels of the image, 2^28 places for blocks.
    """
    with open_file(as_path(path)) as (file, length):
        height, width, lens, planes = _read_description(file)
        stream = _Stream(file, length)
        shear, scale, grid = _read_tables(stream, planes)
        kept = _read_kept(stream, grid)
        slots, units = number_blocks(kept, grid)
        size = units * _native.UNIT_HALVES
        stream.check_claim(2 * size, "blocks")
        halves = np.zeros(size + 2 * _native.HALF_PADDING, np.uint16)
        with progress_bar(2 * size, "load", show=progress, unit="B") as bar:
            for blocks, neighbours in _blocks_by_plane(grid, kept, halves):
                _read_blocks(stream, blocks, neighbours, bar)
        stream.finish()
    return Maps(height, width, lens, shear, grid, slots, halves, scale)


# The description.


def _describe(maps: Maps) -> bytes:
    description = {
        "height": int(maps.height),
        "width": int(maps.width),
        "lens": dataclasses.asdict(maps.lens),
        "planes": maps.plane_count,
    }
    text = json.dumps(description).encode()
    return _MAGIC + struct.pack("<II", _VERSION, len(text)) + text


def _read_description(file: BinaryIO) -> tuple[int, int, Lens, int]:
    """Return height, width, lens and number of planes."""
    if file.read(len(_MAGIC)) != _MAGIC:
        raise SampleError("holds no planes: it does not begin like a .planes file")
    version, length = struct.unpack("<II", read_exactly(file, 8, "version"))
    if version != _VERSION:
        raise SampleError(f"expected {_VERSION}, got {version}; update fewrays?", field="version")
    if length > _MOST_HEADER:
        raise SampleError(f"claims {length} bytes; it has at most {_MOST_HEADER}", field="description")
    try:
        description = json.loads(read_exactly(file, length, "description"))
    except (ValueError, RecursionError) as error:
        problem = error.problem if isinstance(error, SampleError) else f"is no JSON: {error}"
        raise SampleError(problem, field="description") from None
    names = ("height", "width", "lens", "planes")
    if not isinstance(description, dict) or set(description) != set(names):
        raise SampleError(f"expected an object of {', '.join(names)}", field="description")
    height, width, planes = (_whole(description, name) for name in ("height", "width", "planes"))
    check_size(height, width, 1, "description")
    if not 1 <= planes <= _MOST_PLANES:
        raise SampleError(f"expected 1 to {_MOST_PLANES}, got {planes}", field="planes")
    return height, width, _lens_of(description["lens"]), planes


def _whole(description: dict[str, Any], name: str) -> int:
    value = description[name]
    if not isinstance(value, int) or isinstance(value, bool):
        raise SampleError(f"expected a whole number, got {value!r}", field=name)
    return value


def _lens_of(description: Any) -> Lens:
    names = [field.name for field in dataclasses.fields(Lens)]
    if not isinstance(description, dict) or set(description) != set(names):
        raise SampleError(f"expected an object of {', '.join(names)}", field="lens")
    return Lens(**description)


# The tables.


def _read_tables(stream: _Stream, planes: int) -> tuple[Shear, Float64, Grid]:
    stream.check_claim(sum(np.dtype(dtype).itemsize * n for dtype, n in _TABLES.values()) * planes, "planes")
    tables = {}
    for name, (dtype, columns) in _TABLES.items():
        data = stream.read(planes * columns * np.dtype(dtype).itemsize, name)
        table = data.view(dtype).astype(dtype.replace("<", "="))
        tables[name] = table if columns == 1 else table.reshape(planes, columns)
    shear, scale = Shear(tables["slope"], tables["motion"]), tables["scale"]
    grid = Grid(tables["cells"], tables["corner"], tables["shape"])
    _check_tables(shear, scale, grid)
    return shear, scale, grid


def _check_tables(shear: Shear, scale: Float64, grid: Grid) -> None:
    """Raise unless native code can compute with these numbers."""
    far = f"a number of pixels of at most {_FARTHEST:g} in size"
    _check("slope", shear.slope, np.abs(shear.slope) <= _FARTHEST, far)
    _check("slope", shear.slope, np.diff(shear.slope, prepend=-np.inf) >= 0, "one not below the one before")
    _check("motion", shear.motion, np.abs(shear.motion) <= _FARTHEST, far)
    _check("scale", scale, (scale > 0) & (scale <= _LARGEST_SCALE), "a positive number of at most 2^100")
    _check("cells", grid.cells, (grid.cells >= 1) & (grid.cells <= 3), "1, 2 or 3")
    _check("corner", grid.corner, np.abs(grid.corner.astype(np.int64)) <= _FARTHEST, far)
    most = _FARTHEST / np.array(BLOCK[::-1])
    _check("shape", grid.shape, (grid.shape >= 1) & (grid.shape <= most), f"1 to {most[0]:g} by {most[1]:g}")
    places = int(grid.shape.astype(np.int64).prod(axis=1).sum())
    if places > _MOST_PLACES:
        raise SampleError(f"planes have {places} places for blocks; at most {_MOST_PLACES}", field="shape")


def _check(name: str, values: npt.NDArray[Any], good: Bools, expected: str) -> None:
    if not good.all():
        index = first_index(~good)
        raise SampleError(f"expected {expected}, got {values[index]} at {list(index)}", field=name)


def _read_kept(stream: _Stream, grid: Grid) -> Bools:
    """Read for every place whether there is a block."""
    count = grid.slot_count
    size = -(-count // 8)
    stream.check_claim(size if count <= _FREE_PLACES else count, "kept")
    bits = np.unpackbits(stream.read(size, "kept"))
    if bits[count:].any():
        raise SampleError(f"says something of more than the {count} places for blocks", field="kept")
    return bits[:count].view(np.bool_)


# The blocks.


def _blocks_by_plane(grid: Grid, kept: Bools, halves: Halves) -> Iterator[tuple[Halves, list[Indices]]]:
    """Yield the blocks of each plane and their neighbours.

    Yields
    ------
    blocks : ndarray of uint16, (N, 4, cells², 9, 33)
        A view of `halves`.
    neighbours : list of 3 ndarrays of int, (N,)
        Which block lies to the right, below, and below that to the right; -1 for none.
    """
    begin = _native.HALF_PADDING
    for cells, first, (columns, rows) in zip(grid.cells, grid.first_slot, grid.shape, strict=True):
        own = kept[first : first + columns * rows].reshape(rows, columns)
        row, column = np.nonzero(own)
        number = np.full((rows + 1, columns + 1), -1, np.int32)
        number[row, column] = np.arange(len(row), dtype=np.int32)
        neighbours = [number[row, column + 1], number[row + 1, column], number[row + 1, column + 1]]
        end = begin + len(row) * int(cells) ** 2 * _native.UNIT_HALVES
        shape = (len(row), 4, int(cells) ** 2, BLOCK[0] + 1, BLOCK[1] + 1)
        yield halves[begin:end].reshape(shape), neighbours
        begin = end


def _encode(blocks: Halves, neighbours: list[Indices], part: slice) -> Bytes:
    """Change blocks into bytes that deflate well."""
    own = blocks[part]
    inner = _in_image_order(own[..., :-1, :-1])
    change = inner.copy()
    change[..., 1:] -= inner[..., :-1]
    change[..., 1:, 0] -= inner[..., :-1, 0]
    numbers = [change]
    for (edge, repeated), neighbour in zip(_EDGES, neighbours, strict=True):
        beside = neighbour[part]
        rest = own[edge].copy()
        rest[beside >= 0] -= blocks[repeated][beside[beside >= 0]]
        numbers.append(rest)
    flat = np.concatenate([array.reshape(-1) for array in numbers])
    return np.concatenate([flat >> 8, flat & 0xFF]).astype(np.uint8)


def _read_blocks(stream: _Stream, blocks: Halves, neighbours: list[Indices], bar: tqdm[Any]) -> None:
    """Read one plane's blocks: what `_encode` made of them, undone."""
    for first in range(0, len(blocks), _RUN):
        own = blocks[first : first + _RUN]
        upper, lower = stream.read(own.nbytes, "blocks").reshape(2, -1).astype(np.uint16)
        flat = upper << 8 | lower
        shapes = [_in_image_order(own[..., :-1, :-1]).shape, *(own[edge].shape for edge, _ in _EDGES)]
        ends = np.cumsum([np.prod(shape) for shape in shapes])[:-1]
        change, *rests = (part.reshape(n) for part, n in zip(np.split(flat, ends), shapes, strict=True))
        change[..., 0] = np.cumsum(change[..., 0], axis=-1, dtype=np.uint16)
        own[..., :-1, :-1] = _in_block_order(np.cumsum(change, axis=-1, dtype=np.uint16), own.shape[2])
        for (edge, _), rest in zip(_EDGES, rests, strict=True):
            own[edge] = rest
        bar.update(own.nbytes)
    for (edge, repeated), neighbour in zip(_EDGES, neighbours, strict=True):
        blocks[edge][neighbour >= 0] += blocks[repeated][neighbour[neighbour >= 0]]
    for first in range(0, len(blocks), _RUN):
        _check_blocks(blocks[first : first + _RUN])


def _in_image_order(maps: Halves) -> Halves:
    """Put interleaved maps (N, 4, cells², R, C) together, (N, 4, R cells, C cells)."""
    count, channels, squared, rows, columns = maps.shape
    cells = round(squared**0.5)
    parts = maps.reshape(count, channels, cells, cells, rows, columns)
    return parts.transpose(0, 1, 4, 2, 5, 3).reshape(count, channels, rows * cells, columns * cells)


def _in_block_order(image: Halves, squared: int) -> Halves:
    """Take maps apart again: the inverse of `_in_image_order`."""
    count, channels, rows, columns = image.shape
    cells = round(squared**0.5)
    parts = image.reshape(count, channels, rows // cells, cells, columns // cells, cells)
    return parts.transpose(0, 1, 3, 5, 2, 4).reshape(
        count, channels, squared, rows // cells, columns // cells
    )


def _check_blocks(blocks: Halves) -> None:
    """Raise unless opacities lie between 0 and 1 and radiance is finite."""
    if (blocks[:, 0] > _ONE).any():  # as bits; a negative number's are above
        raise SampleError("hold an opacity outside 0 to 1", field="blocks")
    if ((blocks & 0x7FFF) >= _INFINITE).any():
        raise SampleError("hold radiance that is not finite", field="blocks")


class _Stream:
    """A zlib stream that hands out as many bytes as asked for."""

    def __init__(self, file: BinaryIO, length: int) -> None:
        self._file = file
        self._length = length
        self._inflate = zlib.decompressobj()

    def check_claim(self, size: int, what: str) -> None:
        """Raise if the file cannot hold so many bytes."""
        check_deflate_ratio(size, self._length, what)

    def read(self, count: int, what: str) -> Bytes:
        """Return the next bytes; their number must have been checked."""
        data = np.empty(count, np.uint8)
        done = 0
        while done < count:
            part = self._next(count - done)
            if not part:
                raise SampleError(f"the file ends {count - done} bytes too early", field=what)
            data[done : done + len(part)] = np.frombuffer(part, np.uint8)
            done += len(part)
        return data

    def finish(self) -> None:
        """Raise unless all has been read; the checksum at the end has then been compared."""
        if self._next(1) or self._inflate.unused_data or self._file.read(1):
            raise SampleError("data follows the last block", field="blocks")
        if not self._inflate.eof:
            raise SampleError("the file ends too early", field="blocks")

    def _next(self, most: int) -> bytes:
        """Return up to so many bytes; none at the end."""
        part = b""
        try:
            while not part and not self._inflate.eof:
                packed = self._inflate.unconsumed_tail or self._file.read(_CHUNK)
                part = self._inflate.decompress(packed, most)
                if not packed:
                    break
        except zlib.error as error:
            raise SampleError(f"is damaged: {error}") from None
        return part
