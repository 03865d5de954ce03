"""Pages that benchmarks write part by part: their flags, their paragraphs, and the command that they name."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

from report import ROOT

__all__ = ["Part", "command_of", "page_parser", "paragraphs_of", "parse_page_options"]

Part = Callable[[argparse.Namespace], Iterator[str]]
"""Yields a part's paragraphs."""


def page_parser(doc: str | None, parts: Collection[str], repeated: str) -> argparse.ArgumentParser:
    """Return a parser of the flags that every such benchmark has.

    Parameters
    ----------
    doc : str
        The program's docstring; its first line describes it.
    parts : collection of str
        Names of the parts, in their order on the page.
    repeated : str
        What is repeated for the sake of its time, in words.
    """
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--renders", type=Path, default=ROOT / "examples" / "renders")
    parser.add_argument("--parts", nargs="+", choices=parts, default=list(parts), metavar="PART")
    parser.add_argument("--repetitions", type=int, default=3, help=f"timed calls {repeated} (3)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder for the page (docs)")
    return parser


def parse_page_options(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Read the command line."""
    options = parser.parse_args()
    if options.repetitions < 1:
        parser.error(f"--repetitions must be at least 1, got {options.repetitions}")
    return options


def command_of(script: str, chosen: list[str], parts: Collection[str]) -> str:
    """Return the command that makes a page of the chosen parts."""
    command = f"python benchmarks/{script}"
    return command if chosen == list(parts) else f"{command} --parts {' '.join(chosen)}"


def paragraphs_of(parts: Mapping[str, Part], options: argparse.Namespace, first: str) -> list[str]:
    """Make the chosen parts' paragraphs, in their order on the page.

    `first` is measured before the others: it forks to measure memory, before any library starts threads.
    """
    made = {name: list(parts[name](options)) for name in sorted(options.parts, key=lambda n: n != first)}
    return [paragraph for name in options.parts for paragraph in made[name]]
