"""What all tiles of a layered reconstruction share: layers, parts of the aperture, widths of the blurs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fewrays.layered.aperture import ApertureParts, aperture_variance
from fewrays.layered.regions import RegionPlan
from fewrays.layered.slabs import Slabs
from fewrays.lens import Lens
from fewrays.samples import SampleBuffer
from fewrays.tiling import Tiling

__all__ = [
    "FINEST_BY_PLACE",
    "FULL_WEIGHT",
    "MAX_SLOPE",
    "SEEN",
    "Plan",
]

MAX_SLOPE = 2.0**15
"""Slopes beyond this count as this, in pixels: such samples are spread over far more than any image."""

FINEST_BY_PLACE = -1
"""Level from which on bins weigh by place; in finer ones every sample counts alike."""

FULL_WEIGHT = 3 / 8
"""Share of the expected samples from which on a bin weighs as much as any other."""

SEEN = 1 / 8
"""Share of the expected samples from which on a bin is certainly not hidden."""

_FINEST_BLOCK = 8  # side of the blocks of pixels that are surveyed, in pixels
_SURVEY_BYTES = 2**25  # what the survey of an image may take


@dataclass(frozen=True, kw_only=True)
class Plan(Tiling):
    """Everything that a tile needs to know besides the samples.

    Parameters
    ----------
    height, width, tile
        See `Tiling`.
    spp : int
        Samples per pixel.
    slabs : Slabs
        The depth layers.
    pixel_variance : float
        Variance of the pixel filter along one axis, in pixels².
    aperture_variance : float
        Variance of the aperture along one axis, in lens units².
    aperture : ApertureParts
        The parts of the aperture.
    """

    spp: int
    slabs: Slabs
    pixel_variance: float
    aperture_variance: float
    aperture: ApertureParts

    @classmethod
    def for_samples(
        cls,
        samples: SampleBuffer,
        *,
        sigma_pix: float,
        layer_spacing: float,
        aperture_parts: int,
        tile: int,
    ) -> Plan:
        """Lay out layers and parts for a buffer; the parameters are those of `LayeredOptions`."""
        return cls.for_depths(
            samples.lens,
            (samples.height, samples.width, samples.spp),
            (float(samples.depth.min()), float(samples.depth.max())),
            sigma_pix=sigma_pix,
            layer_spacing=layer_spacing,
            aperture_parts=aperture_parts,
            tile=tile,
        )

    @classmethod
    def for_depths(
        cls,
        lens: Lens,
        size: tuple[int, int, int],
        depths: tuple[float, float],
        *,
        sigma_pix: float,
        layer_spacing: float,
        aperture_parts: int,
        tile: int,
    ) -> Plan:
        """Do as `for_samples`, for a size (H, W, S) and the least and the greatest depth of the samples."""
        variance = aperture_variance(lens)
        aperture = ApertureParts.split(variance, aperture_parts)
        ends = lens.slope(np.array(depths, np.float32))
        c_min, c_max = np.clip(ends, -MAX_SLOPE, MAX_SLOPE)
        slabs = Slabs.covering(
            float(c_min),
            float(c_max),
            spacing=layer_spacing,
            sigma_pix=sigma_pix,
            sigma_u=variance**0.5,
            part_sigma=aperture.sigma,
        )
        return cls(
            height=size[0],
            width=size[1],
            tile=tile,
            spp=size[2],
            slabs=slabs,
            pixel_variance=sigma_pix**2,
            aperture_variance=variance,
            aperture=aperture,
        )

    @property
    def interpolation_variance(self) -> float:
        """Variance that reading a map between its cells adds along one axis, in cells².

        Linear interpolation at the fraction f adds ``f (1 - f)``, 1/6 on average; parts at the aperture's
        centre read the cells themselves.
        """
        return (1 - self.aperture.central_weight) / 6

    @property
    def survey_block(self) -> int:
        """Side of the blocks of pixels that are surveyed, in pixels; larger for images of very many."""
        block = _FINEST_BLOCK
        while self.height * self.width * self.slabs.count * 8 > _SURVEY_BYTES * block**2:
            block *= 2
        return block

    @property
    def survey_margin(self) -> float:
        """Pixels around the image beyond which no sample can reach it."""
        return 4 * float(self.slabs.reaches.max()) + 64.0

    @cached_property
    def region_plan(self) -> RegionPlan:
        """The regions that are reconstructed one after the other, and the coarse maps that they need."""
        return RegionPlan.covering(self, int(self.slabs.levels.max(initial=0)))
