"""What scenes of soft shadows are put together from: a floor and sheets over it, two lamps, a camera."""

from __future__ import annotations

from typing import Any

from fewrays.sources.analytic_shadows import Camera, Sheet, aimed
from fewrays.sources.outlines import Outline


def level(height: float, outline: Outline | None = None, **options: Any) -> Sheet:
    """Return a level sheet whose coordinates (a, b) are x and -z; `options` are those of `Sheet`."""
    return Sheet((0, height, 0), (0, 1, 0), (1, 0, 0), outline, **options)


def aside(height: int, width: int, **options: Any) -> Camera:
    """Return a camera that sees the floor around the origin at a slant; `options` are those of `Camera`."""
    return Camera(height, width, position=(0, 3, 4), target=(0, 0.3, 0), fov=35, **options)


FLOOR = level(0)
WARM = aimed((1, 4, 1), (0, 0, 0), (0.6, 0.3), radiance=(10, 8, 6))
"""A rectangular lamp overhead."""
GREEN = aimed((-2, 3, 1), (0, 0, 0), (0.3, 0.5), "disc", radiance=(4, 8, 2))
"""An elliptic lamp on the left."""
