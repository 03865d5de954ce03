"""What users trace in Mitsuba, made ready: the scene, its integrator, and how far away nothing is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fewrays.errors import SampleError
from fewrays.sources.mitsuba_camera import Camera
from fewrays.sources.mitsuba_motion import MovingShapes

__all__ = ["choose_background", "choose_integrator", "load_scene"]

_BACKGROUND_FACTOR = 1000.0  # escaped rays count as this many times farther than the scene's far end


def load_scene(mi: ModuleType, scene: Any, *, merge: bool = True) -> Any:
    """Load a scene unless it is loaded; Mitsuba merges meshes of one material unless told not to."""
    if isinstance(scene, mi.Scene):
        return scene
    file = scene if isinstance(scene, (str, Path)) else None
    if file is not None and not Path(file).is_file():
        raise SampleError("no such file", file=file)
    if file is None and not isinstance(scene, Mapping):
        raise SampleError(
            f"expected an XML file, a dictionary or a mitsuba.Scene, got {type(scene).__name__}",
            field="scene",
        )
    try:
        options = {} if merge else {"optimize": False}
        loaded = mi.load_dict(dict(scene), **options) if file is None else mi.load_file(str(file), **options)
    except (RuntimeError, TypeError) as error:
        raise SampleError(f"Mitsuba cannot load it: {error}", file=file, field="scene") from error
    if not isinstance(loaded, mi.Scene):
        raise SampleError(f"expected a scene, got {type(loaded).__name__}", file=file, field="scene")
    return loaded


def choose_integrator(mi: ModuleType, scene: Any, given: Any, max_depth: int | None) -> Any:
    """Return the integrator that users ask for, else the scene's; refuse one that traces no plain paths."""
    if given is not None and max_depth is not None:
        raise SampleError("give either integrator or max_depth", field="max_depth")
    if max_depth is not None:
        if max_depth < 1:
            raise SampleError(f"expected at least 1 (emitted light only), got {max_depth}", field="max_depth")
        given = {"type": "path", "max_depth": max_depth}
    if given is None:
        chosen = scene.integrator()
    elif isinstance(given, Mapping):
        try:
            chosen = mi.load_dict(dict(given))
        except (RuntimeError, TypeError) as error:
            raise SampleError(f"Mitsuba cannot load it: {error}", field="integrator") from error
    else:
        chosen = given
    # The differentiable integrators sample derivatives along with radiance, through another signature.
    if not isinstance(chosen, mi.SamplingIntegrator) or isinstance(chosen, mi.CppADIntegrator):
        name = chosen.class_name() if hasattr(chosen, "class_name") else type(chosen).__name__
        raise SampleError(
            f"{name} does not just trace paths from the camera; choose another, such as {{'type': 'path'}}",
            field="integrator",
        )
    return chosen


def choose_background(scene: Any, camera: Camera, given: float | None, moving: MovingShapes | None) -> float:
    """Return the depth of rays that hit nothing: finite, and behind everything that can be hit."""
    box = scene.bbox()
    far = camera.near
    if box.valid():
        points = np.array([[float(box.corner(i)[k]) for k in range(3)] for i in range(8)])
        if moving is not None:
            points = np.concatenate([points, moving.end_points()])
        depths = (points - camera.to_world[:3, 3]) @ camera.to_world[:3, 2]
        far = max(far, min(float(depths.max()), camera.far))
    if given is None:
        focus = camera.focus_distance if math.isfinite(camera.focus_distance) else 0.0
        return _BACKGROUND_FACTOR * max(far, focus)
    if not (math.isfinite(given) and given > 0):
        raise SampleError(f"expected a positive, finite number, got {given!r}", field="background_depth")
    if given < far:
        raise SampleError(
            f"expected at least {far:g}, where the scene ends as seen from the camera; got {given:g}",
            field="background_depth",
        )
    return float(given)
