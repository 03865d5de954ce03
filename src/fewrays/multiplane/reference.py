"""The multiplane method in plain NumPy, float64: the definition of what the native kernels compute.

A surface of slope C moves over the screen by M pixels while the shutter is open. If the lens centre sees it
at p at half time, it is seen from the lens point u at the time t at ``p + C u + M (t - 1/2)``. So one map,
as the lens centre sees it, holds the image of a surface from everywhere. The method makes such maps of
samples (`build`), and images of the maps (`render`):

1. **Planes.** Samples are sorted by slope and motion into thin planes (`slabs`), front to back.
2. **Evidence.** A ray *hits* the plane of the surface that it ends at, *passes* those in front of it, and
   says nothing of those behind. It is shared out among the four cells around the place where it crosses a
   plane (`_Window.share_out`).
3. **Estimate.** Hits over hits and passes is the opacity of a cell, and the mean of the hits its radiance.
   Where few rays cross, both are drawn towards those of wider and wider neighbourhoods (`_estimate`). In
   focus, cells on edges count the rays along these as well (`edges_reference`). Planes that are blurred
   anyway are smoothed a little (`_smooth`).
4. **Views.** From each lens point, at each time, the planes are laid behind one another, front to back
   (layered, Eq. 33), and the mean of these views is the image (`render`).

The kernels differ in four respects. They store maps in half precision. They stop compositing 16 neighbouring
pixels when less than 1 % shines through to any of them: what is missing then counts as what was seen, as
everywhere. They compute in single precision, so that a sample on the border of two blocks may count for the
other. And they estimate wide planes in regions of 192 cells with 32 more around them. That gives the same but
for what a region's last blocks repeat of the next region, and what smoothing reads there: the neighbourhoods
of those cells are cut off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens
from fewrays.multiplane.build import BuildOptions, lay_out, rays_along_edges
from fewrays.multiplane.copies import gaussians, halved_planes
from fewrays.multiplane.edges_reference import gather_along_edges
from fewrays.multiplane.maps import BLOCK, Shear
from fewrays.multiplane.render import RenderOptions, shrink_of
from fewrays.multiplane.slabs import assign_planes
from fewrays.multiplane.smoothing import Smoothing, widened
from fewrays.parallel import Execution, progress_bar
from fewrays.samples import SampleBuffer
from fewrays.temporal.reprojection import Paths

if TYPE_CHECKING:
    from fewrays.multiplane import MultiplaneOptions

__all__ = ["LEAST_SEEN", "LEVELS", "Plane", "Planes", "build", "reconstruct", "render"]

Bools = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

LEVELS = 5
"""How many times neighbourhoods double in width: the widest have 2^5 by 2^5 cells."""

LEAST_SEEN = 1e-3
"""Opacity of all planes together below which a view tells nothing of a pixel."""

_WIDEST = 2**LEVELS
_KEPT_AROUND = 2  # cells: a sample reaches one to each side, and interpolation one more
_LEAST_OPACITY = 1 / 32  # of a block that smoothing adds
_SIGMAS = 3  # standard deviations where the Gaussian ends


@dataclass(frozen=True)
class Plane:
    """Opacity and radiance of one plane, as the lens centre sees it at half time.

    Parameters
    ----------
    slope : float
        Pixels by which it moves over the screen per lens unit.
    motion : ndarray, (2,)
        Pixels by which it moves while the shutter is open.
    cells : float
        Per pixel and axis: a whole number, or a half for a smoothed copy.
    corner : ndarray, (2,)
        Image position (x, y) of the corner of the map's first cell, in pixels.
    kept : ndarray of bool, (R, C)
        Which cells lie in blocks that samples hit. Elsewhere the plane counts as empty.
    layer : ndarray, (R, C, 4)
        Opacity, and radiance times opacity.
    """

    slope: float
    motion: Float64
    cells: float
    corner: Float64
    kept: Bools
    layer: Float64

    def seen_at(self, xy: npt.NDArray[np.floating]) -> Float64:
        """Return opacity and premultiplied radiance (…, 4) at positions (…, 2) as the lens centre sees them.

        Interpolates between four cells. Whether the plane is there is up to the first of them: blocks are
        stored with the cells that follow on them.
        """
        place = (xy - self.corner) * self.cells - 0.5
        first = np.floor(place).astype(np.int64)
        right, down = np.moveaxis(place - first, -1, 0)[..., None]
        column, row = np.moveaxis(first, -1, 0)
        # The blocks kept are far from the rim of the map.
        inside = (column >= 0) & (column < self.kept.shape[1]) & (row >= 0) & (row < self.kept.shape[0])
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        inside &= self.kept[row, column]
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        above = (1 - right) * self.layer[row, column] + right * self.layer[row, column + 1]
        below = (1 - right) * self.layer[row + 1, column] + right * self.layer[row + 1, column + 1]
        seen: Float64 = np.where(inside[..., None], (1 - down) * above + down * below, 0.0)
        return seen


@dataclass(frozen=True)
class Planes:
    """All planes, front to back.

    Parameters
    ----------
    height, width : int
        Image size in pixels.
    lens : Lens
        Of the samples.
    shear : Shear
        Slopes and motions of the planes.
    planes : sequence of Plane
    """

    height: int
    width: int
    lens: Lens
    shear: Shear
    planes: Sequence[Plane]


def reconstruct(
    samples: SampleBuffer, options: MultiplaneOptions, execution: Execution | None = None
) -> Float64:
    """Make an image of samples, in the two steps of the method.

    Parameters
    ----------
    samples : SampleBuffer
    options : MultiplaneOptions
    execution : Execution, optional
        For its progress bars.

    Returns
    -------
    ndarray, (H, W, 4)
        Radiance, and the share of the light whose origin the planes know.
    """
    execution = execution or Execution()
    return render(build(samples, options, execution), None, options, execution)


# From samples to planes.


def build(samples: SampleBuffer, options: BuildOptions, execution: Execution) -> Planes:
    """Sort samples into planes and estimate each plane's opacity and radiance."""
    rule = options.slab_rule(samples)
    assignment = assign_planes(samples, rule)
    layout = lay_out(assignment, samples, options)
    shear, grid = layout.shear, layout.grid
    rays = _Rays.of_samples(samples, rule.most_blur)
    along = rays_along_edges(shear, grid, options)
    planes = []
    with progress_bar(len(shear.slope), "multiplane: build", show=execution.progress, unit="plane") as bar:
        for k, (slope, motion) in enumerate(zip(shear.slope, shear.motion, strict=True)):
            cells = int(grid.cells[k])
            hit, passing = (
                np.flatnonzero(which) for which in (assignment.plane_of == k, assignment.plane_of > k)
            )
            hits = rays.at_centre[hit]
            window = _Window.around(hits, cells, grid.corner[k], grid.shape[k])
            passes = rays.xy[passing] - slope * rays.uv[passing] - motion * (rays.time[passing] - 0.5)
            hit_sums = window.share_out(hits, np.column_stack([np.ones(len(hit)), rays.color[hit]]))
            pass_sums = window.share_out(passes, np.ones((len(passing), 1)))
            # Where nothing is kept nothing was hit, though no pass was counted either.
            layer = window.kept[..., None] * _estimate(hit_sums, pass_sums, options.prior, float(along[k]))
            planes.append(Plane(float(slope), motion, cells, window.corner, window.kept, layer))
            bar.update()
    return Planes(samples.height, samples.width, samples.lens, shear, planes)


@dataclass(frozen=True)
class _Rays:
    """What is known of N rays.

    Parameters
    ----------
    xy, uv : ndarray, (N, 2)
        Where they pass the image, in pixels, and the lens.
    time : ndarray, (N, 1)
        When; at half time where nothing moves.
    color : ndarray, (N, 3)
        Radiance.
    at_centre : ndarray, (N, 2)
        Where the lens centre sees what they hit, at half time.
    """

    xy: Float64
    uv: Float64
    time: Float64
    color: Float64
    at_centre: Float64

    @classmethod
    def of_samples(cls, samples: SampleBuffer, most_blur: float) -> _Rays:
        count = samples.depth.size
        time = np.full((count, 1), 0.5) if samples.time is None else samples.time.reshape(-1, 1)
        paths = Paths.of_samples(samples)
        # What is behind the camera at half time counts where it would be at its own depth.
        at_centre = paths.start[:, :2] / samples.depth.reshape(-1, 1)
        half = paths.seen_from(0.0, 0.0, 0.5)
        at_centre[half.sample] = half.xy
        xy, uv = (array.reshape(-1, 2).astype(np.float64) for array in (samples.xy, samples.uv))
        slope = samples.lens.slope(samples.depth.astype(np.float64)).reshape(-1, 1)
        at_centre += (slope - np.clip(slope, -most_blur, most_blur)) * uv
        color = samples.color.reshape(-1, 3).astype(np.float64)
        return cls(xy, uv, time.astype(np.float64), color, at_centre)


@dataclass(frozen=True)
class _Window:
    """The part of a plane that is estimated: the blocks that samples hit, and a widest neighbourhood around.

    Parameters
    ----------
    corner : ndarray, (2,)
        Image position (x, y) of its corner, in pixels.
    cells : int
        Per pixel and axis.
    kept : ndarray of bool, (R, C)
        Which cells lie in blocks that samples hit; R and C are multiples of the widest neighbourhood's width.
    """

    corner: Float64
    cells: int
    kept: Bools

    @classmethod
    def around(cls, hits: Float64, cells: int, corner: npt.ArrayLike, shape: npt.ArrayLike) -> _Window:
        """Put a window around hits (N, 2), of the plane that has its corner and blocks (x, y) there."""
        block = np.array(BLOCK[::-1])
        reach = _KEPT_AROUND / cells
        origin, most = np.asarray(corner, np.float64), np.asarray(shape, np.int64) - 1
        first, last = (np.floor((hits + sign * reach - origin) / block).astype(np.int64) for sign in (-1, 1))
        first, last = np.maximum(first, 0), np.minimum(last, most)
        within = (first <= last).all(axis=1)
        first, last = first[within], last[within]
        if len(first) == 0:
            return cls(origin, cells, np.zeros((_WIDEST, _WIDEST), np.bool_))
        # In cells, with all of the coarsest cells that the blocks touch and one more on every side.
        begin = first.min(axis=0) * block * cells // _WIDEST * _WIDEST - _WIDEST
        end = -(-(last.max(axis=0) + 1) * block * cells // _WIDEST) * _WIDEST + _WIDEST
        kept = np.zeros((end - begin)[::-1], np.bool_)
        for left, top in _blocks_between(first, last) * block * cells - begin:
            kept[top : top + block[1] * cells, left : left + block[0] * cells] = True
        return cls(origin + begin / cells, cells, kept)

    def share_out(self, places: Float64, values: Float64) -> Float64:
        """Share values (N, V) out among the four cells around places (N, 2), as bilinear weights; (R, C, V).

        What falls outside the blocks that are kept is lost.
        """
        shared = np.zeros((*self.kept.shape, values.shape[1]))
        place = (places - self.corner) * self.cells - 0.5
        first: Indices = np.floor(place).astype(np.int64)
        rest = place - first
        for step in np.ndindex(2, 2):
            column, row = (first + step).T
            weight = np.where(step, rest, 1 - rest).prod(axis=1)
            inside = (column >= 0) & (column < self.kept.shape[1]) & (row >= 0) & (row < self.kept.shape[0])
            column, row = column[inside], row[inside]
            np.add.at(shared, (row, column), weight[inside, None] * values[inside])
        shared[~self.kept] = 0.0
        return shared


def _blocks_between(first: Indices, last: Indices) -> Indices:
    """Return the distinct blocks (B, 2) among the up to 2 x 2 from `first` to `last`, (N, 2), of each hit."""
    corners = [np.where(step, last, first) for step in np.ndindex(2, 2)]
    blocks: Indices = np.unique(np.concatenate(corners), axis=0)
    return blocks


def _estimate(hits: Float64, passes: Float64, prior: float, along: float) -> Float64:
    """Estimate opacity and premultiplied radiance of cells, from the widest neighbourhoods to single cells.

    In each neighbourhood the estimate is that of the next wider ones, interpolated, counted as `prior` rays,
    and what its own rays say. Single cells count the rays along their edges as well.

    Parameters
    ----------
    hits : ndarray, (R, C, 4)
        Number of rays that hit each cell, and the sums of their radiance.
    passes : ndarray, (R, C, 1)
        Number of rays that passed each cell.
    prior : float
    along : float
        Rays that cells look for along edges, to each side; 0 for none.

    Returns
    -------
    ndarray, (R, C, 4)
    """
    evidence = [np.concatenate([hits, hits[..., :1] + passes], axis=2)]
    for _ in range(LEVELS):
        evidence.append(_halved(evidence[-1]))
    hit, radiance, total = np.split(evidence.pop(), [1, 4], axis=2)
    opacity = np.divide(hit, total, out=np.zeros_like(hit), where=total > 0)
    color = np.divide(radiance, hit, out=np.zeros_like(radiance), where=hit > 0)
    known = (hit > 0).astype(np.float64)  # radiance is known only where something was hit
    while evidence:
        sums = evidence.pop()
        if not evidence and along > 0:
            sums = gather_along_edges(sums, np.concatenate([opacity, color], axis=2), along)
        hit, radiance, total = np.split(sums, [1, 4], axis=2)
        opacity = (hit + prior * _doubled(opacity)) / (total + prior)
        nearby = _doubled(known)
        around = np.divide(_doubled(color), nearby, out=np.zeros_like(radiance), where=nearby > 0)
        weight = hit + prior * (nearby > 0)
        shrunk = radiance + prior * around
        color = np.divide(shrunk, weight, out=np.zeros_like(radiance), where=weight > 0)
        known = ((nearby > 0) | (hit > 0)).astype(np.float64)
    return np.concatenate([opacity, opacity * color], axis=2)


def _halved(fine: Float64) -> Float64:
    """Sum 2 x 2 cells of a map (R, C, V)."""
    rows, columns, values = fine.shape
    coarse: Float64 = fine.reshape(rows // 2, 2, columns // 2, 2, values).sum(axis=(1, 3))
    return coarse


def _doubled(coarse: Float64) -> Float64:
    """Interpolate a map (R, C, V) linearly at the centres of half as wide cells, (2R, 2C, V)."""
    for axis in (0, 1):
        along = np.moveaxis(coarse, axis, 0)
        before, after = np.concatenate([along[:1], along[:-1]]), np.concatenate([along[1:], along[-1:]])
        fine = np.stack([0.75 * along + 0.25 * before, 0.75 * along + 0.25 * after], axis=1)
        coarse = np.moveaxis(fine.reshape(-1, *along.shape[1:]), 0, axis)
    return coarse


# From planes to images.


def render(planes: Planes, lens: Lens | None, options: RenderOptions, execution: Execution) -> Float64:
    """Make an image of planes, seen through another lens if one is given; see `fewrays.Multiplane.render`.

    Returns
    -------
    ndarray, (H, W, 4)
        Radiance, and the share of the light whose origin the planes know.
    """
    planes = planes if lens is None else _through(planes, lens)
    where = options.locations(planes.lens)
    cells = np.array([plane.cells for plane in planes.planes], np.int32)
    smoothing = options.smoothing_of(planes.shear.slope, cells, planes.lens, where)
    is_halved = halved_planes(smoothing)
    planes = _smoothed(planes, smoothing, is_halved)
    shrink = shrink_of(planes.shear.slope, smoothing.variance, where)
    rim = options.vignetting().front_rim(where.uv, planes.height, planes.width)
    groups = _groups_of(planes, shrink, is_halved)
    pixels = np.stack(np.meshgrid(np.arange(planes.width), np.arange(planes.height)), axis=-1) + 0.5
    sums = np.zeros((planes.height, planes.width, 3))
    known, passing = np.zeros((2, planes.height, planes.width))
    with progress_bar(where.count, "multiplane: render", show=execution.progress, unit="view") as bar:
        for uv, time, offset, weight in zip(where.uv, where.t, where.offset, where.weight, strict=True):
            radiance, opacity = _view(groups, pixels.shape[:2], uv, float(time), offset)
            passes = weight * (rim.passes(uv, pixels) if options.cats_eye > 0 else np.ones_like(known))
            seen = opacity > LEAST_SEEN
            share = np.divide(passes, opacity, out=np.zeros_like(known), where=seen)
            sums += share[..., None] * radiance
            known += np.where(seen, passes, 0.0)
            passing += passes
            bar.update()
    lit = passing if options.darken else np.ones_like(passing)
    image = np.divide(lit[..., None] * sums, known[..., None], out=sums, where=known[..., None] != 0)
    return np.dstack([image, np.divide(known, passing, out=np.zeros_like(known), where=passing != 0)])


def _through(planes: Planes, lens: Lens) -> Planes:
    """Change slopes linearly in 1 / depth: ``C' = a C + b`` (temporal, section 6)."""
    factor = lens.c0 / planes.lens.c0
    slope = factor * planes.shear.slope + (lens.c1 - factor * planes.lens.c1)
    moved = [replace(plane, slope=float(c)) for plane, c in zip(planes.planes, slope, strict=True)]
    return replace(planes, lens=lens, shear=replace(planes.shear, slope=slope), planes=moved)


def _smoothed(planes: Planes, smoothing: Smoothing, is_halved: Bools) -> Planes:
    """Copy planes, smoothed by Gaussians, with means of their cells where these are wide."""
    cells = np.where(is_halved, 0.5, smoothing.cells)
    widths = zip(smoothing.sigma, gaussians(smoothing, is_halved), cells, strict=True)
    soft = [
        _copy(plane, float(sigma), float(gaussian), float(own)) if sigma > 0 else plane
        for plane, (sigma, gaussian, own) in zip(planes.planes, widths, strict=True)
    ]
    return replace(planes, planes=soft)


def _copy(plane: Plane, sigma: float, gaussian: float, cells: float) -> Plane:
    """Smooth a plane with a Gaussian, in pixels, into a copy of so many cells per pixel.

    Kept as well is what smoothing by `sigma` pixels in all has brought to blocks around those kept, unless it
    is next to nothing. Blocks of a copy of half a cell per pixel are twice as large.
    """
    pitch = 2 if cells < 1 else 1
    if pitch == 2:
        plane = _padded(plane, pitch * np.array(BLOCK[::-1]))
    factor = round(plane.cells / cells)
    layer = plane.layer
    for _ in range(factor.bit_length() - 1):
        layer = _halved(layer) / 4
    layer = _smooth(layer, gaussian * cells)
    row, column = (
        np.floor((plane.corner[1 - axis] + (np.arange(count) + 0.5) / cells) / BLOCK[axis]).astype(int)
        for axis, count in enumerate(layer.shape[:2])
    )
    row, column = row - row[0] // pitch * pitch, column - column[0] // pitch * pitch
    own = np.zeros((row[-1] // pitch * pitch + pitch, column[-1] // pitch * pitch + pitch), np.bool_)
    most = np.zeros((len(own) // pitch, own.shape[1] // pitch))
    np.logical_or.at(own, np.ix_(row, column), plane.kept[::factor, ::factor])
    where = np.ix_(row // pitch, column // pitch)
    np.maximum.at(most, where, layer[..., 0])
    reached = _any_of_blocks(widened(own, sigma), pitch)
    kept = np.where(most > _LEAST_OPACITY, reached, _any_of_blocks(own, pitch))
    # The plane ends where its map does, but for the cells that interpolation needs.
    inside = np.zeros(layer.shape[:2], np.bool_)
    inside[:-1, :-1] = kept[where][:-1, :-1]
    return replace(plane, cells=cells, kept=inside, layer=layer)


def _padded(plane: Plane, block: Indices) -> Plane:
    """Widen a plane's map to whole blocks of a size (x, y) in pixels, and one more on every side."""
    end = plane.corner + np.array(plane.kept.shape[::-1]) / plane.cells
    begin: Float64 = (np.floor(plane.corner / block) - 1) * block
    before = np.round((plane.corner - begin) * plane.cells).astype(int)
    after = np.round(((np.ceil(end / block) + 1) * block - end) * plane.cells).astype(int)
    around = [(before[1], after[1]), (before[0], after[0])]
    kept, layer = np.pad(plane.kept, around), np.pad(plane.layer, [*around, (0, 0)])
    return replace(plane, corner=begin, kept=kept, layer=layer)


def _any_of_blocks(kept: Bools, pitch: int) -> Bools:
    """Return which blocks of `pitch` times the size have any that is kept."""
    rows, columns = kept.shape
    blocks = kept.reshape(rows // pitch, pitch, columns // pitch, pitch)
    found: Bools = np.logical_or.reduce(blocks, axis=(1, 3))
    return found


def _smooth(layer: Float64, sigma: float) -> Float64:
    """Convolve a map (R, C, V) with a Gaussian of a standard deviation in cells."""
    if sigma == 0:
        return layer
    reach = min(math.ceil(_SIGMAS * sigma), _WIDEST)
    taps = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / sigma))
    taps /= taps.sum()
    for axis in (0, 1):
        along = np.moveaxis(layer, axis, 0)
        padded = np.pad(along, [(reach, reach), (0, 0), (0, 0)], mode="edge")
        blurred = sum(tap * padded[k : k + len(along)] for k, tap in enumerate(taps))
        layer = np.moveaxis(np.asarray(blurred), 0, axis)
    return layer


@dataclass(frozen=True)
class _Group:
    """Planes that follow on one another, with the scales of their views, at one resolution."""

    planes: Sequence[Plane]
    shrink: Float64
    pitch: int
    """Pixels between the places that a view looks at."""


def _groups_of(planes: Planes, shrink: Float64, is_halved: Bools) -> list[_Group]:
    """Tell planes at half resolution before all others, those of full resolution, and the rest apart."""
    full = np.flatnonzero(~is_halved)
    begin, end = (full[0], full[-1] + 1) if len(full) else (len(shrink), len(shrink))
    parts = (slice(begin), slice(begin, end), slice(end, None))
    return [
        _Group(planes.planes[part], shrink[part], pitch)
        for part, pitch in zip(parts, (2, 1, 2), strict=True)
        if len(shrink[part])
    ]


def _view(
    groups: Sequence[_Group], shape: tuple[int, ...], uv: Float32, time: float, offset: Float32
) -> tuple[Float64, Float64]:
    """Lay planes behind one another as one lens point sees them at one time (layered, Eq. 33).

    Returns
    -------
    radiance : ndarray, (H, W, 3)
        Of all that is seen.
    opacity : ndarray, (H, W)
        Of all planes together.
    """
    height, width = shape
    radiance, transmittance = np.zeros((height, width, 3)), np.ones((height, width))
    for group in groups:
        # At half resolution with a pixel around, for interpolation.
        around = group.pitch - 1
        row, column = (np.arange(-around, -(-n // group.pitch) + around) for n in shape)
        pixels = (np.stack(np.meshgrid(column, row), axis=-1) + 0.5) * group.pitch
        seen = _view_of_group(group, pixels, uv, time, offset)
        if group.pitch == 2:
            seen = _doubled(seen)[2 : 2 + height, 2 : 2 + width]
        radiance += transmittance[..., None] * seen[..., :3]
        transmittance *= seen[..., 3]
    return radiance, 1 - transmittance


def _view_of_group(
    group: _Group, pixels: npt.NDArray[np.floating], uv: Float32, time: float, offset: Float32
) -> Float64:
    """Return radiance and transmittance (R, C, 4) of planes at places in the image (R, C, 2)."""
    found = np.zeros((*pixels.shape[:2], 4))
    found[..., 3] = 1
    for plane, scale in zip(group.planes, group.shrink, strict=True):
        away = scale * (offset - plane.slope * uv) - plane.motion * (time - 0.5)
        seen = plane.seen_at(pixels + away)
        found[..., :3] += found[..., 3:] * seen[..., 1:]
        found[..., 3] *= 1 - seen[..., 0]
    return found
