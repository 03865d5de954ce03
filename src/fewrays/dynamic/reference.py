"""The dynamic light field in plain NumPy, float64: the definition of what the native kernel computes.

All sheets are blurred for what lies between the views (`prefilter`). For each view, its pixels are found by
warping (`warp`), their light is looked up and composited (`synthesis`), and the image is the weighted mean
of all views (Eq. 7)::

    I(p) = Σ w(s, t) L(s, t, p) / Σ w(s, t)

over the rays that are valid. One view after the other: none is kept.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.mipmap import mipmap
from fewrays.dynamic.plan import LightField, Sums
from fewrays.dynamic.prefilter import Blur, prefilter
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.synthesis import composite, look_up
from fewrays.dynamic.warp import NOTHING, WarpSource, warp
from fewrays.parallel import Execution, progress_bar

__all__ = ["synthesize"]

Float64 = npt.NDArray[np.float64]


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
        For its progress bar.
    passed : ndarray of float32, (H, W), optional
        The weights of all rays are added to it, valid or not: what the front rim of the lens lets pass.
    """
    sheets = [_blurred(sheet, field.blur) for sheet in field.sheets]
    kinds = [
        (sheet, opaque, WarpSource.of_sheet(sheet, which, field.tolerance))
        for opaque in (True, False)
        for sheet in sheets
        for which in [sheet.coverage >= 1 if opaque else (sheet.coverage > 0) & (sheet.coverage < 1)]
    ]
    total = np.zeros(sums.shape)
    views = field.views
    with progress_bar(len(views.uv), "dynamic", show=execution.progress, unit="view") as bar:
        for (u, v), weight in zip(views.uv, views.weight, strict=True):
            light, coverage = composite([_seen(field, *kind, float(u), float(v)) for kind in kinds])
            passing = weight * _passing(field, float(u), float(v))
            total[..., :4] += passing[..., None] * light
            total[..., 4] += passing * coverage
            if passed is not None:
                passed += passing.astype(np.float32)
            bar.update()
    sums += total.astype(np.float32)


def _blurred(sheet: Sheet, blur: Blur | float | None) -> Sheet:
    if blur is None:
        return sheet
    return prefilter(sheet, blur) if isinstance(blur, Blur) else mipmap(sheet, blur)


def _passing(field: LightField, u: float, v: float) -> Float64:
    """Share of a lens point's light that passes the front rim of the lens, at every pixel."""
    if field.rim is None:
        return np.ones((field.height, field.width))
    x, y = np.meshgrid(np.arange(field.width) + 0.5, np.arange(field.height) + 0.5)
    return field.rim.passes((u, v), np.stack([x, y], axis=-1))


def _seen(
    field: LightField, sheet: Sheet, opaque: bool, source: WarpSource, u: float, v: float
) -> tuple[Float64, Float64, Float64]:
    """Light, coverage and order of what a view shows of one sheet's opaque pixels, or of its others."""
    number, order = warp(source, (field.height, field.width), u, v, field.growth)
    light, coverage = np.zeros((*order.shape, 4)), np.zeros(order.shape)
    cell = np.flatnonzero(number != NOTHING)
    found, covered = look_up(sheet, number.ravel()[cell], cell, u, v, field.tolerance)
    if opaque:
        found, covered = found / covered[:, None], np.ones(len(cell))
    light.reshape(-1, 4)[cell], coverage.ravel()[cell] = found, covered
    return light, coverage, order
