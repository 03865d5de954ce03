"""From samples to planes.

Every ray tells something of each plane that it reaches. In the plane of the surface that it hits it is a
*hit*; each plane in front of that it *passes*; of what lies behind it says nothing. Both count where the ray
crosses the plane, as the lens centre sees that place: ``x - C u`` (layered, Eq. 39). The opacity of a cell is
the share of hits among hits and passes, its radiance the mean of the hits.

A ray is shared out among the four cells around its crossing. Where few rays cross, the share says little, and
is drawn towards the estimate of a neighbourhood of twice the width, itself made in the same way: that counts
as `prior` rays. So cells average over as many neighbours as the sampling density asks for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.cuda.samples import DeviceSamples
from fewrays.errors import require_option
from fewrays.multiplane.maps import BLOCK, Grid, Maps, Shear, native_planes, number_blocks
from fewrays.multiplane.slabs import Assignment, SlabRule, assign_planes
from fewrays.native_view import view_light_field
from fewrays.parallel import Execution, map_ranges
from fewrays.samples import SampleBuffer

__all__ = [
    "BuildOptions",
    "Layout",
    "beyond_memory",
    "build_maps",
    "extents",
    "lay_out",
    "radiance_scale",
    "rays_along_edges",
]

_MOST_BLUR = 2.0  # widths or heights of the image
_MEGABYTE = 2**20
_MARGIN = 4  # pixels beyond what the lens shifts
_RUN = 128  # samples that are looked at together
_ROWS = 384  # cells of a plane's height that are built at once: two of native code's regions
_LEAST_ALONG = 1 / 3
_DENSE = 3  # samples per pixel that cells of half a pixel need out of focus
_LARGEST = 2.0**15  # stored radiance
_LEAST_EXPONENT = -100  # of a plane's scale: single precision holds its inverse as well


@dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """How planes are made of samples."""

    thickness: float = 0.35
    """Thickness of planes near focus, in pixels of blur radius."""
    linear_to: float = 8.0
    """Blur radius in pixels beyond which planes grow thicker in proportion to it."""
    cells: int = 3
    """Cells per pixel and axis of planes in focus, 1 to 3; others have two, or one if this is 1 or there are
    fewer than three samples per pixel."""
    fine_to: float = 2.0
    """Blur radius in pixels up to which planes count as in focus."""
    memory: float = 1250.0
    """Megabytes (2^20 bytes) for planes; beyond, those with most blur have one cell per pixel."""
    prior: float = 0.2
    """Rays that the estimate of a cell's neighbourhood counts as."""
    along_edges: float = 2.3
    """Rays that cells in focus look for along edges, to each side; 0 for none. Out of focus fewer, in
    inverse proportion to the blur."""
    motion_cell: float = 1.5
    """Motion that one plane stands for, in pixels over the shutter interval along each axis."""

    def __post_init__(self) -> None:
        require_option("thickness", self.thickness, 0.1 <= self.thickness <= 8, "from 0.1 to 8 px")
        require_option("linear_to", self.linear_to, 1 <= self.linear_to <= 1000, "from 1 to 1000 px")
        require_option("cells", self.cells, self.cells in (1, 2, 3), "of 1, 2 or 3")
        require_option("fine_to", self.fine_to, self.fine_to >= 0, "of at least 0 px")
        require_option("memory", self.memory, self.memory >= 0, "of at least 0 MB")
        require_option("prior", self.prior, 0.01 <= self.prior <= 100, "from 0.01 to 100")
        require_option("along_edges", self.along_edges, 0 <= self.along_edges <= 100, "from 0 to 100 rays")
        require_option("motion_cell", self.motion_cell, 0.25 <= self.motion_cell <= 64, "from 0.25 to 64 px")

    def slab_rule(self, samples: SampleBuffer | DeviceSamples) -> SlabRule:
        """Return how samples are sorted."""
        most_blur = _MOST_BLUR * max(samples.height, samples.width)
        return SlabRule(self.thickness, self.linear_to, self.motion_cell, most_blur)


def build_maps(samples: SampleBuffer, options: BuildOptions, execution: Execution) -> Maps:
    """Make planes of samples; see `Multiplane.build`."""
    rule = options.slab_rule(samples)
    assignment = assign_planes(samples, rule)
    field = view_light_field(samples)
    layout = lay_out(assignment, samples, options)
    shear, grid, marks = layout.shear, layout.grid, layout.marks
    scale = radiance_scale(layout.brightest)
    planes = native_planes(shear, grid, scale, rule.most_blur)
    slots, units = number_blocks(marks, grid)
    halves = np.zeros(units * _native.UNIT_HALVES + 2 * _native.HALF_PADDING, np.uint16)
    runs = _native.SampleRuns(-(-samples.depth.size // _RUN))
    map_ranges(
        lambda first, last: _native.multiplane_runs(field, assignment.plane_of, _RUN, first, last, runs),
        -(-samples.depth.size // _RUN),
        replace(execution, progress=False),
        chunk=4096,
    )
    parts = _parts(grid, marks)
    along = rays_along_edges(shear, grid, options)

    def work(first: int, last: int) -> None:
        _native.multiplane_build(
            field,
            assignment.plane_of,
            planes,
            slots,
            runs,
            _RUN,
            layout.reach,
            options.prior,
            along,
            parts,
            first,
            last,
            halves,
        )

    map_ranges(work, len(parts), execution, label="multiplane: build", chunk=1)
    return Maps(samples.height, samples.width, samples.lens, shear, grid, slots, halves, scale)


@dataclass(frozen=True, eq=False)
class Layout:
    """Planes before they are filled.

    Parameters
    ----------
    shear : Shear
    grid : Grid
    marks : ndarray of bool
        Which of all places for blocks samples touch.
    reach : ndarray of float32, (K,)
        How far from its image position a sample hits the plane at most, in pixels.
    brightest : ndarray of float32, (K,)
        The largest radiance of the plane's samples, in size.
    """

    shear: Shear
    grid: Grid
    marks: npt.NDArray[np.bool_]
    reach: npt.NDArray[np.float32]
    brightest: npt.NDArray[np.float32]


def lay_out(assignment: Assignment, samples: SampleBuffer, options: BuildOptions) -> Layout:
    """Choose each plane's extent and resolution, and find the blocks that samples touch."""
    shear, grid = extents(assignment, samples, options)
    layout = _touch(assignment, samples, options, shear, grid)
    kept = np.concatenate([[0], np.cumsum(layout.marks)])
    coarse = beyond_memory(shear, grid, np.diff(kept[np.append(grid.first_slot, grid.slot_count)]), options)
    if coarse.any():
        grid = replace(grid, cells=np.where(coarse, 1, grid.cells).astype(np.int32))
        layout = _touch(assignment, samples, options, shear, grid)
    return layout


def extents(
    assignment: Assignment, samples: SampleBuffer | DeviceSamples, options: BuildOptions
) -> tuple[Shear, Grid]:
    """Choose each plane's extent, and its resolution if there is memory enough."""
    size = np.abs(assignment.slope)
    shift = size[:, None] + 0.5 * np.abs(assignment.motion)
    margin = np.ceil(shift).astype(np.int64) + _MARGIN
    block = np.array(BLOCK[::-1])
    corner = -(np.ceil(margin / block).astype(np.int64) * block)
    end = np.array([samples.width, samples.height]) + margin
    shape = np.ceil((end - corner) / block).astype(np.int32)
    others = min(options.cells, _cells_out_of_focus(assignment, samples))
    cells = np.where(size <= options.fine_to, options.cells, others).astype(np.int32)
    return Shear(assignment.slope, assignment.motion), Grid(cells, corner.astype(np.int32), shape)


def _cells_out_of_focus(assignment: Assignment, samples: SampleBuffer | DeviceSamples) -> int:
    """Return how many cells per pixel and axis planes out of focus have at most, 1 or 2.

    Four cells that have less than a ray each are noisier than one, even where blur averages them: one shares
    evidence out more widely before hits are divided by it. In focus, detail is worth that noise.
    """
    return 2 if assignment.kept >= _DENSE * samples.height * samples.width else 1


def rays_along_edges(shear: Shear, grid: Grid, options: BuildOptions) -> npt.NDArray[np.float32]:
    """Return how many rays the cells of each plane look for along edges, to each side, (K,).

    Out of focus the mean over the lens does the same. There crisp edges show the lens points instead, and
    below `_LEAST_ALONG` of the rays that are looked for in focus it gains nothing.
    """
    blur = np.abs(shear.slope)
    share = np.divide(options.fine_to, blur, out=np.ones_like(blur), where=blur > options.fine_to)
    along = np.where((share >= _LEAST_ALONG) & (grid.cells > 1), options.along_edges * share, 0.0)
    return along.astype(np.float32)


def _touch(
    assignment: Assignment, samples: SampleBuffer, options: BuildOptions, shear: Shear, grid: Grid
) -> Layout:
    """Find the blocks that samples touch."""
    marks = np.zeros(grid.slot_count, np.uint8)
    reach, brightest = np.zeros((2, len(shear.slope)), np.float32)
    planes = native_planes(shear, grid, np.ones(len(shear.slope)), options.slab_rule(samples).most_blur)
    _native.multiplane_mark(view_light_field(samples), assignment.plane_of, planes, marks, reach, brightest)
    return Layout(shear, grid, marks.view(np.bool_), reach, brightest)


def beyond_memory(
    shear: Shear, grid: Grid, blocks: npt.NDArray[np.int64], options: BuildOptions
) -> npt.NDArray[np.bool_]:
    """Return which planes, of so many blocks (K,), have to make do with one cell per pixel, (K,).

    They are those with most blur.
    """
    one = blocks * (2 * _native.UNIT_HALVES)  # bytes with one cell per pixel
    more = one * (grid.cells.astype(np.int64) ** 2 - 1)
    order = np.argsort(np.abs(shear.slope), kind="stable")
    coarse = np.empty(len(order), np.bool_)
    coarse[order] = one.sum() + np.cumsum(more[order]) > options.memory * _MEGABYTE
    return coarse & (grid.cells > 1)


def _parts(grid: Grid, marks: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Cut planes into parts (N, 3) of bounded height, not empty: plane, first row of blocks, end."""
    parts = []
    for plane, (columns, rows) in enumerate(grid.shape):
        first_slot = grid.first_slot[plane]
        own = marks[first_slot : first_slot + rows * columns].reshape(rows, columns)
        used = np.asarray(own.any(axis=1))
        step = _ROWS // (int(grid.cells[plane]) * BLOCK[0])
        parts += [
            (plane, first, min(first + step, int(rows)))
            for first in range(0, rows, step)
            if used[first : first + step].any()
        ]
    return np.array(parts, np.int32).reshape(-1, 3)


def radiance_scale(brightest: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Return the powers of two (K,) that stored radiance is multiplied with."""
    exponent = np.frexp(brightest.astype(np.float64) / _LARGEST)[1]
    scale: npt.NDArray[np.float64] = np.ldexp(1.0, np.maximum(exponent, _LEAST_EXPONENT))
    return scale
