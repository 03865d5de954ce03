"""The layered method's native kernels, mapped over blocks and tiles by a thread pool."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.layered.plan import FINEST_BY_PLACE, FULL_WEIGHT, SEEN, Plan
from fewrays.layered.regions import DEEPEST_TILE_LEVEL, CoarsePass
from fewrays.native_view import view_samples
from fewrays.parallel import Execution, map_ranges, progress_bar, usable_cores
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
    filter_passes = partial(_coarse_maps, view, blocks, plan, native_plan, execution)
    for_all = filter_passes(plan.region_plan.passes_for_all())
    threads = execution.threads or usable_cores()

    def tiles(maps: list[_native.CoarseMap], numbers: npt.NDArray[np.int32], first: int, last: int) -> None:
        _native.layered_tiles(
            view, blocks, native_plan, maps, numbers[first:last], image, counts, contributions
        )

    with progress_bar(plan.tile_count, "layered", show=execution.progress, unit="tile") as bar:
        for region in plan.region_plan.regions:
            maps = filter_passes(plan.region_plan.passes_for(region)) + for_all
            map_ranges(
                partial(tiles, maps, region.tiles),
                len(region.tiles),
                execution,
                bar=bar,
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
    passes: list[CoarsePass],
) -> list[_native.CoarseMap]:
    """Filter the layers that are blurred enough for bins of several pixels."""
    maps = []
    for each in passes:
        levels = plan.slabs.levels
        of_pass = [
            _coarse_map(int(layer), each, int(levels[layer]))
            for layer in np.flatnonzero((levels >= each.first) & (levels <= each.last))
        ]
        if not of_pass:
            continue
        native_pass = _native.CoarsePass(
            first_level=each.first,
            last_level=each.last,
            left=each.left,
            top=each.top,
            right=each.right,
            bottom=each.bottom,
            side=each.side,
        )
        fill = partial(_native.coarse_tiles, view, blocks, native_plan, native_pass, of_pass)
        map_ranges(fill, each.rows * each.columns, execution, label="far layers", chunk=1)
        maps += of_pass
    return maps


def _coarse_map(layer: int, of_pass: CoarsePass, level: int) -> _native.CoarseMap:
    row, column, rows, columns = of_pass.map_window(level)
    # Fresh zeros take no memory before they are written, so places that lack a layer cost nothing.
    return _native.CoarseMap(layer, row, column, np.zeros((5, rows, columns), np.float32))
