"""What can be asked of an image whose truth is known: its size, its pixel filter and its shutter."""

from __future__ import annotations

import math
from typing import Literal

from fewrays.errors import SampleError, require_option

__all__ = ["PixelFilter", "check_filter", "check_shutter", "check_size"]

PixelFilter = Literal["gaussian", "box"]


def check_size(**sizes: int) -> None:
    """Raise a `SampleError` for the first size that is not positive."""
    for name, size in sizes.items():
        if size < 1:
            raise SampleError(f"expected at least 1, got {size!r}", field=name)


def check_filter(pixel_filter: str, sigma_pix: float) -> None:
    """Raise a `SampleError` for an unknown pixel filter, or a Gaussian of no such width."""
    if pixel_filter not in ("gaussian", "box"):
        raise SampleError(f"expected 'gaussian' or 'box', got {pixel_filter!r}", field="pixel_filter")
    if not (math.isfinite(sigma_pix) and sigma_pix >= 0):
        raise SampleError(f"expected a finite number >= 0, got {sigma_pix!r}", field="sigma_pix")


def check_shutter(shutter: tuple[float, float]) -> None:
    """Raise a `SampleError` for a shutter outside ``[0, 1]``, or one that closes before it opens."""
    opens, closes = shutter
    require_option(
        "shutter", shutter, 0 <= opens <= closes <= 1, "(open, close) with 0 <= open <= close <= 1"
    )
