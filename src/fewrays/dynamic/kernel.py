"""The dynamic light field's native kernels, mapped over rows and tiles of the image by a thread pool."""

from __future__ import annotations

import math
import threading
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.dynamic.fill import AGREEMENT, Background
from fewrays.dynamic.mipmap import mip_level
from fewrays.dynamic.plan import LightField, Sums
from fewrays.dynamic.prefilter import Blur, level_count
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.surfaces import slope_gradient
from fewrays.parallel import Execution, map_ranges

__all__ = ["NO_SLOPE", "StageSeconds", "guess_background", "synthesize"]

Float32 = npt.NDArray[np.float32]

_TILE = 128
_BLOCK = 16
NO_SLOPE = 1e30
"""Slope of what is not there: no surface is near."""


@dataclass(frozen=True)
class StageSeconds:
    """Processor time that the views took, over all threads, in seconds.

    Parameters
    ----------
    warping : float
        Finding out what every view sees.
    synthesis : float
        Looking it up and blending.
    """

    warping: float = 0.0
    synthesis: float = 0.0

    def __add__(self, other: StageSeconds) -> StageSeconds:
        return StageSeconds(self.warping + other.warping, self.synthesis + other.synthesis)


def synthesize(
    field: LightField, sums: Sums, execution: Execution, passed: Float32 | None = None
) -> StageSeconds:
    """Add up all views.

    Every tile of the image goes through all views, so that no view is ever held as a whole.

    Parameters
    ----------
    field : LightField
    sums : ndarray of float32, (H, W, 5)
        Radiance, opacity and weights of the valid rays are added to it.
    execution : Execution
    passed : ndarray of float32, (H, W), optional
        The weights of all rays are added to it, valid or not: what the front rim of the lens lets pass.

    Returns
    -------
    StageSeconds
    """
    texels = _texels(field, execution)
    pixels = _warp_pixels(field)
    behind = np.array([sheet.behind for sheet in field.sheets], np.float32)
    sheets = _native.Sheets(texels, pixels, behind)
    blocks = _blocks(sheets, field, execution)
    views = np.column_stack([field.views.uv, field.views.weight]).astype(np.float32)
    rim = None if field.rim is None else _native.FrontRim(**asdict(field.rim))
    seconds = StageSeconds()
    lock = threading.Lock()

    def tiles(first: int, last: int) -> None:
        nonlocal seconds
        taken = _native.dynamic_tiles(
            sheets,
            blocks,
            _BLOCK,
            _TILE,
            views,
            field.tolerance,
            field.growth,
            rim,
            first,
            last,
            sums,
            passed,
        )
        with lock:
            seconds += StageSeconds(*taken)

    count = -(-field.height // _TILE) * -(-field.width // _TILE)
    map_ranges(tiles, count, execution, label="dynamic", chunk=1)
    return seconds


def guess_background(
    light: Float32,
    slope: Float32,
    front: Float32,
    edge: npt.NDArray[np.bool_],
    needed: npt.NDArray[np.bool_],
    tolerance: float,
    reach: int,
    execution: Execution,
) -> Background:
    """Guess what is behind every pixel of an image: twin of `fewrays.dynamic.fill.guess_background`."""
    background = np.empty((*slope.shape, 6), np.float32)
    image = (
        np.ascontiguousarray(light, np.float32),
        np.ascontiguousarray(slope, np.float32),
        np.ascontiguousarray(front, np.float32),
        np.ascontiguousarray(edge).view(np.uint8),
        np.ascontiguousarray(needed).view(np.uint8),
        float(slope.max()),
    )
    agreement = AGREEMENT * tolerance

    def rows(first: int, last: int) -> None:
        _native.dynamic_background(*image, tolerance, agreement, reach, first, last, background)

    map_ranges(rows, slope.shape[0], execution, label="background")
    return Background(background[..., :4], background[..., 4], background[..., 5] > 0)


def _mipmap(texels: Float32, sheet: Sheet, view_radius: float, execution: Execution) -> None:
    """Look a sheet's texels (H, W, 8) up in place: twin of `fewrays.dynamic.mipmap.mipmap`."""
    levels = [texels]
    for _ in range(math.ceil(float(mip_level(np.abs(sheet.slope).max(), view_radius)))):
        fine = levels[-1]
        coarse = np.zeros((-(-fine.shape[0] // 2), -(-fine.shape[1] // 2), 8), np.float32)
        map_ranges(partial(_native.dynamic_halve, fine, coarse), len(coarse), execution, label="mip level")
        levels.append(coarse)
    if len(levels) > 1:
        look_up = partial(_native.dynamic_mipmap, levels, view_radius)
        map_ranges(look_up, len(texels), execution, label="mip level")


def _prefilter(texels: Float32, sheet: Sheet, blur: Blur, execution: Execution) -> None:
    """Blur a sheet's texels (H, W, 8) in place: twin of `fewrays.dynamic.prefilter.prefilter`."""
    count = level_count(sheet.slope, blur)
    if count == 0:
        return
    level, passed = texels.copy(), np.empty_like(texels)
    for number in range(count):
        rule = _native.BlurRule(
            radius=blur.radius, tolerance=blur.tolerance, relative=blur.relative, level=number
        )
        along = partial(_native.dynamic_blur_along, level, passed, rule)
        map_ranges(along, len(texels), execution, label="blur")
        down = partial(_native.dynamic_blur_down, passed, level, texels, rule)
        map_ranges(down, len(texels), execution, label="blur")


def _texels(field: LightField, execution: Execution) -> Float32:
    """Interleave what a lookup reads, blurred: light, coverage, slope and two spare, (sheets, H, W, 8)."""
    texels = np.zeros((len(field.sheets), field.height, field.width, 8), np.float32)
    for texel, sheet in zip(texels, field.sheets, strict=True):
        texel[..., :4] = sheet.light
        texel[..., 4] = sheet.coverage
        texel[..., 5] = sheet.slope
        if isinstance(field.blur, Blur):
            _prefilter(texel, sheet, field.blur, execution)
        elif field.blur is not None:
            _mipmap(texel, sheet, field.blur, execution)
        texel[..., 5][sheet.coverage <= 0] = NO_SLOPE
    return texels


def _warp_pixels(field: LightField) -> Float32:
    """Interleave what warping reads: slope and spread, (sheets, H, W, 2); the spread of what is not is -1."""
    pixels = np.empty((len(field.sheets), field.height, field.width, 2), np.float32)
    for pixel, sheet in zip(pixels, field.sheets, strict=True):
        spread = slope_gradient(sheet.slope, field.tolerance, sheet.shown)
        pixel[..., 0] = sheet.slope
        pixel[..., 1] = np.where(sheet.shown & (sheet.coverage > 0), spread, np.float32(-1))
    return pixels


def _blocks(sheets: _native.Sheets, field: LightField, execution: Execution) -> Float32:
    """Measure the blocks of all sheets, (sheets, rows, columns, 4): ``BlockRange`` in native/dynamic.h."""
    rows, columns = -(-field.height // _BLOCK), -(-field.width // _BLOCK)
    blocks = np.empty((len(field.sheets), rows, columns, 4), np.float32)
    measure = partial(_measure_blocks, sheets, blocks)
    map_ranges(measure, len(field.sheets) * rows, execution, label="dynamic")
    return blocks


def _measure_blocks(sheets: _native.Sheets, blocks: Float32, first: int, last: int) -> None:
    _native.dynamic_blocks(sheets, _BLOCK, first, last, blocks)
