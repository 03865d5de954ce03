"""Planes smoothed for the views that they are looked at with.

A plane that is blurred over a wide disc is seen from N lens points, and so N times, at places that blur puts
far apart. A Gaussian about as wide as a third of their distance closes the gaps between them. How far they
are apart depends on lens, focus and number of views, so planes are stored sharp and smoothed copies are made
for every image. Where the Gaussian is half a pixel wide, these need no more than one cell per pixel. They are
made for one band of the image after the other, so that they take little memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.aperture import Aperture
from fewrays.multiplane.maps import BLOCK, Maps
from fewrays.temporal.locations import Locations

__all__ = [
    "Smoothing",
    "distance_between",
    "touched_places",
    "widened",
]

Bools = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

_LEAST_SIGMA = 0.3  # pixels; a Gaussian narrower than that has no second tap to speak of
_MOST_SIGMA = 10.0  # pixels
_COARSE_SIGMA = 0.5  # pixels; what has been smoothed that much needs one cell per pixel
_NEAR = 2.0  # pixels
_SQUARE = 4.0  # square lens units: all lens points lie in [-1, 1]²
_DARK = 1e-9  # light per square lens unit that is none


@dataclass(frozen=True, eq=False)
class Smoothing:
    """How planes are smoothed for an image.

    Parameters
    ----------
    sigma : ndarray, (K,)
        Standard deviation of the Gaussian in pixels; 0 for planes that stay as they are.
    built : ndarray of int32, (K,)
        Cells per pixel and axis of planes as they were built.
    cells : ndarray of int32, (K,)
        The same of smoothed planes: one where there were two and the Gaussian is wide.
    """

    sigma: Float64
    built: Int32
    cells: Int32

    @classmethod
    def of_views(cls, slope: Float64, cells: Int32, distance: float, strength: float) -> Smoothing:
        """Choose how planes of slopes (K,) and cells (K,) are smoothed for lens points a distance apart.

        With `distance` d in lens units, blur puts them ``|C| d`` pixels apart: the unit of `strength`.
        """
        sigma = strength * np.abs(slope) * distance
        sigma = np.where(sigma > _LEAST_SIGMA, np.minimum(sigma, _MOST_SIGMA), 0.0)
        return cls(sigma, cells, np.where((cells == 2) & (sigma > _COARSE_SIGMA), 1, cells).astype(np.int32))

    @property
    def variance(self) -> Float64:
        """The variance along each axis of all that blurs the planes, in squared pixels, (K,).

        Sharing a ray out among cells convolves with a triangle two cells wide, of the variance 1/6; so does
        interpolation. The mean of n cells convolves with n points.
        """
        built, cells = np.square(self.built, dtype=np.float64), np.square(self.cells, dtype=np.float64)
        return 1 / (6 * built) + 1 / (6 * cells) + (1 / cells - 1 / built) / 12 + np.square(self.sigma)


def distance_between(aperture: Aperture, where: Locations) -> float:
    """Return how far apart neighbouring lens points are, in lens units, as a root of the mean square.

    Where a square lens unit gets a share p of the light, each of N points of equal light has ``1 / (N p)``
    square units to itself. The mean of that over the points is about the N-th part of all the area that lets
    light pass. It is more than the variance of the points tells: at a Gaussian's foot few lie far apart, and
    there they are seen one by one first.
    """
    area = float(np.mean(1 / np.maximum(aperture.density(where.uv), _DARK)))
    return math.sqrt(min(area, _SQUARE) / where.count)


def touched_places(maps: Maps, smoothing: Smoothing) -> Bools:
    """Return which places for blocks smoothed planes may reach."""
    touched = np.zeros(maps.grid.slot_count, np.bool_)
    for plane, (columns, rows) in enumerate(maps.grid.shape):
        if smoothing.sigma[plane] > 0:
            first = maps.grid.first_slot[plane]
            own = slice(first, first + rows * columns)
            kept = maps.slots[own].reshape(rows, columns) >= 0
            touched[own] = widened(kept, float(smoothing.sigma[plane])).reshape(-1)
    return touched


def widened(kept: Bools, sigma: float) -> Bools:
    """Return which blocks (R, C) a Gaussian of a standard deviation in pixels may bring something to.

    Without these, what lies close to a block's border would end there, and small lights would show it. Of
    its weight 98 % lie within two standard deviations, and samples touch the blocks of what is near anyway.
    """
    for size in BLOCK:
        wide = kept.copy()
        blocks = math.ceil(max(2 * sigma - _NEAR, 0.0) / size)
        for step in range(1, min(blocks, len(kept) - 1) + 1):
            wide[step:] |= kept[:-step]
            wide[:-step] |= kept[step:]
        kept = wide.T  # columns next; the second time, rows again
    return kept
