"""From planes to images on a GPU: ``native/cuda/multiplane_render.cu``, launched."""

from __future__ import annotations

from dataclasses import astuple
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.lens import Lens
from fewrays.multiplane.cuda.planes import CHANNELS, MAP_CELLS, DevicePlanes
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.render import RenderOptions, shrink_of
from fewrays.multiplane.smoothing import smoothing_of
from fewrays.temporal.locations import Locations

__all__ = ["KERNELS", "plane_records", "render_planes"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

_TILE = 32
_RENDER = Kernel(
    "multiplane_render",
    "multiplane_render",
    256,
    {
        "planes": "*i4",
        "shrink": "*f4",
        "reach": "*f4",
        "sources": "*u8",
        "slots": "*i4",
        "views": "*f4",
        "image": "*f4",
        "rim": "5f4",
        "count": "i4",
        "view_count": "i4",
        "height": "i4",
        "width": "i4",
        "vignetted": "i4",
        "darken": "i4",
    },
)
_SMOOTH = {
    cells: Kernel(
        "multiplane_render",
        f"multiplane_smooth_{cells}",
        256,
        {
            "planes": "*i4",
            "slots": "*i4",
            "blocks": "*i4",
            "sigma": "*f4",
            "built": "*u2",
            "smoothed": "*u2",
            "count": "i4",
            "first_block": "i4",
            "first_slot": "i4",
            "place": "i4",
        },
    )
    for cells in (1, 2, 3)
}
KERNELS = (_RENDER, *_SMOOTH.values())
"""All kernels of the step."""


def render_planes(machine: Machine, planes: DevicePlanes, lens: Lens | None, options: RenderOptions) -> Any:
    """Make an image, without waiting for it.

    Parameters
    ----------
    machine : Machine
    planes : DevicePlanes
    lens : Lens, optional
        As for `fewrays.Multiplane.render`.
    options : RenderOptions

    Returns
    -------
    array of float32, (H, W, 4)
        On the card: radiance, and the share of the light whose origin the planes know.
    """
    seen = planes.outline.through(lens or planes.outline.lens)
    where = options.locations(seen.lens)
    rim = options.vignetting().front_rim(where.uv, seen.height, seen.width)
    sigma = smoothing_of(seen.shear.slope, where, options.smoothing)
    shrink = shrink_of(seen.shear.slope, seen.grid.cells, sigma, where)
    records = machine.on_device(plane_records(seen), np.int32)
    # The kernel knows smoothed planes by their addresses alone: they must last until it is launched.
    sources, smoothed = _smooth(machine, planes, records, sigma)
    image = machine.xp.empty((seen.height, seen.width, 4), np.float32)
    machine.launch(
        _RENDER,
        (-(-seen.width // _TILE), -(-seen.height // _TILE), 1),
        planes=records,
        shrink=machine.on_device(shrink, np.float32),
        reach=machine.on_device(_reach(seen, shrink, where), np.float32),
        sources=machine.on_device(sources, np.uint64),
        slots=planes.slots,
        views=machine.on_device(np.column_stack([where.uv, where.t, where.offset, where.weight]), np.float32),
        image=image,
        rim=astuple(rim),
        count=seen.plane_count,
        view_count=where.count,
        height=seen.height,
        width=seen.width,
        vignetted=options.cats_eye > 0,
        darken=options.darken,
    )
    del smoothed
    return image


def plane_records(maps: Maps) -> npt.NDArray[np.int32]:
    """Return planes as ``DepthPlane`` in ``native/math/depth_plane.h`` has them, as bits, (K, 10)."""
    shears = np.column_stack([maps.shear.slope, maps.shear.motion, maps.scale]).astype(np.float32)
    grids = [maps.grid.cells, maps.grid.corner, maps.grid.shape, maps.grid.first_slot]
    return np.column_stack([shears.view(np.int32), *grids]).astype(np.int32)


def _reach(maps: Maps, shrink: Float64, where: Locations) -> Float64:
    """Return pixels (K,) that no view shifts a plane beyond."""
    offset, lens = (np.abs(values).max(axis=0) for values in (where.offset, where.uv))
    since = np.abs(where.t - 0.5).max()
    shift = shrink[:, None] * (offset + np.abs(maps.shear.slope)[:, None] * lens)
    farthest: Float64 = (shift + np.abs(maps.shear.motion) * since).max(axis=1)
    return farthest


def _smooth(
    machine: Machine, planes: DevicePlanes, records: Any, sigma: Float64
) -> tuple[npt.NDArray[np.uint64], Any]:
    """Smooth the planes that ask for it; return where each one's blocks are numbered from (K,), and copies.

    Blocks keep their numbers: a smoothed copy of planes lies as they do, and its address is that of the map
    that would be the first of all.
    """
    sources = np.full(len(sigma), machine.address(planes.texels), np.uint64)
    deviation = machine.on_device(sigma, np.float32)
    map_bytes = 2 * MAP_CELLS * CHANNELS
    runs = list(_runs(planes.outline, sigma))
    count = sum(int(planes.first_map[end] - planes.first_map[first]) for first, end in runs)
    smoothed = machine.xp.empty((count, MAP_CELLS, CHANNELS), np.uint16)
    place = 0
    for first, end in runs:
        first_map, first_block = int(planes.first_map[first]), int(planes.first_block[first])
        machine.launch(
            _SMOOTH[int(planes.outline.grid.cells[first])],
            (int(planes.first_block[end]) - first_block, 1, 1),
            planes=records,
            slots=planes.slots,
            blocks=planes.blocks,
            sigma=deviation,
            built=planes.texels,
            smoothed=smoothed,
            count=len(sigma),
            first_block=first_block,
            first_slot=first_map,
            place=place,
        )
        sources[first:end] = np.uint64(machine.address(smoothed) + (place - first_map) * map_bytes)
        place += int(planes.first_map[end]) - first_map
    return sources, smoothed


def _runs(maps: Maps, sigma: Float64) -> list[tuple[int, int]]:
    """Return the first and the end of runs of planes that are smoothed and have the same resolution."""
    kind = np.where(sigma > 0, maps.grid.cells, 0)
    borders = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    return [(first, end) for first, end in pairwise(borders) if end > first and kind[first] > 0]
