"""Planes as the preparation of the multiplane method: built once, rendered for any number of lenses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from fewrays.cuda.device import pick_device
from fewrays.cuda.samples import DeviceSamples
from fewrays.lens import Lens
from fewrays.method import Preparation, Reconstruction
from fewrays.multiplane import engine
from fewrays.multiplane.build import BuildOptions
from fewrays.multiplane.cuda.planes import DevicePlanes
from fewrays.multiplane.planes import Multiplane
from fewrays.multiplane.render import RenderOptions
from fewrays.parallel import Execution
from fewrays.samples import SampleBuffer

__all__ = ["PREPARATION", "PreparedPlanes"]

_MIB = 2**20


@dataclass(frozen=True, eq=False)
class PreparedPlanes:
    """Planes in the shape of `fewrays.method.Prepared`."""

    planes: Multiplane

    @property
    def lens(self) -> Lens:
        """The lens of the samples."""
        return self.planes.lens

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.planes.height

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.planes.width

    def reconstruct(self, lens: Lens, options: RenderOptions, execution: Execution) -> Reconstruction:
        """Render the planes through a lens."""
        return Reconstruction(engine.render(self._planes_on(execution.device), lens, options, execution))

    def _planes_on(self, device: str) -> engine.AnyPlanes:
        """Return the planes where an image of them is made; they are copied once."""
        return self._on_card if pick_device(("cpu", "cuda"), device) == "cuda" else self.planes.planes

    @cached_property
    def _on_card(self) -> DevicePlanes:
        return engine.on_card(self.planes.planes)

    def save(self, path: Path) -> None:
        """Write the planes to a file."""
        self.planes.save(path)

    def describe(self, lens: Lens) -> dict[str, str]:
        """Return how many planes there are, what they take, and where they lie through a lens."""
        maps = self.planes.maps.through(lens)
        slope, motion = maps.shear.slope, np.hypot(*maps.shear.motion.T)
        kept, places = int((maps.slots >= 0).sum()), len(maps.slots)
        per_pixel = maps.nbytes / (maps.width * maps.height)
        texts = {
            "planes": f"{maps.plane_count}, at slopes of {slope.min():.4g} to {slope.max():.4g} px",
            "cells": ", ".join(
                f"{n} x {n} a pixel on {(maps.grid.cells == n).sum()} planes"
                for n in np.unique(maps.grid.cells)
            ),
            "blocks": f"{kept:,} of {places:,} hold something ({kept / places:.1%})",
            "memory": f"{maps.nbytes / _MIB:.1f} MiB, {per_pixel:.0f} bytes a pixel",
        }
        if motion.any():
            texts["motion"] = f"on {(motion > 0).sum()} planes, up to {motion.max():.4g} px"
        return texts


def _prepare(
    samples: SampleBuffer | DeviceSamples, options: BuildOptions, execution: Execution
) -> PreparedPlanes:
    return PreparedPlanes(Multiplane(engine.build(samples, options, execution)))


def _load(path: Path) -> PreparedPlanes:
    return PreparedPlanes(Multiplane.load(path))


PREPARATION = Preparation(
    content="planes", extension=".planes", options=BuildOptions, prepare=_prepare, load=_load
)
"""Building planes, and reading them from a file."""
