"""The layered method in plain NumPy, float64: the definition of what the native kernels compute.

To read it, begin at the end of the story. A pixel's radiance is the mean, over the points of the lens, of
what the nearest surface sends there. A surface of slope C that the lens centre sees at p is seen from the
lens point u at p + C u. So one map of a surface, as the lens centre sees it, holds its image from everywhere
on the lens:

1. **Layers.** Samples are sorted by slope into thin layers (`slabs`). `_survey` notes, for every block of
   pixels, which layers its samples belong to; `_layers_near` finds out which layers may matter to a tile.
2. **Maps.** For each layer, `_scatter` takes samples back to where the lens centre would have seen them.
   Those of the layer itself are hits; those of the layers behind went through it and are holes; those in
   front say nothing. `_filter` blurs both by what a *part* of the aperture (`aperture`) and the pixel filter
   blur, and divides: that gives the layer's opacity and its radiance times opacity.
3. **Compositing.** For each part of the aperture the maps are moved to where its centre sees them and
   composited front to back (`_composite`), and the parts are averaged by their weights.
4. What stays transparent is missing data, not a dark background: the image is divided by its opacity.

Layers near focus hardly move over the lens. Their maps are blurred by the whole aperture at once and not
moved, on bins of half or a quarter of a pixel so that edges in focus stay sharp. Layers far from focus are
blurred by many pixels and get by with bins of 2, 4, 8 … pixels, magnified when a tile needs them
(`_magnify`); where bins are many pixels, one map serves the whole image (`_coarse_maps`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Container, Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays.layered.plan import FINEST_BY_PLACE, FULL_WEIGHT, MAX_SLOPE, SEEN, Plan
from fewrays.layered.regions import DEEPEST_TILE_LEVEL, CoarsePass
from fewrays.layered.taps import TAPS_REACH, gaussian_taps, tap_count
from fewrays.parallel import Execution, progress_bar
from fewrays.samples import SampleBuffer

__all__ = ["blur_variance", "reconstruct_tiles"]

Float64 = npt.NDArray[np.float64]

BIN_VARIANCE = 1 / 12
"""Variance along one axis of where in its bin a sample lies, in bins²."""

MAGNIFIED_VARIANCE = 1 / 4
"""Variance that a quadratic B-spline adds, which reads coarse maps between bins, along one axis, in bins²."""

SHARED_VARIANCE = 1 / 12
"""What sharing a hit between the nearest bins adds to `BIN_VARIANCE` on average, in bins²."""

LEAST_SHARE = 1 / 512
"""Least share of a hit that a bin gets along an axis: none is so small that it could vanish in rounding."""

TAIL = 4.0
"""Pixels around what a layer can reach in which its samples still count, for the pixel filter's sake."""

MIN_WEIGHT = 1e-12
"""Filtered weight below which no sample has said anything about a cell."""

MIN_COVERED = 1e-3
"""Least cover by which what a cover hides is divided."""

MIN_OPACITY = 1e-3
"""Accumulated opacity below which a pixel counts as empty and is not rescaled."""


def reconstruct_tiles(
    samples: SampleBuffer,
    plan: Plan,
    image: npt.NDArray[np.float32],
    counts: npt.NDArray[np.int32],
    contributions: npt.NDArray[np.float32] | None,
    execution: Execution,
) -> None:
    """Reconstruct all tiles, as `fewrays.layered.kernel.reconstruct_tiles` does.

    Parameters
    ----------
    samples : SampleBuffer
    plan : Plan
        With ``slabs.levels`` clipped to at most 0, no layer is filtered on coarse bins: slow and as good as
        it gets.
    image : ndarray, (H, W, 3)
        Receives the radiance.
    counts : ndarray, (tiles,)
        Receives the number of layers that have samples close enough to matter to each tile; the kernels leave
        out some that turn out not to show.
    contributions : ndarray, (H, W, layers, 4), or None
        Receives each layer's part of the image: radiance, and opacity.
    execution : Execution
        For its progress bar.
    """
    flat = _flatten(samples, plan)
    survey = _survey(flat, plan)
    for_all = _coarse_maps(flat, survey, plan, plan.region_plan.passes_for_all())
    with progress_bar(plan.tile_count, "layered", show=execution.progress, unit="tile") as bar:
        for region in plan.region_plan.regions:
            coarse = for_all | _coarse_maps(flat, survey, plan, plan.region_plan.passes_for(region))
            for tile in region.tiles:
                row, column, rows, columns = plan.tile_rectangle(int(tile))
                pixels = np.s_[row : row + rows, column : column + columns]
                layers, sums = _reconstruct_tile(flat, survey, coarse, plan, int(tile))
                total = sums.sum(axis=0)
                scale = 1 / np.where(total[0] > MIN_OPACITY, total[0], 1.0)
                image[pixels] = np.moveaxis(scale * total[1:], 0, -1)
                counts[tile] = len(layers)
                if contributions is not None:
                    for layer, part in zip(layers, sums, strict=True):
                        contributions[(*pixels, layer.index)] = np.moveaxis(scale * part[[1, 2, 3, 0]], 0, -1)
                bar.update()


# Which layers there are, and where.


@dataclass(frozen=True)
class _Flat:
    """The samples as ``(N, …)``."""

    xy: Float64
    uv: Float64
    color: Float64
    slope: Float64
    layer: npt.NDArray[np.intp]
    block: npt.NDArray[np.intp]  # that a sample's pixel is in, row by row


@dataclass(frozen=True)
class _Survey:
    """What the samples of each block are; blocks run row by row."""

    low: Float64  # (blocks, 2): the least x and y of a sample, infinite where there is none
    high: Float64  # (blocks, 2): the largest
    counts: npt.NDArray[np.int64]  # (blocks, layers): samples
    slope_sums: Float64  # (blocks, layers)


@dataclass(frozen=True)
class _Layer:
    """A layer in the neighbourhood of a tile."""

    index: int
    slope: float  # mean of its samples nearby, in pixels per lens unit
    level: int  # bins of 2**level pixels

    @property
    def near(self) -> bool:
        """Whether the layer is near focus."""
        return self.level < 0


@dataclass(frozen=True)
class _Window:
    """A rectangle of square cells; in pixels, but for the numbers of rows and columns."""

    left: float
    top: float
    cell: float
    rows: int
    columns: int


def _flatten(samples: SampleBuffer, plan: Plan) -> _Flat:
    """Leave out samples too far outside the image to reach it, such as the dropped ones."""
    margin = plan.survey_margin
    xy = samples.xy.reshape(-1, 2).astype(np.float64)
    kept = ((xy >= -margin) & (xy <= np.array([plan.width, plan.height]) + margin)).all(axis=-1)
    slope = samples.lens.slope(samples.depth).astype(np.float32).ravel()[kept]
    side = plan.survey_block
    row, column, _ = np.indices(samples.depth.shape) // side
    return _Flat(
        xy=xy[kept],
        uv=samples.uv.reshape(-1, 2)[kept].astype(np.float64),
        color=samples.color.reshape(-1, 3)[kept].astype(np.float64),
        slope=slope.astype(np.float64),
        layer=plan.slabs.of_slope(slope),
        block=(row * -(-plan.width // side) + column).ravel()[kept],
    )


def _survey(samples: _Flat, plan: Plan) -> _Survey:
    """Find out which layers every block of pixels has, and where its samples lie."""
    side = plan.survey_block
    blocks = -(-plan.height // side) * -(-plan.width // side)
    low, high = np.full((blocks, 2), np.inf), np.full((blocks, 2), -np.inf)
    np.minimum.at(low, samples.block, samples.xy)
    np.maximum.at(high, samples.block, samples.xy)
    counts = np.zeros((blocks, plan.slabs.count), np.int64)
    slope_sums = np.zeros((blocks, plan.slabs.count))
    np.add.at(counts, (samples.block, samples.layer), 1)
    np.add.at(slope_sums, (samples.block, samples.layer), np.clip(samples.slope, -MAX_SLOPE, MAX_SLOPE))
    return _Survey(low, high, counts, slope_sums)


def _layers_near(survey: _Survey, plan: Plan, area: _Window, levels: Container[int]) -> Iterator[_Layer]:
    """Yield the layers of some levels, front to back, that have samples close enough to matter to an area.

    A sample is at most ``|C|`` from where the lens centre sees it, and that as far from the pixels it spreads
    to as the aperture's parts reach.
    """
    part_reach = float(np.abs(plan.aperture.parts[:, :2]).max()) + TAPS_REACH * plan.aperture.sigma
    start = np.array([area.left, area.top])
    end = start + area.cell * np.array([area.columns, area.rows])
    for index, (level, reach) in enumerate(
        zip(plan.slabs.levels, plan.slabs.reaches.astype(np.float64), strict=True)
    ):
        if level not in levels:
            continue
        around = reach * (1 + part_reach) + TAIL
        near = ((survey.high >= start - around) & (survey.low < end + around)).all(axis=-1)
        near &= survey.counts[:, index] > 0
        if near.any():
            slope = survey.slope_sums[near, index].sum() / survey.counts[near, index].sum()
            yield _Layer(index, float(slope), int(level))


def blur_variance(plan: Plan, level: int, slope: float) -> float:
    """Return the variance in bins² that remains to blur a layer by, along one axis.

    Wanted is the pixel filter's variance and that of the aperture, or of a part of it, at the layer's slope.
    Bins and interpolation have each a share in it already.
    """
    if level < 0:
        variance = (plan.pixel_variance + slope**2 * plan.aperture_variance) / 4.0**level
    else:
        variance = plan.pixel_variance + slope**2 * plan.aperture.sigma**2 - plan.interpolation_variance
        if level > 0:
            variance = variance / 4.0**level - MAGNIFIED_VARIANCE - SHARED_VARIANCE
    return max(variance - BIN_VARIANCE, 0.0)


# The map of one layer.


def _filter(samples: _Flat, layer: _Layer, plan: Plan, window: _Window) -> Float64:
    """Map of a layer, ``(5, rows, columns)``: how well a cell is known, opacity, and radiance times opacity.

    On the finest bins, each sample counts alike. Elsewhere each bin does that has a fair share of the samples
    (those with less, in proportion), because samples at the lens centre cluster: where a layer is seen past
    an edge, only part of the lens sees it, and unweighted the side that more of it sees would outweigh the
    other.
    """
    variance = blur_variance(plan, layer.level, layer.slope)
    bins = 2 ** max(-layer.level, 0)  # along the side of a cell
    first = 0.5 if layer.near else 0.0  # the centre of a pixel lies between bins, that of a bin in it
    taps = gaussian_taps(variance, first, tap_count(variance, first))
    hits, count = _scatter(samples, layer, window, bins, len(taps))
    expected = plan.spp * (window.cell / bins) ** 2  # samples in a bin, were none hidden by what is in front
    if layer.level < FINEST_BY_PLACE:
        weight = count
    else:
        weight = np.minimum(count / (FULL_WEIGHT * expected), 1.0)
        hits = hits * (weight / np.maximum(count, MIN_WEIGHT))
    seen = np.minimum(count / (SEEN * expected), 1.0)

    down = _blur_matrix(taps, window.rows, bins)
    along = _blur_matrix(taps, window.columns, bins).T
    blurred_weight = down @ weight @ along
    reciprocal = np.where(blurred_weight > MIN_WEIGHT, 1 / np.maximum(blurred_weight, MIN_WEIGHT), 0.0)
    # Samples miss some bins by chance, so that this share is what is seen where nothing is hidden.
    by_chance = 1 - math.exp(-expected)
    known = np.minimum(down @ seen @ along / by_chance, 1.0)
    return np.concatenate([known[None], (down @ hits @ along) * reciprocal])


def _scatter(
    samples: _Flat, layer: _Layer, window: _Window, bins: int, radius: int
) -> tuple[Float64, Float64]:
    """Collect samples where the lens centre would have seen them.

    Parameters
    ----------
    samples, layer, window
        As in `_filter`.
    bins : int
        Bins along the side of a cell.
    radius : int
        Bins around the window.

    Returns
    -------
    hits : ndarray, (4, bin rows, bin columns)
        Number, and summed radiance, of the layer's own samples.
    count : ndarray, (bin rows, bin columns)
        Number of hits and holes. Samples behind the layer met it, and found a hole, where a sample of the
        layer's slope would have been.
    """
    reached = samples.layer >= layer.index
    own = samples.layer[reached] == layer.index
    slope = np.where(own, samples.slope[reached], layer.slope)
    at_center = samples.xy[reached] - slope[:, None] * samples.uv[reached]
    if window.cell > 1:
        # As wide, on average, as shared hits; otherwise these would widen what they cover.
        at_center[~own] += window.cell * _scramble(samples.uv[reached][~own])

    shape = (window.rows * bins + 2 * radius, window.columns * bins + 2 * radius)
    position = np.floor((at_center - (window.left, window.top)) * (bins / window.cell)) + radius
    inside = ((position >= 0) & (position < shape[::-1])).all(axis=-1)
    column, row = position[inside].astype(np.int64).T
    target = row * shape[1] + column

    def add_up(values: npt.NDArray[np.float64] | npt.NDArray[np.bool_]) -> Float64:
        sums = np.bincount(target, values[inside], minlength=shape[0] * shape[1])
        return sums.astype(np.float64).reshape(shape)

    color = samples.color[reached]
    if window.cell > 1:
        hits = _share_hits(at_center[own], color[own], window, radius, shape)
        return hits, hits[0] + add_up(~own)
    hits = np.stack([add_up(own), *(add_up(own * color[:, channel]) for channel in range(3))])
    return hits, add_up(np.ones(len(own)))


def _scramble(uv: Float64) -> Float64:
    """Return numbers from -1/2 to 1/2 that look random, but are the samples' own."""
    many = (uv.astype(np.float32) + np.float32(1)) * np.float32(719.37)
    # As whole numbers: kernels that fuse a product and a difference must find the same.
    return ((many * np.float32(65536)).astype(np.int64) & 0xFFFF) / 65536 - 0.5


def _share_hits(
    at_center: Float64, color: Float64, window: _Window, radius: int, shape: tuple[int, int]
) -> Float64:
    """Share hits between the four nearest bins, so that a light smaller than a bin keeps its place."""
    position = (at_center - (window.left, window.top)) / window.cell + radius - 0.5
    corner = np.floor(position)
    towards = LEAST_SHARE + (1 - 2 * LEAST_SHARE) * (position - corner)
    hits = np.zeros((4, *shape))
    for step in itertools.product((0, 1), (0, 1)):
        bins = corner + step
        inside = ((bins >= 0) & (bins < shape[::-1])).all(axis=-1)
        weight = np.where(step, towards, 1 - towards).prod(axis=-1)[inside]
        column, row = bins[inside].astype(np.int64).T
        np.add.at(hits[0], (row, column), weight)
        for channel in range(3):
            np.add.at(hits[channel + 1], (row, column), weight * color[inside, channel])
    return hits


def _blur_matrix(taps: Float64, cells: int, bins: int) -> Float64:
    """Matrix (cells, bins) that blurs one axis around the centre of every cell.

    There are as many bins around the cells as there are taps on each side.
    """
    center = len(taps) + (bins - 1) / 2 + bins * np.arange(cells)
    distance = np.abs(np.arange(cells * bins + 2 * len(taps)) - center[:, None])
    tap = np.floor(distance).astype(np.intp)
    return np.where(tap < len(taps), taps[np.minimum(tap, len(taps) - 1)], 0.0)


# Layers far from focus.


@dataclass(frozen=True)
class _Map:
    """The map of a layer, and where in it a tile or the image begins."""

    bins: Float64  # (5, bin rows, bin columns)
    size: int  # of a bin, in pixels
    row: int  # of the first pixel of the tile or the image, in pixels from the map's corner
    column: int


def _coarse_maps(samples: _Flat, survey: _Survey, plan: Plan, passes: list[CoarsePass]) -> dict[int, _Map]:
    """Filter the layers that are blurred so much that their reach is more than a tile; maps by layer."""
    maps: dict[int, _Map] = {}
    for each in passes:
        for tile in np.ndindex(each.rows, each.columns):
            top, left = each.top + each.side * tile[0], each.left + each.side * tile[1]
            height, width = min(each.side, each.bottom - top), min(each.side, each.right - left)
            area = _Window(left, top, 1.0, height, width)
            for layer in _layers_near(survey, plan, area, range(each.first, each.last + 1)):
                cell = 2**layer.level
                window = _Window(left, top, cell, math.ceil(height / cell), math.ceil(width / cell))
                row, column = (index * each.side // cell for index in tile)
                if layer.index not in maps:
                    shape = (5, each.rows * each.side // cell, each.columns * each.side // cell)
                    maps[layer.index] = _Map(np.zeros(shape), cell, -each.top, -each.left)
                here = np.s_[:, row : row + window.rows, column : column + window.columns]
                maps[layer.index].bins[here] = _filter(samples, layer, plan, window)
    return maps


# A tile of the image.


def _reconstruct_tile(
    samples: _Flat, survey: _Survey, coarse: dict[int, _Map], plan: Plan, tile: int
) -> tuple[list[_Layer], Float64]:
    """Layers of a tile, and what each adds to it: opacity and radiance, ``(layers, 4, rows, columns)``."""
    row, column, rows, columns = plan.tile_rectangle(tile)
    shape = (rows, columns)
    whole = _Window(column, row, 1.0, plan.tile, plan.tile)
    visible = replace(whole, rows=rows, columns=columns)
    farthest_part = float(np.abs(plan.aperture.parts[:, :2]).max())
    layers, maps = [], []
    for layer in _layers_near(survey, plan, whole, range(-100, 100)):
        # Pixels around the tile that some part of the aperture sees in it.
        border = 0 if layer.near else math.ceil(farthest_part * abs(layer.slope)) + 1
        layers.append(layer)
        maps.append(_map_of_tile(samples, coarse, plan, layer, visible, border))

    sums = np.zeros((len(layers), 4, *shape))
    for u, v, weight in plan.aperture.parts.astype(np.float64):
        visibility = _Visibility.of_everything(shape)
        for layer, layer_map, layer_sums in zip(layers, maps, sums, strict=True):
            if layer.near:
                layer_sums += weight * _composite_near(layer_map.bins, visibility)
            else:
                cell = _read(layer_map, -layer.slope * u, -layer.slope * v, shape)
                layer_sums += weight * _composite(cell, -layer.slope * plan.aperture.sigma, visibility)
    return layers, sums


def _map_of_tile(
    samples: _Flat, coarse: dict[int, _Map], plan: Plan, layer: _Layer, visible: _Window, border: int
) -> _Map:
    """Find the map of a layer that covers the pixels of a tile and a border around them."""
    size, top, left = 2 ** max(layer.level, 0), int(visible.top), int(visible.left)
    if layer.level > DEEPEST_TILE_LEVEL:
        whole = coarse[layer.index]
        return replace(whole, row=whole.row + top, column=whole.column + left)
    window = _bins_around(visible, border, layer.level)
    return _Map(_filter(samples, layer, plan, window), size, top - int(window.top), left - int(window.left))


def _bins_around(area: _Window, border: int, level: int) -> _Window:
    """Return the bins that an area's pixels and a border around them lie in, or near focus the pixels.

    The outermost pixels have bins on all sides, as many as `_magnify` reads.
    """
    size = 2 ** max(level, 0)
    around = math.ceil((border + (size if level > 0 else 0)) / size)
    return _Window(
        left=area.left - around * size,
        top=area.top - around * size,
        cell=size,
        rows=math.ceil(area.rows / size) + 2 * around,
        columns=math.ceil(area.columns / size) + 2 * around,
    )


# Compositing, seen from one part of the aperture.


@dataclass
class _Visibility:
    """How much of what is behind shows at every pixel, to first order in the place within the part."""

    mean: Float64
    along_u: Float64  # change for one standard deviation of the part
    along_v: Float64

    @classmethod
    def of_everything(cls, shape: tuple[int, ...]) -> _Visibility:
        return cls(np.ones(shape), np.zeros(shape), np.zeros(shape))


@dataclass(frozen=True)
class _Cell:
    """A map between four pixels: its value, and how much it changes from one pixel to the next."""

    known: Float64  # (rows, columns); of the first of the four, as it changes slowly
    value: Float64  # (4, rows, columns): opacity and radiance
    step_x: Float64
    step_y: Float64


def _read(layer_map: _Map, x: float, y: float, shape: tuple[int, int]) -> _Cell:
    """Read a map at the pixels of a tile, moved by x and y pixels; linearly between pixels."""
    column, row = math.floor(x), math.floor(y)
    known, *rest = _magnify(layer_map, row, column, (shape[0] + 1, shape[1] + 1))
    corners = np.stack(rest)
    fraction_x, fraction_y = x - column, y - row
    step_x = corners[..., 1:] - corners[..., :-1]
    between = corners[..., :-1] + fraction_x * step_x
    step_y = between[:, 1:] - between[:, :-1]
    return _Cell(
        known=known[:-1, :-1],
        value=between[:, :-1] + fraction_y * step_y,
        step_x=step_x[:, :-1] + fraction_y * (step_x[:, 1:] - step_x[:, :-1]),
        step_y=step_y,
    )


def _magnify(layer_map: _Map, row: int, column: int, shape: tuple[int, int]) -> Float64:
    """Read a map at the centres of pixels, the first of which is `row` and `column` from the tile's first.

    Bins of several pixels are read by quadratic B-splines: linear ones would flatten every peak.
    """
    bins = layer_map.bins
    rows = _reading_matrix(layer_map.row + row, shape[0], bins.shape[1], layer_map.size)
    columns = _reading_matrix(layer_map.column + column, shape[1], bins.shape[2], layer_map.size)
    return np.asarray(rows @ bins @ columns.T)


def _reading_matrix(first: int, count: int, bins: int, size: int) -> Float64:
    """Matrix (count, bins) that reads bins of `size` pixels at the centres of `count` pixels."""
    pixels = np.arange(count)
    matrix = np.zeros((count, bins))
    if size == 1:
        matrix[pixels, np.clip(first + pixels, 0, bins - 1)] = 1.0
        return matrix
    position = (first + pixels + 0.5) / size - 0.5
    nearest = np.floor(position + 0.5).astype(np.intp)
    beyond = position - nearest
    weights = 0.5 * (0.5 - beyond) ** 2, 0.75 - beyond**2, 0.5 * (0.5 + beyond) ** 2
    for step, weight in zip((-1, 0, 1), weights, strict=True):
        # Beyond the map the outermost bins go on.
        np.add.at(matrix, (pixels, np.clip(nearest + step, 0, bins - 1)), weight)
    return matrix


def _composite(cell: _Cell, shear: float, behind: _Visibility) -> Float64:
    """Add a layer behind what is there: opacity and radiance that show, ``(4, rows, columns)``.

    The mean, over a part of the aperture, of visibility times opacity is the product of their means plus
    their covariance (what Eq. 34 of the paper leaves out). To first order both change linearly from one lens
    point to the next, so their covariance is the product of their changes for one standard deviation, added
    up over u and v.

    No ray has seen a layer behind a cover, so where it is covered its map comes from the rays that passed:
    the two means already belong together, and adding their covariance would count it twice. It counts by how
    much more of the layer is known than the cover lets through.

    Parameters
    ----------
    cell : _Cell
        The layer's map as the part's centre sees it.
    shear : float
        Pixels that the map moves by when the lens point moves by one standard deviation.
    behind : _Visibility
        What shows behind the layers so far; the layer is added to them.
    """
    mean, opacity = behind.mean, cell.value[0]
    spare = (cell.known - mean) / np.maximum(1 - mean, MIN_COVERED)
    # A map's very edge has a slope but nothing to see.
    counts = np.where(opacity > MIN_WEIGHT, shear * np.clip(spare, 0.0, 1.0), 0.0)

    covariance = counts * (behind.along_u * cell.step_x + behind.along_v * cell.step_y)
    unclamped = mean * cell.value + covariance
    # Opacity is clamped to where the two exclude each other as far as they can, or coincide; what that adds
    # or takes away has the layer's mean radiance.
    visible = np.clip(unclamped[0], np.maximum(mean + opacity - 1, 0.0), np.minimum(mean, opacity))
    clamped = (visible - unclamped[0]) / np.maximum(opacity, MIN_WEIGHT)
    shown: Float64 = np.maximum(unclamped + clamped * cell.value, 0.0)
    shown[0] = visible

    behind.along_u = behind.along_u * (1 - opacity) - mean * shear * cell.step_x[0]
    behind.along_v = behind.along_v * (1 - opacity) - mean * shear * cell.step_y[0]
    behind.mean = np.maximum(mean - visible, 0.0)
    return shown


def _composite_near(layer_map: Float64, behind: _Visibility) -> Float64:
    """Do the same with a layer near focus, which looks the same from everywhere on the lens."""
    shown: Float64 = behind.mean * layer_map[1:]
    clear = 1 - layer_map[1]
    behind.mean = behind.mean * clear
    behind.along_u = behind.along_u * clear
    behind.along_v = behind.along_v * clear
    return shown
