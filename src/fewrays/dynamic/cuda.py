"""The dynamic light field on a GPU: ``native/cuda/dynamic.cu``, launched.

Views are made several at a time, for some rows of the image at a time, so that the keys of what every pixel
sees in them stay in the card's cache. `fewrays.dynamic.cuda_prepare` makes the sheets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.dynamic import cuda_prepare
from fewrays.dynamic.cuda_prepare import DeviceSheets, prepare_sheets
from fewrays.dynamic.device_layer import DeviceLayer
from fewrays.dynamic.kernel import NO_SLOPE
from fewrays.dynamic.mipmap import mip_level
from fewrays.dynamic.options import DefocusOptions
from fewrays.dynamic.plan import ViewRules
from fewrays.dynamic.prefilter import Blur, level_count
from fewrays.lens import Lens

__all__ = ["KERNELS", "blur_between_views", "defocus_layers", "synthesize_views"]

_VIEWS = 8  # that are made at a time
_LEAST_ROWS = 16
_MIP_LEVEL = np.dtype([("texels", "u8"), ("height", "i4"), ("width", "i4")], align=True)

_WARP = Kernel(
    "dynamic",
    "dynamic_warp",
    256,
    {
        "pixels": "*f4",
        "texels": "*f4",
        "behind": "*f4",
        "veils": "*i4",
        "lens_points": "*f4",
        "keys": "*u8",
        "height": "i4",
        "width": "i4",
        "layers": "i4",
        "first_view": "i4",
        "top": "i4",
        "bottom": "i4",
        "first_row": "i4",
        "end_row": "i4",
        "growth": "f4",
    },
)
_SYNTHESIZE = Kernel(
    "dynamic",
    "dynamic_synthesize",
    128,
    {
        "texels": "*f4",
        "lens_points": "*f4",
        "keys": "*u8",
        "sums": "*f4",
        "passed": "*f4",
        "rim": "5f4",
        "vignetted": "i4",
        "height": "i4",
        "width": "i4",
        "layers": "i4",
        "first_view": "i4",
        "views": "i4",
        "top": "i4",
        "bottom": "i4",
        "tolerance": "f4",
    },
)
_BLUR = {
    "from": "*f4",
    "to": "*f4",
    "sheet": "*f4",
    "height": "i4",
    "width": "i4",
    "radius": "f4",
    "tolerance": "f4",
    "relative": "f4",
    "level": "i4",
}
_BLUR_ALONG = Kernel("dynamic", "dynamic_blur_along", 256, _BLUR)
_BLUR_DOWN = Kernel("dynamic", "dynamic_blur_down", 256, _BLUR)
_HALVE = Kernel(
    "dynamic",
    "dynamic_halve",
    256,
    {
        "fine": "*f4",
        "coarse": "*f4",
        "fine_height": "i4",
        "fine_width": "i4",
        "height": "i4",
        "width": "i4",
    },
)
_MIPMAP = Kernel(
    "dynamic",
    "dynamic_mipmap",
    256,
    {"levels": "*u1", "count": "i4", "height": "i4", "width": "i4", "view_radius": "f4"},
)
KERNELS = (*cuda_prepare.KERNELS, _WARP, _SYNTHESIZE, _BLUR_ALONG, _BLUR_DOWN, _HALVE, _MIPMAP)
"""All kernels of the method."""


def defocus_layers(
    machine: Machine,
    layers: Sequence[DeviceLayer],
    lens: Lens,
    options: DefocusOptions,
) -> Any:
    """Give layers that are on the card the depth of field of a lens.

    Parameters
    ----------
    machine : Machine
    layers : sequence of DeviceLayer
        All of one size, the nearest first.
    lens : Lens
    options : DefocusOptions

    Returns
    -------
    array of float32, (H, W, 4)
        Linear radiance multiplied by opacity, and opacity, on the card, which is not waited for.

    Raises
    ------
    SampleError
        As `fewrays.dynamic.cuda_prepare.prepare_sheets` does.
    """
    rules = ViewRules.of_options(options, lens, layers[0].height, layers[0].width)
    sheets = prepare_sheets(machine, layers, lens, options)
    from_centre = sheets.texels[0, ..., :4].copy()
    blur_between_views(machine, sheets, rules)
    sums, passed = synthesize_views(machine, sheets, rules, vignetting=options.darken)
    xp, one = machine.xp, np.float32(1)
    weight = sums[..., 4:]
    # Where no ray is valid, what the lens centre sees is shown.
    image = xp.where(weight > 0, sums[..., :4] / xp.where(weight > 0, weight, one), from_centre)
    if passed is not None:
        image[..., :3] *= passed[..., None] / np.float32(rules.views.weight.sum())
    return image


def blur_between_views(machine: Machine, sheets: DeviceSheets, rules: ViewRules) -> None:
    """Blur the light of sheets in place, and take the slope of what is not out of the way of lookups."""
    for texels in sheets.texels:
        if isinstance(rules.blur, Blur):
            _prefilter(machine, texels, sheets.steepest, rules.blur)
        elif rules.blur is not None:
            _mipmap(machine, texels, sheets.steepest, rules.blur)
    slope, covered = sheets.texels[..., 5], sheets.texels[..., 4] > 0
    sheets.texels[..., 5] = machine.xp.where(covered, slope, np.float32(NO_SLOPE))


def synthesize_views(
    machine: Machine, sheets: DeviceSheets, rules: ViewRules, *, vignetting: bool = False
) -> tuple[Any, Any]:
    """Add up all views on the card, without waiting for it.

    Parameters
    ----------
    machine : Machine
    sheets : DeviceSheets
        Blurred for what lies between the views.
    rules : ViewRules
    vignetting : bool
        Add up the weights of all rays as well.

    Returns
    -------
    sums : array of float32, (H, W, 5)
        Radiance, opacity and the weights of the rays that are valid.
    passed : array of float32, (H, W), or None
        The weights of all rays.
    """
    xp, height, width = machine.xp, sheets.height, sheets.width
    uv, count = rules.views.uv, len(rules.views.uv)
    sums = xp.zeros((height, width, 5), np.float32)
    passed = xp.zeros((height, width), np.float32) if vignetting else None
    layers = 1 + int(sheets.translucent.sum())  # of keys: one, and those of veils
    veils = np.where(sheets.translucent, np.cumsum(sheets.translucent), 0)
    at_once = min(_VIEWS, count)
    rows = machine.cache_bytes // 2 // (8 * at_once * layers * width)
    around = _rows_around(sheets, rules)
    rows = min(max(rows, around, _LEAST_ROWS), height)
    keys = xp.full(at_once * layers * rows * width, np.uint64(2**64 - 1), np.uint64)
    common = {"texels": sheets.texels, "keys": keys, "height": height, "width": width, "layers": layers}
    common["lens_points"] = machine.on_device(np.column_stack([uv, rules.views.weight]), np.float32)
    warping = {"pixels": sheets.pixels, "growth": rules.growth}
    warping["behind"] = machine.on_device(sheets.behind, np.float32)
    warping["veils"] = machine.on_device(veils, np.int32)
    looking = {"sums": sums, "passed": passed, "vignetted": rules.rim is not None}
    looking["rim"] = astuple(rules.rim) if rules.rim is not None else (0.0, 0.0, 0.0, 1.0, 1.0)
    looking["tolerance"] = rules.tolerance
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        first_row, end_row = max(top - around, 0), min(bottom + around, height)
        pixels, seen = blocks_for((end_row - first_row) * width, _WARP), (bottom - top) * width
        for first in range(0, count, at_once):
            views = min(at_once, count - first)
            part = common | {"first_view": first, "top": top, "bottom": bottom}
            grid = (pixels, len(sheets.behind), views)
            machine.launch(_WARP, grid, first_row=first_row, end_row=end_row, **warping, **part)
            grid = (blocks_for(seen, _SYNTHESIZE), 1, 1)
            machine.launch(_SYNTHESIZE, grid, views=views, **looking, **part)
    return sums, passed


def _rows_around(sheets: DeviceSheets, rules: ViewRules) -> int:
    """Return how many rows beyond some of an image's rows hold pixels that views may show in them."""
    # A surface's slope changes by the tolerance at most, along either axis: no pixel spreads by more.
    shift = float(np.abs(rules.views.uv[:, 1]).max()) * (sheets.steepest + rules.tolerance)
    return math.ceil(min(shift, sheets.height)) + rules.growth + 2


def _prefilter(machine: Machine, texels: Any, steepest: float, blur: Blur) -> None:
    """Blur a sheet's texels (H, W, 8) in place: twin of `fewrays.dynamic.prefilter.prefilter`."""
    count = level_count(steepest, blur)
    if count == 0:
        return
    height, width, _ = texels.shape
    level, passed = texels.copy(), machine.xp.empty_like(texels)
    rule = {"height": height, "width": width, "radius": blur.radius}
    rule |= {"tolerance": blur.tolerance, "relative": blur.relative}
    grid = (blocks_for(height * width, _BLUR_ALONG), 1, 1)
    for number in range(count):
        along, down = {"from": level, "to": passed}, {"from": passed, "to": level}
        machine.launch(_BLUR_ALONG, grid, sheet=None, level=number, **along, **rule)
        machine.launch(_BLUR_DOWN, grid, sheet=texels, level=number, **down, **rule)


def _mipmap(machine: Machine, texels: Any, steepest: float, view_radius: float) -> None:
    """Look a sheet's texels (H, W, 8) up in place: twin of `fewrays.dynamic.mipmap.mipmap`."""
    levels = [texels]
    for _ in range(math.ceil(float(mip_level(steepest, view_radius)))):
        fine = levels[-1]
        coarse = machine.xp.empty((-(-fine.shape[0] // 2), -(-fine.shape[1] // 2), 8), np.float32)
        size = {"fine_height": fine.shape[0], "fine_width": fine.shape[1]}
        size |= {"height": coarse.shape[0], "width": coarse.shape[1]}
        grid = (blocks_for(coarse.shape[0] * coarse.shape[1], _HALVE), 1, 1)
        machine.launch(_HALVE, grid, fine=fine, coarse=coarse, **size)
        levels.append(coarse)
    if len(levels) == 1:
        return
    places = np.array([(machine.address(level), *level.shape[:2]) for level in levels], _MIP_LEVEL)
    height, width, _ = texels.shape
    machine.launch(
        _MIPMAP,
        (blocks_for(height * width, _MIPMAP), 1, 1),
        levels=machine.on_device(places.view(np.uint8), np.uint8),
        count=len(levels),
        height=height,
        width=width,
        view_radius=view_radius,
    )
