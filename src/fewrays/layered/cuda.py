"""The layered method on a GPU: ``native/cuda/layered_*.cu``, launched.

A survey finds out which layers every block of pixels has and where its samples lie; from that, each tile of
the image gets its layers and their slopes, the same as on the processor. ``layered_tiles`` does the rest
patch by patch, in the memory that a block of threads shares. Only layers whose blur is too wide for that get
maps of the whole image beforehand (`fewrays.layered.cuda_maps`), and for them the host waits a second time;
the first is for the depths.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.layered import cuda_maps
from fewrays.layered.cuda_maps import WHOLE_MAP, WholeLayer
from fewrays.layered.plan import FINEST_BY_PLACE, FULL_WEIGHT, SEEN, Plan
from fewrays.layered.reference import TAIL, blur_variance
from fewrays.layered.regions import DEEPEST_TILE_LEVEL
from fewrays.layered.taps import TAPS_REACH, tap_count

if TYPE_CHECKING:
    from fewrays.layered import LayeredOptions

__all__ = ["KERNELS", "MOST_LAYERS", "OWN_SHARED_BYTES", "patch_side", "reconstruct_image"]

OWN_SHARED_BYTES = 12 << 10
"""Shared memory that `layered_tiles` has besides its bins, at most."""

MOST_LAYERS = 256
"""Layers that kernels have room for: more than slopes and `layer_spacing` can lead to."""

_MOST_TAPS = 16
_PATCHES = (64, 32, 16)  # sides of a patch, in pixels
_HALO = 20  # bins around a patch that the widest blur of full-size bins reads, on both sides together
_LEAST_ROWS = 2  # of a strip of a patch
_PLANES = 6  # words of a bin
_WORKERS = 1024  # blocks of threads that share out the patches, at most
_SLOPE_BITS = 30  # of a sum of slopes

_BOX = np.dtype([("extent", "f4", 4), ("brightest", "f4"), ("deepest", "i4")])
_TILE_LAYER = np.dtype([("slope", "f4"), ("count", "u4"), ("radius", "i4"), ("taps", "f4", _MOST_TAPS)])

_SURVEY = Kernel(
    "layered_survey",
    "layered_survey",
    256,
    {
        **SAMPLE_FIELDS,
        "boundaries": "*f4",
        "reaches": "*f4",
        "layer_of": "*i2",
        "boxes": "*u1",
        "counts": "*u4",
        "slopes": "*i4",
        "farthest": "*u4",
        "layers": "i4",
        "height": "i4",
        "width": "i4",
        "spp": "i4",
        "side": "i4",
        "margin": "f4",
        "slope_unit": "f4",
    },
)
_BLOCKS = {"boxes": "*u1", "farthest": "*u4", "side": "i4", "block_rows": "i4", "block_columns": "i4"}
_NEAR = Kernel(
    "layered_survey",
    "layered_near",
    512,
    {
        **_BLOCKS,
        "survey_padding": "i4",
        "counts": "*u4",
        "slopes": "*i4",
        "reaches": "*f4",
        "levels": "*i4",
        "tile_layers": "*u1",
        "brightest": "*f4",
        "layer_counts": "*i4",
        "pixel_variance": "f8",
        "aperture_variance": "f8",
        "part_variance": "f8",
        "interpolation": "f8",
        "layers": "i4",
        "tile": "i4",
        "tile_columns": "i4",
        "part_reach": "f4",
        "tail": "f4",
        "slope_unit": "f4",
    },
)
_TILES = Kernel(
    "layered_tiles",
    "layered_tiles",
    480,
    {
        **SAMPLE_FIELDS,
        **_BLOCKS,
        "survey_padding": "i4",
        "layer_of": "*i2",
        "counts": "*u4",
        "levels": "*i4",
        "reaches": "*f4",
        "tile_layers": "*u1",
        "brightest": "*f4",
        "whole": "*u1",
        "maps": "*f4",
        "parts": "*f4",
        "behind": "*f4",
        "image": "*f4",
        "contributions": "*f4",
        "layers": "i4",
        "part_count": "i4",
        "height": "i4",
        "width": "i4",
        "spp": "i4",
        "tile": "i4",
        "patch": "i4",
        "workers": "i4",
        "words": "i4",
        "finest_by_place": "i4",
        "part_sigma": "f4",
        "farthest_part": "f4",
        "full_weight": "f4",
        "seen": "f4",
    },
)
KERNELS = (_SURVEY, _NEAR, *cuda_maps.KERNELS, _TILES)
"""All kernels of the method."""


@dataclass(frozen=True, eq=False)
class _Survey:
    """What the card knows of blocks of pixels, in the names of ``SurveyArguments``."""

    side: int
    rows: int
    columns: int
    boxes: Any
    counts: Any  # (blocks, layers)
    slopes: Any  # (blocks, layers)
    farthest: Any
    layer_of: Any
    reaches: Any
    slope_unit: float

    def blocks(self) -> dict[str, Any]:
        """Return ``Survey``, and the padding behind it."""
        return {
            "boxes": self.boxes,
            "farthest": self.farthest,
            "side": self.side,
            "block_rows": self.rows,
            "block_columns": self.columns,
            "survey_padding": 0,
        }


@dataclass(frozen=True, eq=False)
class _Tiles:
    """What the card knows of tiles: ``TileLayer`` by tile and layer, largest radiance, number of layers."""

    layers: Any
    brightest: Any
    counts: Any


def reconstruct_image(
    machine: Machine, samples: DeviceSamples, options: LayeredOptions, *, aovs: bool = False
) -> tuple[Any, npt.NDArray[np.int32], Any, Plan]:
    """Reconstruct an image.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    options : LayeredOptions
    aovs : bool
        Whether to find out what each layer contributes, and wait for it.

    Returns
    -------
    image : array of float32, (H, W, 3)
        Radiance, on the card.
    counts : array of int32, (tiles,)
        Layers near each tile, on the card.
    contributions : array of float32, (H, W, layers, 4), or None
        Each layer's part of the image, radiance and opacity, on the card.
    plan : Plan
        Of the tiles and layers.
    """
    xp = machine.xp
    ends = machine.on_host(xp.stack([samples.depth.min(), samples.depth.max()]))
    size = (samples.height, samples.width, samples.spp)
    plan = Plan.for_depths(samples.lens, size, (float(ends[0]), float(ends[1])), **asdict(options))
    assert plan.slabs.count <= MOST_LAYERS
    words = (machine.shared_bytes - OWN_SHARED_BYTES) // 4
    patch = patch_side(machine.shared_bytes)
    survey = _survey(machine, samples, plan)
    tiles = _find_layers(machine, plan, survey)
    whole, maps = _whole_maps(machine, samples, plan, survey, patch, words)
    image = xp.empty((plan.height, plan.width, 3), np.float32)
    contributions = xp.zeros((plan.height, plan.width, plan.slabs.count, 4), np.float32) if aovs else None
    parts = plan.aperture.parts
    workers = min(plan.tile_count * (-(-plan.tile // patch)) ** 2, _WORKERS)
    machine.launch(
        _TILES,
        (workers, 1, 1),
        shared_bytes=4 * words,
        layer_of=survey.layer_of,
        counts=survey.counts,
        levels=machine.on_device(plan.slabs.levels, np.int32),
        reaches=survey.reaches,
        tile_layers=tiles.layers,
        brightest=tiles.brightest,
        whole=whole,
        maps=maps,
        parts=machine.on_device(parts, np.float32),
        behind=xp.empty((workers, 3 * len(parts) + 4, patch, patch), np.float32),
        image=image,
        contributions=contributions,
        layers=plan.slabs.count,
        part_count=len(parts),
        height=plan.height,
        width=plan.width,
        spp=plan.spp,
        tile=plan.tile,
        patch=patch,
        workers=workers,
        words=words,
        finest_by_place=FINEST_BY_PLACE,
        part_sigma=plan.aperture.sigma,
        farthest_part=_farthest_part(plan),
        full_weight=FULL_WEIGHT,
        seen=SEEN,
        **survey.blocks(),
        **samples.arguments(),
    )
    return image, tiles.counts, contributions, plan


def patch_side(shared_bytes: int) -> int:
    """Return the side of a patch in pixels, for the shared memory that a block can have.

    The larger, the fewer samples are read for several patches; but strips of a patch read them again as well,
    so one layer of full-size bins is to have room in one piece.
    """
    words = (shared_bytes - OWN_SHARED_BYTES) // 4
    fitting = (side for side in _PATCHES if _PLANES * (side + _HALO) * (side + _HALO + 1) <= words)
    return next(fitting, _PATCHES[-1])


def _farthest_part(plan: Plan) -> float:
    return float(np.abs(plan.aperture.parts[:, :2]).max())


def _survey(machine: Machine, samples: DeviceSamples, plan: Plan) -> _Survey:
    """Find out which layers every block of pixels has, and where its samples lie."""
    xp, side, layers = machine.xp, plan.survey_block, plan.slabs.count
    rows, columns = -(-plan.height // side), -(-plan.width // side)
    survey = _Survey(
        side=side,
        rows=rows,
        columns=columns,
        boxes=xp.empty(rows * columns * _BOX.itemsize, np.uint8),
        counts=xp.empty((rows * columns, layers), np.uint32),
        slopes=xp.empty((rows * columns, layers), np.int32),
        farthest=xp.zeros(1, np.uint32),
        layer_of=xp.empty(samples.count, np.int16),
        reaches=machine.on_device(plan.slabs.reaches, np.float32),
        slope_unit=2.0 ** (_SLOPE_BITS - math.ceil(math.log2(side * side * plan.spp))),
    )
    machine.launch(
        _SURVEY,
        (columns, rows, 1),
        boundaries=machine.on_device(plan.slabs.boundaries, np.float32),
        reaches=survey.reaches,
        layer_of=survey.layer_of,
        boxes=survey.boxes,
        counts=survey.counts,
        slopes=survey.slopes,
        farthest=survey.farthest,
        layers=layers,
        height=plan.height,
        width=plan.width,
        spp=plan.spp,
        side=side,
        margin=plan.survey_margin,
        slope_unit=survey.slope_unit,
        **samples.arguments(),
    )
    return survey


def _find_layers(machine: Machine, plan: Plan, survey: _Survey) -> _Tiles:
    """Find the layers that matter to each tile, their slopes and the taps of their blurs."""
    xp, layers = machine.xp, plan.slabs.count
    tiles = _Tiles(
        layers=xp.empty(plan.tile_count * layers * _TILE_LAYER.itemsize, np.uint8),
        brightest=xp.empty(plan.tile_count, np.float32),
        counts=xp.empty(plan.tile_count, np.int32),
    )
    machine.launch(
        _NEAR,
        (plan.tile_count, 1, 1),
        counts=survey.counts,
        slopes=survey.slopes,
        reaches=survey.reaches,
        levels=machine.on_device(plan.slabs.levels, np.int32),
        tile_layers=tiles.layers,
        brightest=tiles.brightest,
        layer_counts=tiles.counts,
        pixel_variance=plan.pixel_variance,
        aperture_variance=plan.aperture_variance,
        part_variance=plan.aperture.sigma**2,
        interpolation=plan.interpolation_variance,
        layers=layers,
        tile=plan.tile,
        tile_columns=plan.tile_columns,
        part_reach=_farthest_part(plan) + TAPS_REACH * plan.aperture.sigma,
        tail=TAIL,
        slope_unit=survey.slope_unit,
        **survey.blocks(),
    )
    return tiles


def _fits_a_patch(plan: Plan, index: int, patch: int, words: int) -> bool:
    """Return whether a layer's bins around the least strip of a patch find room, whatever its slope."""
    level, reach = int(plan.slabs.levels[index]), float(plan.slabs.reaches[index])
    if level > DEEPEST_TILE_LEVEL:
        return False
    near, size, bins = level < 0, 2 ** max(level, 0), 2 ** max(-level, 0)
    radius = tap_count(blur_variance(plan, level, reach), 0.5 if near else 0.0)
    # A cell and a tap more than the largest slope needs, for what rounding may add to it.
    around = 0 if near else math.ceil((_farthest_part(plan) * reach + 1) / size) + (size > 1) + 1
    rows, columns = ((-(-side // size) + 2 * around) * bins + 2 * radius for side in (_LEAST_ROWS, patch))
    planes = _PLANES - near
    return radius < _MOST_TAPS and planes * rows * (columns + 1) <= words


def _whole_maps(
    machine: Machine, samples: DeviceSamples, plan: Plan, survey: _Survey, patch: int, words: int
) -> tuple[Any, Any]:
    """Make maps of the whole image for layers that no patch has room for: ``WholeMap`` of all, and values."""
    table = np.zeros(plan.slabs.count, WHOLE_MAP)
    too_wide = [index for index in range(plan.slabs.count) if not _fits_a_patch(plan, index, patch, words)]
    made: list[Any] = []
    if too_wide:
        of_layers = machine.xp.stack(
            [survey.counts[:, too_wide].sum(0, np.int64), survey.slopes[:, too_wide].sum(0, np.int64)]
        )
        brightest = survey.boxes.view(np.float32).reshape(-1, _BOX.itemsize // 4)[:, 4].max()
        counts, slopes = machine.on_host(of_layers)
        maker = cuda_maps.MapMaker(machine, samples, plan, survey.layer_of, float(machine.on_host(brightest)))
        first = 0
        for index, count, slope in zip(too_wide, counts.tolist(), slopes.tolist(), strict=True):
            mean = slope / survey.slope_unit * float(plan.slabs.reaches[index]) / max(count, 1)
            layer = WholeLayer.of_plan(plan, index, mean)
            table[index] = (first, layer.rows, layer.columns, layer.border, 0)
            if count:
                made.append(maker.make(layer).ravel())
                first += made[-1].size
    values = machine.xp.concatenate(made) if made else machine.xp.empty(0, np.float32)
    return machine.on_device(table.view(np.uint8), np.uint8), values
