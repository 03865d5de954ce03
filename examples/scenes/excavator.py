"""Excavator: two machines on a building site under one large lamp (after temporal, Figure 11).

Soft shadows from a rectangular light of noticeable size: narrow penumbrae under tracks and bricks, wide ones
under the booms. Fine parts in front of each other, such as railings, barriers, hoses, ropes and a lattice,
cast shadows that a few samples per pixel can only hint at.

Three variants (`VARIANTS`): still through a pinhole; moving, with the excavator's arm swinging, its bucket
curling and the crane driving; and moving through a lens. Points travel up to 35 px at 640 px width.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from scenes import crane, digger, site
from scenes.geometry import Array, merge, to_mitsuba
from scenes.metalwork import Body, placed, transform
from scenes.stage import thin_lens

__all__ = ["FOCUS", "LENS_RADIUS", "LIGHT_SHIFTS", "VARIANTS", "Variant", "motion", "scene"]

FOCUS = 13.2
LENS_RADIUS = 0.20
FOV = 41.0


class Variant(NamedTuple):
    """What sets a variant of the scene apart: its lens radius, and whether anything moves."""

    lens_radius: float
    moves: bool


VARIANTS = {
    "still": Variant(0.0, False),
    "moving": Variant(0.0, True),
    "moving_defocused": Variant(LENS_RADIUS, True),
}

LIGHT_SHIFTS = tuple(0.35 * frame for frame in range(6))
"""By how much the lamp is shifted in each frame of a sequence, in world units."""

_EXCAVATOR = transform([2.5, 0, 0.4], degrees=147)
_CRANE = transform([-5.6, 0, 7.6], degrees=12)
_LAMP, _LIT = np.array([10.0, 9.6, -3.6]), np.array([-1.6, 0.0, 2.6])  # where it hangs, where it shines

_COLOR = {"type": "mesh_attribute", "name": "vertex_color"}
_MATERIALS: dict[str, dict[str, Any]] = {
    name: {"type": "twosided", "bsdf": {"type": "principled", "base_color": _COLOR, **looks}}
    for name, looks in {
        "paint": {"roughness": 0.5, "specular": 0.5},
        "steel": {"roughness": 0.5, "metallic": 0.6, "specular": 0.5},
        "dark": {"roughness": 0.55, "specular": 0.4},
    }.items()
}
_MATERIALS["earth"] = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _COLOR}}


def scene(width: int, height: int, *, light_shift: float = 0.0) -> dict[str, Any]:
    """Return the scene as the shutter opens, as a Mitsuba dictionary; a variant must be active.

    Parameters
    ----------
    width, height : int
        Image size in pixels.
    light_shift : float
        By how much the lamp is shifted to the right of the picture, in world units.
    """
    earth = site.ground([(_EXCAVATOR, 1.0), (_CRANE, 1.08)])
    still = {"ground": to_mitsuba(earth, _MATERIALS["earth"])}
    still |= _shapes("debris", site.debris(), np.eye(4))
    still |= _shapes("base", digger.excavator()["base"], _EXCAVATOR)
    content = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": thin_lens(
            width,
            height,
            fov=FOV,
            lens_radius=LENS_RADIUS,
            focus_distance=FOCUS,
            eye=[0, 6.1, -13.2],
            target=[0.1, 1.62, 0.5],
        ),
        "lamp": _lamp(light_shift),
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.095, 0.115, 0.15]}},
        # As one instance, what rests is not sorted anew with the moving shapes, for every slice of time.
        "still": {"type": "shapegroup", **still},
        "site": {"type": "instance", "of": {"type": "ref", "id": "still"}},
    }
    for body, (parts, place, _) in _moving_bodies().items():
        content |= _shapes(body, parts, place)
    return content


def motion() -> dict[str, Array]:
    """Return where what moves is when the shutter closes, as `fewrays.sources.mitsuba.render` takes it."""
    return {
        f"{body}_{material}": end for body, (parts, _, end) in _moving_bodies().items() for material in parts
    }


def _moving_bodies() -> dict[str, tuple[Body, Array, Array]]:
    """Return bodies in their own axes, where they are put, and how they move from there, in the world."""
    excavator, lifter = digger.excavator(), crane.crane()
    swing = transform(degrees=-6.0)
    curl = transform(axis=[0, 0, 1], degrees=-12.0, pivot=digger.BUCKET_PIN)
    drive = transform([0.32, 0, 0])
    sway = transform([0.30, 0.02, 0], axis=[0, 0, 1], degrees=3.0, pivot=crane.CRANE_TIP)

    def in_world(move: Array, place: Array) -> Array:
        return np.asarray(place @ move @ np.linalg.inv(place))

    return {
        "house": (excavator["house"], _EXCAVATOR, in_world(swing, _EXCAVATOR)),
        "arm": (excavator["arm"], _EXCAVATOR, in_world(swing, _EXCAVATOR)),
        "bucket": (excavator["bucket"], _EXCAVATOR, in_world(swing @ curl, _EXCAVATOR)),
        "carrier": (lifter["carrier"], _CRANE, in_world(drive, _CRANE)),
        "load": (lifter["load"], _CRANE, in_world(sway, _CRANE)),
    }


def _shapes(body: str, parts: Body, place: Array) -> dict[str, Any]:
    return {
        f"{body}_{material}": to_mitsuba(placed(merge(meshes), place), _MATERIALS[material])
        for material, meshes in parts.items()
    }


def _lamp(shift: float) -> dict[str, Any]:
    import mitsuba as mi

    to_right = np.array([-shift, 0, 0])
    look = mi.ScalarTransform4f().look_at((_LAMP + to_right).tolist(), (_LIT + to_right).tolist(), [0, 0, 1])
    return {
        "type": "rectangle",
        "to_world": look.scale([0.95, 0.95, 1]),
        "emitter": {
            "type": "area",
            "radiance": {"type": "rgb", "value": [420.0, 362.0, 287.0]},
            "sampling_weight": 8.0,  # brute force picks it over the sky, which brings far less light
        },
    }
