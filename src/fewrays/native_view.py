"""How native code is shown a `SampleBuffer`."""

from __future__ import annotations

from fewrays import _native
from fewrays.samples import SampleBuffer

__all__ = ["view_samples"]


def view_samples(samples: SampleBuffer) -> _native.Samples:
    """Return a view that native code reads samples through, without a copy."""
    return _native.Samples(
        samples.xy, samples.uv, samples.depth, samples.color, samples.lens.c0, samples.lens.c1
    )
