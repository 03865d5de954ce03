"""What image sequences share: which focus distances they have, where frames are written, animations.

Frames are spaced evenly in dioptres, 1 / distance. The slope of a surface at depth z through a lens focused
at f is ``C = c0 (1/z - 1/f)``: equal steps of 1/f change every circle of confusion by equal numbers of
pixels. Equal steps of f would race through the near distances, crawl through the far ones, and never reach
infinity, which is 0 dioptres.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import PIL.features
import PIL.Image

from fewrays.cli.command import IMAGE_SUFFIXES, check_output
from fewrays.errors import SampleError, require_option
from fewrays.io.files import replace_files

__all__ = [
    "ANIMATION_SUFFIXES",
    "Ease",
    "check_sequence",
    "focus_distances",
    "frame_path",
    "is_animation",
    "save_animation",
]

Ease = Literal["none", "in", "out", "in-out"]

ANIMATION_SUFFIXES = (".gif", ".webp")
_NUMBER = re.compile(r"%0?(\d*)d|\{\}")  # where a file name takes the frame's number
_DIGITS = 4
_EASINGS: dict[Ease, Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]] = {
    "none": lambda t: t,
    "in": np.square,
    "out": lambda t: t * (2 - t),
    "in-out": lambda t: t * t * (3 - 2 * t),
}


def is_animation(path: Path) -> bool:
    """Tell whether a file holds a whole sequence."""
    return path.suffix.lower() in ANIMATION_SUFFIXES


def check_sequence(path: Path, frames: int, fps: float, exposure: float) -> None:
    """Refuse a sequence that cannot be written, before the work that it is for.

    Raises
    ------
    SampleError
        For an output of an unknown kind or in no directory, less than two frames, frame rates out of range,
        and exposure where images hold radiance.
    """
    check_output(path, (*IMAGE_SUFFIXES, *ANIMATION_SUFFIXES))
    suffix = path.suffix.lower()
    if suffix == ".webp" and not PIL.features.check("webp"):
        raise SampleError("this build of Pillow cannot write WebP; use .gif", file=path)
    if exposure and suffix not in (".png", *ANIMATION_SUFFIXES):
        raise SampleError("is for .png, .gif and .webp; others store the radiance itself", field="exposure")
    require_option("frames", frames, frames >= 2, "of at least 2")
    require_option("fps", fps, 0 < fps <= 100, "above 0 and up to 100")


def focus_distances(first: float, last: float, frames: int, ease: Ease = "none") -> list[float]:
    """Return the focus distance of every frame, evenly spaced in dioptres before easing.

    Parameters
    ----------
    first, last : float
        Distances of the ends in scene units, positive; infinity is 0 dioptres.
    frames : int
        How many, at least 2.
    ease : {"none", "in", "out", "in-out"}
        Where the focus travels slowly: nowhere, at the start, at the end, or at both.

    Raises
    ------
    SampleError
        For a distance that is not positive.
    """
    for name, distance in (("from", first), ("to", last)):
        require_option(name, distance, distance > 0, "above 0, as a focus distance is")
    share = _EASINGS[ease](np.linspace(0, 1, frames))
    dioptres = (1 - share) / first + share / last
    inner = [1 / d if d > 0 else math.inf for d in dioptres[1:-1].tolist()]
    return [first, *inner, last]


def frame_path(pattern: Path, number: int) -> Path:
    """Return the file of a frame: its number in place of ``%04d`` or ``{}``, else before the extension."""
    match = _NUMBER.search(pattern.name)
    if match is None:
        return pattern.with_name(f"{pattern.stem}.{number:0{_DIGITS}}{pattern.suffix}")
    width = _DIGITS if match[0] == "{}" else int(match[1] or 0)
    return pattern.with_name(f"{pattern.name[: match.start()]}{number:0{width}}{pattern.name[match.end() :]}")


def save_animation(path: Path, pictures: Sequence[npt.NDArray[np.uint8]], fps: float) -> None:
    """Write pictures ``(H, W, 3)``, sRGB, as one endless .gif or .webp; complete or not at all."""
    form = path.suffix[1:].upper()
    images = [PIL.Image.fromarray(picture) for picture in pictures]
    if form == "GIF":  # 256 colours a frame: dithered, because smooth blur shows bands
        images = [image.quantize(palette=image.quantize()) for image in images]
    with replace_files(path) as [temporary], temporary.open("wb") as file:
        images[0].save(
            file,
            format=form,
            save_all=True,
            append_images=images[1:],
            duration=round(1000 / fps),
            loop=0,
            quality=90,
        )
