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
from fewrays.temporal.cuda_view import GRID_FIELDS, MOST_BANDS, VIEW_FIELDS, DeviceView
from fewrays.temporal.plan import WIDEST, Plan
from fewrays.temporal.relighting_cuda import Relighting

__all__ = ["KERNELS", "reconstruct_bands"]

_MOST_CELLS = 2**26
_SEEN_NUMBERS = 6  # of a sample as a view sees it

_SORTED = {
    "seen": "*i4",
    "starts": "*u4",
    "taken": "*u4",
    "order": "*i4",
    "sorted": "*i4",
    **GRID_FIELDS,
    "samples": "i4",
}
_PROJECT = Kernel(
    "temporal",
    "temporal_project",
    256,
    {**SAMPLE_FIELDS, "seen": "*i4", "counts": "*u4", **GRID_FIELDS, "u": "f4", "v": "f4", "at": "f4"},
)
_FILL = Kernel("temporal", "temporal_fill", 256, _SORTED)
_ARRANGE = Kernel("temporal", "temporal_arrange", 256, _SORTED)
_RESOLVE = Kernel(
    "temporal",
    "temporal_resolve",
    128,
    {
        "color": "*f4",
        "uv": "*f4",
        "bandwidth": "*f4",
        "bands": "*f4",
        "offset_x": "f4",
        "offset_y": "f4",
        "weight": "f4",
        "band_starts": f"{MOST_BANDS}f4",
        "band_count": "i4",
        "height": "i4",
        "width": "i4",
        **VIEW_FIELDS,
    },
)
KERNELS = (_PROJECT, _FILL, _ARRANGE, _RESOLVE)
"""All kernels of the method."""


def reconstruct_bands(
    machine: Machine, samples: DeviceSamples, plan: Plan, relighting: Relighting | None = None
) -> Any:
    """Add up what all pixels see, by how blurred that is, without waiting for it.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    plan : Plan
    relighting : Relighting, optional
        Lights what is seen; without it, that has the samples' own radiance.

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
    sorting = {"seen": seen, "starts": starts, "taken": counts, "order": order, "sorted": arranged}
    sorting |= {"samples": samples.count, **grid}
    for number, ((u, v), time) in enumerate(zip(where.uv, where.t, strict=True)):
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
        view = DeviceView.of_plan(plan, number, grid, arranged, starts)
        if relighting is None:
            _resolve(machine, samples, plan, number, view, bands)
        else:
            relighting.add_view(number, view, bands)
    return bands


def _resolve(
    machine: Machine, samples: DeviceSamples, plan: Plan, number: int, view: DeviceView, bands: Any
) -> None:
    """Add what all pixels see in a view, as bright as samples are."""
    x, y = plan.locations.offset[number]
    machine.launch(
        _RESOLVE,
        (blocks_for(plan.height * plan.width, _RESOLVE), 1, 1),
        color=samples.color,
        uv=samples.uv,
        bandwidth=samples.bandwidth,
        bands=bands,
        offset_x=x,
        offset_y=y,
        weight=plan.locations.weight[number],
        band_starts=view.band_starts,
        band_count=len(plan.band_starts),
        height=plan.height,
        width=plan.width,
        **view.arguments,
    )


def _grid(plan: Plan) -> dict[str, Any]:
    """Lay cells as wide as R, or wider if there were too many, over all that any location looks at."""
    around = WIDEST * plan.rule.radius + float(np.abs(plan.locations.offset).max(initial=0)) + 1
    side = plan.rule.radius
    while (plan.width + 2 * around) / side * (plan.height + 2 * around) / side > _MOST_CELLS:
        side *= 2
    columns, rows = (math.ceil((size + 2 * around) / side) + 1 for size in (plan.width, plan.height))
    return {"left": -around, "top": -around, "side": side, "columns": columns, "rows": rows}
