"""Planes of samples, and the blocks that they touch: ``native/cuda/multiplane_assign.cu``, launched.

The host waits for the card three times, for how much memory is to be taken: it must know which planes there
are, where they stand, and how many blocks they have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.multiplane.cuda.planes import plane_records
from fewrays.multiplane.maps import BLOCK, Grid, Maps, Shear
from fewrays.multiplane.slabs import FARTHEST, MOST_PLANES, Assignment, SlabRule

__all__ = ["KERNELS", "Assigned", "Marked", "assign", "mark", "outline"]

Int64 = npt.NDArray[np.int64]

_TILE = 32  # cells of a tile's side
_MOST_KEYS = 2**28  # that are counted one by one
_MEANS_EACH = 16  # samples of a thread
_MEAN_UNIT = 2.0**16

_KEYS = Kernel(
    "multiplane_assign",
    "multiplane_keys",
    256,
    {
        **SAMPLE_FIELDS,
        "thickness": "f8",
        "linear_to": "f8",
        "most_blur": "f8",
        "motion_cell": "f8",
        "farthest": "f8",
        "exact_c0": "f8",
        "exact_c1": "f8",
        "keys": "*i8",
        "seen": "*f4",
        "present": "*u1",
        "first_slab": "i4",
        "middle": "i4",
        "side": "i4",
    },
)
_MEANS = Kernel(
    "multiplane_assign",
    "multiplane_means",
    256,
    {
        "keys": "*i8",
        "plane_keys": "*i8",
        "seen": "*f4",
        "tallies": "*u8",
        "samples": "i8",
        "count": "i4",
        "unused": "i4",
    },
)
_MARK = Kernel(
    "multiplane_assign",
    "multiplane_mark",
    256,
    {
        **SAMPLE_FIELDS,
        "planes": "*i4",
        "keys": "*i8",
        "plane_keys": "*i8",
        "ranks": "*i2",
        "plane_of": "*i2",
        "places": "*f4",
        "marks": "*u1",
        "brightest": "*u4",
        "count": "i4",
        "most_blur": "f4",
    },
)
_TILES = Kernel(
    "multiplane_assign",
    "multiplane_tiles",
    256,
    {"planes": "*i4", "first_tile": "*i4", "marks": "*u1", "kept": "*u1", "count": "i4", "tiles": "i4"},
)
KERNELS = (_KEYS, _MEANS, _MARK, _TILES)
"""All kernels of the step."""


@dataclass(frozen=True, eq=False)
class Assigned:
    """Planes, and how to find that of a sample.

    Parameters
    ----------
    keys, plane_keys : array of int64, (N,) and (K,)
        Of samples, and of planes in their own order.
    ranks : array of int16, (K,)
        Number of each such plane in the order of `assignment`.
    assignment : Assignment
        Slope and motion of the planes; its ``plane_of`` is empty.
    """

    keys: Any
    plane_keys: Any
    ranks: Any
    assignment: Assignment


def assign(machine: Machine, samples: DeviceSamples, rule: SlabRule) -> Assigned:
    """Sort samples into planes."""
    xp = machine.xp
    moving = samples.motion is not None
    first_slab, last_slab = rule.index(-rule.most_blur), rule.index(rule.most_blur)
    middle = math.ceil(FARTHEST / rule.motion_cell) + 1 if moving else 0
    side = 2 * middle + 1
    count = int(last_slab - first_slab + 1) * side**2
    keys, seen = xp.empty(samples.count, np.int64), xp.empty((samples.count, 3), np.float32)
    present = xp.zeros(count, np.uint8) if count <= _MOST_KEYS else None
    machine.launch(
        _KEYS,
        (blocks_for(samples.count, _KEYS), 1, 1),
        thickness=rule.thickness,
        linear_to=rule.linear_to,
        most_blur=rule.most_blur,
        motion_cell=rule.motion_cell,
        farthest=FARTHEST,
        exact_c0=samples.lens.c0,
        exact_c1=samples.lens.c1,
        keys=keys,
        seen=seen,
        present=present,
        first_slab=int(first_slab),
        middle=middle,
        side=side,
        **samples.arguments(),
    )
    found = xp.unique(keys) if present is None else xp.flatnonzero(present)
    numbers = np.asarray(machine.on_host(found), np.int64)
    numbers = numbers[numbers >= 0]
    if len(numbers) == 0:  # all samples were dropped: one plane that holds nothing
        numbers = np.array([(-int(first_slab) * side + middle) * side + middle], np.int64)
    if len(numbers) > MOST_PLANES:
        return assign(machine, samples, replace(rule, motion_cell=2 * rule.motion_cell))
    plane_keys = machine.on_device(numbers, np.int64)
    tallies = xp.zeros((len(numbers), 4), np.uint64)
    machine.launch(
        _MEANS,
        (-(-samples.count // (_MEANS.threads * _MEANS_EACH)), 1, 1),
        keys=keys,
        plane_keys=plane_keys,
        seen=seen,
        tallies=tallies,
        samples=samples.count,
        count=len(numbers),
        unused=0,
    )
    sums = machine.on_host(tallies).view(np.int64)
    means = sums[:, 1:] / _MEAN_UNIT / np.maximum(sums[:, :1], 1)
    order = np.argsort(means[:, 0], kind="stable")
    ranks = machine.on_device(np.argsort(order), np.int16)
    kept = int(sums[:, 0].sum())
    planes = Assignment(np.zeros(0, np.int16), means[order, 0], means[order, 1:], kept)
    return Assigned(keys, plane_keys, ranks, planes)


@dataclass(frozen=True, eq=False)
class Marked:
    """Planes, and what of them samples touch.

    Parameters
    ----------
    plane_of : array of int16, (N,)
    places : array of float32, (N, 2)
        Where the lens centre sees each sample's surface at half time.
    slots : array of int32
        As of `DevicePlanes`.
    first_tile : array of int32, (K,)
        Of each plane, among all places for tiles.
    tile_of, tiles : array of int32
        Number of each place's tile among those kept, or -1; and places of those.
    first_block, first_map, first_kept : ndarray of int64, (K + 1,)
        First block, map and kept tile of each plane, and the end.
    brightest : ndarray of float32, (K,)
        Largest radiance of each plane, in size.
    """

    plane_of: Any
    places: Any
    slots: Any
    first_tile: Any
    tile_of: Any
    tiles: Any
    first_block: Int64
    first_map: Int64
    first_kept: Int64
    brightest: npt.NDArray[np.float32]


def outline(samples: DeviceSamples, shear: Shear, grid: Grid, scale: npt.NDArray[np.float64]) -> Maps:
    """Return planes without blocks."""
    slots, halves = np.zeros(0, np.int32), np.zeros(0, np.uint16)
    return Maps(samples.height, samples.width, samples.lens, shear, grid, slots, halves, scale)


def mark(
    machine: Machine,
    samples: DeviceSamples,
    assigned: Assigned,
    shear: Shear,
    grid: Grid,
    most_blur: float,
) -> Marked:
    """Find the blocks and tiles of planes that samples touch, and number them."""
    xp, planes = machine.xp, len(shear.slope)
    records = machine.on_device(plane_records(outline(samples, shear, grid, np.ones(planes))), np.int32)
    plane_of = xp.empty(samples.count, np.int16)
    places = xp.empty((samples.count, 2), np.float32)
    marks, brightest = xp.zeros(grid.slot_count, np.uint8), xp.zeros(planes, np.uint32)
    machine.launch(
        _MARK,
        (blocks_for(samples.count, _MARK), 1, 1),
        planes=records,
        keys=assigned.keys,
        plane_keys=assigned.plane_keys,
        ranks=assigned.ranks,
        plane_of=plane_of,
        places=places,
        marks=marks,
        brightest=brightest,
        count=planes,
        most_blur=most_blur,
        **samples.arguments(),
    )
    first_tile = _first_tile(grid)
    on_card = machine.on_device(first_tile[:-1], np.int32)
    kept = xp.empty(int(first_tile[-1]), np.uint8)
    machine.launch(
        _TILES,
        (blocks_for(len(kept), _TILES), 1, 1),
        planes=records,
        first_tile=on_card,
        marks=marks,
        kept=kept,
        count=planes,
        tiles=len(kept),
    )
    squares = np.repeat(grid.cells.astype(np.int32) ** 2, grid.shape.prod(axis=1))
    maps_before = _before(xp, xp.where(marks > 0, machine.on_device(squares, np.int32), 0))
    blocks_before, tiles_before = _before(xp, marks), _before(xp, kept)
    # One transfer tells the host of all of these.
    place_ends = machine.on_device(np.append(grid.first_slot, grid.slot_count), np.int64)
    tile_ends = machine.on_device(first_tile, np.int64)
    ends = machine.on_host(
        xp.stack([blocks_before[place_ends], maps_before[place_ends], tiles_before[tile_ends]])
    )
    return Marked(
        plane_of,
        places,
        xp.where(marks > 0, maps_before[:-1], -1).astype(np.int32),
        on_card,
        xp.where(kept > 0, tiles_before[:-1], -1).astype(np.int32),
        xp.flatnonzero(kept).astype(np.int32),
        ends[0],
        ends[1],
        ends[2],
        machine.on_host(brightest).view(np.float32),
    )


def _first_tile(grid: Grid) -> Int64:
    """First place for a tile of each plane, and the end, (K + 1,)."""
    columns, rows = grid.shape.T.astype(np.int64)
    down = -(-rows * BLOCK[0] * grid.cells // _TILE)
    return np.concatenate([[0], np.cumsum(down * columns * BLOCK[1] * grid.cells // _TILE)])


def _before(xp: Any, numbers: Any) -> Any:
    """Return the sums of the numbers before each, and of all, (N + 1,)."""
    sums = xp.zeros(len(numbers) + 1, np.int64)
    sums[1:] = xp.cumsum(numbers, dtype=np.int64)
    return sums
