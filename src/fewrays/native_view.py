"""How native code is shown a `SampleBuffer`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.samples import SampleBuffer

__all__ = ["view_light_field", "view_samples"]


def view_samples(samples: SampleBuffer) -> _native.Samples:
    """Return a view that native code reads samples through, without a copy."""
    return _native.Samples(
        samples.xy, samples.uv, samples.depth, samples.color, samples.lens.c0, samples.lens.c1
    )


def view_light_field(
    samples: SampleBuffer, spacing: npt.NDArray[np.float32] | None = None
) -> _native.LightField:
    """Return a view of samples one after the other, without a copy; with motion where anything moves.

    `spacing` (N,) is how far samples are apart, where that differs from place to place.
    """
    count = samples.depth.size

    def flat(values: npt.NDArray[np.float32] | None, *channels: int) -> npt.NDArray[np.float32] | None:
        return None if values is None else values.reshape(count, *channels)

    moving = samples.motion is not None and bool(samples.motion.any())
    return _native.LightField(
        xy=samples.xy.reshape(count, 2),
        uv=samples.uv.reshape(count, 2),
        depth=samples.depth.reshape(count),
        color=samples.color.reshape(count, 3),
        time=flat(samples.time) if moving else None,
        motion=flat(samples.motion, 3) if moving else None,
        bandwidth=flat(samples.bandwidth),
        spacing=spacing,
        c0=samples.lens.c0,
        c1=samples.lens.c1,
    )
