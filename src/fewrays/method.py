"""The shape that every reconstruction method has.

A method is a name, a frozen dataclass of options and a function from samples to an image. The CLI, the
benchmarks and `fewrays.reconstruct` know methods only by this shape. A method may also say what of its work
does not depend on the lens that is looked through (`Preparation`): then many images take that work once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from fewrays.errors import require_known_options
from fewrays.lens import Lens
from fewrays.parallel import Execution

__all__ = ["Image", "Method", "Preparation", "Prepared", "Reconstruction", "make_options"]

Options = TypeVar("Options")

Image = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Reconstruction:
    """What a method returns.

    Parameters
    ----------
    image : ndarray, (H, W, 3)
        Linear radiance, float32.
    aovs : dict of str to ndarray
        Further outputs by name, when they were asked for; each starts with ``(H, W)``.
    """

    image: Image
    aovs: dict[str, npt.NDArray[Any]] = field(default_factory=dict)


class Prepared(Protocol):
    """What a method made of samples, once, for any number of images."""

    @property
    def lens(self) -> Lens:
        """The lens of the samples."""

    @property
    def height(self) -> int:
        """Image height in pixels."""

    @property
    def width(self) -> int:
        """Image width in pixels."""

    def reconstruct(self, lens: Lens, options: Any, execution: Execution) -> Reconstruction:
        """Make an image, with the method's options; those for preparing have had their effect."""

    def save(self, path: Path) -> None:
        """Write it to a file."""

    def describe(self, lens: Lens) -> dict[str, str]:
        """Return what there is to say about it, one short text per heading, as that lens sees it."""


@dataclass(frozen=True)
class Preparation:
    """How a method divides its work: what is made of samples once, and images that are made of that.

    Parameters
    ----------
    content : str
        What is made, in one word.
    extension : str
        Of files that hold it, with the dot.
    options : type
        The dataclass of those of the method's options that preparing reads.
    prepare : callable
        ``prepare(samples, options, execution) -> Prepared``, on any of the method's devices but the
        reference.
    load : callable
        ``load(path) -> Prepared``, from a file.
    """

    content: str
    extension: str
    options: type[Any]
    prepare: Callable[[Any, Any, Execution], Prepared]
    load: Callable[[Path], Prepared]


def _reads_none(_options: Any) -> bool:
    return False


@dataclass(frozen=True)
class Method:
    """A reconstruction method.

    Parameters
    ----------
    name : str
        What users call it.
    summary : str
        One line for ``--help``.
    options : type
        A frozen dataclass whose fields all have defaults; it validates itself.
    devices : tuple of str
        The devices that it runs on; ``"auto"`` means ``"cuda"`` where that is one and there is a GPU, else
        the first.
    run : callable
        ``run(samples, options, execution) -> Reconstruction``; samples are a `SampleBuffer`, or for
        ``"cuda"`` those or `fewrays.cuda.samples.DeviceSamples`.
    preparation : Preparation, optional
        For methods whose work is mostly done before the lens matters.
    reads_lights : callable, optional
        Whether, with its options, it reads the light samples of area lights itself; others are given samples
        that `fewrays.shade` has shaded.
    """

    name: str
    summary: str
    options: type[Any]
    devices: tuple[str, ...]
    run: Callable[[Any, Any, Execution], Reconstruction]
    preparation: Preparation | None = None
    reads_lights: Callable[[Any], bool] = _reads_none


def make_options(kind: type[Options], given: Mapping[str, Any], taker: str) -> Options:
    """Make an options object out of the keyword arguments that users gave.

    Parameters
    ----------
    kind : type
        A dataclass of options.
    given : mapping of str
        Values by the names of its fields.
    taker : str
        What users call that which takes the options, for messages.

    Raises
    ------
    SampleError
        For a name that is no field, or a value that the dataclass refuses.
    """
    require_known_options(given, [field.name for field in fields(kind)], taker)  # type: ignore[arg-type]
    return kind(**given)
