"""The rendered example scenes: their sample buffers, and references under both pixel filters."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import fewrays
from fewrays.color import gamma_encode
from fewrays.method import Image
from fewrays.pixel_filter import PixelFilterShape

__all__ = [
    "SAMPLINGS",
    "SCENES",
    "Reference",
    "Scene",
    "how_to_render",
    "load_references",
    "load_scene",
    "require_match",
    "require_renders",
    "samples_file",
]

SCENES = ("foliage", "serpent", "citadel")
SAMPLINGS = ("square", "gaussian")
"""How lens positions were drawn: uniformly over the square, or from the Gaussian aperture itself."""

_INSTALL = 'pip install "fewrays[mitsuba]"'
_BLOCK, _BLOCK_ERROR = 20, 0.02  # pixels; share of white after gamma 2.2. Noise alone leaves 0.005.
_FILTERS: tuple[PixelFilterShape, ...] = ("gaussian", "box")


@dataclass(frozen=True)
class Reference:
    """A reference image ``(H, W, 3)``, its samples per pixel, and its noise as PSNR after gamma 2.2 in dB."""

    image: Image
    spp: int
    noise_psnr: float

    @property
    def noise_mse(self) -> float:
        """Mean squared error after gamma 2.2 that the reference's own noise causes."""
        return float(10 ** (-self.noise_psnr / 10))


@dataclass(frozen=True)
class Scene:
    """A scene's sample buffers by lens sampling and its references by pixel filter."""

    name: str
    samples: dict[str, fewrays.SampleBuffer]
    references: dict[PixelFilterShape, Reference]


def require_renders(folder: Path, scenes: Sequence[str], spp: int) -> None:
    """Exit with the command that renders what is missing, if anything is.

    Raises
    ------
    SystemExit
        Naming the missing files.
    """
    missing = [path for scene in scenes for path in _files(folder, scene, spp) if not path.exists()]
    if missing:
        needed = [scene for scene in scenes if any(path.name.startswith(scene) for path in missing)]
        raise SystemExit(
            f"{len(missing)} rendered files are missing, the first is {missing[0]}; "
            f"make them with\n    {_INSTALL}\n    {how_to_render(needed, [spp], folder)}"
        )


def load_scene(folder: Path, name: str, spp: int) -> Scene:
    """Load a scene's buffers of `spp` samples per pixel, and its references.

    Raises
    ------
    SampleError
        For files that are not what they should be.
    """
    samples = {s: fewrays.load(samples_file(folder, name, s, spp)) for s in SAMPLINGS}
    return Scene(name, samples, load_references(folder, name))


def load_references(folder: Path, name: str) -> dict[PixelFilterShape, Reference]:
    """Load a scene's references by pixel filter.

    Raises
    ------
    SampleError
        For files that are not what they should be.
    """
    record = json.loads(_record_file(folder, name).read_text())
    return {
        f: Reference(
            fewrays.load_image(_reference_file(folder, name, f)),
            record["spp"],
            record["noise_psnr_gamma22_db"][f],
        )
        for f in _FILTERS
    }


def require_match(folder: Path, scene: Scene, box_image: Image) -> None:
    """Exit if the samples show another scene than the reference, as after a change to only one of them.

    Parameters
    ----------
    folder : path
        Where the files lie, for the message.
    scene : Scene
        With the reference.
    box_image : ndarray, (H, W, 3)
        The mean of each pixel's samples; its mean over blocks of pixels is nearly free of noise.

    Raises
    ------
    SystemExit
        When the block means differ by more than noise explains.
    """
    difference = _blocks(box_image) - _blocks(scene.references["box"].image)
    error = float(np.sqrt(np.square(difference).mean()))
    if error > _BLOCK_ERROR:
        spp = next(iter(scene.samples.values())).spp
        raise SystemExit(
            f"{scene.name}: the samples and the reference in {folder} are not of the same scene (means over "
            f"{_BLOCK} x {_BLOCK} pixels differ by {error:.1%} of white); "
            f"make them with\n    {_INSTALL}\n    {how_to_render([scene.name], [spp], folder)}"
        )


def _blocks(image: Image) -> npt.NDArray[np.float64]:
    """Mean of every block of pixels, after gamma 2.2."""
    height, width = (side // _BLOCK for side in image.shape[:2])
    whole = image[: height * _BLOCK, : width * _BLOCK].astype(np.float64)
    return gamma_encode(whole.reshape(height, _BLOCK, width, _BLOCK, 3).mean(axis=(1, 3)))


def how_to_render(scenes: Sequence[str], spp: Sequence[int], folder: Path | None = None) -> str:
    """Return the command that renders scenes; into the usual folder when none is given."""
    command = ["python", "examples/render.py", *scenes, "--spp", *map(str, spp)]
    if folder is not None:
        command += ["--out", str(folder)]
    return shlex.join(command)


def samples_file(folder: Path, scene: str, sampling: str, spp: int) -> Path:
    """Return where a sample buffer lies."""
    return folder / f"{scene}_{sampling}_{spp}spp.npz"


def _files(folder: Path, scene: str, spp: int) -> list[Path]:
    return [
        *(samples_file(folder, scene, sampling, spp) for sampling in SAMPLINGS),
        *(_reference_file(folder, scene, pixel_filter) for pixel_filter in _FILTERS),
        _record_file(folder, scene),
    ]


def _record_file(folder: Path, scene: str) -> Path:
    return folder / f"{scene}_reference.json"


def _reference_file(folder: Path, scene: str, pixel_filter: str) -> Path:
    return folder / f"{scene}_reference_{pixel_filter}.exr"
