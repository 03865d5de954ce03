"""What moves before a pinhole: which of two points is in front.

Methods for lens and time tell depths by slopes, and the slopes of a pinhole are all the same. What stays
where it is seen needs no order. What moves covers and uncovers what is behind it, and does need one. So such
samples are taken for those of a lens, so small that nothing else comes of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar, cast

import numpy as np

from fewrays.cuda.samples import DeviceSamples
from fewrays.samples import SampleBuffer

__all__ = ["needs_order", "with_order"]

Samples = TypeVar("Samples", bound=SampleBuffer | DeviceSamples)

_LEAST_BLUR = 1e-4  # pixels


def needs_order(samples: SampleBuffer | DeviceSamples) -> bool:
    """Tell whether samples have motion, but no slopes that tell what is in front."""
    return samples.lens.c0 == 0 and samples.motion is not None


def with_order(samples: Samples, blur: float = _LEAST_BLUR) -> Samples:
    """Return samples of a pinhole as if of a lens.

    Parameters
    ----------
    samples : SampleBuffer or DeviceSamples
        The host waits for those on a card.
    blur : float
        Blur radius of what is infinitely far, in pixels; the lens is focused on the median depth.

    Returns
    -------
    SampleBuffer or DeviceSamples
    """
    lens, middle = samples.lens, float(np.median(samples.depth))
    return cast(Samples, samples.with_lens(replace(lens, c0=-blur * middle, c1=lens.c1 + blur)))
