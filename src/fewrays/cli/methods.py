"""What the commands that run a method share: which options it has, and how its images say what they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fewrays import __version__
from fewrays.lens import Lens
from fewrays.method import Method
from fewrays.reconstruct import METHODS, find_method

__all__ = ["DEFAULT_METHOD", "named_method", "provenance"]

DEFAULT_METHOD = next(iter(METHODS))


def named_method(arguments: Sequence[str]) -> Method:
    """Return the method that the arguments of a command name with ``--method``, or the default one.

    Raises
    ------
    SampleError
        For an unknown method.
    """
    name = DEFAULT_METHOD
    for flag, value in zip(arguments, [*arguments[1:], ""], strict=True):
        if flag == "--method":
            name = value
        elif flag.startswith("--method="):
            name = flag.removeprefix("--method=")
    return find_method(name)


def provenance(method: Method, options: Any, lens: Lens, samples: Path) -> dict[str, str]:
    """Return what an image's header says of how it was made."""
    return {
        "software": f"fewrays {__version__}",
        "method": method.name,
        "options": ", ".join(f"{name}={value}" for name, value in asdict(options).items()),
        "lens": str(lens),
        "samples": samples.name,
    }
