"""What all locations of a temporal reconstruction share: where they are, and what makes a surface there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays.lighting import Lighting
from fewrays.samples import SampleBuffer
from fewrays.temporal.dispersion import dispersion
from fewrays.temporal.locations import Locations
from fewrays.tiling import Tiling

__all__ = ["BAND_STARTS", "CROSSING_TOLERANCE", "MOST_SAMPLES", "WIDEST", "Plan", "SurfaceRule"]

CROSSING_TOLERANCE = 0.1
"""Pixels by which the paths of samples of one surface may cross."""

BAND_STARTS = (0.0, 4.0, 8.0, 16.0)
"""Circle-of-confusion radii in pixels at which bands of blur begin."""

MOST_SAMPLES = 512
"""Samples near a location that are looked at closely: of more, the nearest."""

WIDEST = 8.0
"""Radius in units of R up to which samples are looked for where there are none nearer."""


_OVERHANG = 0.11  # in units of R: silhouettes neither grow nor shrink
_LIGHT_OVERHANG = 0.75  # times that: shadows neither grow nor shrink


@dataclass(frozen=True)
class SurfaceRule:
    """When samples near a location belong to one surface, and how that is filtered.

    Parameters
    ----------
    radius : float
        R, in pixels: smaller holes between samples are filled (section 3.3).
    along_lens, along_time : float
        The part of the lens and of the shutter that one location stands for: δ in Eq. 5, in lens units, and
        the same share of the shutter.
    tolerance : float
        Pixels by which paths may cross.
    tent : float
        Radius of the tent filter in units of R; 0 takes the nearest sample instead.
    overhang : float
        Pixels by which a surface reaches beyond its outermost samples, on average.
    """

    radius: float
    along_lens: float
    along_time: float
    tolerance: float = CROSSING_TOLERANCE
    tent: float = 1.0
    overhang: float = 0.0

    def scaled(self, factor: float) -> SurfaceRule:
        """Return the rule for where a pixel's length counts `factor` times."""
        return replace(
            self,
            radius=factor * self.radius,
            tolerance=factor * self.tolerance,
            overhang=factor * self.overhang,
        )

    def for_light(self, samples: SampleBuffer, lighting: Lighting) -> SurfaceRule:
        """Return the rule for light samples: the light is their lens, and the tent is always on."""
        wider = dispersion(samples, _light_points(lighting)) / dispersion(samples)
        return replace(
            self,
            radius=wider * self.radius,
            overhang=_LIGHT_OVERHANG * wider * self.overhang,
            tent=self.tent or 1.0,
        )

    @classmethod
    def for_samples(
        cls, samples: SampleBuffer, locations: int, *, radius_scale: float, tent_scale: float
    ) -> SurfaceRule:
        """Measure R from the samples' pattern."""
        return cls.for_holes(dispersion(samples), locations, radius_scale=radius_scale, tent_scale=tent_scale)

    @classmethod
    def for_holes(
        cls, largest: float, locations: int, *, radius_scale: float, tent_scale: float
    ) -> SurfaceRule:
        """Take R from a radius of holes in pixels; δ is ``1 / √locations`` (Eq. 5), on a lens 2 wide."""
        along_lens = 1 / math.sqrt(locations)
        radius = radius_scale * largest
        return cls(
            radius=radius,
            along_lens=along_lens,
            along_time=along_lens / 2,
            tent=tent_scale,
            overhang=_OVERHANG * radius,
        )


def _light_points(lighting: Lighting) -> npt.NDArray[np.float32]:
    """Return where light samples start, ``(H, W, S, 2)``, on the light: anywhere, if there are none."""
    light = max(lighting.lights, key=lambda each: np.count_nonzero(each.density))
    anywhere = np.random.default_rng(0).uniform(-0.9, 0.9, light.luv.shape).astype(np.float32)
    return np.where(light.density[..., None] > 0, light.luv, anywhere)


@dataclass(frozen=True, kw_only=True)
class Plan(Tiling):
    """Everything that a tile needs to know besides the samples.

    Parameters
    ----------
    height, width, tile
        See `Tiling`.
    locations : Locations
        Where every pixel reads the light field.
    rule : SurfaceRule
    band_starts : tuple of float
        Least circle-of-confusion radius ``|C|`` of each band of blur, in pixels: what is seen is added up
        apart for each.
    lighting : Lighting, optional
        The samples' area lights, if light and shadow are to be reconstructed.
    """

    locations: Locations
    rule: SurfaceRule
    band_starts: tuple[float, ...] = BAND_STARTS
    lighting: Lighting | None = None
