"""Checks that every container of samples makes of its arrays, once, so that nothing behind it has to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, first_index

__all__ = [
    "OFF_IMAGE",
    "Arrays",
    "Float32",
    "as_float32",
    "check_nan_option",
    "check_range",
    "check_shapes",
    "find_unusable",
    "park",
]

Float32 = npt.NDArray[np.float32]
Arrays = dict[str, Float32]

OFF_IMAGE = -(2.0**20)
"""Image coordinate where dropped samples are parked, so far outside that nothing gathers them."""


def check_nan_option(nan: Literal["reject", "drop"]) -> None:
    """Raise a `SampleError` unless `nan` is one of the two things to do with values that are not finite."""
    if nan not in ("reject", "drop"):
        raise SampleError(f"expected 'reject' or 'drop', got {nan!r}", field="nan")


def as_float32(name: str, value: npt.ArrayLike) -> Float32:
    """Return real numbers as a C-contiguous float32 array, the same one if it already is that."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise SampleError(f"expected real numbers, got dtype {array.dtype}", field=name)
    with np.errstate(over="ignore"):  # what overflows becomes infinite and is reported as such
        return np.ascontiguousarray(array, dtype=np.float32)


def check_shapes(arrays: Arrays, channels: Mapping[str, int | None], shape: tuple[int, ...]) -> None:
    """Raise unless every array has depth's shape, followed by its number of channels if it has any."""
    for name, array in arrays.items():
        count = channels[name]
        expected = shape if count is None else (*shape, count)
        if array.shape != expected:
            raise SampleError(
                f"expected shape {expected} to go with depth's {shape}, got {array.shape}", field=name
            )


def find_unusable(
    arrays: Arrays, shape: tuple[int, ...], *, drop: bool, may_be_infinite: tuple[str, ...] = ()
) -> npt.NDArray[np.bool_]:
    """Find the samples with NaN or infinities that are not legal.

    Parameters
    ----------
    arrays : dict
        Arrays of `shape`, or of `shape` and channels.
    shape : tuple of int
        One entry for each sample.
    drop : bool
        Return them. Otherwise there must not be any.
    may_be_infinite : tuple of str
        The arrays in which infinities are legal.

    Returns
    -------
    ndarray of bool
        With `shape`.

    Raises
    ------
    SampleError
        Naming the array, the first index and the value, unless `drop`.
    """
    bad = np.zeros(shape, bool)
    for name, array in arrays.items():
        # A finite sum shows at once that every value is.
        with np.errstate(invalid="ignore"):
            if np.isfinite(array.sum(dtype=np.float64)):
                continue
        finite = ~np.isnan(array) if name in may_be_infinite else np.isfinite(array)
        if finite.all():
            continue
        if not drop:
            index = first_index(~finite)
            raise SampleError(
                f"{finite.size - int(finite.sum())} of {finite.size} values are NaN or infinite, the first "
                f"at {list(index)}: {array[index]}; mend the renderer's output or pass nan='drop'",
                field=name,
            )
        bad |= ~(finite if finite.ndim == len(shape) else finite.all(axis=-1))
    return bad


def park(arrays: Arrays, bad: npt.NDArray[np.bool_], places: Mapping[str, npt.ArrayLike]) -> Arrays:
    """Return copies of arrays in which some samples have the values of `places`, or else 0."""
    parked = {}
    for name, array in arrays.items():
        parked[name] = array.copy()
        parked[name][bad] = places.get(name, 0.0)
    return parked


def check_range(
    name: str,
    array: npt.NDArray[np.floating],
    accept: Callable[[npt.NDArray[np.floating]], npt.NDArray[np.bool_]],
    hint: str,
    shown: Float32 | None = None,
) -> None:
    """Raise unless `accept` holds for all of `array`, naming the first exception and how many there are."""
    good = accept(array)
    if good.all():
        return
    index = first_index(~good)
    value = (array if shown is None else shown)[index]
    count = good.size - int(good.sum())
    raise SampleError(f"value {value} at {list(index)} ({count} such): {hint}", field=name)
