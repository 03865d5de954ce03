"""From planes to images on a GPU: ``native/cuda/multiplane_render.cu``, launched."""

from __future__ import annotations

from dataclasses import astuple, replace
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
from fewrays.multiplane.smoothing import Smoothing
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
        "first_maps": "*i4",
        "shifts": "*i4",
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
    (cells, factor): Kernel(
        "multiplane_render",
        f"multiplane_smooth_{cells}_{factor}",
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
            "end": "i4",
        },
    )
    for cells, factor in ((1, 1), (2, 1), (2, 2), (3, 1))
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
    smoothing = Smoothing.of_views(seen.shear.slope, seen.grid.cells, where, options.smoothing)
    shrink = shrink_of(seen.shear.slope, smoothing.variance, where)
    # The kernel knows smoothed planes by their addresses alone: they must last until it is launched.
    sources, smoothed = _smooth(machine, planes, smoothing)
    looked_at = replace(seen, grid=replace(seen.grid, cells=smoothing.cells))
    image = machine.xp.empty((seen.height, seen.width, 4), np.float32)
    machine.launch(
        _RENDER,
        (-(-seen.width // _TILE), -(-seen.height // _TILE), 1),
        planes=machine.on_device(plane_records(looked_at), np.int32),
        shrink=machine.on_device(shrink, np.float32),
        reach=machine.on_device(_reach(seen, shrink, where), np.float32),
        sources=machine.on_device(sources, np.uint64),
        first_maps=machine.on_device(planes.first_map[:-1], np.int32),
        shifts=machine.on_device(np.where(smoothing.cells < smoothing.built, 2, 0), np.int32),
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
    machine: Machine, planes: DevicePlanes, smoothing: Smoothing
) -> tuple[npt.NDArray[np.uint64], Any]:
    """Smooth the planes that ask for it; return where each one's blocks are, (K,), and the smoothed ones."""
    map_bytes = 2 * MAP_CELLS * CHANNELS
    sources = (machine.address(planes.texels) + planes.first_map[:-1] * map_bytes).astype(np.uint64)
    records = machine.on_device(plane_records(planes.outline), np.int32)
    sigma = machine.on_device(smoothing.sigma, np.float32)
    blocks = np.diff(planes.first_block)
    maps = np.where(smoothing.sigma > 0, blocks * smoothing.cells.astype(np.int64) ** 2, 0)
    places = np.cumsum(maps) - maps
    smoothed = machine.xp.empty((int(maps.sum()), MAP_CELLS, CHANNELS), np.uint16)
    for first, end in _runs(smoothing):
        built, cells = int(smoothing.built[first]), int(smoothing.cells[first])
        first_block, end_block = int(planes.first_block[first]), int(planes.first_block[end])
        machine.launch(
            _SMOOTH[built, built // cells],
            (end_block - first_block, 1, 1),
            planes=records,
            slots=planes.slots,
            blocks=planes.blocks,
            sigma=sigma,
            built=planes.texels,
            smoothed=smoothed[int(places[first]) :],
            count=len(sources),
            first_block=first_block,
            end=end_block,
        )
        sources[first:end] = (machine.address(smoothed) + places[first:end] * map_bytes).astype(np.uint64)
    return sources, smoothed


def _runs(smoothing: Smoothing) -> list[tuple[int, int]]:
    """Return the first and the end of runs of planes that are smoothed in one way."""
    kind = np.where(smoothing.sigma > 0, 4 * smoothing.built + smoothing.cells, 0)
    borders = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    return [(first, end) for first, end in pairwise(borders) if end > first and kind[first] > 0]
