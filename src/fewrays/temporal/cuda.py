"""The temporal method on a GPU: ``native/cuda/temporal.cu``, launched.

View after view: all samples are seen from the view's lens point at its time and sorted into a grid; then
every pixel resolves what it sees there. Views follow each other without a word from the host.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.temporal.plan import WIDEST, Plan

__all__ = ["KERNELS", "reconstruct_bands"]

_MOST_CELLS = 2**26
_MOST_BANDS = 8
_SEEN_NUMBERS = 6  # of a sample as a view sees it

_GRID = {"left": "f4", "top": "f4", "side": "f4", "columns": "i4", "rows": "i4"}
_SORTED = {
    "seen": "*i4",
    "starts": "*u4",
    "taken": "*u4",
    "order": "*i4",
    "sorted": "*i4",
    **_GRID,
    "samples": "i4",
}
_PROJECT = Kernel(
    "temporal",
    "temporal_project",
    256,
    {**SAMPLE_FIELDS, "seen": "*i4", "counts": "*u4", **_GRID, "u": "f4", "v": "f4", "at": "f4"},
)
_FILL = Kernel("temporal", "temporal_fill", 256, _SORTED)
_ARRANGE = Kernel("temporal", "temporal_arrange", 256, _SORTED)
_RESOLVE = Kernel(
    "temporal",
    "temporal_resolve",
    128,
    {
        "sorted": "*i4",
        "starts": "*u4",
        "color": "*f4",
        "uv": "*f4",
        "bandwidth": "*f4",
        "bands": "*f4",
        **_GRID,
        "radius": "f4",
        "along_lens": "f4",
        "along_time": "f4",
        "tolerance": "f4",
        "tent": "f4",
        "overhang": "f4",
        "u": "f4",
        "v": "f4",
        "offset_x": "f4",
        "offset_y": "f4",
        "weight": "f4",
        "band_starts": f"{_MOST_BANDS}f4",
        "band_count": "i4",
        "height": "i4",
        "width": "i4",
    },
)
KERNELS = (_PROJECT, _FILL, _ARRANGE, _RESOLVE)
"""All kernels of the method."""


def reconstruct_bands(machine: Machine, samples: DeviceSamples, plan: Plan) -> Any:
    """Add up what all pixels see, by how blurred that is, without waiting for it.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    plan : Plan

    Returns
    -------
    array of float32, (H, W, bands, 4)
    """
    xp, where = machine.xp, plan.locations
    grid = _grid(plan)
    cells = grid["columns"] * grid["rows"]
    seen = xp.empty((samples.count, _SEEN_NUMBERS), np.int32)
    arranged = xp.empty((samples.count, _SEEN_NUMBERS), np.int32)
    order = xp.empty(samples.count, np.int32)
    counts, starts = xp.zeros(cells, np.uint32), xp.zeros(cells + 1, np.uint32)
    bands = xp.zeros((plan.height, plan.width, len(plan.band_starts), 4), np.float32)
    starts_of_bands = np.full(_MOST_BANDS, np.inf)
    starts_of_bands[: len(plan.band_starts)] = plan.band_starts
    sorting = {"seen": seen, "starts": starts, "taken": counts, "order": order, "sorted": arranged}
    sorting |= {"samples": samples.count, **grid}
    for (u, v), time, (x, y), weight in zip(where.uv, where.t, where.offset, where.weight, strict=True):
        counts.fill(0)
        machine.launch(
            _PROJECT,
            (blocks_for(samples.count, _PROJECT), 1, 1),
            seen=seen,
            counts=counts,
            u=u,
            v=v,
            at=time,
            **grid,
            **samples.arguments(),
        )
        xp.cumsum(counts, dtype=np.uint32, out=starts[1:])
        counts.fill(0)
        machine.launch(_FILL, (blocks_for(samples.count, _FILL), 1, 1), **sorting)
        machine.launch(_ARRANGE, (blocks_for(cells, _ARRANGE), 1, 1), **sorting)
        machine.launch(
            _RESOLVE,
            (blocks_for(plan.height * plan.width, _RESOLVE), 1, 1),
            sorted=arranged,
            starts=starts,
            color=samples.color,
            uv=samples.uv,
            bandwidth=samples.bandwidth,
            bands=bands,
            radius=plan.rule.radius,
            along_lens=plan.rule.along_lens,
            along_time=plan.rule.along_time,
            tolerance=plan.rule.tolerance,
            tent=plan.rule.tent,
            overhang=plan.rule.overhang,
            u=u,
            v=v,
            offset_x=x,
            offset_y=y,
            weight=weight,
            band_starts=starts_of_bands,
            band_count=len(plan.band_starts),
            height=plan.height,
            width=plan.width,
            **grid,
        )
    return bands


def _grid(plan: Plan) -> dict[str, Any]:
    """Lay cells as wide as R, or wider if there were too many, over all that any location looks at."""
    around = WIDEST * plan.rule.radius + float(np.abs(plan.locations.offset).max(initial=0)) + 1
    side = plan.rule.radius
    while (plan.width + 2 * around) / side * (plan.height + 2 * around) / side > _MOST_CELLS:
        side *= 2
    columns, rows = (math.ceil((size + 2 * around) / side) + 1 for size in (plan.width, plan.height))
    return {"left": -around, "top": -around, "side": side, "columns": columns, "rows": rows}
