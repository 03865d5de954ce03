"""The layered method on a GPU: ``native/cuda/layered.cu``, launched.

The whole image is one tile: a layer has one slope, the mean of all its samples, where the processor's kernels
take that of the samples around each tile. One layer is made and composited after the other, so that the card
holds the bins of one layer at a time. The host waits once, for the slopes of the layers.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.layered.plan import FINEST_BY_PLACE, FULL_WEIGHT, SEEN, Plan
from fewrays.layered.reference import blur_variance
from fewrays.layered.taps import gaussian_taps, tap_count

if TYPE_CHECKING:
    from fewrays.layered import LayeredOptions

__all__ = ["KERNELS", "reconstruct_image"]

_SAMPLES_EACH = 16  # that a thread assigns to layers
_SLOPE_UNIT = 2.0**16
_BIN_CHANNELS = 6
_TALLY = np.dtype([("slopes", "i8"), ("count", "u4"), ("unused", "u4")])

_WINDOW = {
    "left": "f4",
    "top": "f4",
    "cell": "f4",
    "rows": "i4",
    "columns": "i4",
    "bins_per_cell": "i4",
    "radius": "i4",
}
_ASSIGN = Kernel(
    "layered",
    "layered_assign",
    256,
    {
        **SAMPLE_FIELDS,
        "boundaries": "*f4",
        "layer_of": "*i2",
        "tallies": "*u1",
        "brightest": "*u4",
        "layers": "i4",
        "height": "i4",
        "width": "i4",
        "margin": "f4",
    },
)
_SCATTER = Kernel(
    "layered",
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
_WEIGH = Kernel("layered", "layered_weigh", 256, _FILTER)
_BLUR_DOWN = Kernel("layered", "layered_blur_down", 256, _FILTER)
_BLUR_ALONG = Kernel("layered", "layered_blur_along", 256, _FILTER)
_COMPOSITE = Kernel(
    "layered",
    "layered_composite",
    256,
    {
        "map": "*f4",
        "parts": "*f4",
        "visibility": "*f4",
        "sums": "*f4",
        "part_count": "i4",
        "height": "i4",
        "width": "i4",
        "rows": "i4",
        "columns": "i4",
        "size": "i4",
        "border": "i4",
        "near": "i4",
        "slope": "f4",
        "part_sigma": "f4",
    },
)
_FINISH = Kernel("layered", "layered_finish", 256, {"sums": "*f4", "image": "*f4", "pixels": "i8"})
KERNELS = (_ASSIGN, _SCATTER, _WEIGH, _BLUR_DOWN, _BLUR_ALONG, _COMPOSITE, _FINISH)
"""All kernels of the method."""


@dataclass(frozen=True)
class _Layer:
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
    def of_plan(cls, plan: Plan, index: int, slope: float) -> _Layer:
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

    def window(self) -> dict[str, float]:
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


def reconstruct_image(machine: Machine, samples: DeviceSamples, options: LayeredOptions) -> Any:
    """Reconstruct an image.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    options : LayeredOptions
        Its tile plays no part.

    Returns
    -------
    array of float32, (H, W, 3)
        Radiance, on the card.
    """
    xp = machine.xp
    ends = machine.on_host(xp.stack([samples.depth.min(), samples.depth.max()]))
    size = (samples.height, samples.width, samples.spp)
    plan = Plan.for_depths(samples.lens, size, (float(ends[0]), float(ends[1])), **asdict(options))
    layer_of, layers, scale = _assign(machine, samples, plan)
    parts = machine.on_device(plan.aperture.parts, np.float32)
    visibility = xp.zeros((len(parts), 3, plan.height, plan.width), np.float32)
    visibility[:, 0] = 1.0
    sums = xp.zeros((4, plan.height, plan.width), np.float32)
    for layer in layers:
        layer_map = _filter(machine, samples, layer_of, plan, layer, scale)
        machine.launch(
            _COMPOSITE,
            (blocks_for(plan.height * plan.width, _COMPOSITE), 1, 1),
            map=layer_map,
            parts=parts,
            visibility=visibility,
            sums=sums,
            part_count=len(parts),
            height=plan.height,
            width=plan.width,
            rows=layer.rows,
            columns=layer.columns,
            size=layer.size,
            border=layer.border,
            near=layer.level < 0,
            slope=layer.slope,
            part_sigma=plan.aperture.sigma,
        )
    image = xp.empty((plan.height, plan.width, 3), np.float32)
    pixels = plan.height * plan.width
    machine.launch(_FINISH, (blocks_for(pixels, _FINISH), 1, 1), sums=sums, image=image, pixels=pixels)
    return image


def _assign(machine: Machine, samples: DeviceSamples, plan: Plan) -> tuple[Any, list[_Layer], float]:
    """Sort samples into layers: numbers on the card, those that there are, and a scale of radiance."""
    xp, count = machine.xp, plan.slabs.count
    layer_of = xp.empty(samples.count, np.int16)
    tallies = xp.zeros(count * _TALLY.itemsize, np.uint8)
    brightest = xp.zeros(1, np.uint32)
    machine.launch(
        _ASSIGN,
        (-(-samples.count // (_ASSIGN.threads * _SAMPLES_EACH)), 1, 1),
        boundaries=machine.on_device(plan.slabs.boundaries, np.float32),
        layer_of=layer_of,
        tallies=tallies,
        brightest=brightest,
        layers=count,
        height=plan.height,
        width=plan.width,
        margin=plan.survey_margin,
        **samples.arguments(),
    )
    found = machine.on_host(tallies).view(_TALLY)
    largest = float(machine.on_host(brightest).view(np.float32)[0])
    scale = 2.0 ** -math.frexp(largest)[1] if largest > 0 else 1.0
    layers = [
        _Layer.of_plan(
            plan, index, float(found["slopes"][index]) / _SLOPE_UNIT / float(found["count"][index])
        )
        for index in np.flatnonzero(found["count"]).tolist()
    ]
    return layer_of, layers, scale


def _filter(
    machine: Machine, samples: DeviceSamples, layer_of: Any, plan: Plan, layer: _Layer, scale: float
) -> Any:
    """Make the map of a layer, (5, rows, columns): `known`, opacity, and radiance times opacity."""
    xp = machine.xp
    rows, columns = layer.bins()
    bins = xp.zeros((rows, columns, 5), np.uint64)
    window = layer.window()
    machine.launch(
        _SCATTER,
        (blocks_for(samples.count, _SCATTER), 1, 1),
        layer_of=layer_of,
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
