"""The file of planes, ``.planes``: a zip of NumPy arrays and a JSON description.

Blocks of half-precision numbers are stored deflated. Opacity is 0 or 1 in most cells, so they shrink by about
a third.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from fewrays.errors import SampleError
from fewrays.io.files import replace_files
from fewrays.lens import Lens
from fewrays.multiplane.maps import Grid, Maps, Shear

__all__ = ["load_maps", "save_maps"]


def save_maps(path: str | Path, maps: Maps) -> None:
    """Write planes to a file; see `Multiplane.save`."""
    lens = {f"lens_{name}": np.array(value) for name, value in dataclasses.asdict(maps.lens).items()}
    with replace_files(Path(path)) as [temporary], temporary.open("wb") as file:
        np.savez_compressed(
            file,
            size=np.array([maps.height, maps.width]),
            scale=np.array(maps.scale),
            slots=maps.slots,
            halves=maps.halves,
            **dataclasses.asdict(maps.shear),
            **dataclasses.asdict(maps.grid),
            **lens,
        )


def load_maps(path: str | Path) -> Maps:
    """Read planes from a file; see `Multiplane.load`."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            lens = Lens(**{f.name: stored[f"lens_{f.name}"].item() for f in dataclasses.fields(Lens)})
            shear = Shear(**{f.name: stored[f.name] for f in dataclasses.fields(Shear)})
            grid = Grid(**{f.name: stored[f.name] for f in dataclasses.fields(Grid)})
            height, width = (int(n) for n in stored["size"])
            return Maps(
                height, width, lens, shear, grid, stored["slots"], stored["halves"], float(stored["scale"])
            )
    except (OSError, KeyError, ValueError) as error:
        raise SampleError(f"holds no planes: {error}", file=path) from None
