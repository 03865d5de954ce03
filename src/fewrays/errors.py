"""The one exception type that bad input raises, and where in an array the trouble starts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

__all__ = ["SampleError", "first_index", "require_known_options", "require_option"]


class SampleError(ValueError):
    """Samples, a lens or a file that fewrays cannot use.

    Parameters
    ----------
    problem : str
        What is wrong, with the offending value, and what to do about it.
    file : str or path, optional
        The file that the value came from.
    field : str, optional
        The field, header line or channel that holds the value.
    """

    def __init__(self, problem: str, *, file: str | Path | None = None, field: str | None = None) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.field = field
        super().__init__(": ".join(part for part in (self.file, field, problem) if part))

    def in_file(self, file: str | Path) -> SampleError:
        """Return the same error, naming the file that the data came from."""
        return SampleError(self.problem, file=file, field=self.field)


def first_index(mask: npt.NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the index of the first true value of a mask that has one."""
    return tuple(int(i) for i in np.unravel_index(int(np.argmax(mask)), mask.shape))


def require_option(name: str, value: object, accepted: bool, allowed: str) -> None:
    """Raise a `SampleError` that names an option, its value and what is allowed, unless it is accepted."""
    if not accepted:
        raise SampleError(f"expected a value {allowed}, got {value!r}", field=name)


def require_known_options(given: Iterable[str], known: Sequence[str], taker: str) -> None:
    """Raise a `SampleError` for the first option that `taker` does not know; it names all that there are."""
    for name in given:
        if name not in known:
            raise SampleError(
                f"no such option for {taker}; there are {', '.join(known) or 'none'}", field=name
            )
