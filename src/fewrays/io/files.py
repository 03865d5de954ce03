"""How every format opens, bounds and replaces files.

Reading: only regular files, and nothing larger than their length can account for is allocated. Writing:
under a temporary name in the same directory, renamed when complete, so that a reader never sees half a
file.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from fewrays.errors import SampleError

__all__ = [
    "MAX_DEFLATE_RATIO",
    "as_path",
    "check_deflate_ratio",
    "open_file",
    "read_exactly",
    "replace_files",
]

MAX_DEFLATE_RATIO = 1032
"""DEFLATE needs at least two bits for a run of 258 bytes, so that no stream expands more than this."""

_SLACK = 1024  # bytes that a tiny stream may claim whatever its length


def as_path(path: str | os.PathLike[str]) -> Path:
    """Return `path` as a `Path`, or raise a `SampleError` for what is none."""
    try:
        return Path(path)
    except TypeError:
        raise SampleError(f"expected a path, got {type(path).__name__}", field="path") from None


@contextmanager
def open_file(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular, non-empty file for reading and yield it with its length in bytes.

    Raises
    ------
    SampleError
        When there is no such file, it is a directory or a device, is empty, or cannot be read. Errors raised
        inside the ``with`` block that name no file are raised again with this one.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # before opening: a pipe without a writer would block
            raise SampleError("is not a regular file")
        with path.open("rb") as file:
            length = os.fstat(file.fileno()).st_size
            if length == 0:
                raise SampleError("is empty (0 bytes)")
            yield file, length
    except SampleError as error:
        raise (error if error.file else error.in_file(path)) from error.__cause__
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the path
        raise SampleError(f"cannot be read: {_reason(error)}", file=path) from None


def read_exactly(file: BinaryIO, count: int, what: str) -> bytes:
    """Read `count` bytes or raise a `SampleError` that names `what` is missing."""
    data = file.read(count)
    if len(data) != count:
        raise SampleError(f"the file ends {count - len(data)} bytes too early", field=what)
    return data


def check_deflate_ratio(size: int, packed: int, what: str) -> None:
    """Raise unless `packed` bytes of a DEFLATE stream can hold `size` bytes."""
    if size > packed * MAX_DEFLATE_RATIO + _SLACK:
        raise SampleError(
            f"claims {size} bytes, more than its {packed} compressed bytes can hold", field=what
        )


@contextmanager
def replace_files(*paths: Path, overwrite: bool = True) -> Iterator[list[Path]]:
    """Yield temporary paths beside `paths`; rename them when the block succeeds, delete them when it fails.

    Parameters
    ----------
    *paths : Path
        The files to write. A symbolic link keeps pointing to its target, which is replaced.
    overwrite : bool
        Whether existing files may be replaced.

    Raises
    ------
    SampleError
        When a target exists and must not be replaced, is not a regular file, or cannot be written.
    """
    temporary: list[Path] = []
    try:
        targets = [Path(os.path.realpath(path)) for path in paths]
        for target, path in zip(targets, paths, strict=True):
            _check_target(target, path, overwrite=overwrite)
            name = target.with_name(f".{target.name[:200]}.{secrets.token_hex(6)}.tmp")
            name.open("xb").close()  # made by open() so that it gets the permissions of any new file
            temporary.append(name)
        yield temporary
        for name, target in zip(temporary, targets, strict=True):
            name.replace(target)
    except (OSError, ValueError) as error:
        if isinstance(error, SampleError):
            raise
        raise SampleError(f"cannot be written: {_reason(error)}", file=paths[0]) from None
    finally:
        for name in temporary:
            name.unlink(missing_ok=True)


def _check_target(target: Path, path: Path, *, overwrite: bool) -> None:
    if not target.parent.is_dir():
        raise SampleError(f"cannot be written: there is no directory {target.parent}", file=path)
    if not target.exists():
        return
    if not target.is_file():
        raise SampleError("cannot be written: it exists and is not a regular file", file=path)
    if not overwrite:
        raise SampleError("exists; pass overwrite=True to replace it", file=path)


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
