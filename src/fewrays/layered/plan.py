"""What all tiles of a layered reconstruction share: layers, parts of the aperture, widths of the blurs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fewrays.layered.aperture import ApertureParts, aperture_variance
from fewrays.layered.slabs import Slabs
from fewrays.samples import SampleBuffer

__all__ = ["DEEPEST_TILE_LEVEL", "FULL_WEIGHT", "MAP_MARGIN", "MAX_SLOPE", "SEEN", "Plan"]

MAX_SLOPE = 2.0**15
"""Slopes beyond this count as this, in pixels: such samples are spread over far more than any image."""

MAP_MARGIN = 12
"""Bins of a coarse layer's map around the image."""

DEEPEST_TILE_LEVEL = 1
"""Layers of bins up to this level are filtered tile by tile; those of coarser bins as maps of the whole image."""

FULL_WEIGHT = 3 / 8
"""Share of the expected samples from which on a bin weighs as much as any other."""

SEEN = 1 / 8
"""Share of the expected samples from which on a bin is certainly not hidden."""


@dataclass(frozen=True)
class Plan:
    """Everything that a tile needs to know besides the samples.

    Parameters
    ----------
    height, width, spp : int
        Size of the image in pixels, samples per pixel.
    tile : int
        Side of a tile of the image in pixels.
    map_tile : int
        Side of a tile of a coarse layer's map in bins.
    slabs : Slabs
        The depth layers.
    pixel_variance : float
        Variance of the pixel filter along one axis, in pixels².
    aperture_variance : float
        Variance of the aperture along one axis, in lens units².
    aperture : ApertureParts
        The parts of the aperture.
    """

    height: int
    width: int
    spp: int
    tile: int
    map_tile: int
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
        map_tile: int = 256,
    ) -> Plan:
        """Lay out layers and parts for a buffer; the parameters are those of `LayeredOptions`."""
        variance = aperture_variance(samples.lens)
        aperture = ApertureParts.split(variance, aperture_parts)
        ends = samples.lens.slope(np.array([samples.depth.min(), samples.depth.max()], np.float32))
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
            samples.height,
            samples.width,
            samples.spp,
            tile,
            map_tile,
            slabs,
            sigma_pix**2,
            variance,
            aperture,
        )

    @property
    def interpolation_variance(self) -> float:
        """Variance that reading a map between its cells adds along one axis, in cells².

        Linear interpolation at the fraction f adds ``f (1 - f)``, 1/6 on average; parts in the aperture's centre
        read the cells themselves.
        """
        return (1 - self.aperture.central_weight) / 6

    @property
    def tile_columns(self) -> int:
        """Tiles in a row of tiles."""
        return -(-self.width // self.tile)

    @property
    def tile_count(self) -> int:
        """Number of tiles."""
        return self.tile_columns * -(-self.height // self.tile)

    def map_tiles(self, level: int) -> tuple[int, int]:
        """Rows and columns of tiles in the map of a coarse layer of bins of ``2**level`` pixels."""
        bins = (-(-side // 2**level) + 2 * MAP_MARGIN for side in (self.height, self.width))
        rows, columns = (-(-count // self.map_tile) for count in bins)
        return rows, columns
