"""Planes smoothed for the views that they are looked at with: the smoothing kernels, launched.

Which places for blocks a smoothed plane may reach is known to the host (`fewrays.multiplane.smoothing`), so
that nothing waits for the card. The card gives up those that next to nothing came to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.multiplane.cuda.planes import CHANNELS, MAP_CELLS, DevicePlanes, plane_records
from fewrays.multiplane.maps import number_blocks
from fewrays.multiplane.smoothing import Smoothing, touched_places

__all__ = ["KERNELS", "Smoothed", "smooth_planes"]

_SMOOTH = {
    (cells, factor): Kernel(
        "multiplane_render",
        f"multiplane_smooth_{cells}_{factor}",
        256,
        {
            "planes": "*i4",
            "slots": "*i4",
            "places": "*i4",
            "blocks": "*i4",
            "sigma": "*f4",
            "built": "*u2",
            "smoothed": "*u2",
            "count": "i4",
            "first_block": "i4",
        },
    )
    for cells, factor in ((1, 1), (2, 1), (2, 2), (3, 1))
}
KERNELS = tuple(_SMOOTH.values())
"""All kernels of the step."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What views look at.

    Parameters
    ----------
    slots : array of int32
        Where blocks begin, as in `DevicePlanes`: those of smoothed planes in `texels`, others in the planes'
        own.
    texels : array of uint16, (maps, `MAP_CELLS`, `CHANNELS`)
        The smoothed blocks.
    """

    slots: Any
    texels: Any


def smooth_planes(machine: Machine, planes: DevicePlanes, smoothing: Smoothing) -> Smoothed:
    """Smooth the planes that ask for it, without waiting for it.

    Parameters
    ----------
    machine : Machine
    planes : DevicePlanes
    smoothing : Smoothing

    Returns
    -------
    Smoothed
    """
    outline, grid = planes.outline, planes.outline.grid
    wide = touched_places(outline, smoothing)
    numbers, maps = number_blocks(wide, replace(grid, cells=smoothing.cells))
    is_smoothed = np.repeat(smoothing.sigma > 0, grid.shape.prod(axis=1))
    places = machine.on_device(np.where(is_smoothed, numbers, outline.slots), np.int32)
    texels = machine.xp.empty((maps, MAP_CELLS, CHANNELS), np.uint16)
    touched = np.flatnonzero(wide)
    ends = np.searchsorted(touched, np.append(grid.first_slot, grid.slot_count))
    work = {
        "planes": machine.on_device(plane_records(outline), np.int32),
        "slots": planes.slots,
        "places": places,
        "blocks": machine.on_device(touched, np.int32),
        "sigma": machine.on_device(smoothing.sigma, np.float32),
        "built": planes.texels,
        "smoothed": texels,
        "count": outline.plane_count,
    }
    for first, end in _runs(smoothing):
        built, cells = int(smoothing.built[first]), int(smoothing.cells[first])
        blocks = (int(ends[end] - ends[first]), 1, 1)
        machine.launch(_SMOOTH[built, built // cells], blocks, first_block=int(ends[first]), **work)
    return Smoothed(places, texels)


def _runs(smoothing: Smoothing) -> list[tuple[int, int]]:
    """Return the first and the end of runs of planes that are smoothed in one way."""
    kind = np.where(smoothing.sigma > 0, 4 * smoothing.built + smoothing.cells, 0)
    borders = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    return [(first, end) for first, end in pairwise(borders) if end > first and kind[first] > 0]
