"""The options of depth of field from one image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fewrays.aperture import MAX_POINTS
from fewrays.aperture_options import ApertureOptions
from fewrays.dynamic.views import LensPoints
from fewrays.errors import require_option
from fewrays.vignetting import CatsEye

__all__ = ["DefocusOptions"]


@dataclass(frozen=True, kw_only=True)
class DefocusOptions(ApertureOptions):
    """Options of depth of field from one image."""

    views: int = 36
    """Views from the lens that are blended: time grows with them, large blur gets smoother and crisper."""
    lens_points: LensPoints = "vogel"
    """Where on the lens they are: an even spiral, or the paper's Halton sequence."""
    cats_eye: float = 0.0
    """How far the lens's front rim is displaced in the image's corners, in lens radii, 0 to 1."""
    darken: bool = False
    """Whether what it cuts off darkens the corners; otherwise blurred lights change their shape alone."""
    falloff_f_number: float = math.inf
    """f-number for which rays fall off by cos⁴φ; infinite for no fall-off, as renderers' lenses have none."""
    prefilter: Literal["surface", "mipmap", "none"] = "surface"
    """Blur for what lies between the views: within surfaces, the paper's mip pyramid, or none."""
    footprint: float = 0.7
    """Width of that blur, in units of the views' distance."""
    fill_reach: int = 64
    """Pixels from an edge up to which the surface behind it is carried on; 0 leaves out rays without data."""
    split_edges: bool = True
    """Take antialiased edges apart into what is in front and what is behind."""
    growth: int = 0
    """Pixels to every side that a warped pixel covers as well; the paper's support growth is 1."""
    surface_tolerance: float = 1.0
    """Slopes of neighbouring pixels that differ by more pixels belong to different surfaces."""
    invalid_depth: Literal["error", "background"] = "error"
    """What NaN, zero or negative depths are: an error, or infinitely far background."""

    def __post_init__(self) -> None:
        for name, least, most in (("views", 1, MAX_POINTS), ("fill_reach", 0, 4096), ("growth", 0, 4)):
            value = getattr(self, name)
            whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
            require_option(
                name,
                value,
                whole and least <= value <= most,
                f"that is a whole number from {least} to {most}",
            )
        for name, choices in (
            ("lens_points", ("vogel", "halton")),
            ("prefilter", ("surface", "mipmap", "none")),
            ("invalid_depth", ("error", "background")),
        ):
            value = getattr(self, name)
            require_option(name, value, value in choices, f"out of {', '.join(choices)}")
        require_option("falloff_f_number", self.falloff_f_number, self.falloff_f_number >= 0.1, "from 0.1")
        require_option("footprint", self.footprint, 0 <= self.footprint <= 8, "from 0 to 8")
        require_option(
            "surface_tolerance",
            self.surface_tolerance,
            0.01 <= self.surface_tolerance <= 100,
            "from 0.01 to 100 px",
        )
        self.vignetting()
        super().__post_init__()

    def vignetting(self) -> CatsEye:
        """Return what the lens's front rim does."""
        return CatsEye(self.cats_eye, self.darken)
