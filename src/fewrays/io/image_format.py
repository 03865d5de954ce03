"""What an image file format is: the record that each format module fills in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

__all__ = ["Image", "ImageFormat"]

Image = npt.NDArray[np.float32]


@dataclass(frozen=True)
class ImageFormat:
    """An image file format.

    Parameters
    ----------
    extension : str
        Lower case, with the dot.
    display : bool
        Whether it holds display values, which depend on the exposure, instead of radiance.
    load : callable
        ``load(file, length, path) -> (H, W, 3) or (H, W) array``, linear.
    save : callable
        ``save(path, image, exposure, provenance)``; `path` is a temporary name.
    """

    extension: str
    display: bool
    load: Callable[[BinaryIO, int, Path], npt.NDArray[np.generic]]
    save: Callable[[Path, Image, float, Mapping[str, str]], None]
