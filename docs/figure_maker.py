"""The commands that make the figures and tables of pages, part by part."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Mapping

from figure_drawing import IMAGES


def maker(parts: Mapping[str, Callable[[], None]], pages: str) -> Callable[..., None]:
    """Return a command that runs parts by their names, or all, and prints how long each takes."""

    def main(names: tuple[str, ...] = (), /) -> None:
        print(f"commit {commit()}")
        for name in names or parts:
            start = time.perf_counter()
            parts[name]()
            print(f"({name}: {time.perf_counter() - start:.0f} s)")

    main.__doc__ = f"""Make the figures and tables of {pages}.

    Parameters
    ----------
    names
        Names of parts; all when omitted.
    """
    return main


def commit() -> str:
    """Return the commit of the checkout that this file lies in."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    run = subprocess.run(command, cwd=IMAGES.parent, capture_output=True, text=True, check=False)
    return run.stdout.strip() or "unknown"
