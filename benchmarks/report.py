"""What the pages that benchmarks write have in common: tables, and where and from what they were measured."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import fewrays
from fewrays.io.files import replace_files
from fewrays.parallel import usable_cores

__all__ = ["ROOT", "cpu_model", "markdown_table", "met", "provenance", "write_page"]

ROOT = Path(__file__).resolve().parents[1]
_CODE = ("src", "native", "benchmarks", "examples", "pyproject.toml", "CMakeLists.txt")
_PACKAGES = ("numpy", "pyoidn", "flip-evaluator", "scikit-image")


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table: the first column flush left, the others flush right.

    Raises
    ------
    ValueError
        When a row has not one cell for each head.
    """
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    rule = [":" + "-" * max(2, widths[0] - 1), *("-" * max(2, width - 1) + ":" for width in widths[1:])]
    lines = []
    for row in (head, rule, *rows):
        cells = [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def met(good: bool) -> str:
    """Return a target's verdict in bold."""
    return "**Met**" if good else "**Missed**"


def provenance(command: str) -> str:
    """Return a Markdown list of how, where and from which code a page was measured.

    Parameters
    ----------
    command : str
        The command line that measures the same; without the places of files.
    """
    versions = ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    return "\n".join(
        [
            f"- Command: `{command}`",
            f"- Machine: {cpu_model()}, {usable_cores()} cores; {_system()}",
            f"- Software: {platform.python_implementation()} {platform.python_version()}, "
            f"fewrays {fewrays.__version__}, {versions}",
            f"- Code: {_commit()}",
        ]
    )


def write_page(path: Path, *parts: str) -> None:
    """Write the paragraphs of a page, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_files(path) as (partial,):
        partial.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def cpu_model() -> str:
    """Return the processor's name."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):  # not Linux, or one without a name
        return f"{platform.system()} {platform.mac_ver()[0] or platform.version()}"


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _commit() -> str:
    git = shutil.which("git")
    if git is None or not (ROOT / ".git").exists():
        return "not a git checkout"
    commit = _git(git, "rev-parse", "--short=12", "HEAD")
    changed = _git(git, "status", "--porcelain", "--", *_CODE)
    return f"commit `{commit}`" + (", with uncommitted changes to code" if changed else "")


def _git(git: str, *arguments: str) -> str:
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    done = subprocess.run(
        [git, "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True, env=environment
    )
    return done.stdout.strip()
