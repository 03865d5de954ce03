"""Planes smoothed for the views that they are looked at with: the smoothing kernels, launched.

Which places for blocks a smoothed plane may reach is known to the host (`fewrays.multiplane.smoothing`), so
that nothing waits for the card. The card gives up those that next to nothing came to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.multiplane.copies import Copies, gaussians
from fewrays.multiplane.cuda.planes import CHANNELS, MAP_CELLS, DevicePlanes, plane_records
from fewrays.multiplane.maps import number_blocks

__all__ = ["KERNELS", "Smoothed", "copy_records", "smooth_planes"]

_SMOOTH = {
    (cells, factor): Kernel(
        "multiplane_render",
        f"multiplane_smooth_{cells}_{factor}",
        256,
        {
            "planes": "*i4",
            "copies": "*i4",
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
    for cells, factor in ((1, 1), (1, 2), (2, 1), (2, 2), (2, 4), (3, 1))
}
KERNELS = tuple(_SMOOTH.values())
"""All kernels of the step."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What views look at.

    Parameters
    ----------
    slots : array of int32
        Where blocks begin, of all places of the copies' grid: those of smoothed planes in `texels`, others in
        the planes' own.
    texels : array of uint16, (maps, `MAP_CELLS`, `CHANNELS`)
        The smoothed blocks.
    """

    slots: Any
    texels: Any


def smooth_planes(machine: Machine, planes: DevicePlanes, copies: Copies) -> Smoothed:
    """Smooth the planes that ask for it, without waiting for it.

    Parameters
    ----------
    machine : Machine
    planes : DevicePlanes
    copies : Copies
        Of the planes' outline, as a lens sees them.

    Returns
    -------
    Smoothed
    """
    grid, smoothing = copies.grid, copies.smoothing
    numbers, maps = number_blocks(copies.touched, grid)
    places = machine.on_device(np.maximum(numbers, copies.slots), np.int32)
    texels = machine.xp.empty((maps, MAP_CELLS, CHANNELS), np.uint16)
    touched = np.flatnonzero(copies.touched)
    ends = np.searchsorted(touched, np.append(grid.first_slot, grid.slot_count))
    work = {
        "planes": machine.on_device(plane_records(planes.outline), np.int32),
        "copies": machine.on_device(copy_records(copies), np.int32),
        "slots": planes.slots,
        "places": places,
        "blocks": machine.on_device(touched, np.int32),
        "sigma": machine.on_device(gaussians(smoothing, copies.is_halved), np.float32),
        "built": planes.texels,
        "smoothed": texels,
        "count": len(grid.cells),
    }
    factor = smoothing.built // smoothing.cells * np.where(copies.is_halved, 2, 1)
    for first, end in _runs(np.where(smoothing.sigma > 0, 16 * smoothing.built + factor, 0)):
        blocks = (int(ends[end] - ends[first]), 1, 1)
        kernel = _SMOOTH[int(smoothing.built[first]), int(factor[first])]
        machine.launch(kernel, blocks, first_block=int(ends[first]), **work)
    return Smoothed(places, texels)


def copy_records(copies: Copies) -> npt.NDArray[np.int32]:
    """Return copies as ``DepthPlane`` in ``native/math/depth_plane.h`` has them, as bits, (K, 10)."""
    return plane_records(replace(copies.maps, shear=copies.shear, grid=copies.grid))


def _runs(kind: npt.NDArray[np.integer]) -> list[tuple[int, int]]:
    """Return the first and the end of runs of planes that are smoothed in one way, and not at all where 0."""
    borders = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    return [(first, end) for first, end in pairwise(borders) if end > first and kind[first] > 0]
