"""Warping: what every view sees at each of its pixels (section 3.2).

A pixel with slope C, which the lens centre sees at x, is seen from the lens point (u, v) at ``x + C (u, v)``
(Eq. 4; slopes are disparities relative to the focal plane, so that the shift by the focal disparity in Eq. 7
is included). There it covers the pixels whose centres are nearest. Rounding would leave cracks where a
surface stretches, so that every pixel covers as much more as its surface's slope changes from pixel to
pixel; the paper has each written to its neighbours too (`growth`), which makes silhouettes grow. Of all that
fall on a pixel the nearest wins. The image's outermost pixels cover all that lies beyond them: what is in
front there must hide what is behind. What does not cover its pixel wholly hides nothing: of each sheet's
such pixels the nearest is kept beside the opaque one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.surfaces import slope_gradient

__all__ = ["NOTHING", "WarpSource", "warp"]

Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]

NOTHING = -1
"""Number of no pixel: no ray of the light field ends here."""


@dataclass(frozen=True, eq=False)
class WarpSource:
    """A sheet's pixels of one kind, opaque or not, ready to be warped.

    Parameters
    ----------
    number : ndarray of int64, (M,)
        Row times width plus column, in order.
    slope, order : ndarray of float64, (M,)
        Slope in pixels, and what visibility is resolved by.
    spread : ndarray of float64, (M,)
        How much wider than a pixel it may look from the rim of the lens.
    """

    number: Int64
    slope: Float64
    order: Float64
    spread: Float64

    @classmethod
    def of_sheet(cls, sheet: Sheet, which: npt.NDArray[np.bool_], tolerance: float) -> WarpSource:
        """Gather the pixels of a sheet that are shown and among `which`."""
        number = np.flatnonzero(sheet.shown & which)
        slope = sheet.slope.ravel()[number]
        spread = slope_gradient(sheet.slope, tolerance, sheet.shown).ravel()[number]
        return cls(
            number,
            slope.astype(float),
            (slope + np.float32(sheet.behind)).astype(float),
            spread.astype(float),
        )


def warp(
    source: WarpSource, shape: tuple[int, int], u: float, v: float, growth: int = 0
) -> tuple[Int64, Float64]:
    """Find the nearest pixel that a lens point sees at each pixel of its view.

    Parameters
    ----------
    source : WarpSource
    shape : (int, int)
        Height and width of the image.
    u, v : float
        Lens point.
    growth : int
        Pixels to every side that are covered as well.

    Returns
    -------
    number : ndarray of int64, (H, W)
        Of the pixel seen, `NOTHING` where there is none.
    order : ndarray of float64, (H, W)
        What its visibility was resolved by; infinite where there is none.
    """
    height, width = shape
    row, column = np.divmod(source.number, width)
    half_u, half_v = (0.5 + growth + 0.5 * source.spread * abs(lens) for lens in (u, v))
    left, right = _covered(column, column + source.slope * u, half_u, width)
    top, bottom = _covered(row, row + source.slope * v, half_v, height)
    wide, high = np.maximum(right - left, 0), np.maximum(bottom - top, 0)
    pixel = np.repeat(np.arange(len(source.number)), wide * high)
    within = np.arange(len(pixel)) - np.repeat(np.cumsum(wide * high) - wide * high, wide * high)
    down, along = np.divmod(within, wide[pixel])
    cell = (top[pixel] + down) * width + left[pixel] + along

    nearest = np.lexsort([source.number[pixel], source.order[pixel], cell])
    cell, first = np.unique(cell[nearest], return_index=True)
    pixel = pixel[nearest][first]
    number = np.full(height * width, NOTHING, np.int64)
    order = np.full(height * width, np.inf)
    number[cell], order[cell] = source.number[pixel], source.order[pixel]
    return number.reshape(shape), order.reshape(shape)


def _covered(start: Int64, position: Float64, half: Float64, size: int) -> tuple[Int64, Int64]:
    """Return the first pixel that each covers along an axis, and the one after the last.

    It covers those whose centres lie between its borders, one of these included: without spread, one pixel.
    """
    first = np.ceil(position - half).astype(np.int64)
    end = np.ceil(position + half).astype(np.int64)
    first[start == 0] = 0
    end[start == size - 1] = size
    return np.maximum(first, 0), np.minimum(end, size)
