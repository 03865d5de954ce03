"""Reading one ``.npy`` stream with its size checked before anything is allocated; never unpickles."""

from __future__ import annotations

import math
import tokenize
import warnings
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError

__all__ = ["ArrayHeader", "read_array", "read_header"]

_CHUNK = 1 << 24  # bytes read at a time


@dataclass(frozen=True)
class ArrayHeader:
    """Shape and type of the array that follows, and the bytes that its header took."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran_order: bool
    length: int

    @property
    def nbytes(self) -> int:
        """Bytes of array data."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_header(stream: IO[bytes], field: str) -> ArrayHeader:
    """Read the header of a ``.npy`` stream.

    Raises
    ------
    SampleError
        For anything that is not a plain array: a bad header, a pickle, structured or object types.
    """
    counted = _Counted(stream)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns of, and mends, headers that Python 2 wrote
            version = np.lib.format.read_magic(counted)
            if version == (1, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_1_0(counted)
            elif version == (2, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_2_0(counted)
            else:
                raise SampleError(f"npy version {version[0]}.{version[1]} is not 1.0 or 2.0", field=field)
    except SampleError:
        raise
    except (ValueError, TypeError, OverflowError, SyntaxError, tokenize.TokenError, UserWarning) as error:
        # One line: NumPy quotes the whole header.
        raise SampleError(
            f"the npy header is malformed: {str(error).splitlines()[0][:200]}", field=field
        ) from None
    if dtype.hasobject or dtype.kind not in "fiubU":
        raise SampleError(f"expected plain numbers, got dtype {dtype}; fewrays never unpickles", field=field)
    if min(shape, default=0) < 0 or any(isinstance(n, bool) for n in shape):
        raise SampleError(f"the npy header claims the shape {shape}", field=field)
    return ArrayHeader(tuple(int(n) for n in shape), dtype, fortran, counted.count)


def read_array(stream: IO[bytes], header: ArrayHeader, field: str) -> npt.NDArray[Any]:
    """Read the array that `header` describes; the caller has checked that its size is plausible."""
    flat = np.empty(math.prod(header.shape), header.dtype)
    data = flat.view(np.uint8)
    done = 0
    while done < len(data):
        block = stream.read(min(_CHUNK, len(data) - done))
        if not block:
            raise SampleError(f"the data ends after {done} of {len(data)} bytes", field=field)
        data[done : done + len(block)] = np.frombuffer(block, np.uint8)
        done += len(block)
    if stream.read(1):
        raise SampleError(
            f"data follows the {len(data)} bytes that the shape {header.shape} takes", field=field
        )
    return flat.reshape(header.shape, order="F" if header.fortran_order else "C")


class _Counted:
    """A stream that counts what is read and never hands out more than a header can need."""

    _MOST = 1 << 16

    def __init__(self, stream: IO[bytes]) -> None:
        self.stream = stream
        self.count = 0

    def read(self, size: int = -1, /) -> bytes:
        data = self.stream.read(min(size, self._MOST) if size >= 0 else self._MOST)
        self.count += len(data)
        return data
