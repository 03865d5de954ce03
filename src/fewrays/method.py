"""The shape that every reconstruction method has.

A method is a name, a frozen dataclass of options and a function from samples to an image. The CLI, the
benchmarks and `fewrays.reconstruct` know methods only by this shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer

__all__ = ["Image", "Method", "Reconstruction"]

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
        The devices that it runs on, the one that ``"auto"`` means first.
    run : callable
        ``run(samples, options, execution) -> Reconstruction``.
    """

    name: str
    summary: str
    options: type[Any]
    devices: tuple[str, ...]
    run: Callable[[SampleBuffer, Any, Execution], Reconstruction]
