"""What all pixels of a light field share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.prefilter import Blur
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.views import Views
from fewrays.vignetting import FrontRim

__all__ = ["LightField", "Sums"]

Sums = npt.NDArray[np.float32]
"""Sums over the views (H, W, 5): radiance, opacity, and the weights of the rays that are valid."""


@dataclass(frozen=True, eq=False)
class LightField:
    """Everything that the views are made from.

    Parameters
    ----------
    sheets : sequence of Sheet
        All of one size. Of equally near ones the first wins.
    views : Views
    tolerance : float
        Slopes in pixels by which neighbours of one surface may differ.
    growth : int
        Pixels to every side that a warped pixel covers as well.
    blur : Blur or float, optional
        What stands for the light between the views: a blur within surfaces, or the paper's mip pyramid for a
        part of the aperture of that radius in lens units.
    rim : FrontRim, optional
        The front rim of a lens that cuts rays off.
    """

    sheets: Sequence[Sheet]
    views: Views
    tolerance: float
    growth: int = 0
    blur: Blur | float | None = None
    rim: FrontRim | None = None

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.sheets[0].slope.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.sheets[0].slope.shape[1])
