"""`Kernel`: a function of a GPU, and how its arguments lie in memory.

Every kernel takes one structure. It is described here once more, so that a record of the same layout can be
made, and so that arrays are checked before a kernel reads them: a card tells nobody that it was given the
wrong ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Kernel"]


@dataclass(frozen=True, eq=False)
class Kernel:
    """A kernel of one of the `fewrays.cuda.source.PROGRAMS`.

    Parameters
    ----------
    program : str
        The file that holds it.
    name : str
        Its name there.
    threads : int
        Of a block.
    arguments : mapping of str to str
        Fields of its structure in order, each as a NumPy type, with ``*`` before that of what a pointer
        points to: ``{"keys": "*u8", "width": "i4"}``.
    """

    program: str
    name: str
    threads: int
    arguments: Mapping[str, str]

    @cached_property
    def layout(self) -> np.dtype[Any]:
        """The structure, aligned as C++ does."""
        fields = [(name, "u8" if code[0] == "*" else code) for name, code in self.arguments.items()]
        return np.dtype(fields, align=True)

    def pack(self, values: Mapping[str, Any], address: Callable[[Any], int]) -> npt.NDArray[np.void]:
        """Return the structure.

        Parameters
        ----------
        values : mapping of str to array or number
            Of every field; None for a pointer to nothing.
        address : callable
            Of an array's first element, where the kernel runs.

        Returns
        -------
        ndarray of one element

        Raises
        ------
        TypeError
            For fields that are missing or unknown, and arrays of another type or not contiguous: mistakes of
            the caller, not of a user.
        """
        if set(values) != set(self.arguments):
            wrong = sorted(set(values) ^ set(self.arguments))
            raise TypeError(f"{self.name} takes {', '.join(self.arguments)}; check {', '.join(wrong)}")
        record = np.zeros(1, self.layout)
        for field, code in self.arguments.items():
            value = values[field]
            if code[0] == "*":
                record[field] = 0 if value is None else address(self._checked(field, value))
            else:
                record[field] = value
        return record

    def _checked(self, field: str, array: Any) -> Any:
        wanted = np.dtype(self.arguments[field][1:])
        if array.dtype != wanted or not array.flags.c_contiguous:
            raise TypeError(
                f"{self.name}: {field} is to be a contiguous array of {wanted}, not of {array.dtype}"
                f"{'' if array.flags.c_contiguous else ', not contiguous'}"
            )
        return array
