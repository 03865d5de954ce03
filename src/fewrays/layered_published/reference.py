"""The published layered method in plain NumPy, float64: the definition of what the native kernel computes.

Follows Algorithms 1 and 2 of the paper: for every tile, find the active layers (section 6.2); for every
layer, front to back, pre-integrate the samples along the layer's shear, blur on the screen, normalise, and
composite by average opacity (Eq. 35). The paper stops there; here the result is also divided by the
accumulated opacity, because what is left transparent is missing data, not a dark background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.layered_published.filters import LayerFilter, layer_taps
from fewrays.layered_published.partitions import Layer, active_layers
from fewrays.layered_published.plan import Plan
from fewrays.samples import SampleBuffer

__all__ = ["reconstruct_tile"]

Float64 = npt.NDArray[np.float64]

MIN_WEIGHT = 1e-20
"""Filtered sample weight below which a pixel has seen no ray of a layer."""

MIN_OPACITY = 1e-3
"""Accumulated opacity below which a pixel counts as empty and is not rescaled."""


@dataclass(frozen=True)
class _TileSamples:
    """The samples whose image positions lie in the outer tile, flattened to ``(N, …)``."""

    xy: Float64  # relative to the outer tile's corner
    uv: Float64
    color: Float64
    slope: npt.NDArray[np.float32]


def reconstruct_tile(
    samples: SampleBuffer, plan: Plan, tile: int, layer_images: npt.NDArray[np.float32] | None
) -> tuple[Float64, int]:
    """Reconstruct one tile (Algorithm 2).

    Parameters
    ----------
    samples : SampleBuffer
    plan : Plan
        Tiles, partitions and filter rule.
    tile : int
        Index of the tile, row by row.
    layer_images : ndarray, (H, W, L, 4), or None
        Receives each layer's premultiplied radiance and opacity, at the slot of its first partition.

    Returns
    -------
    image : ndarray, (h, w, 3)
        The tile's radiance.
    layers : int
        Number of active layers.
    """
    row, column, height, width = plan.tile_rectangle(tile)
    inside = _gather(samples, row - plan.ring, column - plan.ring, plan.tile + 2 * plan.ring)
    partition = plan.partitions.of_slope(inside.slope)
    layers = active_layers(partition, inside.slope, plan.max_layers)

    radiance = np.zeros((plan.tile, plan.tile, 3))
    transmittance = np.ones((plan.tile, plan.tile))
    for layer in layers:
        layer_filter = plan.rule.filter(layer.c_min, layer.c_max)
        layer_radiance, layer_opacity = filter_layer(inside, partition, layer, layer_filter, plan)
        radiance += transmittance[..., None] * layer_radiance
        transmittance *= 1 - layer_opacity
        if layer_images is not None:
            target = layer_images[row : row + height, column : column + width, plan.slots[layer.first]]
            target[..., :3] = layer_radiance[:height, :width]
            target[..., 3] = layer_opacity[:height, :width]

    opacity = 1 - transmittance
    radiance /= np.where(opacity > MIN_OPACITY, opacity, 1.0)[..., None]
    return radiance[:height, :width], len(layers)


def filter_layer(
    samples: _TileSamples,
    partition: npt.NDArray[np.uint8],
    layer: Layer,
    layer_filter: LayerFilter,
    plan: Plan,
) -> tuple[Float64, Float64]:
    """Average radiance and opacity of one layer over the lens, for a tile (Algorithm 1).

    Samples of the layer are hits; samples of layers behind it passed through and are holes; samples of layers
    in front say nothing about this one.

    Returns
    -------
    radiance : ndarray, (tile, tile, 3)
        Premultiplied by opacity.
    opacity : ndarray, (tile, tile)
    """
    size = plan.tile + 2 * plan.ring
    reached = partition >= layer.first
    hit = (partition <= layer.last)[reached]

    uv = samples.uv[reached]
    weight = np.exp(-layer_filter.falloff * np.square(uv).sum(axis=-1))
    q = np.floor(samples.xy[reached] - layer_filter.eta * uv).astype(np.int64)
    inside = ((q >= 0) & (q < size)).all(axis=-1)
    bins = (q[:, 1] * size + q[:, 0])[inside]

    blur = _blur_matrix(layer_filter.variance, plan.tile, plan.ring)

    def scatter_and_blur(values: Float64) -> Float64:
        sums = np.bincount(bins, values[inside], minlength=size * size)
        return blur @ sums.astype(np.float64).reshape(size, size) @ blur.T

    hits = scatter_and_blur(weight * hit)
    total = scatter_and_blur(weight)
    reciprocal = np.where(total > MIN_WEIGHT, 1 / np.maximum(total, MIN_WEIGHT), 0.0)
    color = samples.color[reached]
    radiance = [scatter_and_blur(weight * hit * color[:, i]) * reciprocal for i in range(3)]
    return np.stack(radiance, axis=-1), hits * reciprocal


def _gather(samples: SampleBuffer, row: int, column: int, size: int) -> _TileSamples:
    """Collect the samples in the square of `size` pixels whose corner is at (`row`, `column`)."""
    x, y = samples.xy[..., 0], samples.xy[..., 1]
    inside = (x >= column) & (x < column + size) & (y >= row) & (y < row + size)
    return _TileSamples(
        xy=samples.xy[inside].astype(np.float64) - (column, row),
        uv=samples.uv[inside].astype(np.float64),
        color=samples.color[inside].astype(np.float64),
        slope=samples.lens.slope(samples.depth[inside]).astype(np.float32),
    )


def _blur_matrix(variance: float, tile: int, ring: int) -> Float64:
    """Matrix (pixels of the tile, pixels of the outer tile): blurs one axis, as far as the ring reaches."""
    distance = np.abs(np.arange(tile + 2 * ring) - (np.arange(tile)[:, None] + ring))
    return np.where(distance <= ring, layer_taps(variance, ring)[np.minimum(distance, ring)], 0.0)
