"""The native format: a NumPy ``.npz`` archive, readable with ``numpy.load`` alone.

Members: ``version`` (1), the arrays of `SampleBuffer` under their own names in float32, and the lens as
``c0``, ``c1``, ``sigma`` (float64 scalars), ``aperture`` and ``sampling`` (text scalars). Nothing is pickled.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from fewrays.errors import SampleError, first_index
from fewrays.io.files import check_deflate_ratio, open_file, replace_files
from fewrays.io.formats import Format, StoredSamples, check_size
from fewrays.io.npy_header import ArrayHeader, read_array, read_header
from fewrays.parallel import progress_bar
from fewrays.samples import SampleBuffer

__all__ = ["FORMAT", "load", "save"]

_VERSION = 1
_REQUIRED = ("xy", "uv", "depth", "color")
_OPTIONAL = ("time", "motion", "bandwidth")
_COEFFICIENTS = ("c0", "c1")
_NUMBERS = (*_COEFFICIENTS, "sigma")
_TEXTS = ("aperture", "sampling")
_NDIM = {"depth": 3, "time": 3, "bandwidth": 3}
_MOST_TEXT = 64  # characters of a text scalar
_MOST_MEMBERS = 64
_LEVEL = 4  # of zlib: float data gains 2 % from level 6 and takes twice as long
_CHUNK = 1 << 22


def load(path: Path, progress: bool) -> StoredSamples:
    """Read a ``.npz`` sample file.

    Parameters
    ----------
    path : Path
        The file.
    progress : bool
        Show a progress bar for work over two seconds.

    Returns
    -------
    StoredSamples

    Raises
    ------
    SampleError
        For anything but a complete, consistent archive of version 1; sizes are checked against the length of
        the file and the caps before an array is allocated.
    """
    with open_file(path) as (file, length), _archive(file) as archive:
        members = _members(archive, length)
        version = _number(archive, members, "version")
        if version != _VERSION:
            raise SampleError(f"expected {_VERSION}, got {version:g}; update fewrays?", field="version")
        lens: dict[str, float | str] = {name: _number(archive, members, name) for name in _COEFFICIENTS}
        if "sigma" in members:
            lens["sigma"] = _number(archive, members, "sigma")
        lens |= {name: _text(archive, members, name) for name in _TEXTS if name in members}
        names = [*_REQUIRED, *(name for name in _OPTIONAL if name in members)]
        headers = {name: _array_header(archive, members, name) for name in names}
        with progress_bar(len(names), "load", show=progress, unit="array") as bar:
            return StoredSamples({n: _array(archive, members, n, headers[n], bar) for n in names}, lens)


def save(
    path: Path,
    samples: SampleBuffer,
    overwrite: bool,
    progress: bool,
    *,
    compressed: bool = False,
    half: bool = False,
) -> None:
    """Write a ``.npz`` sample file.

    Parameters
    ----------
    path : Path
        The file.
    samples : SampleBuffer
        What to write.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : bool
        Show a progress bar for work over two seconds.
    compressed : bool
        Compress with DEFLATE: smaller, but many times slower.
    half : bool
        Store the colour, and nothing else, as float16: 11 significant bits. Loading gives float32 again.

    Raises
    ------
    SampleError
        When a colour does not fit into float16, or the file cannot be written.
    """
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(samples, name) for name in samples.field_names()}
    if half:
        arrays["color"] = _as_half(samples.color)
    scalars: dict[str, npt.NDArray[Any]] = {"version": np.array(_VERSION, np.int64)}
    scalars |= {name: np.array(getattr(samples.lens, name), np.float64) for name in _NUMBERS}
    scalars |= {name: np.array(getattr(samples.lens, name)) for name in _TEXTS}
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    total = sum(array.nbytes for array in arrays.values())
    with (
        replace_files(path, overwrite=overwrite) as [temporary],
        zipfile.ZipFile(temporary, "w", method, compresslevel=_LEVEL if compressed else None) as archive,
        progress_bar(total, "save", show=progress, unit="B") as bar,
    ):
        for name, array in (scalars | arrays).items():
            _write_member(archive, name, array, bar)


def _write_member(archive: zipfile.ZipFile, name: str, array: npt.NDArray[Any], bar: tqdm[Any]) -> None:
    # A fixed date makes equal samples equal files.
    info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    info.compress_type = archive.compression
    with archive.open(info, "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, np.lib.format.header_data_from_array_1_0(array))
        data = array.reshape(-1).view(np.uint8)
        for start in range(0, len(data), _CHUNK):
            block = data[start : start + _CHUNK]
            member.write(block.data)
            bar.update(len(block) if array.ndim else 0)


def _as_half(color: npt.NDArray[np.float32]) -> npt.NDArray[np.float16]:
    with np.errstate(over="ignore"):
        half = color.astype(np.float16)
    bad = ~np.isfinite(half)
    if bad.any():
        index = first_index(bad)
        raise SampleError(
            f"value {color[index]} at {list(index)} does not fit into float16 "
            "(65504 at most); save without half",
            field="color",
        )
    return half


@contextmanager
def _archive(file: IO[bytes]) -> Iterator[zipfile.ZipFile]:
    """Open an archive and turn whatever `zipfile` says about a broken one into a `SampleError`."""
    try:
        with zipfile.ZipFile(file) as archive:
            yield archive
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


def _open(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str) -> IO[bytes]:
    if name not in members:
        raise SampleError(
            f"is missing; the archive holds {', '.join(sorted(members)) or 'nothing'}", field=name
        )
    return archive.open(members[name])


def _array_header(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str) -> ArrayHeader:
    """Read an array's header and check its type, its shape and the bytes that the member has for it."""
    with _open(archive, members, name) as stream:
        header = read_header(stream, name)
    if header.dtype.kind != "f" or header.dtype.itemsize > 8:
        raise SampleError(f"expected float32, got dtype {header.dtype}", field=name)
    ndim = _NDIM.get(name, 4)
    if len(header.shape) != ndim or (ndim == 4 and not 2 <= header.shape[3] <= 3):
        expected = (
            "(H, W, S)" if ndim == 3 else "(H, W, S, 3)" if name in ("color", "motion") else "(H, W, S, 2)"
        )
        raise SampleError(f"expected shape {expected}, got {header.shape}", field=name)
    height, width, spp = header.shape[:3]
    check_size(height, width, spp, name)
    _check_length(members, name, header)
    return header


def _check_length(members: dict[str, zipfile.ZipInfo], name: str, header: ArrayHeader) -> None:
    available = members[name].file_size - header.length
    if header.nbytes != available:
        raise SampleError(
            f"shape {header.shape} of {header.dtype} takes {header.nbytes} bytes, the member has {available}",
            field=name,
        )


def _array(
    archive: zipfile.ZipFile,
    members: dict[str, zipfile.ZipInfo],
    name: str,
    header: ArrayHeader,
    bar: tqdm[Any],
) -> npt.NDArray[np.floating]:
    with _open(archive, members, name) as stream:
        read_header(stream, name)
        array = read_array(stream, header, name)
    bar.update()
    return array


def _scalar(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str, kinds: str) -> Any:
    with _open(archive, members, name) as stream:
        header = read_header(stream, name)
        if header.shape != () or header.dtype.kind not in kinds or header.dtype.itemsize > 4 * _MOST_TEXT:
            wanted = "a text" if kinds == "U" else "a number"
            raise SampleError(f"expected {wanted}, got {header.dtype} of shape {header.shape}", field=name)
        _check_length(members, name, header)
        return read_array(stream, header, name)[()]


def _number(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str) -> float:
    return float(_scalar(archive, members, name, "fiu"))


def _text(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], name: str) -> str:
    return str(_scalar(archive, members, name, "U"))


FORMAT = Format("npz", (".npz",), load, save, save_options=("compressed", "half"))
