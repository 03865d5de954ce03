"""A view's samples in a card's memory, sorted into cells: ``SortedView`` in ``native/cuda/location.h``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.temporal.plan import Plan

__all__ = ["GRID_FIELDS", "MOST_BANDS", "VIEW_FIELDS", "DeviceView"]

MOST_BANDS = 8
"""Bands of blur that kernels have room for."""

GRID_FIELDS = {"left": "f4", "top": "f4", "side": "f4", "columns": "i4", "rows": "i4"}
"""``CellGrid``, as `fewrays.cuda.kernel.Kernel` describes it."""

_RULE = ("radius", "along_lens", "along_time", "tolerance", "tent", "overhang")

VIEW_FIELDS = {
    "sorted": "*i4",
    "starts": "*u4",
    **GRID_FIELDS,
    **dict.fromkeys(_RULE, "f4"),
    "u": "f4",
    "v": "f4",
}
"""``SortedView``."""


@dataclass(frozen=True, eq=False)
class DeviceView:
    """All samples as a view sees them.

    Parameters
    ----------
    arguments : dict
        What kernels take, by `VIEW_FIELDS`.
    band_starts : ndarray, (MOST_BANDS,)
        Least slopes of the bands of blur, in size; infinite for those that are not used.
    """

    arguments: dict[str, Any]
    band_starts: npt.NDArray[np.float64]

    @classmethod
    def of_plan(cls, plan: Plan, number: int, grid: dict[str, Any], ordered: Any, starts: Any) -> DeviceView:
        """Describe view `number` of a plan: `ordered` samples, and where those of each cell begin."""
        u, v = plan.locations.uv[number]
        rule = {name: getattr(plan.rule, name) for name in _RULE}
        band_starts = np.full(MOST_BANDS, np.inf)
        band_starts[: len(plan.band_starts)] = plan.band_starts
        return cls({"sorted": ordered, "starts": starts, **grid, **rule, "u": u, "v": v}, band_starts)
