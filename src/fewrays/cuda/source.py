"""The text of kernels: one string each, whatever they include.

The run-time compiler for GPUs knows no folders, and a cache that is keyed by the text must see all of it. So
the lines that include our own headers are replaced by these, each once. Those that include the standard
library's are left out: ``standard.h`` stands for it.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

__all__ = ["OPTIONS", "PROGRAMS", "kernel_folder", "program_text"]

PROGRAMS = (
    "dynamic",
    "dynamic_prepare",
    "layered_survey",
    "layered_maps",
    "layered_tiles",
    "multiplane_assign",
    "multiplane_build",
    "multiplane_render",
    "relighting",
    "shadows",
    "temporal",
    "temporal_dispersion",
    "temporal_mean",
    "temporal_refine",
)
"""Files of kernels, by name, one for each method's stage."""

OPTIONS = ("-std=c++20", "--device-as-default-execution-space")
"""What the compiler is told: functions are the GPU's unless they say otherwise."""

_INCLUDE = re.compile(r'#include\s+(?:"(?P<own>[^"]+)"|<[^>]+>)')


def kernel_folder() -> Path:
    """Return the folder of the kernels: of the installed package, or of the checkout that this file is in."""
    installed = Path(__file__).parent / "native" / "cuda"
    if installed.is_dir():
        return installed
    return Path(__file__).parents[3] / "native" / "cuda"


@cache
def program_text(name: str) -> str:
    """Return the whole text of a file of kernels.

    Parameters
    ----------
    name : str
        One of `PROGRAMS`.

    Returns
    -------
    str
        CUDA C++ that includes nothing.
    """
    folder = kernel_folder()
    seen: set[Path] = set()
    parts = [_text_of(folder / "standard.h", seen), _text_of(folder / f"{name}.cu", seen)]
    return "\n".join(parts)


def _text_of(path: Path, seen: set[Path]) -> str:
    path = path.resolve()
    if path in seen:
        return ""
    seen.add(path)
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        include = _INCLUDE.match(line)
        if include is None:
            lines.append("" if line.startswith("#pragma once") else line)
        elif include["own"]:
            lines.append(_text_of(path.parent / include["own"], seen))
    return "\n".join(lines)
