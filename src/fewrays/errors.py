"""The one exception type that bad input raises."""

from __future__ import annotations

from pathlib import Path

__all__ = ["SampleError"]


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
