"""The example scenes through the disc lens: their sample buffers, and references that tell what to expect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fewrays
from example_renders import Reference, how_to_render, load_references, samples_file
from fewrays.pixel_filter import PixelFilterShape

__all__ = ["MOVING", "SCENES", "STILL", "DiscScene", "how_to_render_disc", "load_disc_scene", "rendered"]

STILL, MOVING = "foliage", "butterflies"
SCENES = (STILL, MOVING, "serpent", "citadel")
"""Those that have to be there come first, the one at rest and the one in motion."""


@dataclass(frozen=True)
class DiscScene:
    """A scene through the disc lens: its samples, and its references by pixel filter."""

    name: str
    samples: fewrays.SampleBuffer
    references: dict[PixelFilterShape, Reference]

    @property
    def label(self) -> str:
        """Name and samples per pixel."""
        return f"{self.name}, {self.samples.spp} spp"


def load_disc_scene(folder: Path, name: str, spp: int) -> DiscScene:
    """Load a scene of `spp` samples per pixel.

    Raises
    ------
    SampleError
        For files that are not what they should be.
    SystemExit
        With the command that renders what is missing.
    """
    if not rendered(folder, [name], spp):
        raise SystemExit(
            f"{name} through the disc lens, of {spp} samples per pixel, or its reference is not in {folder}; "
            f"make it with\n    {how_to_render_disc([name], [spp], folder)}"
        )
    samples = fewrays.load(samples_file(folder, name, "disc", spp))
    return DiscScene(name, samples, load_references(folder, f"{name}_disc"))


def rendered(folder: Path, scenes: Sequence[str], spp: int) -> list[str]:
    """Return those of the scenes that have been rendered with `spp` samples per pixel, with references."""
    return [
        name
        for name in scenes
        if samples_file(folder, name, "disc", spp).exists()
        and (folder / f"{name}_disc_reference.json").exists()
    ]


def how_to_render_disc(scenes: Sequence[str], spp: Sequence[int], folder: Path | None = None) -> str:
    """Return the command that renders scenes through the disc lens."""
    return f"{how_to_render(scenes, spp, folder)} --aperture disc"
