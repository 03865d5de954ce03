"""Layered light field reconstruction as published (Vaidyanathan, Munkberg, Clarberg and Salvi 2015).

Samples are split into depth layers; each layer's radiance and opacity are averaged over the lens by a
separable sheared filter; the layers are composited by average opacity. `reference` is the method in plain
NumPy, `filters` and `partitions` hold its mathematics, `plan` what all tiles share.

Four things differ from the paper, for reasons given in the modules named: a disc lens becomes the Gaussian of
equal second moment, importance samples are never weighted up (both in `filters`), slope ranges are exact and
not rounded to bins (`partitions`), and the result is divided by the accumulated opacity (`reference`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewrays.errors import require_option
from fewrays.layered_published import kernel, reference
from fewrays.layered_published.filters import FilterRule
from fewrays.layered_published.partitions import Partitions
from fewrays.layered_published.plan import Plan
from fewrays.method import Method, Reconstruction
from fewrays.parallel import Execution, progress_bar
from fewrays.samples import SampleBuffer

__all__ = ["AXIS_ALIGNED_METHOD", "METHOD", "LayeredAxisAlignedOptions", "PublishedOptions"]


@dataclass(frozen=True, kw_only=True)
class PublishedOptions:
    """Options of ``method="layered-published"``."""

    sigma_pix: float = 0.5
    """Standard deviation of the Gaussian pixel filter, in pixels."""
    partitions: int = 15
    """Depth partitions on either side of the focal plane, fewer where boundaries share a bin; fewer are
    faster and noisier."""
    partition_sigma_x: float = 8.0
    """Screen-space extent that the sheared filter of a whole partition may have, in pixels: larger makes
    partitions narrower and more."""
    bin_size: float = 0.5
    """Partition boundaries are multiples of this slope, in pixels."""
    tile: int = 32
    """Side of a tile in pixels."""
    ring: int = 16
    """Width in pixels of the ring around a tile whose samples it uses."""
    max_sigma_x: float = 8.0
    """Largest screen-space extent of a filter (standard deviation), in pixels; at most half the ring."""
    max_layers: int | None = None
    """Largest number of layers in a tile: neighbouring layers are joined beyond it. No limit by default."""

    def __post_init__(self) -> None:
        require_option("sigma_pix", self.sigma_pix, 0.01 <= self.sigma_pix <= 4.0, "from 0.01 to 4 px")
        require_option("partitions", self.partitions, 1 <= self.partitions <= 100, "from 1 to 100")
        require_option(
            "partition_sigma_x",
            self.partition_sigma_x,
            1 <= self.partition_sigma_x <= 256,
            "from 1 to 256 px",
        )
        require_option("bin_size", self.bin_size, 0.01 <= self.bin_size <= 8.0, "from 0.01 to 8 px")
        require_option("tile", self.tile, 4 <= self.tile <= 256, "from 4 to 256 px")
        require_option("ring", self.ring, 1 <= self.ring <= 256, "from 1 to 256 px")
        limit = self.ring / 2
        require_option(
            "max_sigma_x",
            self.max_sigma_x,
            0.0 < self.max_sigma_x <= limit,
            f"in (0, ring / 2 = {limit:g}] px",
        )
        if self.max_layers is not None:
            require_option("max_layers", self.max_layers, self.max_layers >= 1, "at least 1")


@dataclass(frozen=True, kw_only=True)
class LayeredAxisAlignedOptions(PublishedOptions):
    """Options of ``method="layered-axis-aligned"``, the paper's OURAA."""

    k: float = 2.0
    """Divisor of the filter widths, which keeps more of the aperture's spectrum."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_option("k", self.k, 0.1 <= self.k <= 100, "from 0.1 to 100")


def _run_sheared(samples: SampleBuffer, options: PublishedOptions, execution: Execution) -> Reconstruction:
    rule = FilterRule.for_lens(
        samples.lens, "sheared", sigma_pix=options.sigma_pix, max_sigma_x=options.max_sigma_x
    )
    return _run(samples, options, rule, execution)


def _run_axis_aligned(
    samples: SampleBuffer, options: LayeredAxisAlignedOptions, execution: Execution
) -> Reconstruction:
    rule = FilterRule.for_lens(
        samples.lens,
        "axis-aligned",
        sigma_pix=options.sigma_pix,
        max_sigma_x=options.max_sigma_x,
        k=options.k,
    )
    return _run(samples, options, rule, execution)


def _run(
    samples: SampleBuffer, options: PublishedOptions, rule: FilterRule, execution: Execution
) -> Reconstruction:
    plan = _plan(samples, options, rule, with_slots=execution.aovs)
    shape = (samples.height, samples.width)
    image = np.zeros((*shape, 3), np.float32)
    counts = np.zeros(plan.tile_count, np.int32)
    layer_images = None
    if execution.aovs:
        layer_images = np.zeros((*shape, int(plan.slots.max()) + 1, 4), np.float32)

    if execution.device == "reference":
        with progress_bar(plan.tile_count, "layers", show=execution.progress, unit="tile") as bar:
            for tile in range(plan.tile_count):
                row, column, height, width = plan.tile_rectangle(tile)
                pixels, counts[tile] = reference.reconstruct_tile(samples, plan, tile, layer_images)
                image[row : row + height, column : column + width] = pixels
                bar.update()
    else:
        kernel.reconstruct_tiles(samples, plan, image, counts, layer_images, execution)

    return plan.reconstruction(image, counts, layer_images)


def _plan(samples: SampleBuffer, options: PublishedOptions, rule: FilterRule, *, with_slots: bool) -> Plan:
    partitions = Partitions.of_constant_energy(
        options.partitions,
        sigma_u=rule.sigma_u,
        sigma_x=options.partition_sigma_x,
        bin_size=options.bin_size,
    )
    slots = np.full(partitions.count, -1, np.int32)
    if with_slots:  # per-layer images only for the partitions that occur
        occurring = np.unique(
            np.concatenate([partitions.of_slope(samples.lens.slope(d)) for d in samples.depth])
        )
        slots[occurring] = np.arange(len(occurring))
    return Plan(
        height=samples.height,
        width=samples.width,
        tile=options.tile,
        ring=options.ring,
        partitions=partitions,
        rule=rule,
        max_layers=options.max_layers,
        slots=slots,
    )


METHOD = Method(
    name="layered-published",
    summary="depth layers, separable sheared filters: the method of Vaidyanathan et al. 2015 as published",
    options=PublishedOptions,
    devices=("cpu", "reference"),
    run=_run_sheared,
)

AXIS_ALIGNED_METHOD = Method(
    name="layered-axis-aligned",
    summary="depth layers, axis-aligned filters (the baseline OURAA of the layered paper)",
    options=LayeredAxisAlignedOptions,
    devices=("cpu", "reference"),
    run=_run_axis_aligned,
)
