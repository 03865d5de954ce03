"""Who is compared on every page: what the pages call each image, and how it is made from samples."""

from __future__ import annotations

from typing import Any

import fewrays
from fewrays.method import Image
from fewrays.sources.analytic import PixelFilter
from peers import DENOISER, denoise

__all__ = [
    "BEST",
    "BEST_OPTIONS",
    "OURS",
    "PLAIN",
    "PUBLISHED",
    "RIVALS",
    "make_image",
    "pixel_filter_of",
    "tile_side",
]

OURS, PUBLISHED, PLAIN = "layered", "layered-published", "box"
RIVALS = (PLAIN, DENOISER, PUBLISHED, OURS)
"""What tables with room for a few images show, from the starting point to the result."""


BEST = "layered, best"
BEST_OPTIONS: dict[str, Any] = {"aperture_parts": 19}
"""Options of `OURS` for those to whom the last decibel counts more than time."""


def make_image(algorithm: str, samples: fewrays.SampleBuffer) -> Image:
    """Return the image ``(H, W, 3)`` that a method, or the denoiser, makes of samples by default."""
    if algorithm == DENOISER:
        return denoise(fewrays.reconstruct(samples, PLAIN))
    return fewrays.reconstruct(samples, algorithm)


def pixel_filter_of(algorithm: str) -> PixelFilter:
    """Return the pixel filter that an algorithm's images have by default.

    Methods with a choice say which; of the others those with a width for it have the Gaussian.
    """
    method = fewrays.METHODS.get(algorithm)
    options = getattr(method, "options", None)
    fallback: PixelFilter = "gaussian" if hasattr(options, "sigma_pix") else "box"
    chosen: PixelFilter = getattr(options, "pixel_filter", fallback)
    return chosen


def tile_side(algorithm: str) -> int:
    """Return the side in pixels of the tiles that a method works in by default.

    Raises
    ------
    ValueError
        For an algorithm without such an option.
    """
    method = fewrays.METHODS.get(algorithm)
    side = getattr(method.options(), "tile", None) if method else None
    if side is None:
        raise ValueError(f"{algorithm} has no tiles")
    return int(side)
