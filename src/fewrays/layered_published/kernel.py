"""The published layered method's native kernel, mapped over tiles by a thread pool."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.layered_published.filters import FilterRule
from fewrays.layered_published.plan import Plan
from fewrays.native_view import view_samples
from fewrays.parallel import Execution, map_ranges
from fewrays.samples import SampleBuffer

__all__ = ["native_rule", "reconstruct_tiles"]

_BLOCK = 16  # side of the blocks of pixels whose samples' extents are known, in pixels


def reconstruct_tiles(
    samples: SampleBuffer,
    plan: Plan,
    image: npt.NDArray[np.float32],
    counts: npt.NDArray[np.int32],
    layer_images: npt.NDArray[np.float32] | None,
    execution: Execution,
) -> None:
    """Reconstruct all tiles into `image`, the number of layers into `counts` and the layers if asked for."""
    view = view_samples(samples)
    # How far the ring of a tile that the image's edge cuts through may reach beyond that.
    margin = float(plan.tile + plan.ring)
    extents = np.empty((-(-plan.height // _BLOCK), -(-plan.width // _BLOCK), 4), np.float32)
    map_ranges(
        lambda first, last: _native.block_extents(view, _BLOCK, margin, first, last, extents),
        len(extents),
        execution,
        label="sorting",
    )
    native_plan = _native.PublishedPlan(
        tile=plan.tile,
        ring=plan.ring,
        max_layers=plan.max_layers or 0,
        bins_per_pixel=1 / plan.partitions.bin_size,
        first_bin=plan.partitions.first_bin,
        partition_of_bin=plan.partitions.table,
        slot_of_partition=plan.slots,
        rule=native_rule(plan.rule),
    )
    map_ranges(
        lambda first, last: _native.published_tiles(
            view, extents, _BLOCK, native_plan, first, last, image, counts, layer_images
        ),
        plan.tile_count,
        execution,
        label="layers",
    )


def native_rule(rule: FilterRule) -> _native.FilterRule:
    """Hand a filter rule to the native side, field by field."""
    return _native.FilterRule(
        family=_native.FilterFamily(("sheared", "axis-aligned").index(rule.family)),
        sigma_pix=rule.sigma_pix,
        sigma_u=rule.sigma_u,
        max_sigma_x=rule.max_sigma_x,
        sampling=_native.Sampling(("disc", "square", "gaussian").index(rule.sampling)),
        sampling_sigma=rule.sampling_sigma,
        k=rule.k,
    )
