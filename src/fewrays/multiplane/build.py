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

__all__ = ["BuildOptions", "build_maps", "lay_out", "radiance_scale"]

_MOST_BLUR = 2.0  # widths or heights of the image
_MARGIN = 4  # pixels beyond what the lens shifts
_RUN = 128  # samples that are looked at together
_ROWS = 384  # cells of a plane's height that are built at once: two of native code's regions
_LARGEST = 2.0**15  # stored radiance
_LEAST_EXPONENT = -100  # of a plane's scale: single precision holds its inverse as well


@dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """How planes are made of samples."""

    thickness: float = 0.4
    """Thickness of planes near focus, in pixels of blur radius."""
    linear_to: float = 8.0
    """Blur radius in pixels beyond which planes grow thicker in proportion to it."""
    cells: int = 3
    """Cells per pixel and axis of planes in focus, 1 to 3."""
    fine_to: float = 2.0
    """Blur radius in pixels up to which planes have two cells, to a third of it `cells`; others have one."""
    prior: float = 0.2
    """Rays that the estimate of a cell's neighbourhood counts as."""
    motion_cell: float = 1.5
    """Motion that one plane stands for, in pixels over the shutter interval along each axis."""

    def __post_init__(self) -> None:
        require_option("thickness", self.thickness, 0.1 <= self.thickness <= 8, "from 0.1 to 8 px")
        require_option("linear_to", self.linear_to, 1 <= self.linear_to <= 1000, "from 1 to 1000 px")
        require_option("cells", self.cells, self.cells in (1, 2, 3), "of 1, 2 or 3")
        require_option("fine_to", self.fine_to, self.fine_to >= 0, "of at least 0 px")
        require_option("prior", self.prior, 0.01 <= self.prior <= 100, "from 0.01 to 100")
        require_option("motion_cell", self.motion_cell, 0.25 <= self.motion_cell <= 64, "from 0.25 to 64 px")

    def slab_rule(self, samples: SampleBuffer | DeviceSamples) -> SlabRule:
        """Return how samples are sorted."""
        most_blur = _MOST_BLUR * max(samples.height, samples.width)
        return SlabRule(self.thickness, self.linear_to, self.motion_cell, most_blur)


def build_maps(samples: SampleBuffer, options: BuildOptions, execution: Execution) -> Maps:
    """Make planes of samples; see `Multiplane.build`."""
    rule = options.slab_rule(samples)
    assignment = assign_planes(samples, rule)
    shear, grid = lay_out(assignment, samples, options)
    field, no_scale = view_light_field(samples), np.ones(len(shear.slope))
    marks = np.zeros(grid.slot_count, np.uint8)
    reach, brightest = np.zeros((2, len(shear.slope)), np.float32)
    unscaled = native_planes(shear, grid, no_scale, rule.most_blur)
    _native.multiplane_mark(field, assignment.plane_of, unscaled, marks, reach, brightest)
    scale = radiance_scale(brightest)
    planes = native_planes(shear, grid, scale, rule.most_blur)
    slots, units = number_blocks(marks.view(np.bool_), grid)
    halves = np.zeros(units * _native.UNIT_HALVES + 2 * _native.HALF_PADDING, np.uint16)
    runs = _native.SampleRuns(-(-samples.depth.size // _RUN))
    map_ranges(
        lambda first, last: _native.multiplane_runs(field, assignment.plane_of, _RUN, first, last, runs),
        -(-samples.depth.size // _RUN),
        replace(execution, progress=False),
        chunk=4096,
    )
    parts = _parts(grid, marks)

    def work(first: int, last: int) -> None:
        _native.multiplane_build(
            field,
            assignment.plane_of,
            planes,
            slots,
            runs,
            _RUN,
            reach,
            options.prior,
            parts,
            first,
            last,
            halves,
        )

    map_ranges(work, len(parts), execution, label="multiplane: build", chunk=1)
    return Maps(samples.height, samples.width, samples.lens, shear, grid, slots, halves, scale)


def lay_out(
    assignment: Assignment, samples: SampleBuffer | DeviceSamples, options: BuildOptions
) -> tuple[Shear, Grid]:
    """Choose each plane's resolution and extent."""
    size = np.abs(assignment.slope)
    cells = np.where(size <= options.fine_to, min(options.cells, 2), 1).astype(np.int32)
    cells[size <= options.fine_to / 3] = options.cells
    shift = size[:, None] + 0.5 * np.abs(assignment.motion)
    margin = np.ceil(shift).astype(np.int64) + _MARGIN
    block = np.array(BLOCK[::-1])
    corner = -(np.ceil(margin / block).astype(np.int64) * block)
    end = np.array([samples.width, samples.height]) + margin
    shape = np.ceil((end - corner) / block).astype(np.int32)
    return Shear(assignment.slope, assignment.motion), Grid(cells, corner.astype(np.int32), shape)


def _parts(grid: Grid, marks: npt.NDArray[np.uint8]) -> npt.NDArray[np.int32]:
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
    """Return the powers of two (K,) that stored radiance is multiplied with, for the largest of each plane."""
    exponent = np.frexp(brightest.astype(np.float64) / _LARGEST)[1]
    scale: npt.NDArray[np.float64] = np.ldexp(1.0, np.maximum(exponent, _LEAST_EXPONENT))
    return scale
