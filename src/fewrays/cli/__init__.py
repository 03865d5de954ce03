"""The ``fewrays`` command line.

Every command is a frozen dataclass in a module of its own: its fields are the flags, its docstring is the
help, its ``run`` does the work. This module finds the command, runs it, and turns what goes wrong into one
plain line and an exit status: 0 done, 2 the user can mend it, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fewrays import __version__
from fewrays.cli.command import Command, build
from fewrays.cli.compare import Compare
from fewrays.cli.convert import Convert
from fewrays.cli.defocus import Defocus
from fewrays.cli.demo import Demo
from fewrays.cli.info import Info
from fewrays.cli.methods import named_method
from fewrays.cli.planes import Planes
from fewrays.cli.reconstruct import Reconstruct
from fewrays.cli.refocus import Refocus
from fewrays.cli.render import Render
from fewrays.cli.source import preparing_method
from fewrays.errors import SampleError
from fewrays.method import Method

__all__ = ["COMMANDS", "main", "parse"]

COMMANDS: dict[str, type[Command]] = {
    "demo": Demo,
    "render": Render,
    "reconstruct": Reconstruct,
    "refocus": Refocus,
    "defocus": Defocus,
    "planes": Planes,
    "compare": Compare,
    "info": Info,
    "convert": Convert,
}

_WITH_METHOD: dict[str, Any] = {"reconstruct": Reconstruct, "refocus": Refocus}  # flags depend on --method

DONE, USER_ERROR, INTERRUPTED = 0, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments after the program's name; those of the process when omitted.

    Returns
    -------
    int
        The exit status.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    with _plain_warnings():
        try:
            status = _run(arguments)
            sys.stdout.flush()  # so that a closed pipe shows here and not at the interpreter's end
            return status
        except SystemExit as stop:  # how the parser ends after --help or a wrong flag
            return stop.code if isinstance(stop.code, int) else USER_ERROR
        except KeyboardInterrupt:
            return INTERRUPTED
        except BrokenPipeError:  # the reader, such as `head`, has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        except ImportError as error:
            if "fewrays[" not in str(error):  # not an extra that the message tells how to get, but a bug
                raise
            return _fail(str(error))
        except SampleError as error:
            return _fail(str(error))
        except OSError as error:
            return _fail(": ".join(str(part) for part in (error.filename, error.strerror or error) if part))
        except MemoryError:
            return _fail("out of memory: use a smaller image or fewer samples per pixel")


def parse(arguments: Sequence[str]) -> Command:
    """Build the command that the arguments ask for, without running it.

    Raises
    ------
    SampleError
        For an unknown command or method.
    SystemExit
        From the parser: after ``--help`` with status 0, for wrong flags with status 2.
    """
    name, rest = arguments[0], list(arguments[1:])
    if name not in COMMANDS:
        raise SampleError(f"unknown command {name!r}; choose from {', '.join(COMMANDS)}")
    kind: Any = COMMANDS[name]
    if name in _WITH_METHOD:
        method = _method_of(rest)
        kind, rest = _WITH_METHOD[name][method.options], [*rest, "--method", method.name]
    command: Command = build(kind, rest, prog=f"fewrays {name}")
    return command


def _method_of(arguments: Sequence[str]) -> Method:
    """Return the method that ``--method`` names; else the one that prepared a file there, or the default."""
    if not any(argument.split("=")[0] == "--method" for argument in arguments):
        for argument in arguments:
            if method := preparing_method(Path(argument)):
                return method
    return named_method(arguments)


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_overview())
        return DONE if arguments else USER_ERROR
    if arguments[0] == "--version":
        print(f"fewrays {__version__}")
        return DONE
    parse(arguments).run()
    return DONE


def _overview() -> str:
    commands = "\n".join(f"  {name:<12} {kind.summary()}" for name, kind in COMMANDS.items())
    return (
        "usage: fewrays COMMAND ...\n\n"
        "Noise-free depth of field from a few rays per pixel.\n\n"
        f"commands:\n{commands}\n\n"
        "options:\n"
        "  -h, --help   show this text; 'fewrays COMMAND --help' explains a command, with examples\n"
        "  --version    show the version"
    )


def _fail(problem: str) -> int:
    print(f"fewrays: error: {problem}", file=sys.stderr)
    return USER_ERROR


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings as one line, without the place in the code that gave them."""

    def show(message: Warning | str, *_: object, **__: object) -> None:
        print(f"fewrays: warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = show
        yield
