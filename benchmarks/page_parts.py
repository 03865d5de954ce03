"""Pages that benchmarks write part by part: their flags, their paragraphs, and the command that they name.

Each such benchmark is a program ``NAME.py`` that writes ``docs/NAME-results.md``, and its pictures beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path

from report import ROOT, provenance, write_page

__all__ = ["Part", "make_page", "parse_page_options"]

Part = Callable[[argparse.Namespace], Iterator[str]]
"""Yields a part's paragraphs."""


def parse_page_options(
    doc: str | None, parts: Collection[str], *, repeated: str = "of each contender", kept: str | None = None
) -> argparse.Namespace:
    """Read the command line: the flags that every such benchmark has.

    Parameters
    ----------
    doc : str
        The program's docstring; its first line describes it.
    parts : collection of str
        Names of the parts, in their order on the page.
    repeated : str
        What is repeated for the sake of its time, in words.
    kept : str, optional
        What a flag ``--keep FOLDER`` keeps, in words; without them there is no such flag.
    """
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--renders", type=Path, default=ROOT / "examples" / "renders")
    parser.add_argument("--parts", nargs="+", choices=parts, default=list(parts), metavar="PART")
    parser.add_argument("--repetitions", type=int, default=3, help=f"timed calls {repeated} (3)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for the page (docs)")
    if kept is not None:
        parser.add_argument("--keep", type=Path, help=f"folder for {kept} (none is kept)")
    options = parser.parse_args()
    if options.repetitions < 1:
        parser.error(f"--repetitions must be at least 1, got {options.repetitions}")
    return options


def make_page(
    name: str,
    introduction: Iterable[str],
    parts: Mapping[str, Part],
    options: argparse.Namespace,
    *,
    first: str | None = None,
) -> None:
    """Make the chosen parts, write the page, and print where it lies.

    Parameters
    ----------
    name : str
        Of the benchmark's file, without its extension.
    introduction : iterable of str
        The page's first paragraphs.
    parts : mapping of str
        All parts by name, in their order on the page.
    options : Namespace
        As `parse_page_options` returns them.
    first : str, optional
        The part to make before the others: the one that forks to measure memory, which is best done before
        any library starts threads.
    """
    (options.out / "images").mkdir(parents=True, exist_ok=True)
    paragraphs = _paragraphs_of(parts, options, first)
    command = _command_of(f"{name}.py", options.parts, parts)
    page = options.out / f"{name}-results.md"
    write_page(page, *introduction, provenance(command), *paragraphs)
    print(page)


def _command_of(script: str, chosen: list[str], parts: Collection[str]) -> str:
    """Return the command that makes a page of the chosen parts."""
    command = f"python benchmarks/{script}"
    return command if chosen == list(parts) else f"{command} --parts {' '.join(chosen)}"


def _paragraphs_of(parts: Mapping[str, Part], options: argparse.Namespace, first: str | None) -> list[str]:
    """Make the chosen parts' paragraphs, `first` before the others, and return them in the page's order."""
    made = {name: list(parts[name](options)) for name in sorted(options.parts, key=lambda n: n != first)}
    return [paragraph for name in options.parts for paragraph in made[name]]
