"""A ``.npz`` archive whose members are read one by one, their sizes checked before anything is allocated."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from fewrays.errors import SampleError
from fewrays.io.files import check_deflate_ratio
from fewrays.io.formats import check_size
from fewrays.io.npy_header import ArrayHeader, read_array, read_header

__all__ = ["NpzArchive"]

_MOST_TEXT = 64  # characters of a text scalar
_MOST_MEMBERS = 1024


class NpzArchive:
    """An open archive.

    Parameters
    ----------
    archive : ZipFile
        Open for reading.
    length : int
        Of the file, in bytes.

    Raises
    ------
    SampleError
        For members whose claimed sizes the file cannot hold, that are compressed otherwise than by DEFLATE,
        or that share a name.
    """

    def __init__(self, archive: zipfile.ZipFile, length: int) -> None:
        self._archive = archive
        self._members = _members(archive, length)

    @classmethod
    @contextmanager
    def open(cls, file: IO[bytes], length: int) -> Iterator[NpzArchive]:
        """Open an archive and turn whatever `zipfile` says about a broken one into a `SampleError`."""
        try:
            with zipfile.ZipFile(file) as archive:
                yield cls(archive, length)
        except SampleError:
            raise
        except (
            zipfile.BadZipFile,
            zlib.error,
            struct.error,
            EOFError,
            NotImplementedError,
            RuntimeError,
            UnicodeDecodeError,
            ValueError,
        ) as error:
            raise SampleError(f"is not a complete .npz archive: {error}") from None

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def names(self) -> tuple[str, ...]:
        """Names of all members."""
        return tuple(self._members)

    def number(self, name: str) -> float:
        """Read a member that is one number."""
        return float(self._small(name, "fiu", ())[()])

    def numbers(self, name: str, count: int) -> npt.NDArray[np.float64]:
        """Read a member of `count` numbers."""
        return self._small(name, "fiu", (count,)).astype(np.float64)

    def text(self, name: str) -> str:
        """Read a member that is one text."""
        return str(self._small(name, "U", ())[()])

    def header(self, name: str, channels: int | None) -> ArrayHeader:
        """Read an array's header and check its type, its shape and the bytes that the member has for it.

        Parameters
        ----------
        name : str
            The member.
        channels : int or None
            The array is ``(H, W, S, channels)``, or ``(H, W, S)``.
        """
        with self._open(name) as stream:
            header = read_header(stream, name)
        if header.dtype.kind != "f" or header.dtype.itemsize > 8:
            raise SampleError(f"expected float32, got dtype {header.dtype}", field=name)
        if len(header.shape) < 3 or header.shape[3:] != (() if channels is None else (channels,)):
            expected = "(H, W, S)" if channels is None else f"(H, W, S, {channels})"
            raise SampleError(f"expected shape {expected}, got {header.shape}", field=name)
        height, width, spp = header.shape[:3]
        check_size(height, width, spp, name)
        self._check_length(name, header)
        return header

    def headers(
        self, channels: Mapping[str, int | None], *, optional: tuple[str, ...] = (), prefix: str = ""
    ) -> dict[str, ArrayHeader]:
        """Read the headers of arrays that have a prefix before their names; optional ones may be missing."""
        names = [name for name in channels if name not in optional or prefix + name in self]
        return {name: self.header(prefix + name, channels[name]) for name in names}

    def arrays(
        self, headers: Mapping[str, ArrayHeader], bar: tqdm[Any], *, prefix: str = ""
    ) -> dict[str, npt.NDArray[np.floating]]:
        """Read the arrays that `headers` describe."""
        found = {}
        for name, header in headers.items():
            with self._open(prefix + name) as stream:
                read_header(stream, prefix + name)
                found[name] = read_array(stream, header, prefix + name)
            bar.update()
        return found

    def _open(self, name: str) -> IO[bytes]:
        if name not in self._members:
            raise SampleError(
                f"is missing; the archive holds {', '.join(sorted(self._members)) or 'nothing'}", field=name
            )
        return self._archive.open(self._members[name])

    def _check_length(self, name: str, header: ArrayHeader) -> None:
        available = self._members[name].file_size - header.length
        if header.nbytes != available:
            raise SampleError(
                f"shape {header.shape} of {header.dtype} takes {header.nbytes} bytes, the member has "
                f"{available}",
                field=name,
            )

    def _small(self, name: str, kinds: str, shape: tuple[int, ...]) -> npt.NDArray[Any]:
        with self._open(name) as stream:
            header = read_header(stream, name)
            of_kind = header.dtype.kind in kinds and header.dtype.itemsize <= 4 * _MOST_TEXT
            if header.shape != shape or not of_kind:
                wanted = "a text" if kinds == "U" else f"{shape[0]} numbers" if shape else "a number"
                raise SampleError(
                    f"expected {wanted}, got {header.dtype} of shape {header.shape}", field=name
                )
            self._check_length(name, header)
            return read_array(stream, header, name)


def _members(archive: zipfile.ZipFile, length: int) -> dict[str, zipfile.ZipInfo]:
    """Return the archive's members by array name, their claimed sizes checked against the file's length."""
    infos = archive.infolist()
    if len(infos) > _MOST_MEMBERS:
        raise SampleError(f"holds {len(infos)} members; a sample file has at most {_MOST_MEMBERS}")
    members = {info.filename.removesuffix(".npy"): info for info in infos}
    if len(members) != len(infos):
        raise SampleError("holds two members of one name")
    for name, info in members.items():
        if not name.isprintable():
            raise SampleError(f"holds a member of the name {name!r}")
        if info.flag_bits & 1:
            raise SampleError("is encrypted", field=name)
        if info.compress_size > length - info.header_offset:
            raise SampleError(f"claims {info.compress_size} bytes; the file has {length}", field=name)
        if info.compress_type == zipfile.ZIP_STORED:
            if info.file_size != info.compress_size:
                raise SampleError(
                    f"claims {info.file_size} bytes but stores {info.compress_size}", field=name
                )
        elif info.compress_type == zipfile.ZIP_DEFLATED:
            check_deflate_ratio(info.file_size, info.compress_size, name)
        else:
            raise SampleError(f"uses compression {info.compress_type}; expected none or DEFLATE", field=name)
    if sum(info.compress_size for info in infos) > length:
        raise SampleError("members overlap")
    return members
