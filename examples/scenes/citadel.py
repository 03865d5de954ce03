"""Citadel: a courtyard of brick, arches, columns and stairs, seen through a dark gateway.

Moderate depth complexity: large overlapping structures from a few metres to the far towers, with texture
detail on all of them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from scenes.geometry import (
    Array,
    Mesh,
    bitmap,
    box,
    fractal_noise,
    grid,
    merge,
    revolve,
    scatter,
    to_mitsuba,
    tube,
)
from scenes.stage import sun, thin_lens

__all__ = ["FOCUS", "LENS_RADIUS", "scene"]

FOCUS = 6.2
LENS_RADIUS = 0.13
FOV = 50.0
SAND, OCHRE, GREY = np.array([0.52, 0.41, 0.28]), np.array([0.48, 0.30, 0.16]), np.array([0.34, 0.32, 0.30])


def scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a Mitsuba dictionary; a variant must be active."""
    import mitsuba as mi

    vertex_color = {"type": "mesh_attribute", "name": "vertex_color"}
    matte = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": vertex_color}}
    grain = fractal_noise(_torus_points(512) * 3.0, octaves=4, gain=0.55, seed=17)
    stone = {
        "type": "bumpmap",
        "arbitrary": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(grain[..., None].astype(np.float32)),
            "raw": True,
        },
        "scale": 0.055,
        "bsdf": matte,
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
            eye=[0.25, 1.55, 0],
            target=[0.0, 1.62, FOCUS],
        ),
        "sun": sun([-0.58, -0.56, 0.60], [8.2, 6.7, 4.8]),
        "sky": {"type": "envmap", "bitmap": _sky()["bitmap"]},
        "masonry": to_mitsuba(_masonry(), stone, smooth=False),
        "columns": to_mitsuba(_columns(), matte),
        "urns": to_mitsuba(_urns(), matte),
        "banners": to_mitsuba(_banners(), matte),
        "hills": to_mitsuba(_hills(), matte),
        "chains": to_mitsuba(_chains(), matte),
    }


def _torus_points(size: int) -> Array:
    """Points (size, size, 3) of a torus, so that noise at them repeats at a texture's edges."""
    angle = 2 * np.pi * np.arange(size) / size
    v, u = np.meshgrid(angle, angle, indexing="ij")
    return np.stack([(2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)], -1) + 7.3


def _stones(
    rng: np.random.Generator, centres: Array, sizes: Array, color: Array, axes: Array | None = None
) -> Mesh:
    """Blocks (K, 3) of sizes (K, 3), each with its own shade, grain and slightly uneven face."""
    count = len(centres)
    if axes is None:
        axes = np.broadcast_to(np.eye(3), (count, 3, 3))
    axes = axes + rng.normal(0, 0.006, (count, 3, 3))
    warm = rng.normal(0, 0.05, (count, 3)) * [1, 0.4, -0.6]
    tint = np.clip(color * rng.uniform(0.68, 1.22, (count, 1)) + warm * color, 0.02, 0.9)
    blocks = scatter(
        box([1, 1, 1]).painted([1.0, 1.0, 1.0]), centres, sizes[:, :, None] * axes, np.ones(count), tint
    )
    span = np.repeat(np.max(sizes, axis=1), 24)[:, None]
    shift = np.repeat(rng.random((count, 2)), 24, axis=0)
    return Mesh(blocks.vertices, blocks.faces, blocks.colors, blocks.uv * span * 0.9 + shift)


def _courses(
    length: float, height: float, brick: float, course: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Lay bricks over a rectangle; return their centres (K, 2) from its lower middle, and lengths (K,)."""
    centres, lengths = [], []
    for row in range(round(height / course)):
        cuts = np.arange(-length / 2 + (row % 2) * brick / 2, length / 2, brick)
        cuts = np.unique(
            np.clip(
                [-length / 2, *(cuts + rng.normal(0, 0.06 * brick, len(cuts))), length / 2],
                -length / 2,
                length / 2,
            )
        )
        centres.append(
            np.stack([(cuts[1:] + cuts[:-1]) / 2, np.full(len(cuts) - 1, (row + 0.5) * course)], -1)
        )
        lengths.append(np.diff(cuts))
    return np.concatenate(centres), np.concatenate(lengths)


def _wall(
    rng: np.random.Generator,
    start: tuple[float, float],
    end: tuple[float, float],
    base: float,
    height: float,
    color: Array,
    *,
    brick: float = 0.42,
    thickness: float = 0.4,
    arches: tuple[tuple[float, float, float], ...] = (),
) -> Mesh:
    """Build a wall between two points (x, z) of the ground, with arches (middle, radius, springing)."""
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    course = brick * 0.42
    at, width = _courses(length, height, brick, course, rng)
    keep = np.ones(len(at), bool)
    for middle, radius, springing in arches:
        outside = radius + 0.3
        dx = np.abs(at[:, 0] - middle)
        over = np.hypot(dx, np.maximum(at[:, 1] - springing, 0)) > outside
        keep &= over & ~((at[:, 1] <= springing) & (dx < outside))
    at, width = at[keep], width[keep]
    along = np.array([(b - a)[0], 0, (b - a)[1]]) / length
    axes = np.stack([along, [0, 1, 0], np.cross(along, [0, 1, 0])])
    origin = np.array([(a + b)[0] / 2, base, (a + b)[1] / 2])
    gap = 0.014 if not arches else 0.006
    depth = thickness + rng.normal(0, 0.02, len(at))
    sizes = np.stack([width - gap, np.full(len(at), course - gap), depth], -1)
    local = np.concatenate([at, np.zeros((len(at), 1))], axis=1)
    parts = [_stones(rng, origin + local @ axes, sizes, color, np.broadcast_to(axes, (len(at), 3, 3)))]
    mortar = box([1, 1, 1]).painted(0.55 * GREY)
    if not arches:
        slab = scatter(
            mortar,
            (origin + np.array([0, height / 2, 0]))[None],
            np.array([length, height, thickness * 0.93])[None, :, None] * axes[None],
            np.ones(1),
            np.ones((1, 3)),
        )
        parts.append(slab)
    parts += [_arch(rng, origin, axes, thickness, *arch) for arch in arches]
    return merge(parts)


def _arch(
    rng: np.random.Generator,
    origin: Array,
    axes: Array,
    thickness: float,
    middle: float,
    radius: float,
    springing: float,
) -> Mesh:
    """Wedge-shaped stones around an opening, and its jambs."""
    count = max(9, int(radius * 16) | 1)
    angle = (np.arange(count) + 0.5) / count * np.pi
    ring = radius + 0.15
    local = np.stack([middle + ring * np.cos(angle), springing + ring * np.sin(angle), 0 * angle], -1)
    turned = np.stack(
        [
            [np.array([np.cos(t), np.sin(t), 0]), np.array([-np.sin(t), np.cos(t), 0]), np.array([0, 0, 1])]
            for t in angle
        ]
    )
    sizes = np.tile([0.3, np.pi * ring / count - 0.02, thickness + 0.1], (count, 1))
    jambs = np.arange(0.15, springing, 0.3)
    sides = np.concatenate(
        [np.stack([np.full(len(jambs), middle + s * ring), jambs, 0 * jambs], -1) for s in (-1, 1)]
    )
    jamb_sizes = np.tile([0.3, 0.28, thickness + 0.1], (len(sides), 1))
    return merge(
        [
            _stones(rng, origin + local @ axes, sizes, SAND * 1.1, turned @ axes),
            _stones(
                rng, origin + sides @ axes, jamb_sizes, SAND * 1.1, np.broadcast_to(axes, (len(sides), 3, 3))
            ),
        ]
    )


def _masonry() -> Mesh:
    rng = np.random.default_rng(11)
    parts = [
        # The gateway that the camera looks out of.
        _wall(
            rng,
            (-2.2, 2.0),
            (2.6, 2.0),
            0,
            3.2,
            OCHRE,
            brick=0.3,
            arches=((0.08, 0.86, 1.42),),
            thickness=0.4,
        ),
        # Arcades to both sides of the yard, and a gatehouse at its end.
        _wall(
            rng,
            (-3.6, 3.4),
            (-3.6, 16.0),
            0,
            3.7,
            SAND,
            brick=0.34,
            arches=tuple((x, 1.1, 1.75) for x in (-4.6, -1.55, 1.5, 4.55)),
        ),
        _wall(
            rng,
            (3.8, 16.0),
            (3.8, 3.4),
            0,
            3.7,
            OCHRE,
            brick=0.34,
            arches=tuple((x, 1.1, 1.75) for x in (-4.6, -1.55, 1.5, 4.55)),
        ),
        _wall(
            rng,
            (-6, 16.0),
            (6, 16.0),
            1.4,
            2.5,
            SAND * 1.3,
            brick=0.34,
            arches=((0.0, 0.85, 0.95), (-2.4, 0.35, 1.1), (2.4, 0.35, 1.1)),
            thickness=0.8,
        ),
        _wall(rng, (-7, 5.5), (-7, 17), 0, 4.5, OCHRE),
        _wall(rng, (7, 17), (7, 5.5), 0, 4.5, OCHRE),
        _pavement(rng),
        _stairs(rng),
        _battlements(rng),
        _parapet(rng),
    ]
    for x, z, radius, height in (
        (-5.6, 25, 1.9, 7.0),
        (4.6, 31, 2.3, 8.6),
        (-1.8, 46, 3.4, 11.5),
        (13, 40, 3.0, 9.5),
    ):
        parts.append(_tower(rng, x, z, radius, height))
    return merge(parts)


def _pavement(rng: np.random.Generator) -> Mesh:
    x, z = np.meshgrid(np.arange(-8, 8, 0.62), np.arange(0.4, 19, 0.62))
    x = x + 0.31 * (np.round(z / 0.62) % 2)
    centres = np.stack([x.ravel(), rng.normal(-0.05, 0.008, x.size), z.ravel()], -1)
    slabs = _stones(rng, centres, np.tile([0.595, 0.1, 0.595], (x.size, 1)), 1.15 * GREY)
    return merge([slabs, box([60, 0.02, 90], [0, -0.06, 45]).painted(0.4 * OCHRE)])


def _stairs(rng: np.random.Generator) -> Mesh:
    """Build steps up to the gatehouse, with a block at each side."""
    parts = []
    for step in range(8):
        x = np.arange(-2.1, 2.2, 0.6) + 0.15 * (step % 2)
        centres = np.stack(
            [x, np.full(len(x), 0.0875 + 0.175 * step), np.full(len(x), 11.2 + 0.42 * step + 1.2)], -1
        )
        parts.append(_stones(rng, centres, np.tile([0.585, 0.17, 2.4], (len(x), 1)), SAND))
    blocks = np.array([[s * 2.75, 0.45, 11.6] for s in (-1, 1)])
    parts.append(_stones(rng, blocks, np.tile([0.8, 0.9, 0.8], (2, 1)), SAND * 1.1))
    return merge(parts)


def _battlements(rng: np.random.Generator) -> Mesh:
    parts = []
    for x in (-3.6, 3.8):
        z = np.arange(3.7, 16, 0.95)
        parts.append(
            _stones(
                rng, np.stack([0 * z + x, 0 * z + 3.98, z], -1), np.tile([0.45, 0.6, 0.55], (len(z), 1)), SAND
            )
        )
    along = np.arange(-5.6, 5.7, 0.95)
    parts.append(
        _stones(
            rng,
            np.stack([along, 0 * along + 4.2, 0 * along + 16.0], -1),
            np.tile([0.55, 0.65, 0.9], (len(along), 1)),
            SAND,
        )
    )
    return merge(parts)


def _parapet(rng: np.random.Generator) -> Mesh:
    """Build a low wall in the yard that carries the urns."""
    parts = []
    for side, z in ((-1, 6.2), (1, 7.6)):
        x = np.array([0.75, 1.25, 1.75, 2.25]) * side
        parts.append(
            _stones(
                rng, np.stack([x, 0 * x + 0.28, 0 * x + z], -1), np.tile([0.49, 0.56, 0.42], (4, 1)), SAND
            )
        )
        parts.append(
            _stones(rng, np.array([[1.5 * side, 0.62, z]]), np.array([[2.2, 0.12, 0.56]]), SAND * 1.2)
        )
    return merge(parts)


def _tower(rng: np.random.Generator, x: float, z: float, radius: float, height: float) -> Mesh:
    """Build a round tower of blocks, crowned with merlons."""
    course, per_ring = 0.5, int(radius * 9)
    ring, around = np.meshgrid(np.arange(int(height / course)), np.arange(per_ring), indexing="ij")
    angle = (2 * np.pi * (around + 0.5 * (ring % 2)) / per_ring).ravel()
    y = (ring.ravel() + 0.5) * course
    flare = np.where(y > height - 2 * course, 1.08, 1.0)
    top = (np.arange(per_ring) * 2 + 0.5) * np.pi / per_ring
    top = top[::2]
    angle, y = np.concatenate([angle, top]), np.concatenate([y, np.full(len(top), height + 0.5)])
    flare = np.concatenate([flare, np.full(len(top), 1.08)])
    out = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1)
    axes = np.stack(
        [np.stack([-out[:, 2], out[:, 1], out[:, 0]], -1), np.tile([0.0, 1.0, 0.0], (len(out), 1)), out],
        axis=1,
    )
    width = 2 * np.pi * radius / per_ring
    sizes = np.tile([width * 0.97, course * 0.95, 0.6], (len(out), 1))
    sizes[len(ring.ravel()) :, 1] = 1.0
    centres = np.array([x, 0, z]) + out * (radius * flare)[:, None] + np.stack([0 * y, y, 0 * y], -1)
    blocks = _stones(rng, centres, sizes, SAND * [1.2, 1.25, 1.35], axes)
    core = revolve([(radius, 0), (radius, height), (0, height)], 40).painted(0.3 * SAND).moved([x, 0, z])
    return merge([blocks, core])


def _columns() -> Mesh:
    """Fluted columns with base and capital, free-standing in two rows."""
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    profile = np.array(
        [
            (0.34, 0.00),
            (0.34, 0.12),
            (0.31, 0.14),
            (0.33, 0.19),
            (0.31, 0.24),
            (0.26, 0.27),
            (0.235, 0.32),
            (0.23, 0.8),
            (0.225, 1.4),
            (0.215, 2.0),
            (0.20, 2.46),
            (0.225, 2.50),
            (0.205, 2.54),
            (0.26, 2.66),
            (0.33, 2.74),
            (0.335, 2.80),
            (0.35, 2.81),
            (0.35, 2.90),
            (0.0, 2.90),
        ]
    )
    fine = np.concatenate([np.linspace(a, b, 8, endpoint=False) for a, b in pairwise(profile)])
    shaft = ((fine[:, 1] > 0.33) & (fine[:, 1] < 2.44))[:, None]
    radius = fine[:, :1] - shaft * 0.016 * np.abs(np.sin(10 * angle)) ** 0.5
    column = grid(
        np.stack([radius * np.cos(angle), fine[:, 1:] + 0 * angle, -radius * np.sin(angle)], -1), wrap=True
    )
    parts = []
    for i, (x, z) in enumerate([(s * 1.95 + 0.05, z) for z in (5.4, 8.2, 11.0) for s in (-1, 1)]):
        speck = fractal_noise(column.vertices * 14 + 3.1 * i, octaves=5, gain=0.75, seed=19)[:, None]
        stain = fractal_noise(column.vertices * [3, 0.8, 3] + 1.7 * i, octaves=3, seed=23)[:, None]
        tone = np.array([0.62, 0.55, 0.44]) * (1 + 0.22 * speck) * (1 + 0.18 * stain)
        parts.append(column.painted(np.clip(tone, 0.03, 0.9)).moved([x, 0, z]))
    return merge(parts)


def _urns() -> Mesh:
    """Painted urns on the parapets."""
    profile = [
        (0, 0),
        (0.16, 0),
        (0.15, 0.04),
        (0.07, 0.09),
        (0.08, 0.13),
        (0.19, 0.28),
        (0.235, 0.42),
        (0.20, 0.54),
        (0.13, 0.60),
        (0.15, 0.65),
        (0.17, 0.66),
        (0.14, 0.66),
        (0, 0.6),
    ]
    fine = np.concatenate([np.linspace(a, b, 16, endpoint=False) for a, b in pairwise(np.array(profile))])
    urn = revolve(fine, 180)
    turn = np.arctan2(urn.vertices[:, 2], urn.vertices[:, 0])
    y = urn.vertices[:, 1]
    key = (np.sin(turn * 14) * np.sin(y * 90) > 0) & (y > 0.3) & (y < 0.5)
    band = np.abs(((y * 18) % 1) - 0.5) > 0.4
    color = np.where(
        key[:, None], [0.72, 0.62, 0.42], np.where(band[:, None], [0.05, 0.04, 0.06], [0.40, 0.11, 0.05])
    )
    places = [
        (-0.95, 0.68, 6.2, 1.0),
        (-1.6, 0.68, 6.2, 0.75),
        (0.9, 0.68, 7.6, 1.0),
        (1.5, 0.68, 7.6, 0.85),
        (-2.75, 0.9, 11.6, 1.5),
        (2.75, 0.9, 11.6, 1.5),
    ]
    return merge(
        [urn.painted(color).moved(place[:3], scale=place[3], turn=i) for i, place in enumerate(places)]
    )


def _banners() -> Mesh:
    """Cloth that hangs from the arcades."""
    parts = []
    for i, (x, z, color) in enumerate(
        [
            (-3.3, 7.1, [0.50, 0.04, 0.03]),
            (-3.3, 10.1, [0.06, 0.12, 0.38]),
            (3.45, 6.0, [0.06, 0.14, 0.40]),
            (3.45, 9.1, [0.52, 0.05, 0.03]),
            (3.45, 12.2, [0.55, 0.36, 0.05]),
        ]
    ):
        s, t = np.meshgrid(np.linspace(0, 1, 60), np.linspace(-0.5, 0.5, 40), indexing="ij")
        fold = 0.05 * np.sin(t * 14 + i) * s + 0.08 * np.sin(2.2 * s + i)
        cut = 1 - 0.12 * (1 - np.abs(2 * t)) * (s > 0.8) * (s - 0.8) / 0.2
        cloth = grid(np.stack([x + fold, 3.62 - 1.75 * s * cut, z + 0.85 * t], -1))
        emblem = (
            (np.abs(np.hypot(t, (s - 0.45) * 2.2) - 0.28) < 0.05)
            | (np.abs(t) > 0.44)
            | (np.hypot(t, (s - 0.45) * 2.2) < 0.1)
        )
        parts.append(cloth.painted(np.where(emblem.reshape(-1, 1), [0.75, 0.55, 0.16], color)))
    return merge(parts)


def _chains() -> Mesh:
    """Two chains of a portcullis, close to the camera."""
    turn = np.linspace(0, 2 * np.pi, 25)
    link = tube(np.stack([0.026 * np.cos(turn), 0.045 * np.sin(turn), 0 * turn], -1), 0.009, 8).painted(
        [0.10, 0.09, 0.08]
    )
    parts = []
    for x, z in ((-0.34, 1.3), (0.72, 1.45)):
        parts += [link.moved([x, 1.0 + 0.068 * k, z], turn=(k % 2) * np.pi / 2 + 0.4) for k in range(26)]
    return merge(parts)


def _hills() -> Mesh:
    x, z = np.meshgrid(np.linspace(-90, 90, 160), np.linspace(55, 140, 80))
    y = 5 + 0.20 * (z - 55) + 7 * fractal_noise(np.stack([x, 0 * x, z], -1) * 0.03, octaves=5, seed=29)
    tone = np.clip(0.9 + 0.4 * fractal_noise(np.stack([x, y, z], -1) * 0.5, octaves=3, seed=30), 0.3, 1.4)
    return grid(np.stack([x, y, z], -1)).painted((tone[..., None] * [0.20, 0.24, 0.20]).reshape(-1, 3))


def _sky() -> dict[str, Any]:
    """Deep blue overhead, haze at the horizon, clouds between."""
    height, width = 256, 512
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    elevation, azimuth = np.pi * (0.5 - v), 2 * np.pi * u
    around = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)], -1
    )
    up = np.clip(np.sin(elevation), 0, 1)[..., None]
    color = np.array([1.0, 0.95, 0.88]) * (1 - up) ** 4 + np.array([0.32, 0.55, 1.0]) * (1 - (1 - up) ** 4)
    clouds = np.clip(fractal_noise(around * [3, 7, 3], octaves=5, gain=0.55, seed=41), 0, 1)[..., None]
    color = color * (1 - clouds) + clouds * np.array([1.5, 1.45, 1.4])
    color[elevation < 0] = [0.42, 0.35, 0.27]
    return bitmap(np.concatenate([color, color[:, :1]], axis=1))
