"""Foliage: a toadstool in focus, seen through thousands of leaves against a bright forest.

Very high depth complexity. The leaves in front have circles of confusion of 20 to 43 px at 640 px width,
the forest behind of 8 to 18 px; every leaf edge mixes three or more layers.
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

__all__ = ["FOCUS", "LENS_RADIUS", "RUST", "STRAW", "leaf", "scene"]

FOCUS = 3.2
LENS_RADIUS = 0.065
FOV = 40.0
SPRING, MOSS, OLIVE = (0.23, 0.42, 0.05), (0.09, 0.22, 0.04), (0.20, 0.25, 0.05)
RUST, STRAW = (0.40, 0.13, 0.03), (0.46, 0.34, 0.10)


def scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a Mitsuba dictionary; a variant must be active."""
    rng = np.random.default_rng(7)
    leafy = {
        "type": "principledthin",
        "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
        "diff_trans": 0.9,
        "roughness": 0.45,
    }
    matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": leafy["base_color"]}}
    glossy = {
        "type": "twosided",
        "bsdf": {"type": "principled", "base_color": leafy["base_color"], "roughness": 0.3, "specular": 0.4},
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": thin_lens(
            width,
            height,
            fov=FOV,
            lens_radius=LENS_RADIUS,
            focus_distance=FOCUS,
            eye=[0, 0.62, 0],
            target=[0, 0.50, FOCUS],
        ),
        "sun": sun([0.62, -0.72, -0.25], [8.6, 7.4, 5.5]),
        "sky": {"type": "envmap", "scale": 1.45, **_forest_light()},
        "ground": to_mitsuba(_ground(), matte),
        "trunks": to_mitsuba(_trunks(rng), matte),
        "caps": to_mitsuba(_caps(rng), glossy),
        "stems": to_mitsuba(_stems(rng), matte),
        "grass": to_mitsuba(_grass(rng), leafy),
        "litter": to_mitsuba(_litter(rng), leafy),
        "undergrowth": to_mitsuba(_undergrowth(rng), leafy),
        "bushes": to_mitsuba(_bushes(rng), leafy),
        "branches": to_mitsuba(_foreground(rng), leafy),
    }


def _height(x: Array, z: Array) -> Array:
    points = np.stack([x * 0.9, np.zeros_like(x), z * 0.9], -1)
    bank = 0.16 * np.exp(-((x - 0.1) ** 2) / 0.9 - (z - 3.3) ** 2 / 0.5)
    return 0.10 * fractal_noise(points, octaves=4, seed=3) + bank + 0.01 * np.maximum(z - 4, 0) ** 1.4


def _ground() -> Mesh:
    z, x = np.meshgrid(0.3 + 30 * np.linspace(0, 1, 500) ** 1.6, np.linspace(-1, 1, 360), indexing="ij")
    x = x * (2.0 + z * 0.8)
    points = np.stack([x, _height(x, z), z], -1)
    tint = fractal_noise(points * 5, octaves=5, gain=0.7, seed=9)[..., None] * 0.5 + 0.5
    color = (1 - tint) * np.array([0.07, 0.05, 0.03]) + tint * np.array([0.10, 0.15, 0.03])
    return grid(points).painted(np.clip(color, 0.01, 1).reshape(-1, 3))


def leaf(segments: int = 6, width: float = 0.34, fold: float = 0.25, curl: float = 0.22) -> Mesh:
    """One leaf of length 1 along y, facing z, folded along its midrib."""
    s = np.linspace(0, 1, segments + 1)[:, None]
    t = np.linspace(-1, 1, 5)[None, :]
    half = width * np.sin(np.pi * s**0.75) ** 0.85 * (1 - 0.35 * s) + 0.012
    points = np.stack([half * t, s - 0.04 * t**2 + 0 * t, fold * half * np.abs(t) - curl * s**2 + 0 * t], -1)
    vein = 1.0 + 0.35 * (np.abs(t) < 0.25) + 0.12 * np.cos(7 * np.pi * s) * (np.abs(t) > 0.25)
    return grid(points).painted(np.repeat((vein + 0 * s).reshape(-1, 1), 3, axis=1) * 0.85)


def _tints(rng: np.random.Generator, count: int, *palette: tuple[float, float, float]) -> Array:
    """Draw colours between those of a palette, each lighter or darker by chance."""
    weights = rng.dirichlet(np.full(len(palette), 0.6), count)
    colors: Array = weights @ np.array(palette) * rng.uniform(0.6, 1.35, (count, 1))
    return np.clip(colors, 0, 0.9)


def _directions(rng: np.random.Generator, count: int) -> Array:
    vectors = rng.normal(size=(count, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors


def _clump(
    rng: np.random.Generator, centre: Array, radius: float, count: int, size: float, colors: Array
) -> Mesh:
    """Leaves on the outside of a blob, hanging outwards."""
    outward = _directions(rng, count)
    positions = centre + outward * radius * rng.uniform(0.55, 1.05, (count, 1)) * [1, 0.8, 1]
    forward = outward + 0.8 * _directions(rng, count) + [0, -0.35, 0]
    axes = frames(forward, outward + np.array([0, 0.6, 0]))
    return scatter(leaf(4), positions, axes, size * rng.uniform(0.6, 1.3, count), colors)


def _sprig(
    rng: np.random.Generator, start: Array, end: Array, sag: float, pairs: int, size: float, colors: Array
) -> Mesh:
    """Grow a twig with leaves to both sides; `colors` holds one for each of the 2 `pairs` leaves."""
    s = np.linspace(0, 1, 24)[:, None]
    path = start + s * (end - start) + [0, -1, 0] * (sag * s**2)
    path = path + 0.03 * np.linalg.norm(end - start) * fractal_noise(
        path[:, None] * 3 + [[0, 0, 0], [9, 0, 0], [0, 9, 0]], seed=5
    )
    twig = tube(path, 0.006 * (1.15 - s[:, 0]), 6).painted([0.10, 0.07, 0.04])
    at = np.repeat(np.linspace(0.08, 1, pairs), 2)
    index = at * (len(path) - 1)
    positions = np.stack([np.interp(index, np.arange(len(path)), path[:, k]) for k in range(3)], -1)
    along = (end - start + [0, -2 * sag, 0]) / np.linalg.norm(end - start + [0, -2 * sag, 0])
    side = np.cross(along, [0, 0, 1.0])
    side = side / np.linalg.norm(side) * np.tile([1, -1], pairs)[:, None]
    forward = side + 0.7 * along + 0.35 * rng.normal(size=(2 * pairs, 3)) + [0, -0.15, 0]
    facing = np.array([0, 0.8, -0.9]) + 0.5 * rng.normal(size=(2 * pairs, 3))
    scales = size * rng.uniform(0.7, 1.25, 2 * pairs) * (1.1 - 0.5 * at)
    return merge([twig, scatter(leaf(8), positions, frames(forward, facing), scales, colors)])


def _foreground(rng: np.random.Generator) -> Mesh:
    """Hang twigs into the picture from the left, the top and the right, 1.0 to 2.2 from the camera."""
    sprigs = []
    for count, box_from, box_to in (
        (17, [(-0.85, 0.75, 1.0), (-0.3, 1.15, 2.1)], [(-0.45, 0.35, 1.0), (-0.16, 0.75, 2.1)]),
        (13, [(0.35, 0.85, 1.1), (0.9, 1.15, 2.2)], [(0.22, 0.45, 1.1), (0.6, 0.8, 2.2)]),
        (7, [(-0.3, 0.95, 1.3), (0.4, 1.25, 2.2)], [(-0.3, 0.78, 1.3), (0.4, 0.95, 2.2)]),
        (7, [(-0.7, 0.0, 1.0), (-0.3, 0.2, 1.3)], [(-0.48, 0.3, 1.0), (-0.22, 0.45, 1.4)]),
        (3, [(0.1, 0.92, 1.5), (0.35, 1.0, 2.3)], [(-0.15, 0.55, 1.5), (0.15, 0.7, 2.3)]),
        (6, [(0.35, 0.05, 1.0), (0.7, 0.2, 1.4)], [(0.28, 0.30, 1.0), (0.5, 0.45, 1.5)]),
    ):
        for _ in range(count):
            start, end = (rng.uniform(low, high) for low, high in (box_from, box_to))
            end[2] = start[2] + rng.uniform(-0.12, 0.12)
            palette = (SPRING, MOSS, OLIVE) if rng.random() < 0.85 else (STRAW, RUST, OLIVE)
            sprigs.append(_sprig(rng, start, end, rng.uniform(0, 0.12), 15, 0.075, _tints(rng, 30, *palette)))
    return merge(sprigs)


def _undergrowth(rng: np.random.Generator) -> Mesh:
    """Fern-like fronds around the toadstools, just in front of and behind the focal plane."""
    fronds = []
    for _ in range(70):
        x, z = rng.uniform(-1.6, 1.6), rng.uniform(2.5, 5.0)
        if abs(x - 0.05) < 0.42 and z < 3.45:
            continue
        base = np.array([x, _height(np.array(x), np.array(z)), z])
        lean = rng.uniform(0, 2 * np.pi)
        for k in range(5):
            angle = lean + 2 * np.pi * k / 5 + rng.normal() * 0.2
            length = rng.uniform(0.22, 0.42)
            tip = base + length * np.array([np.cos(angle), 1.0, np.sin(angle)])
            fronds.append(_sprig(rng, base, tip, 0.4 * length, 14, 0.075, _tints(rng, 28, SPRING, MOSS)))
    return merge(fronds)


def _bushes(rng: np.random.Generator) -> Mesh:
    """Sunlit bushes and low branches in the background."""
    clumps = []
    for _ in range(70):
        z = rng.uniform(5.2, 15)
        x = rng.uniform(-0.55, 0.55) * z
        y = float(_height(np.array(x), np.array(z))) + rng.uniform(-0.02, 0.15) * z * (0.3 + 1.8 * abs(x) / z)
        colors = _tints(rng, 130, SPRING, MOSS, STRAW) * 1.25
        clumps.append(_clump(rng, np.array([x, y, z]), rng.uniform(0.25, 0.6), 130, 0.2, colors))
    for _ in range(16):
        z = rng.uniform(4.6, 9)
        centre = np.array([rng.uniform(-0.45, 0.45) * z, 0.62 + rng.uniform(0.13, 0.24) * z, z])
        clumps.append(_clump(rng, centre, 0.42, 110, 0.15, _tints(rng, 110, SPRING, STRAW) * 1.2))
    return merge(clumps)


def _grass(rng: np.random.Generator) -> Mesh:
    s = np.linspace(0, 1, 6)[:, None]
    t = np.linspace(-1, 1, 2)[None, :]
    blade = grid(np.stack([0.022 * (1 - s**1.5) * t, s + 0 * t, -0.35 * s**2 + 0 * t], -1)).painted(
        [1.0, 1.0, 1.0]
    )
    count = 16000
    z = 1.2 + 8 * rng.random(count) ** 1.5
    x = rng.uniform(-0.6, 0.6, count) * z
    patch = fractal_noise(np.stack([x * 1.6, 0 * x, z * 1.6], -1), octaves=3, seed=21)
    keep = patch > rng.normal(0.0, 0.25, count)
    x, z = x[keep], z[keep]
    forward = np.stack([rng.normal(0, 0.3, len(x)), np.ones(len(x)), rng.normal(0, 0.3, len(x))], -1)
    axes = frames(forward, _directions(rng, len(x)) * [1, 0.1, 1])
    positions = np.stack([x, _height(x, z) - 0.01, z], -1)
    near_caps = np.exp(-(x**2) / 0.2 - (z - 3.1) ** 2 / 0.3)
    scales = rng.uniform(0.08, 0.24, len(x)) * (1 - 0.5 * near_caps)
    return scatter(blade, positions, axes, scales, _tints(rng, len(x), SPRING, MOSS, OLIVE))


def _litter(rng: np.random.Generator) -> Mesh:
    """Fallen leaves."""
    count = 2600
    z = 1.3 + 6 * rng.random(count) ** 1.4
    x = rng.uniform(-0.6, 0.6, count) * z
    positions = np.stack([x, _height(x, z) + 0.012, z], -1)
    forward = _directions(rng, count) * [1, 0.25, 1]
    facing = np.array([0, 1.0, 0]) + 0.35 * rng.normal(size=(count, 3))
    return scatter(
        leaf(6, width=0.4, fold=0.5),
        positions,
        frames(forward, facing),
        rng.uniform(0.04, 0.1, count),
        _tints(rng, count, RUST, STRAW, OLIVE),
    )


_TOADSTOOLS = (
    (0.03, 3.2, 0.50, 0.30, 0.05),
    (0.40, 3.42, 0.30, 0.19, -0.1),
    (-0.33, 3.05, 0.24, 0.15, 0.12),
    (-0.12, 2.86, 0.10, 0.075, 0.0),
)
"""Toadstools: x, z, height of the stem, radius of the cap, lean."""


def _toadstool_bases() -> list[tuple[Array, float, float, float]]:
    return [
        (np.array([x, float(_height(np.array(x), np.array(z))) - 0.02, z]), stem, cap, lean)
        for x, z, stem, cap, lean in _TOADSTOOLS
    ]


def _dome(radius: Array) -> Array:
    """Height of a cap of radius 1 above its rim."""
    return 0.62 * np.sqrt(np.maximum(1 - np.minimum(radius, 1) ** 2.3, 0))


def _caps(rng: np.random.Generator) -> Mesh:
    """Red caps with white warts."""
    parts = []
    angle = np.linspace(0, np.pi / 2, 40)
    shape = revolve(np.stack([np.sin(angle), _dome(np.sin(angle))], -1)[::-1], 120)
    wart = revolve([(0.0, -0.2), (1, -0.1), (0.9, 0.35), (0.6, 0.6), (0.25, 0.72), (0, 0.75)], 14)
    for base, stem, cap, lean in _toadstool_bases():
        noise = fractal_noise(shape.vertices * 4 + 10 * cap, octaves=4, seed=2)[:, None]
        bumpy = Mesh(shape.vertices * (1 + 0.02 * noise), shape.faces, shape.colors, shape.uv)
        rim = np.hypot(shape.vertices[:, 0], shape.vertices[:, 2])[:, None]
        red = np.array([0.62, 0.035, 0.02]) * (1 + 0.25 * noise) + rim**6 * np.array([0.14, 0.09, 0.02])
        top = base + np.array([lean * stem, stem, 0])
        parts.append(bumpy.painted(np.clip(red, 0, 1)).moved(top, scale=cap))
        count = 90
        radius = np.sqrt(rng.uniform(0.0, 0.93, count))
        turn = np.arange(count) * 2.399963 + rng.normal(0, 0.15, count)
        foot = np.stack([radius * np.cos(turn), _dome(radius), radius * np.sin(turn)], -1)
        normal = foot * [1, 1.6, 1]
        axes = frames(normal / np.linalg.norm(normal, axis=1, keepdims=True), _directions(rng, count))
        sizes = cap * rng.uniform(0.025, 0.075, count) * (1.15 - 0.6 * radius)
        cream = np.array([0.86, 0.80, 0.66]) * rng.uniform(0.85, 1.05, (count, 1))
        parts.append(scatter(wart.painted([1.0, 1.0, 1.0]), top + cap * foot, axes, sizes, cream))
    return merge(parts)


def _stems(rng: np.random.Generator) -> Mesh:
    """Stems with a skirt, and the gills under the caps."""
    parts = []
    for base, stem, cap, lean in _toadstool_bases():
        s = np.linspace(0, 1, 40)
        path = base + np.stack([lean * stem * s**1.5, stem * s, 0 * s], -1)
        width = cap * (0.16 + 0.12 * np.exp(-7 * s) + 0.02 * np.sin(40 * s) * np.exp(-6 * s))
        stalk = tube(path, width, 40)
        fibre = 1 + 0.12 * fractal_noise(stalk.vertices * [60, 8, 60], octaves=3, seed=4)[:, None]
        parts.append(stalk.painted(np.clip(np.array([0.74, 0.68, 0.55]) * fibre, 0, 0.9)))
        top = base + np.array([lean * stem, stem, 0])
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        radius = np.linspace(0.15, 0.985, 12)[:, None]
        drop = (
            0.05 * np.sign(np.sin(90 * angle)) * np.sin(np.pi * radius) - 0.06 * np.sin(np.pi * radius) + 0.01
        )
        gills = grid(np.stack([radius * np.cos(angle), drop, radius * np.sin(angle)], -1), wrap=True)
        parts.append(gills.painted([0.80, 0.72, 0.56]).moved(top, scale=cap))
        ruffle = 1 + 0.12 * np.sin(14 * angle + rng.uniform(0, 6))
        ring = np.linspace(0.17, 0.42, 8)[:, None]
        skirt = grid(
            np.stack([ring * np.cos(angle), -0.9 * (ring - 0.17) ** 1.2 * ruffle, ring * np.sin(angle)], -1),
            wrap=True,
        )
        at = base + np.array([lean * stem * 0.72**1.5, stem * 0.74, 0])
        parts.append(skirt.painted([0.82, 0.76, 0.62]).moved(at, scale=cap))
    return merge(parts)


def _trunks(rng: np.random.Generator) -> Mesh:
    parts = []
    for x, z, radius in (
        (-2.6, 7.5, 0.32),
        (2.1, 6.4, 0.22),
        (0.9, 10.5, 0.3),
        (-1.0, 13, 0.3),
        (4.4, 11, 0.4),
        (-5, 12, 0.4),
        (2.6, 15, 0.3),
    ):
        s = np.linspace(0, 1, 60)
        wander = 0.25 * fractal_noise(np.stack([s * 2, 0 * s + x, 0 * s + z], -1), octaves=2, seed=8)
        path = np.stack([x + wander + 0.5 * s * rng.normal(), -0.3 + 9 * s, z + 0 * s], -1)
        trunk = tube(path, radius * (1 - 0.5 * s + 0.6 * np.exp(-12 * s)), 40)
        bark = fractal_noise(trunk.vertices * [6, 1.3, 6], octaves=4, seed=6)[:, None]
        parts.append(trunk.painted(np.clip(np.array([0.16, 0.11, 0.075]) * (1 + 0.8 * bark), 0.01, 1)))
    return merge(parts)


def _forest_light() -> dict[str, Any]:
    """Sky above, and around the horizon a far forest with the sun breaking through its gaps."""
    height, width = 512, 1024
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    elevation, azimuth = np.pi * (0.5 - v), 2 * np.pi * u
    around = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)], -1
    )
    sky = np.array([0.55, 0.78, 1.0]) + (0.9 * np.exp(-2.5 * np.abs(elevation)))[..., None] * np.array(
        [1.0, 0.85, 0.55]
    )
    leaves = fractal_noise(around * 9, octaves=5, gain=0.65, seed=31)
    canopy = 1 / (1 + np.exp(-8 * (0.55 - 1.6 * elevation + 0.8 * leaves)))
    green = np.array([0.20, 0.30, 0.06]) * np.clip(0.9 + 0.7 * leaves, 0.1, None)[..., None]
    glints = np.clip(fractal_noise(around * 40, octaves=2, seed=47) - 0.72, 0, None) * (
        np.abs(elevation) < 0.6
    )
    pixels = (
        sky * (1 - canopy[..., None])
        + green * canopy[..., None]
        + glints[..., None] * np.array([7.0, 6.0, 3.5])
    )
    pixels[elevation < -0.25] = [0.10, 0.09, 0.04]
    pixels = np.concatenate([pixels, pixels[:, :1]], axis=1)  # Mitsuba's maps repeat their first column
    return {"bitmap": bitmap(pixels)["bitmap"]}
