"""Serpent: a scaled body that winds through the focal plane over a fine mosaic.

Low depth complexity and high-frequency texture: tesserae and scales of a few pixels, and depth that changes
smoothly, so that a wrong slope shows at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scenes.geometry import (
    Array,
    Mesh,
    bitmap,
    fractal_noise,
    frames,
    grid,
    merge,
    revolve,
    scatter,
    to_mitsuba,
    tube,
)
from scenes.stage import sun, thin_lens

__all__ = ["FOCUS", "LENS_RADIUS", "scene"]

FOCUS = 3.3
LENS_RADIUS = 0.1
FOV = 40.0


def scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a Mitsuba dictionary; a variant must be active."""
    vertex_color = {"type": "mesh_attribute", "name": "vertex_color"}
    glazed = {
        "type": "twosided",
        "bsdf": {"type": "principled", "base_color": vertex_color, "roughness": 0.35, "specular": 0.5},
    }
    matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": vertex_color}}
    mosaic = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": bitmap(_mosaic())}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": thin_lens(
            width,
            height,
            fov=FOV,
            lens_radius=LENS_RADIUS,
            focus_distance=FOCUS,
            eye=[0, 1.30, 0],
            target=[0, 0.62, FOCUS],
        ),
        "sun": sun([-0.75, -0.8, 0.35], [4.9, 4.2, 3.2]),
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.58, 0.70, 0.88]}},
        "floor": to_mitsuba(_plane([-16, 0, 0.2], [32, 0, 0], [0, 0, 16.2], 16 / 2), mosaic, smooth=False),
        "wall": to_mitsuba(_plane([-16, 0, 12.0], [32, 0, 0], [0, 9, 0], 16 / 6), mosaic, smooth=False),
        "serpent": to_mitsuba(_body(), glazed),
        "spines": to_mitsuba(_spines(), glazed),
        "pots": to_mitsuba(_pots(), matte),
    }


def _plane(corner: list[float], right: list[float], up: list[float], repeats: float) -> Mesh:
    """Span a rectangle whose texture repeats that often along `right`, squares staying squares."""
    base, a, b = np.array(corner), np.array(right), np.array(up)
    mesh = grid(np.array([[base, base + a], [base + b, base + a + b]]))
    aspect = np.linalg.norm(b) / np.linalg.norm(a)
    return Mesh(mesh.vertices, mesh.faces, mesh.colors, mesh.uv * [2 * repeats, 2 * repeats * aspect])


def _mosaic(size: int = 2048, tiles: int = 64) -> Array:
    """Tesserae in rings and waves of blue, cream and ochre, with grout between, repeating at the edges."""
    rng = np.random.default_rng(5)
    y, x = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    row, column = y * tiles // size, x * tiles // size
    across = (column + 0.5) / tiles - 0.5
    along = (row + 0.5) / tiles - 0.5
    radius = np.hypot(across, along)
    palette = np.array(
        [
            [0.05, 0.13, 0.30],
            [0.70, 0.62, 0.46],
            [0.46, 0.22, 0.06],
            [0.10, 0.33, 0.38],
            [0.62, 0.56, 0.44],
            [0.03, 0.05, 0.10],
        ]
    )
    rings = (radius * 22).astype(int)
    petals = np.cos(8 * np.arctan2(along, across)) * 0.08 + 0.30
    choice = np.where(radius < petals, np.array([2, 1, 3, 1, 0, 0, 1, 5])[rings % 8], 4)
    choice = np.where(np.maximum(np.abs(across), np.abs(along)) > 0.44, 0, choice)
    choice = np.where(np.maximum(np.abs(across), np.abs(along)) > 0.47, 1, choice)
    shade = rng.uniform(0.6, 1.35, (tiles, tiles, 1))[row, column] * (
        1 + rng.normal(0, 0.05, (tiles, tiles, 3))[row, column]
    )
    color = palette[choice] * shade
    wobble = rng.uniform(0.06, 0.14, (4, tiles, tiles))[:, row, column]
    fx, fy = x * tiles / size - column, y * tiles / size - row
    grout = (fx < wobble[0]) | (fx > 1 - wobble[1]) | (fy < wobble[2]) | (fy > 1 - wobble[3])
    return np.clip(np.where(grout[..., None], [0.28, 0.26, 0.23], color), 0.01, 0.95)


def _spine(s: Array) -> Array:
    """Return the centre line of the body, for s from 0 (tail) to 1 (neck)."""
    knots = np.array(
        [
            [3.6, 0.06, 8.0],
            [2.6, 0.12, 7.2],
            [1.2, 0.16, 7.6],
            [-0.2, 0.75, 7.0],
            [-1.5, 0.2, 6.0],
            [-2.0, 0.2, 5.0],
            [-0.9, 0.24, 4.3],
            [0.4, 0.95, 4.5],
            [1.45, 0.5, 4.4],
            [1.6, 0.22, 3.4],
            [0.8, 0.2, 2.6],
            [-0.2, 0.2, 2.35],
            [-0.95, 0.2, 2.7],
            [-0.85, 0.26, 3.3],
            [-0.45, 0.55, 3.42],
            [-0.28, 0.88, 3.34],
            [-0.08, 1.0, 3.2],
            [0.12, 0.96, 3.06],
        ]
    )
    at = s * (len(knots) - 3) + 1.0
    i = np.clip(at.astype(int), 1, len(knots) - 3)
    t = (at - i)[:, None]
    a, b, c, d = (knots[i + k] for k in (-1, 0, 1, 2))  # a Catmull-Rom spline
    result: Array = 0.5 * (
        2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3
    )
    return result


def _thickness(s: Array) -> Array:
    result: Array = (
        0.155 * np.minimum(1, (s / 0.55) ** 0.7 + 0.08) * (1 - 0.42 * np.clip((s - 0.8) / 0.2, 0, 1))
    )
    return result


def _body() -> Mesh:
    """Tube with overlapping scales in relief; each has its own shade, and the pattern follows diamonds."""
    rows, around = 2600, 220
    s = np.linspace(0, 1, rows)
    path = _spine(s)
    radius = _thickness(s)
    body = tube(path, radius, around)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1) / radius[1:])])
    angle = np.arange(around) / around
    b, a = np.meshgrid(length * 4.2, angle * 34, indexing="ij")
    line = np.floor(b)
    shifted = a + 0.5 * (line % 2)
    u, v = shifted - np.floor(shifted) - 0.5, b - line
    ridge = np.clip(1 - (2 * u) ** 2 - 0.55 * (v - 0.15) ** 2, 0, 1) * (0.35 + 0.65 * v)
    center = np.repeat(path, around, axis=0)
    vertices = center + (body.vertices - center) * (1 + 0.085 * (ridge - 0.4)).reshape(-1, 1)

    cell = np.stack([np.floor(shifted) % 34, line, 0 * line], -1)
    shade = 1 + 0.35 * fractal_noise(cell * 0.97 + 0.31, octaves=1, seed=3)
    diamond = np.cos(2 * np.pi * cell[..., 0] / 34 * 3) + np.cos(2 * np.pi * line / 15)
    jade, gold, dark = (
        np.array([0.04, 0.30, 0.20]),
        np.array([0.62, 0.40, 0.08]),
        np.array([0.015, 0.06, 0.09]),
    )
    color = np.where((diamond > 1.0)[..., None], gold, np.where((diamond > 0.35)[..., None], dark, jade))
    color = color * shade[..., None] * (0.35 + 0.75 * np.sqrt(ridge))[..., None]
    scaled = Mesh(vertices, body.faces, np.clip(color, 0.005, 0.95).reshape(-1, 3), body.uv)
    return merge([scaled, _head(path[-1], path[-1] - path[-25])])


def _head(at: Array, along: Array) -> Mesh:
    """Shape a snake's head: a flattened, tapering dome with brows and eyes."""
    axes = frames(along[None], np.array([[0.0, 1.0, 0.0]]))
    v, u = np.meshgrid(np.linspace(0, 1, 140), np.linspace(0, 2 * np.pi, 180, endpoint=False), indexing="ij")
    girth = 0.12 + 0.075 * np.sin(np.pi * np.clip(v * 1.25, 0, 1)) - 0.10 * v**2
    girth = girth * np.sqrt(np.clip(1 - v**6, 0, 1)) + 1e-4
    points = np.stack([1.15 * girth * np.cos(u), v * 0.46 - 0.02, (0.72 - 0.12 * v) * girth * np.sin(u)], -1)
    brow = (
        0.03
        * np.exp(-((v - 0.5) ** 2) / 0.01)
        * np.exp(-((np.abs(np.cos(u)) - 0.75) ** 2) / 0.03)
        * (np.sin(u) > 0)
    )
    mouth = -0.012 * np.exp(-((np.sin(u) + 0.18) ** 2) / 0.002) * (v > 0.25)
    points[..., 2] += brow
    points *= (1 + mouth / (girth + 0.05))[..., None]
    pits = fractal_noise(points * 55, octaves=2, seed=12)
    points += (0.004 * pits)[..., None]
    tone = np.clip(0.75 + 0.5 * pits, 0.2, 1.4)[..., None]
    upper = (np.sin(u) > -0.18)[..., None]
    color = np.where(upper, np.array([0.05, 0.34, 0.22]), np.array([0.72, 0.58, 0.26])) * tone
    head = grid(points, wrap=True).painted(np.clip(color, 0.01, 0.95).reshape(-1, 3))
    ball = revolve(np.stack([np.sin(np.linspace(0, np.pi, 24)), np.cos(np.linspace(0, np.pi, 24))], -1), 32)
    eyes = []
    for side in (-1, 1):
        iris = ball.moved([side * 0.118, 0.23, 0.075], scale=0.034).painted([0.90, 0.62, 0.05])
        pupil = ball.moved([side * 0.146, 0.236, 0.078], scale=[0.01, 0.009, 0.024]).painted(
            [0.01, 0.01, 0.01]
        )
        eyes += [iris, pupil]
    model = merge([head, *eyes])
    return scatter(model, at[None], axes, np.ones(1), np.ones((1, 3)))


def _spines() -> Mesh:
    """Set a crest of thorns along the back."""
    s = np.linspace(0.12, 0.985, 150)
    path = _spine(s)
    ahead = _spine(np.minimum(s + 2e-3, 1)) - _spine(s - 2e-3)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0]) - ahead * ahead[:, 1:2]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    thorn = revolve([(0.24, 0.0), (0.20, 0.25), (0.11, 0.6), (0.0, 1.0)], 10).painted([0.85, 0.55, 0.12])
    radius = _thickness(s)
    axes = frames(up - 0.55 * ahead, ahead)
    return scatter(thorn, path + up * radius[:, None] * 0.93, axes, radius * 0.75, np.full((len(s), 3), 0.9))


def _pots() -> Mesh:
    """Glazed jars along the far wall: large, soft shapes behind the serpent."""
    profile = [
        (0, 0),
        (0.3, 0),
        (0.52, 0.35),
        (0.55, 0.7),
        (0.38, 1.0),
        (0.2, 1.12),
        (0.2, 1.2),
        (0.3, 1.28),
        (0.26, 1.28),
        (0, 1.1),
    ]
    jar = revolve(profile, 64)
    parts = []
    for x, z, size, color in (
        (-4.2, 10.2, 1.25, [0.55, 0.16, 0.05]),
        (-2.6, 9.2, 0.8, [0.10, 0.28, 0.42]),
        (3.4, 9.9, 1.35, [0.62, 0.40, 0.10]),
        (0.9, 10.8, 0.9, [0.30, 0.36, 0.12]),
    ):
        stripes = 1 + 0.35 * np.sign(np.sin(jar.vertices[:, 1:2] * 26))
        parts.append(jar.painted(np.clip(stripes * color, 0, 0.95)).moved([x, 0, z], scale=size))
    return merge(parts)
