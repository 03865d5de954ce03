"""The layered method's native kernels, mapped over blocks and tiles by a thread pool."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.layered.plan import DEEPEST_TILE_LEVEL, FINEST_BY_PLACE, FULL_WEIGHT, MAP_MARGIN, SEEN, Plan
from fewrays.native_view import view_samples
from fewrays.parallel import Execution, map_ranges, usable_cores
from fewrays.samples import SampleBuffer

__all__ = ["reconstruct_tiles"]


def reconstruct_tiles(
    samples: SampleBuffer,
    plan: Plan,
    image: npt.NDArray[np.float32],
    counts: npt.NDArray[np.int32],
    contributions: npt.NDArray[np.float32] | None,
    execution: Execution,
) -> None:
    """Fill in the image, the number of layers of each tile and, if asked for, what each layer contributes."""
    view = view_samples(samples)
    native_plan = _native.LayeredPlan(
        tile=plan.tile,
        boundaries=plan.slabs.boundaries,
        levels=plan.slabs.levels,
        deepest_tile_level=DEEPEST_TILE_LEVEL,
        map_margin=MAP_MARGIN,
        reaches=plan.slabs.reaches,
        pixel_variance=plan.pixel_variance,
        aperture_variance=plan.aperture_variance,
        part_variance=plan.aperture.sigma**2,
        parts=plan.aperture.parts,
        interpolation=plan.interpolation_variance,
        full_weight=FULL_WEIGHT,
        seen=SEEN,
        finest_by_place=FINEST_BY_PLACE,
    )
    blocks = _survey(view, plan, native_plan, execution)
    maps = _coarse_maps(view, blocks, plan, native_plan, execution)
    threads = execution.threads or usable_cores()
    map_ranges(
        lambda first, last: _native.layered_tiles(
            view, blocks, native_plan, maps, first, last, image, counts, contributions
        ),
        plan.tile_count,
        execution,
        label="layered",
        chunk=min(max(plan.tile_count // (4 * threads), 1), 16),
    )


def _survey(
    view: _native.Samples,
    plan: Plan,
    native_plan: _native.LayeredPlan,
    execution: Execution,
) -> _native.BlockLayers:
    """Find out which layers every block of pixels has, and where its samples lie."""
    block = plan.survey_block
    shape = (-(-plan.height // block), -(-plan.width // block))
    extents = np.empty((*shape, 4), np.float32)
    counts = np.zeros((*shape, plan.slabs.count), np.int32)
    slope_sums = np.zeros((*shape, plan.slabs.count), np.float32)
    map_ranges(
        lambda first, last: _native.block_layers(
            view, native_plan, plan.survey_margin, first, last, block, extents, counts, slope_sums
        ),
        shape[0],
        execution,
        label="survey",
    )
    return _native.BlockLayers(block, extents, counts, slope_sums)


def _coarse_maps(
    view: _native.Samples,
    blocks: _native.BlockLayers,
    plan: Plan,
    native_plan: _native.LayeredPlan,
    execution: Execution,
) -> list[_native.CoarseMap]:
    """Filter the layers that are blurred enough for bins of several pixels."""
    maps = []
    for each in plan.coarse_passes():
        levels = plan.slabs.levels
        # Fresh zeros take no memory before they are written, so places that lack a layer cost nothing.
        of_pass = [
            _native.CoarseMap(int(layer), np.zeros((5, *plan.map_shape(int(levels[layer]))), np.float32))
            for layer in np.flatnonzero((levels >= each.first) & (levels <= each.last))
        ]
        if not of_pass:
            continue
        native_pass = _native.CoarsePass(
            first_level=each.first,
            last_level=each.last,
            side=each.side,
            margin=each.margin,
            columns=each.columns,
        )
        fill = partial(_native.coarse_tiles, view, blocks, native_plan, native_pass, of_pass)
        map_ranges(fill, each.rows * each.columns, execution, label="far layers", chunk=1)
        maps += of_pass
    return maps
