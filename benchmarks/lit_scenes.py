"""The rendered example with light samples of its lamp: buffers and references of its variants and frames."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

import fewrays
from example_renders import Reference
from fewrays.method import Image

__all__ = ["SPP", "VARIANTS", "LitScene", "frames", "how_to_render_lit", "load_lit", "rendered_variants"]

SPP = 4
VARIANTS = {"still": "still", "moving": "moving", "moving_defocused": "moving and defocused"}
"""What the files call the variants, and what the page does."""

_SCENE, _SEQUENCE = "excavator", "light"
_COMMANDS = {
    "still": "--reference-spp 1024",
    "moving": "--reference-spp 512 --reference-shading-spp 4",
    "moving_defocused": "--reference-spp 512 --reference-shading-spp 4",
    _SEQUENCE: "--width 320 --height 180 --reference-spp 768",
}


@dataclass(frozen=True)
class LitScene:
    """Samples with light samples, and the reference under the box filter.

    Parameters
    ----------
    label : str
        What the page calls it.
    path : path
        The samples' file.
    samples : SampleBuffer
    reference : Reference
    """

    label: str
    path: Path
    samples: fewrays.SampleBuffer
    reference: Reference

    @cached_property
    def shaded(self) -> fewrays.SampleBuffer:
        """The samples, with their light and shadow reconstructed."""
        return fewrays.shade(self.samples)

    @cached_property
    def averaged(self) -> Image:
        """The mean of each pixel's samples as they are, shadow noise and all."""
        return fewrays.reconstruct(self.samples, "box", shadows=False)


def rendered_variants(folder: Path) -> list[str]:
    """Return the variants whose samples and references there are.

    Raises
    ------
    SystemExit
        With the commands that render them, where there are none.
    """
    found = [name for name in VARIANTS if _there(folder, name)]
    if not found:
        raise SystemExit(f"nothing is rendered in {folder}; make it with\n{how_to_render_lit(VARIANTS)}")
    return found


def load_lit(folder: Path, name: str) -> LitScene:
    """Load a variant, or a frame that `frames` names.

    Raises
    ------
    SampleError
        For files that are not what they should be, and samples without light samples.
    SystemExit
        With the command that renders what is missing.
    """
    if not _there(folder, name):
        raise SystemExit(
            f"{_SCENE}_{name} or its reference is not in {folder}; make it with\n{how_to_render_lit([name])}"
        )
    path = _samples_file(folder, name)
    samples = fewrays.load(path)
    if samples.lighting is None:
        raise fewrays.SampleError(
            "holds no light samples; render it with examples/render.py", file=path, field="lighting"
        )
    record = json.loads(_record_file(folder, name).read_text())
    image = fewrays.load_image(_image_file(folder, name))
    reference = Reference(image, record["spp"], record["noise_psnr_gamma22_db"]["box"])
    return LitScene(VARIANTS.get(name, name), path, samples, reference)


def frames(folder: Path) -> list[str]:
    """Return the rendered frames of the sequence over which the lamp moves, in their order."""
    numbers = range(len(list(folder.glob(f"{_SCENE}_{_SEQUENCE}_*_{SPP}spp.npz"))))
    return [name for name in (f"{_SEQUENCE}_{k}" for k in numbers) if _there(folder, name)]


def how_to_render_lit(names: Sequence[str] | dict[str, str]) -> str:
    """Return the commands that render variants, one a line; frames are rendered together."""
    wanted = dict.fromkeys(_SEQUENCE if name.startswith(_SEQUENCE) else name for name in names)
    base = f"python examples/render.py {_SCENE} --spp {SPP} --variants"
    return "\n".join(f"    {base} {name} {_COMMANDS[name]}" for name in wanted)


def difference_of_means(scene: LitScene) -> float:
    """Return by how much the samples' mean colour differs from the reference's, as a share of it."""
    means = [np.asarray(image, np.float64).mean() for image in (scene.averaged, scene.reference.image)]
    return float(abs(means[0] / means[1] - 1))


def _there(folder: Path, name: str) -> bool:
    files = (_samples_file(folder, name), _record_file(folder, name), _image_file(folder, name))
    return all(path.exists() for path in files)


def _samples_file(folder: Path, name: str) -> Path:
    return folder / f"{_SCENE}_{name}_{SPP}spp.npz"


def _record_file(folder: Path, name: str) -> Path:
    return folder / f"{_SCENE}_{name}_reference.json"


def _image_file(folder: Path, name: str) -> Path:
    return folder / f"{_SCENE}_{name}_reference_box.exr"
