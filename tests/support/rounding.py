"""How far a reference's image moves where its samples' positions are rounded as a kernel rounds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fewrays.method import Image

__all__ = ["change_by_rounding"]

_LOST = 2.0**-22
"""What four roundings of float32 may take from a number, as a share of it."""


def change_by_rounding(
    make_image: Callable[[], Image], scatter: tuple[Any, str], size: Callable[..., float]
) -> Image:
    """Return the change of each value of an image, (H, W, 3).

    A bin gets a sample or does not, so an image is a step function of the samples' positions, and where one
    lies within rounding of an edge, kernel and reference may both be right and differ. Moved by as much as
    rounding may lose, once towards each end of both axes, all samples that can fall into a neighbouring bin
    do so in one of two images; what these two change adds up to the result.

    Parameters
    ----------
    make_image : callable
        Runs the reference.
    scatter : (module, str)
        Where to find its function that puts samples, its first argument, into bins by their ``xy``.
    size : callable
        Takes the arguments of that function and returns the largest number that its positions are computed
        from, in pixels.
    """
    module, name = scatter
    original, expected = getattr(module, name), make_image()
    changes = np.zeros_like(expected)
    for towards in (-_LOST, _LOST):

        def moved(samples: Any, *rest: Any, towards: float = towards) -> Any:
            shift = towards * float(size(samples, *rest))
            return original(replace(samples, xy=samples.xy + shift), *rest)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, name, moved)
            changes += np.abs(make_image() - expected)
    return changes
