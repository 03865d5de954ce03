"""From samples to planes on a GPU: ``native/cuda/multiplane_build.cu``, launched."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.multiplane.build import (
    BuildOptions,
    beyond_memory,
    extents,
    radiance_scale,
    rays_along_edges,
)
from fewrays.multiplane.cuda.assign import Marked, assign, mark, outline
from fewrays.multiplane.cuda.planes import CHANNELS, MAP_CELLS, DevicePlanes, plane_records
from fewrays.multiplane.maps import BLOCK, Maps

__all__ = ["KERNELS", "build_planes"]

Int64 = npt.NDArray[np.int64]

_TILE_SUMS = 341  # neighbourhoods of a tile, in all levels
_CELLS = BLOCK[0] * BLOCK[1]  # of a map
_MOST_EVIDENCE = 2**31  # bytes that the sums of planes which are made at once should take
_EVIDENCE_BYTES = 36  # of a cell
_MOST_UNITS = 20  # bits behind the point of a ray's weight

_EVIDENCE_FIELDS = {
    "passes": "*u4",
    "hits": "*u8",
    "first_plane": "i4",
    "end_plane": "i4",
    "first_map": "i8",
    "pass_unit": "f4",
    "prior": "f4",
}
_ESTIMATE_FIELDS = {
    "planes": "*i4",
    "slots": "*i4",
    "first_tile": "*i4",
    "tile_of": "*i4",
    "tiles": "*i4",
    "along": "*f4",
    "sums": "*f4",
    "texels": "*u2",
    **_EVIDENCE_FIELDS,
    "count": "i4",
    "first_kept": "i4",
}
_GATHER = Kernel(
    "multiplane_build",
    "multiplane_evidence",
    256,
    {
        **SAMPLE_FIELDS,
        "planes": "*i4",
        "slots": "*i4",
        "plane_of": "*i2",
        "places": "*f4",
        **_EVIDENCE_FIELDS,
    },
)
_SUMS = Kernel("multiplane_build", "multiplane_sums", 256, _ESTIMATE_FIELDS)
_ESTIMATE = Kernel("multiplane_build", "multiplane_estimate", 256, _ESTIMATE_FIELDS)
_ESTIMATE_EDGES = Kernel("multiplane_build", "multiplane_estimate_edges", 256, _ESTIMATE_FIELDS)
KERNELS = (_GATHER, _SUMS, _ESTIMATE, _ESTIMATE_EDGES)
"""All kernels of the step."""


def build_planes(machine: Machine, samples: DeviceSamples, options: BuildOptions) -> DevicePlanes:
    """Make planes of samples; see `fewrays.Multiplane.build`.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    options : BuildOptions

    Returns
    -------
    DevicePlanes
    """
    rule = options.slab_rule(samples)
    planes = assign(machine, samples, rule)
    shear, grid = extents(planes.assignment, samples, options)
    marked = mark(machine, samples, planes, shear, grid, rule.most_blur)
    coarse = beyond_memory(shear, grid, np.diff(marked.first_block), options)
    if coarse.any():
        grid = replace(grid, cells=np.where(coarse, 1, grid.cells).astype(np.int32))
        marked = mark(machine, samples, planes, shear, grid, rule.most_blur)
    empty = outline(samples, shear, grid, radiance_scale(marked.brightest))
    # The host waits now, so that it need not for every image.
    known = replace(empty, slots=machine.on_host(marked.slots))
    texels = machine.xp.zeros((int(marked.first_map[-1]), MAP_CELLS, CHANNELS), np.uint16)
    _estimate(machine, samples, known, marked, options, texels)
    return DevicePlanes(known, marked.slots, texels, marked.first_map)


def _estimate(
    machine: Machine,
    samples: DeviceSamples,
    planes: Maps,
    marked: Marked,
    options: BuildOptions,
    texels: Any,
) -> None:
    """Make opacity and radiance of cells, some planes at a time."""
    xp = machine.xp
    records = machine.on_device(plane_records(planes), np.int32)
    along = rays_along_edges(planes.shear, planes.grid, options)
    along_on_card = machine.on_device(along, np.float32)
    # Any cell can hold 16 times as many rays as there are in a pixel, and those of 4096 pixels at 1 spp.
    pass_unit = 2.0 ** min(_MOST_UNITS, 28 - math.ceil(math.log2(samples.spp)))
    for first, end in _groups(marked.first_map):
        first_map = int(marked.first_map[first])
        cells = (int(marked.first_map[end]) - first_map) * _CELLS
        evidence = {
            "passes": xp.zeros(cells, np.uint32),
            "hits": xp.zeros((cells, 4), np.uint64),
            "first_plane": first,
            "end_plane": end,
            "first_map": first_map,
            "pass_unit": pass_unit,
            "prior": options.prior,
        }
        machine.launch(
            _GATHER,
            (blocks_for(samples.count, _GATHER), 1, 1),
            planes=records,
            slots=marked.slots,
            plane_of=marked.plane_of,
            places=marked.places,
            **samples.arguments(),
            **evidence,
        )
        for first_alike, end_alike in _alike(along[first:end] > 0):
            first_kept = int(marked.first_kept[first + first_alike])
            tiles = int(marked.first_kept[first + end_alike]) - first_kept
            work = {
                "planes": records,
                "slots": marked.slots,
                "first_tile": marked.first_tile,
                "tile_of": marked.tile_of,
                "tiles": marked.tiles,
                "along": along_on_card,
                "sums": xp.empty((tiles, _TILE_SUMS, 5), np.float32),
                "texels": texels,
                "count": planes.plane_count,
                "first_kept": first_kept,
                **evidence,
            }
            machine.launch(_SUMS, (tiles, 1, 1), **work)
            estimate = _ESTIMATE_EDGES if along[first + first_alike] > 0 else _ESTIMATE
            machine.launch(estimate, (tiles, 1, 1), **work)


def _groups(first_map: Int64) -> list[tuple[int, int]]:
    """Planes [first, end) whose sums together take a bounded part of memory, one plane at least."""
    most = _MOST_EVIDENCE // (_EVIDENCE_BYTES * _CELLS)
    groups, first = [], 0
    while first < len(first_map) - 1:
        end = int(np.searchsorted(first_map, first_map[first] + most, side="right")) - 1
        end = max(end, first + 1)
        groups.append((first, end))
        first = end
    return groups


def _alike(values: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Cut values into runs [first, end) of equal ones."""
    return list(pairwise([0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]))
