"""What all pixels of a light field share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.options import DefocusOptions
from fewrays.dynamic.prefilter import Blur
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.views import Views
from fewrays.lens import Lens
from fewrays.vignetting import FrontRim

__all__ = ["LightField", "Sums", "ViewRules"]

Sums = npt.NDArray[np.float32]
"""Sums over the views (H, W, 5): radiance, opacity, and the weights of the rays that are valid."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ViewRules:
    """How views are made of sheets, whatever these show.

    Parameters
    ----------
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

    views: Views
    tolerance: float
    growth: int = 0
    blur: Blur | float | None = None
    rim: FrontRim | None = None

    @classmethod
    def of_options(cls, options: DefocusOptions, lens: Lens, height: int, width: int) -> ViewRules:
        """Make them for images of a size in pixels."""
        aperture = options.aperture_of(lens)
        views = Views.of_aperture(aperture, options.views, options.lens_points, options.falloff_f_number)
        blur: Blur | float | None = None
        if options.prefilter == "surface":
            blur = Blur(views.radius * options.footprint, options.surface_tolerance)
        elif options.prefilter == "mipmap":
            blur = views.radius * options.footprint
        rim = options.vignetting().front_rim(views.uv, height, width) if options.cats_eye > 0 else None
        return cls(
            views=views, tolerance=options.surface_tolerance, growth=options.growth, blur=blur, rim=rim
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class LightField(ViewRules):
    """Everything that the views are made from.

    Parameters
    ----------
    sheets : sequence of Sheet
        All of one size. Of equally near ones the first wins.
    views, tolerance, growth, blur, rim
        As in `ViewRules`.
    """

    sheets: Sequence[Sheet]

    @classmethod
    def of_sheets(cls, sheets: Sequence[Sheet], rules: ViewRules) -> LightField:
        """Put sheets and rules together."""
        return cls(sheets=sheets, **{field.name: getattr(rules, field.name) for field in fields(ViewRules)})

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.sheets[0].slope.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.sheets[0].slope.shape[1])
