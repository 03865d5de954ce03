"""Maps of whole layers on a GPU: ``native/cuda/layered_maps.cu``, launched.

For layers that are blurred so much that no patch has room for what reaches it. Their slope is the mean of all
their samples; the processor's kernels have regions of the image instead, which are larger than most images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.layered.plan import FINEST_BY_PLACE, FULL_WEIGHT, SEEN, Plan
from fewrays.layered.reference import blur_variance
from fewrays.layered.taps import gaussian_taps, tap_count

__all__ = ["KERNELS", "WHOLE_MAP", "MapMaker", "WholeLayer"]

WHOLE_MAP = np.dtype([("first", "i8"), ("rows", "i4"), ("columns", "i4"), ("border", "i4"), ("unused", "i4")])
"""``WholeMap``: where a layer's map lies in memory; no rows where it has none."""

_BIN_CHANNELS = 6

_WINDOW = {
    "left": "f4",
    "top": "f4",
    "cell": "f4",
    "rows": "i4",
    "columns": "i4",
    "bins_per_cell": "i4",
    "radius": "i4",
}
_SCATTER = Kernel(
    "layered_maps",
    "layered_scatter",
    256,
    {
        **SAMPLE_FIELDS,
        "layer_of": "*i2",
        "bins": "*u8",
        **_WINDOW,
        "layer": "i4",
        "slope": "f4",
        "scale": "f4",
    },
)
_FILTER = {
    "bins": "*u8",
    "weighed": "*f4",
    "down": "*f4",
    "map": "*f4",
    "taps": "*f4",
    **_WINDOW,
    "by_place": "i4",
    "full_weight": "f4",
    "seen": "f4",
    "by_chance": "f4",
    "scale": "f4",
}
_WEIGH = Kernel("layered_maps", "layered_weigh", 256, _FILTER)
_BLUR_DOWN = Kernel("layered_maps", "layered_blur_down", 256, _FILTER)
_BLUR_ALONG = Kernel("layered_maps", "layered_blur_along", 256, _FILTER)
KERNELS = (_SCATTER, _WEIGH, _BLUR_DOWN, _BLUR_ALONG)
"""The kernels that make them."""


@dataclass(frozen=True)
class WholeLayer:
    """A layer, and the cells of its map.

    Parameters
    ----------
    index : int
    slope : float
        Of its samples, on average, in pixels per lens unit.
    level : int
        Bins of ``2**level`` pixels; below 0 it is near focus.
    border : int
        Pixels from the map's corner to the image's.
    rows, columns : int
        Of cells.
    taps : ndarray
        Of its blur, on one side of a cell's centre.
    """

    index: int
    slope: float
    level: int
    border: int
    rows: int
    columns: int
    taps: npt.NDArray[np.float64]

    @classmethod
    def of_plan(cls, plan: Plan, index: int, slope: float) -> WholeLayer:
        """Lay out a layer's map around the image."""
        level = int(plan.slabs.levels[index])
        size = 2 ** max(level, 0)
        around = 0
        if level >= 0:
            farthest = float(np.abs(plan.aperture.parts[:, :2]).max())
            # What splines read on all sides of the pixels that some part of the aperture sees in the image.
            wanted = math.ceil(farthest * abs(slope)) + 1 + (size if level > 0 else 0)
            around = math.ceil(wanted / size)
        variance = blur_variance(plan, level, slope)
        first = 0.5 if level < 0 else 0.0
        return cls(
            index=index,
            slope=slope,
            level=level,
            border=around * size,
            rows=math.ceil(plan.height / size) + 2 * around,
            columns=math.ceil(plan.width / size) + 2 * around,
            taps=gaussian_taps(variance, first, tap_count(variance, first)),
        )

    @property
    def size(self) -> int:
        """Side of a cell in pixels."""
        return int(2 ** max(self.level, 0))

    @property
    def bins_per_cell(self) -> int:
        """Bins along the side of a cell."""
        return int(2 ** max(-self.level, 0))

    def window(self) -> dict[str, Any]:
        """Return ``LayerWindow``."""
        return {
            "left": -self.border,
            "top": -self.border,
            "cell": self.size,
            "rows": self.rows,
            "columns": self.columns,
            "bins_per_cell": self.bins_per_cell,
            "radius": len(self.taps),
        }

    def bins(self) -> tuple[int, int]:
        """Return rows and columns of bins."""
        around = 2 * len(self.taps)
        return self.rows * self.bins_per_cell + around, self.columns * self.bins_per_cell + around


class MapMaker:
    """Makes maps of the layers of some samples, one at a time.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    plan : Plan
    layer_of : array of int16, (samples,)
        The layer of each sample, on the card.
    brightest : float
        The largest radiance in size.
    """

    def __init__(
        self, machine: Machine, samples: DeviceSamples, plan: Plan, layer_of: Any, brightest: float
    ) -> None:
        self._machine = machine
        self._samples = samples
        self._plan = plan
        self._layer_of = layer_of
        self._scale = 2.0 ** -math.frexp(brightest)[1] if brightest > 0 else 1.0

    def make(self, layer: WholeLayer) -> Any:
        """Return the map of a layer, (5, rows, columns): `known`, opacity, and radiance times opacity."""
        machine, samples, plan, scale = self._machine, self._samples, self._plan, self._scale
        xp = machine.xp
        rows, columns = layer.bins()
        bins = xp.zeros((rows, columns, 5), np.uint64)
        window = layer.window()
        machine.launch(
            _SCATTER,
            (blocks_for(samples.count, _SCATTER), 1, 1),
            layer_of=self._layer_of,
            bins=bins,
            layer=layer.index,
            slope=layer.slope,
            scale=scale,
            **window,
            **samples.arguments(),
        )
        expected = plan.spp * (layer.size / layer.bins_per_cell) ** 2
        layer_map = xp.empty((5, layer.rows, layer.columns), np.float32)
        arguments = {
            "bins": bins,
            "weighed": xp.empty((_BIN_CHANNELS, rows, columns), np.float32),
            "down": xp.empty((_BIN_CHANNELS, layer.rows, columns), np.float32),
            "map": layer_map,
            "taps": machine.on_device(layer.taps, np.float32),
            "by_place": layer.level >= FINEST_BY_PLACE,
            "full_weight": FULL_WEIGHT * expected,
            "seen": SEEN * expected,
            "by_chance": 1 - math.exp(-expected),
            "scale": scale,
            **window,
        }
        machine.launch(_WEIGH, (blocks_for(rows * columns, _WEIGH), 1, 1), **arguments)
        down = blocks_for(layer.rows * columns, _BLUR_DOWN)
        machine.launch(_BLUR_DOWN, (down, _BIN_CHANNELS, 1), **arguments)
        machine.launch(_BLUR_ALONG, (blocks_for(layer.rows * layer.columns, _BLUR_ALONG), 1, 1), **arguments)
        return layer_map
