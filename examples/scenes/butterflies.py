"""Butterflies: eight of them on the wing among the leaves of the foliage scene.

Motion blur and defocus at once: they fly at depths from 1 to 5.5 around the focal plane at 3.2, in front of
leaves and behind them, travel 2 to 48 px over the shutter interval at 640 px width, and beat their wings. A
few dead leaves fall. What rests is the foliage scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes import foliage
from scenes.geometry import Array, Mesh, fractal_noise, frames, grid, merge, revolve, to_mitsuba, tube

__all__ = ["motion", "scene"]


@dataclass(frozen=True)
class _Flight:
    """A butterfly at the instants when the shutter opens and closes, and its looks.

    Parameters
    ----------
    position, travel : (float, float, float)
        Where its body is at first, and how far it flies: to the left of the picture, up, and away.
    heading, climb, bank : float
        Degrees: from the right of the picture towards its depth, nose up, and right wing down.
    beat : (float, float)
        Degrees that the wings are raised, at first and in the end.
    span : float
        Length of a forewing.
    looks : str
        Which of `_LOOKS`.
    """

    position: tuple[float, float, float]
    travel: tuple[float, float, float]
    heading: float
    climb: float
    bank: float
    beat: tuple[float, float]
    span: float
    looks: str


_FLIGHTS = {
    "morpho": _Flight((-0.05, 0.81, 2.85), (-0.056, 0.023, 0.03), 35, 30, -15, (38, 12), 0.165, "morpho"),
    "monarch": _Flight((0.25, 0.36, 3.10), (-0.006, 0.006, 0.01), 125, 35, 15, (30, 22), 0.155, "monarch"),
    "white": _Flight((-0.34, 0.47, 4.20), (-0.161, 0.041, -0.15), 20, 35, -10, (12, 50), 0.19, "white"),
    "brimstone": _Flight(
        (-0.25, 0.27, 2.70), (0.086, 0.024, 0.10), 150, 35, 15, (12, 38), 0.125, "brimstone"
    ),
    "near": _Flight((0.20, 0.34, 1.50), (-0.032, 0.009, 0.05), 40, 40, -15, (45, 20), 0.085, "monarch"),
    "blue": _Flight((-0.22, 0.65, 1.25), (0.006, 0.039, 0.03), 110, 40, 10, (12, 38), 0.085, "morpho"),
    "far": _Flight((-0.20, 1.33, 5.50), (-0.035, -0.006, 0.05), 160, 35, 10, (25, 20), 0.24, "monarch"),
    "pale": _Flight((0.25, 0.62, 1.05), (-0.032, -0.011, -0.02), -20, 30, -10, (45, 15), 0.07, "brimstone"),
}


def scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as the shutter opens, as a Mitsuba dictionary; a variant must be active."""
    import mitsuba as mi

    content = foliage.scene(width, height)
    # As one instance, what rests is not sorted anew with the moving shapes, for every slice of time.
    still = {name: part for name, part in content.items() if isinstance(part, mi.Mesh)}
    content = {name: part for name, part in content.items() if name not in still}
    content["still"] = {"type": "shapegroup", **still}
    content["forest"] = {"type": "instance", "of": {"type": "ref", "id": "still"}}
    thin = {
        "type": "principledthin",
        "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
        "diff_trans": 0.6,
        "roughness": 0.5,
    }
    for name, flight in _FLIGHTS.items():
        content[name] = to_mitsuba(_butterfly(flight, 0), thin)
    for name, (start, _) in _falling_leaves().items():
        content[name] = to_mitsuba(start, thin)
    return content


def motion() -> dict[str, Any]:
    """Return where what moves is when the shutter closes, as `fewrays.sources.mitsuba.render` takes it."""
    ends: dict[str, Any] = {name: _butterfly(flight, 1).vertices for name, flight in _FLIGHTS.items()}
    ends.update({name: fall for name, (_, fall) in _falling_leaves().items()})
    return ends


def _butterfly(flight: _Flight, at: int) -> Mesh:
    """Pose a butterfly as the shutter opens (0) or closes (1); both have the same vertices in number."""
    raised = np.radians(flight.beat[at])
    wings = []
    for side in (1, -1):
        for wing in _WINGS:
            mesh = _wing(wing, *_LOOKS[flight.looks])
            x, y, z = mesh.vertices.T
            x, z = x * np.cos(raised) - z * np.sin(raised), x * np.sin(raised) + z * np.cos(raised)
            wings.append(Mesh(np.stack([side * x, y, z], -1), mesh.faces, mesh.colors, mesh.uv))
    model = merge([*wings, _body()])
    heading, climb, bank = np.radians([flight.heading, flight.climb, flight.bank])
    ahead = np.array([-np.cos(climb) * np.cos(heading), np.sin(climb), np.cos(climb) * np.sin(heading)])
    # Seen from above, so that the camera, which is in front, looks at the wings and not at their edges.
    axes = frames(ahead[None], np.array([[0.0, 0.7, -0.8]]))[0]
    roll = np.array([[np.cos(bank), 0, np.sin(bank)], [0, 1, 0], [-np.sin(bank), 0, np.cos(bank)]])
    position = np.array(flight.position) + at * np.array(flight.travel)
    return Mesh(flight.span * (model.vertices @ roll @ axes) + position, model.faces, model.colors, model.uv)


_WINGS = {
    # Degrees from straight out towards the head, radii in lengths of a forewing, number of veins.
    "fore": ([-22, -8, 10, 28, 42, 52, 62], [0.52, 0.74, 0.80, 0.92, 1.0, 0.86, 0.30], 9),
    "hind": ([-98, -80, -62, -42, -24, -6, 14], [0.34, 0.62, 0.66, 0.72, 0.66, 0.58, 0.25], 7),
}


def _wing(wing: str, paint: _Paint, ground: Array, veins: Array) -> Mesh:
    """Return a right wing, lying in the plane z = 0 with its root at the origin, the head towards y."""
    degrees, radii, count = _WINGS[wing]
    t = np.linspace(0, 1, 97)
    s = np.linspace(0.02, 1, 60)[:, None]
    angle = np.radians(degrees[0] + t * (degrees[-1] - degrees[0]))[None, :]
    scallop = 1 + 0.012 * np.cos(2 * np.pi * count * t)
    rim = (_smooth(np.array(radii), t) * scallop)[None, :]
    points = np.stack([s * rim * np.cos(angle), s * rim * np.sin(angle), 0.05 * s * (1 - s) + 0 * rim], -1)
    root = np.array([0.02, 0.10 if wing == "fore" else 0.02, 0.004 if wing == "fore" else 0.0])
    colors = paint(s + 0 * rim, np.broadcast_to(t, (60, 97)), count, ground, veins)
    speckle = 1 + 0.10 * fractal_noise(points * 40, octaves=2, seed=4)[..., None]
    return grid(points + root).painted(np.clip(colors * speckle, 0.005, 0.95).reshape(-1, 3))


_Paint = Callable[[Array, Array, int, Array, Array], Array]
"""Colours (R, C, 3) from the distance to the root, 0 to 1, the place along the rim, 0 to 1, the number of
veins, and the colours of the ground and of the veins."""


def _margin(s: Array, t: Array, count: int, ground: Array, veins: Array) -> Array:
    """Dark veins and a dark margin with two rows of white dots, as a monarch has."""
    cell = t * count - np.floor(t * count) - 0.5
    dark = (np.abs(cell) > 0.5 - 0.035 / np.maximum(s, 0.15)) | (s > 0.83) | (t > 0.95) | (s < 0.06)
    color = np.where(dark[..., None], veins, ground * (0.75 + 0.35 * s[..., None]))
    for row, size in ((0.885, 0.20), (0.945, 0.15)):
        dot = np.hypot(cell, (s - row) * 7) < size
        color = np.where((dot & (t < 0.95))[..., None], [0.85, 0.82, 0.75], color)
    return color


def _sheen(s: Array, t: Array, count: int, ground: Array, veins: Array) -> Array:
    """Paint a bright field that darkens to the root and ends in a dark border."""
    edge = np.clip((s - 0.74 - 0.03 * np.cos(2 * np.pi * count * t)) / 0.05, 0, 1)
    edge = np.maximum(edge, np.clip((t - 0.9) / 0.05, 0, 1))[..., None]
    line = 0.25 * (np.abs(t * count - np.round(t * count)) < 0.03)[..., None]
    field = ground * (0.55 + 0.65 * np.sin(np.pi * np.clip(s, 0, 0.8))[..., None])
    color = field * (1 - edge) * (1 - line) + veins * edge
    dot = np.hypot(t * count - np.floor(t * count) - 0.5, (s - 0.90) * 9) < 0.16
    return np.where(dot[..., None], [0.8, 0.85, 0.9], color)


def _plain(s: Array, t: Array, count: int, ground: Array, veins: Array) -> Array:
    """Paint a pale field with fine veins, a tip and an eye of the second colour."""
    line = 0.3 * (np.abs(t * count - np.round(t * count)) < 0.035)[..., None]
    tip = (np.clip((s - 0.86) / 0.06, 0, 1) * np.clip((t - 0.45) / 0.1, 0, 1))[..., None]
    eye = np.exp(-((s - 0.55) ** 2 + (0.5 * (t - 0.62)) ** 2) / 0.003)[..., None]
    mixed = np.clip(tip + eye, 0, 1)
    return ground * (1 - line) * (0.8 + 0.25 * s[..., None]) * (1 - mixed) + veins * mixed


_LOOKS: dict[str, tuple[_Paint, Array, Array]] = {
    "monarch": (_margin, np.array([0.82, 0.27, 0.02]), np.array([0.02, 0.013, 0.01])),
    "morpho": (_sheen, np.array([0.05, 0.30, 0.85]), np.array([0.015, 0.015, 0.03])),
    "brimstone": (_plain, np.array([0.85, 0.72, 0.08]), np.array([0.75, 0.25, 0.02])),
    "white": (_plain, np.array([0.82, 0.82, 0.76]), np.array([0.06, 0.06, 0.07])),
}


def _body() -> Mesh:
    """Thorax, abdomen, head and feelers along y."""
    y = np.linspace(-0.36, 0.2, 40)
    girth = 0.028 * np.sqrt(np.clip(1 - ((y + 0.12) / 0.25) ** 2, 0, 1))
    girth = np.maximum(girth, 0.045 * np.sqrt(np.clip(1 - ((y - 0.07) / 0.13) ** 2, 0, 1))) + 1e-3
    spine = np.stack([0 * y, y, -0.02 - 0.1 * np.minimum(y, 0) ** 2], -1)
    trunk = tube(spine, girth, 16).painted([0.035, 0.025, 0.02])
    turn = np.linspace(0, np.pi, 16)
    head = revolve(np.stack([np.sin(turn), np.cos(turn)], -1), 20).painted([0.03, 0.02, 0.015])
    parts = [trunk, head.moved([0, 0.215, -0.015], scale=0.034)]
    s = np.linspace(0, 1, 16)
    for side in (-1, 1):
        path = np.stack([side * (0.012 + 0.16 * s**1.3), 0.235 + 0.30 * s, 0.06 * s**2], -1)
        club = 0.005 + 0.009 * np.exp(-(((s - 1) / 0.08) ** 2))
        parts.append(tube(path, club, 6).painted([0.02, 0.015, 0.01]))
    return merge(parts)


def _smooth(values: Array, t: Array) -> Array:
    """Return a Catmull-Rom spline through equally spaced values, at t from 0 to 1."""
    padded = np.concatenate([[2 * values[0] - values[1]], values, [2 * values[-1] - values[-2]]])
    at = t * (len(values) - 1)
    i = np.clip(at.astype(int), 0, len(values) - 2)
    f = at - i
    a, b, c, d = (padded[i + k] for k in range(4))
    result: Array = 0.5 * (
        2 * b + (c - a) * f + (2 * a - 5 * b + 4 * c - d) * f**2 + (3 * b - a - 3 * c + d) * f**3
    )
    return result


def _falling_leaves() -> dict[str, tuple[Mesh, Array]]:
    """Return dead leaves as the shutter opens, and the rigid motion (4, 4) of each till it closes."""
    rng = np.random.default_rng(12)
    leaves = {}
    for i, position in enumerate(
        ((-0.16, 0.55, 3.4), (0.28, 0.30, 2.4), (0.16, 1.02, 3.7), (0.22, 0.66, 1.8))
    ):
        model = foliage.leaf(6)
        turn = frames(rng.normal(size=(1, 3)), np.array([[0.1, 0.5, -1.0]]))[0]
        centre = np.array(position)
        vertices = centre + 0.085 * ((model.vertices - [0, 0.5, 0]) @ turn)
        tint = np.array([foliage.RUST, foliage.STRAW][i % 2]) * 1.4
        mesh = Mesh(vertices, model.faces, np.clip(model.colors * tint, 0, 0.9), model.uv)
        end = np.eye(4)
        end[:3, :3] = _rotation(rng.normal(size=3), np.radians(35))
        drop = centre + rng.normal(0, 0.015, 3) - [0, 0.07, 0]
        end[:3, 3] = drop - end[:3, :3] @ centre
        leaves[f"leaf{i}"] = (mesh, end)
    return leaves


def _rotation(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) about an axis, by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
