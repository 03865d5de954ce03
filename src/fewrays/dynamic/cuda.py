"""The dynamic light field on a GPU: ``native/cuda/dynamic.cu``, launched.

Views are made several at a time, for some rows of the image at a time, so that the keys of what every pixel
sees in them stay in the card's cache. Sheets are prepared on the host (`fewrays.dynamic.prepare`); whatever
depends on the views happens on the card.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.device import require_machine
from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.dynamic.kernel import NO_SLOPE, warp_pixels
from fewrays.dynamic.mipmap import mip_level
from fewrays.dynamic.plan import LightField, Sums
from fewrays.dynamic.prefilter import Blur, level_count
from fewrays.dynamic.sheet import Sheet
from fewrays.errors import SampleError
from fewrays.parallel import Execution

__all__ = ["KERNELS", "DeviceField", "synthesize", "synthesize_views", "upload"]

_VIEWS = 8  # that are made at a time
_LEAST_ROWS = 16
_MOST_PIXELS = 2**32 - 1  # of all sheets, which keys number
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
KERNELS = (_WARP, _SYNTHESIZE, _BLUR_ALONG, _BLUR_DOWN, _HALVE, _MIPMAP)
"""All kernels of the method."""


@dataclass(frozen=True, eq=False)
class DeviceField:
    """A light field on the card, blurred for what lies between its views.

    Parameters
    ----------
    texels : array of float32, (sheets, H, W, 8)
        ``Texel`` in ``native/math/sheet_lookup.h``.
    pixels : array of float32, (sheets, H, W, 2)
        ``WarpPixel`` there.
    behind : array of float32, (sheets,)
        Pixels of slope by which each stands back.
    veils : array of int32, (sheets,)
        Number of each one's layer of translucent pixels, from 1 on; 0 for sheets without.
    layers : int
        Layers of keys: one, and those of veils.
    lens_points : array of float32, (N, 3)
        u, v, weight.
    rows_around : int
        Rows beyond which no view shifts a pixel.
    """

    texels: Any
    pixels: Any
    behind: Any
    veils: Any
    layers: int
    lens_points: Any
    rows_around: int


def synthesize(
    field: LightField, sums: Sums, execution: Execution, passed: npt.NDArray[np.float32] | None = None
) -> None:
    """Add up all views, as `fewrays.dynamic.kernel.synthesize` does.

    Parameters
    ----------
    field : LightField
    sums : ndarray of float32, (H, W, 5)
        Radiance, opacity and weights of the valid rays are added to it.
    execution : Execution
        Not used: a GPU takes no threads and shows no progress.
    passed : ndarray of float32, (H, W), optional
        The weights of all rays are added to it, valid or not.

    Raises
    ------
    SampleError
        Without a GPU, and for images of more pixels than keys can number.
    """
    del execution
    machine = require_machine()
    total, weights = synthesize_views(machine, field, upload(machine, field), vignetting=passed is not None)
    sums += machine.on_host(total)
    if passed is not None:
        passed += machine.on_host(weights)


def upload(machine: Machine, field: LightField) -> DeviceField:
    """Copy a light field to the card and blur it."""
    if len(field.sheets) * field.height * field.width > _MOST_PIXELS:
        raise SampleError(
            f"{field.width} x {field.height} pixels in {len(field.sheets)} sheets are more than the GPU's "
            "kernels can number; use device='cpu'",
            field="color",
        )
    translucent = [bool(((sheet.coverage > 0) & (sheet.coverage < 1)).any()) for sheet in field.sheets]
    veils = np.where(translucent, np.cumsum(translucent), 0)
    views = np.column_stack([field.views.uv, field.views.weight])
    pixels = warp_pixels(field)
    steepest = max(float(np.abs(sheet.slope).max()) for sheet in field.sheets)
    shift = float(np.abs(field.views.uv[:, 1]).max()) * (steepest + 0.5 * float(pixels[..., 1].max()))
    return DeviceField(
        texels=_texels(machine, field),
        pixels=machine.on_device(pixels, np.float32),
        behind=machine.on_device(np.array([sheet.behind for sheet in field.sheets]), np.float32),
        veils=machine.on_device(veils, np.int32),
        layers=1 + sum(translucent),
        lens_points=machine.on_device(views, np.float32),
        rows_around=math.ceil(min(shift, field.height)) + field.growth + 2,
    )


def synthesize_views(
    machine: Machine, field: LightField, device: DeviceField, *, vignetting: bool = False
) -> tuple[Any, Any]:
    """Add up all views on the card, without waiting for it.

    Parameters
    ----------
    machine : Machine
    field : LightField
    device : DeviceField
        The same on the card.
    vignetting : bool
        Add up the weights of all rays as well.

    Returns
    -------
    sums : array of float32, (H, W, 5)
        Radiance, opacity and the weights of the rays that are valid.
    passed : array of float32, (H, W), or None
        The weights of all rays.
    """
    xp, height, width = machine.xp, field.height, field.width
    count = len(field.views.uv)
    sums = xp.zeros((height, width, 5), np.float32)
    passed = xp.zeros((height, width), np.float32) if vignetting else None
    at_once = min(_VIEWS, count)
    rows = machine.cache_bytes // 2 // (8 * at_once * device.layers * width)
    rows = min(max(rows, device.rows_around, _LEAST_ROWS), height)
    keys = xp.full(at_once * device.layers * rows * width, np.uint64(2**64 - 1), np.uint64)
    rim = astuple(field.rim) if field.rim is not None else (0.0, 0.0, 0.0, 1.0, 1.0)
    common = {"texels": device.texels, "lens_points": device.lens_points, "keys": keys}
    common |= {"height": height, "width": width, "layers": device.layers}
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        first_row, end_row = max(top - device.rows_around, 0), min(bottom + device.rows_around, height)
        pixels, seen = blocks_for((end_row - first_row) * width, _WARP), (bottom - top) * width
        for first in range(0, count, at_once):
            views = min(at_once, count - first)
            part = common | {"first_view": first, "top": top, "bottom": bottom}
            machine.launch(
                _WARP,
                (pixels, len(field.sheets), views),
                pixels=device.pixels,
                behind=device.behind,
                veils=device.veils,
                first_row=first_row,
                end_row=end_row,
                growth=field.growth,
                **part,
            )
            machine.launch(
                _SYNTHESIZE,
                (blocks_for(seen, _SYNTHESIZE), 1, 1),
                sums=sums,
                passed=passed,
                rim=rim,
                vignetted=field.rim is not None,
                views=views,
                tolerance=field.tolerance,
                **part,
            )
    return sums, passed


def _texels(machine: Machine, field: LightField) -> Any:
    """Interleave what a lookup reads, blurred: light, coverage, slope and two spare, (sheets, H, W, 8)."""
    texels = machine.xp.zeros((len(field.sheets), field.height, field.width, 8), np.float32)
    for texel, sheet in zip(texels, field.sheets, strict=True):
        coverage = machine.on_device(sheet.coverage, np.float32)
        texel[..., :4] = machine.on_device(sheet.light, np.float32)
        texel[..., 4] = coverage
        texel[..., 5] = machine.on_device(sheet.slope, np.float32)
        if isinstance(field.blur, Blur):
            _prefilter(machine, texel, sheet, field.blur)
        elif field.blur is not None:
            _mipmap(machine, texel, sheet, field.blur)
        texel[..., 5][coverage <= 0] = NO_SLOPE
    return texels


def _prefilter(machine: Machine, texels: Any, sheet: Sheet, blur: Blur) -> None:
    """Blur a sheet's texels (H, W, 8) in place: twin of `fewrays.dynamic.prefilter.prefilter`."""
    count = level_count(sheet.slope, blur)
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


def _mipmap(machine: Machine, texels: Any, sheet: Sheet, view_radius: float) -> None:
    """Look a sheet's texels (H, W, 8) up in place: twin of `fewrays.dynamic.mipmap.mipmap`."""
    levels = [texels]
    for _ in range(math.ceil(float(mip_level(np.abs(sheet.slope).max(), view_radius)))):
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
