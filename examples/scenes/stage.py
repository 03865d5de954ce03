"""What the example scenes share: a thin-lens camera, and the sun."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

__all__ = ["sun", "thin_lens"]


def thin_lens(
    width: int,
    height: int,
    *,
    fov: float,
    lens_radius: float,
    focus_distance: float,
    eye: Sequence[float],
    target: Sequence[float],
) -> dict[str, Any]:
    """Return a Mitsuba sensor at `eye` that looks at `target`, y up; `fov` is horizontal, in degrees."""
    import mitsuba as mi

    return {
        "type": "thinlens",
        "fov": fov,
        "aperture_radius": lens_radius,
        "focus_distance": focus_distance,
        "near_clip": 0.05,
        "to_world": mi.ScalarTransform4f().look_at(list(eye), list(target), [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb"},
    }


def sun(direction: Sequence[float], irradiance: Sequence[float]) -> dict[str, Any]:
    """Return a Mitsuba emitter that shines along `direction` with an RGB irradiance."""
    return {
        "type": "directional",
        "direction": list(direction),
        "irradiance": {"type": "rgb", "value": list(irradiance)},
    }
