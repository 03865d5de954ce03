"""Parts that machines are put together from: blocks, beams, rods, wheels, tracks, hydraulic cylinders, cabs.

x points forward and y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from scenes.geometry import Array, Mesh, grid, merge, revolve, tube

__all__ = [
    "BLACK",
    "CHROME",
    "HOSE",
    "IRON",
    "RUST",
    "Body",
    "bars",
    "beam",
    "block",
    "cab",
    "cylinder",
    "drum",
    "hose",
    "joined",
    "placed",
    "post",
    "railing",
    "rod",
    "track",
    "transform",
]

Body = dict[str, list[Mesh]]
"""Meshes by material: ``paint``, ``steel`` (bare, worn) or ``dark`` (rubber, glass, grease)."""

BLACK, IRON = np.array([0.035, 0.035, 0.04]), np.array([0.13, 0.12, 0.11])
RUST, CHROME = np.array([0.20, 0.11, 0.065]), np.array([0.62, 0.63, 0.65])
GLASS, HOSE = np.array([0.02, 0.03, 0.04]), np.array([0.022, 0.022, 0.024])


def transform(
    shift: npt.ArrayLike = (0, 0, 0),
    *,
    axis: npt.ArrayLike = (0, 1, 0),
    degrees: float = 0.0,
    pivot: npt.ArrayLike = (0, 0, 0),
) -> Array:
    """Return the 4 x 4 matrix that turns about an axis through `pivot`, then shifts."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    result = np.eye(4)
    result[:3, :3] += np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    result[:3, 3] = np.asarray(pivot) - result[:3, :3] @ np.asarray(pivot) + np.asarray(shift)
    return result


def placed(mesh: Mesh, matrix: Array) -> Mesh:
    """Return the mesh moved by a 4 x 4 matrix."""
    vertices = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return Mesh(vertices, mesh.faces, mesh.colors, mesh.uv)


def block(size: npt.ArrayLike, centre: npt.ArrayLike = (0, 0, 0), bevel: float = 0.02) -> Mesh:
    """Return a box whose edges are cut off, so that they catch the light; all its faces are flat."""
    half = np.asarray(size, float) / 2
    bevel = min(bevel, 0.4 * float(half.min()))
    signs = np.array(list(np.ndindex(2, 2, 2))) * 2 - 1
    corners = np.stack([signs * (half - bevel * (np.arange(3) != axis)) for axis in range(3)], axis=1)
    facets: list[Array] = list(corners)
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1, 1):
            side = np.flatnonzero(signs[:, axis] == sign)
            facets.append(corners[side[[0, 1, 3, 2]], axis])
        for at_b, at_c in np.ndindex(2, 2):
            edge = np.flatnonzero((signs[:, b] == 2 * at_b - 1) & (signs[:, c] == 2 * at_c - 1))
            facets.append(
                np.stack([corners[edge[0], b], corners[edge[0], c], corners[edge[1], c], corners[edge[1], b]])
            )
    return _facets(facets).moved(centre)


def beam(top: npt.ArrayLike, bottom: npt.ArrayLike, width: float, z: float = 0.0) -> Mesh:
    """Return a box beam between two polylines (N, 2) of the side view, `width` across, centred on `z`."""
    lines = [np.asarray(line, float) for line in (top, bottom)]
    sides = [
        np.stack([np.column_stack([line, np.full(len(line), z + s * width / 2)]) for s in (-1, 1)])
        for line in lines
    ]
    surfaces = [
        sides[0],
        sides[1],
        np.stack([sides[0][0], sides[1][0]]),
        np.stack([sides[0][1], sides[1][1]]),
    ]
    surfaces += [np.stack([sides[0][:, end], sides[1][:, end]]) for end in (0, -1)]
    return merge([_faceted(surface) for surface in surfaces])


def rod(start: npt.ArrayLike, end: npt.ArrayLike, radius: float, segments: int = 12) -> Mesh:
    """Return a round bar with flat ends."""
    return bars(np.array([[start, end]], float), radius, segments)


def bars(ends: Array, radius: float, segments: int = 8) -> Mesh:
    """Return round bars between pairs of points (K, 2, 3), with flat ends."""
    return merge(
        [
            merge(
                [
                    tube(pair, radius, segments),
                    *(_disc(pair[k], pair[1] - pair[0], radius, segments) for k in (0, 1)),
                ]
            )
            for pair in ends
        ]
    )


def post(start: npt.ArrayLike, end: npt.ArrayLike, width: float) -> Mesh:
    """Return a square bar."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    way = b - a
    length = float(np.linalg.norm(way))
    upright = np.array([0.0, 1.0, 0.0])
    axis = np.cross(upright, way)
    matrix = np.eye(4)
    if np.linalg.norm(axis) > 1e-9:
        matrix = transform(axis=axis, degrees=float(np.degrees(np.arccos(np.clip(way[1] / length, -1, 1)))))
    matrix[:3, 3] = (a + b) / 2
    return placed(block([width, length, width], (0, 0, 0), 0.012), matrix)


def _disc(centre: Array, normal: Array, radius: float, segments: int) -> Mesh:
    ends = np.stack([centre, centre + 1e-4 * normal / np.linalg.norm(normal)])
    return tube(ends, [radius, 0.0], segments)


def _facets(polygons: Sequence[Array]) -> Mesh:
    """Return convex polygons (3 or 4, 3) as triangles that share no vertices with their neighbours."""
    vertices = np.concatenate(polygons)
    starts = np.cumsum([0, *(len(polygon) for polygon in polygons)])
    faces = [
        [start, start + k, start + k + 1]
        for start, polygon in zip(starts, polygons, strict=False)
        for k in range(1, len(polygon) - 1)
    ]
    return Mesh(vertices, np.array(faces), np.full(vertices.shape, 0.5), np.zeros((len(vertices), 2)))


def _faceted(points: Array) -> Mesh:
    """Span a surface over points (R, C, 3) with an edge along every line between columns."""
    return _facets(
        [
            np.stack([points[r, c], points[r, c + 1], points[r + 1, c + 1], points[r + 1, c]])
            for r in range(points.shape[0] - 1)
            for c in range(points.shape[1] - 1)
        ]
    )


def drum(radius: float, width: float, centre: npt.ArrayLike, segments: int = 28, hub: float = 0.45) -> Mesh:
    """Return a wheel whose axle lies along z: tread, rim, web and hub."""
    r, w = radius, width / 2
    profile = [
        (0, -w * 1.1),
        (hub * r, -w * 1.1),
        (hub * r, -w * 0.5),
        (0.8 * r, -w * 0.5),
        (0.84 * r, -w),
        (r, -w),
    ]
    profile += [(a, -b) for a, b in reversed(profile)]
    wheel = revolve(profile, segments)
    points = wheel.vertices[:, [0, 2, 1]] * [1, -1, 1]
    flat = points.reshape(len(profile), segments, 3)
    # Rings that share no vertices have hard edges between them.
    return merge([grid(flat[k : k + 2], wrap=True) for k in range(len(profile) - 1)]).moved(centre)


def track(
    length: float, radius: float, width: float, z: float, links: int, phase: float
) -> tuple[Mesh, Mesh]:
    """Return a crawler track, and the wheels and the frame inside it."""
    flat = length - 2 * radius
    shoe = _shoe((2 * flat + 2 * np.pi * radius) / links, width)
    shoes = []
    for k in range(links):
        x, y, angle = _along_track((k + phase) / links, flat, radius)
        shoes.append(placed(shoe, transform([x, y + 0.04, z], axis=[0, 0, 1], degrees=angle)))
    inner = radius - 0.09
    wheels = [drum(inner, 0.42 * width, [x, radius + 0.04, z]) for x in (flat / 2, -flat / 2)]
    wheels += [
        drum(0.42 * radius, 0.5 * width, [x, 0.10 + 0.42 * radius + 0.04, z], 20)
        for x in np.linspace(-0.36, 0.36, 6) * length
    ]
    wheels += [
        drum(0.2 * radius, 0.4 * width, [x, 1.62 * radius, z], 16) for x in (-0.17 * length, 0.17 * length)
    ]
    frame = block([flat * 1.02, 0.55 * radius, 0.62 * width], [0, radius + 0.07, z], 0.03)
    step = [block([0.42, 0.03, 0.14], [x, radius + 0.18, z + np.sign(z) * 0.36 * width]) for x in (-0.4, 0.5)]
    return merge(shoes), merge([*wheels, frame, *step])


def _shoe(pitch: float, width: float) -> Mesh:
    """Return one link of a track: a plate with two cleats, and the chain's links on its inside."""
    return merge(
        [
            block([0.88 * pitch, 0.035, width], [0, 0.0175, 0], 0.008),
            block([0.05, 0.055, 0.97 * width], [-0.3 * pitch, -0.02, 0], 0.012),
            block([0.03, 0.035, 0.97 * width], [0.15 * pitch, -0.012, 0], 0.01),
            block([1.04 * pitch, 0.07, 0.05], [0, 0.065, 0.11 * width], 0.012),
            block([1.04 * pitch, 0.07, 0.05], [0, 0.065, -0.11 * width], 0.012),
        ]
    )


def _along_track(share: float, flat: float, radius: float) -> tuple[float, float, float]:
    """Return place (x, y) and turn in degrees at a share of the way round, from the ground's rear end on."""
    bend = np.pi * radius
    s = share * 2 * (flat + bend)
    if s < flat:
        return s - flat / 2, 0.0, 0.0
    if s < flat + bend:
        angle = (s - flat) / radius
        return flat / 2 + radius * np.sin(angle), radius * (1 - np.cos(angle)), float(np.degrees(angle))
    if s < 2 * flat + bend:
        x = flat / 2 - (s - flat - bend)
        sag = 0.035 * np.sin(np.pi * (x / flat + 0.5)) ** 2
        return x, 2 * radius - sag, 180.0
    angle = np.pi + (s - 2 * flat - bend) / radius
    return -flat / 2 + radius * np.sin(angle), radius * (1 - np.cos(angle)), float(np.degrees(angle))


def cylinder(start: npt.ArrayLike, end: npt.ArrayLike, radius: float, out: float = 0.45) -> tuple[Mesh, Mesh]:
    """Return a hydraulic cylinder's barrel and its rod, which is out by a share of the length."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    middle = b + (a - b) * out
    toward = (b - a) / np.linalg.norm(b - a)
    across = np.array([0, 0, 1.5 * radius])
    eyes = [rod(p - across, p + across, 1.25 * radius, 18) for p in (a, b)]
    barrel = merge(
        [rod(a, middle, radius, 20), rod(middle - 0.05 * toward, middle + 0.05 * toward, 1.18 * radius, 20)]
    )
    return merge([barrel, *eyes]), rod(middle, b, 0.52 * radius, 16)


def hose(points: npt.ArrayLike, radius: float = 0.016) -> Mesh:
    """Return a hose along a smooth curve through points (N, 3)."""
    knots = np.asarray(points, float)
    knots = np.concatenate([2 * knots[:1] - knots[1:2], knots, 2 * knots[-1:] - knots[-2:-1]])
    t = np.linspace(0, 1, 12, endpoint=False)[:, None]
    path = []
    for a, b, c, d in zip(knots[:-3], knots[1:-2], knots[2:-1], knots[3:], strict=True):
        path.append(
            0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
        )
    return tube(np.concatenate([*path, knots[-2:-1]]), radius, 8)


def railing(points: npt.ArrayLike, height: float, radius: float = 0.018) -> Mesh:
    """Return a railing with posts at points (N, 3), a hand rail and a knee rail."""
    feet = np.asarray(points, float)
    up = np.array([0, height, 0])
    pairs = [[foot, foot + up] for foot in feet]
    for level in (1.0, 0.52):
        pairs += [[a + level * up, b + level * up] for a, b in pairwise(feet)]
    return bars(np.array(pairs), radius, 10)


def cab(size: tuple[float, float, float], foot: tuple[float, float, float], paint: Array) -> Body:
    """Return a driver's cab: pillars and roof around dark glass, over a lower wall."""
    length, height, width = size
    x, y, z = foot
    wall, roof = 0.36 * height, 0.09
    top = y + height - roof
    front = x + length / 2
    lean = 0.16 * length  # of the front pillars
    pillars = []
    for side in (-1, 1):
        at = z + side * (width / 2 - 0.035)
        for low, high in ((front - 0.04, front - lean), (x + 0.02, x + 0.02)):
            pillars.append(post([low, y + wall, at], [high, top, at], 0.065))
        pillars.append(post([x - length / 2 + 0.04, y + wall, at], [x - length / 2 + 0.06, top, at], 0.065))
    glass = beam(
        [(x - length / 2 + 0.05, top), (front - lean - 0.03, top)],
        [(x - length / 2 + 0.04, y + wall - 0.02), (front - 0.06, y + wall - 0.02)],
        width - 0.09,
        z,
    )
    panels = [
        block([length, wall, width], [x, y + wall / 2, z], 0.035),
        block([length * 0.9, roof, width * 1.02], [x - 0.04 * length, top + roof / 2, z], 0.03),
        block([length * 0.5, 0.05, width * 0.55], [x - 0.08 * length, top + roof + 0.02, z], 0.015),
    ]
    lamps, mirrors = [], []
    for side in (-1, 1):
        lamp = np.array([x + length * 0.36, top + roof + 0.04, z + side * 0.25 * width])
        lamps.append(rod(lamp, lamp + np.array([0.07 * length, 0, 0]), 0.05, 16))
        mirror = np.array([front, top + 0.02, z + side * (width / 2 + 0.2)])
        mirrors.append(rod([front - lean, top, z + side * width / 2], mirror, 0.012, 8))
        mirrors.append(block([0.03, 0.2, 0.12], mirror - np.array([0, 0.09, 0]), 0.01))
    wiper = rod([front - 0.03, y + wall, z], [front - 0.1, y + wall + 0.42 * height, z + 0.12], 0.010, 6)
    return {
        "paint": [merge([*panels, *pillars]).painted(paint)],
        "dark": [glass.painted(GLASS), merge([*mirrors, wiper]).painted(BLACK)],
        "steel": [merge(lamps).painted(CHROME)],
    }


def joined(*bodies: Body) -> Body:
    """Return all meshes of bodies that move together as one."""
    result: Body = {}
    for body in bodies:
        for material, meshes in body.items():
            result.setdefault(material, []).extend(meshes)
    return result
