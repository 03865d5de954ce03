"""The example scenes as pinhole pictures with depth, their references through the lens, and rival images."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from example_renders import Reference, load_references
from fewrays.dynamic import DepthLayer
from fewrays.io.rgbz import load_rgbz
from fewrays.method import Image

__all__ = ["SCENES", "VIEWS", "PinholeScene", "load_pinhole_scene", "require_pinhole_renders"]

SCENES = ("foliage", "serpent", "citadel")
VIEWS = (12, 24, 36, 48, 64)
"""As in the paper's Table 1."""


@dataclass(frozen=True)
class PinholeScene:
    """A scene as a pinhole sees it and as the lens does.

    Parameters
    ----------
    name : str
    front, behind : DepthLayer
        What is seen first, and next.
    lens : Lens
        That of the reference.
    reference : Reference
        Ray traced through the disc lens, box pixel filter.
    accumulated : mapping of int to ndarray, (H, W, 3)
        The mean of so many pinhole renders from points of the lens.
    """

    name: str
    front: DepthLayer
    behind: DepthLayer
    lens: fewrays.Lens
    reference: Reference
    accumulated: Mapping[int, Image]


def require_pinhole_renders(folder: Path, names: Sequence[str]) -> None:
    """Exit with the commands that render what is missing, if anything is.

    Raises
    ------
    SystemExit
        Naming the first missing file.
    """
    views = [str(count) for count in VIEWS]
    for command, files in (
        (
            ["examples/pinhole.py", *names, "--views", *views],
            [file for name in names for file in _pinhole_files(folder, name)],
        ),
        (
            ["examples/render.py", *names, "--aperture", "disc", "--spp", "8"],
            [folder / f"{name}_disc_reference.json" for name in names],
        ),
    ):
        missing = [file for file in files if not file.exists()]
        if missing:
            line = shlex.join(["python", *command, "--out", str(folder)])
            raise SystemExit(
                f"{missing[0]} and {len(missing) - 1} others are missing; make them with\n    {line}"
            )


def load_pinhole_scene(folder: Path, name: str) -> PinholeScene:
    """Load a scene.

    Raises
    ------
    SampleError
        For files that are not what they should be.
    SystemExit
        When the picture does not say through which lens the reference was made.
    """
    front, behind, *accumulated = _pinhole_files(folder, name)
    picture = load_rgbz(front)
    if picture.lens is None:
        raise SystemExit(f"{front} has no lens in its header; render it by examples/pinhole.py")
    return PinholeScene(
        name,
        picture.layers[0],
        load_rgbz(behind).layers[0],
        fewrays.Lens(*picture.lens),
        load_references(folder, f"{name}_disc")["box"],
        {count: fewrays.load_image(file) for count, file in zip(VIEWS, accumulated, strict=True)},
    )


def _pinhole_files(folder: Path, name: str) -> list[Path]:
    stems = ["pinhole", "pinhole_behind", *(f"accumulated_{count}" for count in VIEWS)]
    return [folder / f"{name}_{stem}.exr" for stem in stems]
