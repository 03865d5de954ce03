"""Gloss: a polished teapot on a polished table, out of focus; the lamps that they reflect are in focus.

A reflection lies deeper than the metal that shows it, on the table as deep as the lamps; it is not blurred as
the metal is. The image is only right if it keeps which place on the lens saw which reflection (temporal,
section 6, Figure 14).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scenes.geometry import Array, Mesh, bitmap, grid, merge, revolve, to_mitsuba, tube
from scenes.stage import thin_lens

__all__ = ["FOCUS", "LENS_RADIUS", "ROUGHNESS", "scene"]

FOCUS = 12.0
LENS_RADIUS = 0.08
ROUGHNESS = 0.008
FOV = 36.0

_EYE, _TARGET = (0.0, 0.85, -2.6), (0.0, 0.16, 0.0)


def scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a Mitsuba dictionary; a variant must be active."""
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": thin_lens(
            width, height, fov=FOV, lens_radius=LENS_RADIUS, focus_distance=FOCUS, eye=_EYE, target=_TARGET
        ),
        "room": {"type": "envmap", "bitmap": bitmap(_room())["bitmap"]},
        "pot": to_mitsuba(_pot().moved([-0.05, 0, -0.1], scale=0.6, turn=-0.5), _metal("Ag")),
        "table": to_mitsuba(_table(), _metal("Cu"), smooth=False),
    }


def _metal(material: str) -> dict[str, Any]:
    metal = {"type": "roughconductor", "material": material, "distribution": "ggx", "alpha": ROUGHNESS}
    return {"type": "twosided", "bsdf": metal}


def _room(height: int = 512) -> Array:
    """Paint the light around the scene, (H, 2 H, 3): pale ceiling, dark walls, lamps of 1 to 2 degrees."""
    polar = (np.arange(height) + 0.5) / height * np.pi
    turn = (np.arange(2 * height) + 0.5) / height * np.pi
    up = np.broadcast_to(np.cos(polar)[:, None], (height, 2 * height))
    around = np.sin(polar)[:, None]
    direction = np.stack([around * np.sin(turn), up, -around * np.cos(turn)], axis=-1)
    light = 0.06 + 0.5 * np.clip(up, 0, 1)[..., None] ** 2 * np.array([0.7, 0.9, 1.2])
    rng = np.random.default_rng(4)
    for _ in range(230):
        bearing, rise = rng.uniform(0, 2 * np.pi), rng.uniform(np.radians(4), np.radians(40))
        lamp = [np.cos(rise) * np.sin(bearing), np.sin(rise), np.cos(rise) * np.cos(bearing)]
        inside = direction @ lamp > np.cos(np.radians(rng.uniform(0.5, 1.1)))
        light[inside] = rng.uniform(3, 8) * rng.uniform([0.9, 0.45, 0.15], [1.0, 0.85, 1.0])
    return np.asarray(light)


def _pot() -> Mesh:
    """Shape a teapot: body, lid and knob turned about the axis, with a spout and a handle."""
    turn = np.linspace(-0.42 * np.pi, 0.36 * np.pi, 80)
    body = np.stack([0.72 * np.cos(turn) ** 0.9, 0.56 + 0.58 * np.sin(turn)], axis=-1)
    rise = np.linspace(0, 1, 40)
    lid = np.stack([0.34 * np.sqrt(1 - rise**2) + 0.02, 1.08 + 0.10 * rise], axis=-1)
    knob = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 30)
    ball = np.stack([0.085 * np.cos(knob), 1.25 + 0.085 * np.sin(knob)], axis=-1)
    return merge(
        [revolve(body, 160), revolve(lid, 120), revolve(ball, 60), _spout(), _handle()],
    )


def _spout() -> Mesh:
    s = np.linspace(0, 1, 60)
    path = np.stack([0.55 + 0.62 * s, 0.42 + 0.62 * s**1.7, 0 * s], axis=-1)
    return tube(path, 0.16 - 0.09 * s, 60)


def _handle() -> Mesh:
    turn = np.linspace(0.42 * np.pi, 1.62 * np.pi, 80)
    path = np.stack([-0.70 + 0.40 * np.cos(turn), 0.60 + 0.34 * np.sin(turn), 0 * turn], axis=-1)
    return tube(path, 0.06, 40)


def _table() -> Mesh:
    across, along = np.meshgrid([-3.0, 3.0], [-3.0, 1.6])
    return grid(np.stack([across, 0 * across, along], axis=-1))
