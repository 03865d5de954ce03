"""Meshes made of NumPy arrays, and their way into Mitsuba.

Builders return a `Mesh`; `merge` joins thousands of them into one, each with its own vertex colours, which
traces faster than as many instances. y is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = [
    "Mesh",
    "bitmap",
    "box",
    "fractal_noise",
    "frames",
    "grid",
    "merge",
    "revolve",
    "scatter",
    "to_mitsuba",
    "tube",
]

Array = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Mesh:
    """Triangles with a colour and texture coordinates at each vertex.

    Parameters
    ----------
    vertices : ndarray, (N, 3)
        Positions.
    faces : ndarray, (M, 3)
        Vertex numbers of the triangles.
    colors : ndarray, (N, 3)
        Reflectance, linear RGB.
    uv : ndarray, (N, 2)
        Texture coordinates.
    """

    vertices: Array
    faces: Faces
    colors: Array
    uv: Array

    def painted(self, color: npt.ArrayLike) -> Mesh:
        """Return the mesh in a colour, or in one colour per vertex."""
        return Mesh(
            self.vertices, self.faces, np.broadcast_to(color, self.vertices.shape).astype(float), self.uv
        )

    def moved(self, offset: npt.ArrayLike, *, scale: npt.ArrayLike = 1.0, turn: float = 0.0) -> Mesh:
        """Return the mesh scaled, turned about the y axis by an angle in radians, then shifted."""
        cos, sin = np.cos(turn), np.sin(turn)
        rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
        vertices = (self.vertices * np.asarray(scale, float)) @ rotation.T + np.asarray(offset, float)
        return Mesh(vertices, self.faces, self.colors, self.uv)


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        np.concatenate([mesh.colors for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
    )


def grid(points: Array, *, wrap: bool = False) -> Mesh:
    """Span a surface over points (R, C, 3); `wrap` closes each row into a ring."""
    rows, columns = points.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(number, -1, axis=1) if wrap else number[:, 1:]
    left = number if wrap else number[:, :-1]
    a, b, c, d = left[:-1], right[:-1], left[1:], right[1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns, endpoint=not wrap), indexing="ij")
    vertices = points.reshape(-1, 3)
    return Mesh(vertices, faces, np.full(vertices.shape, 0.5), np.stack([u, v], -1).reshape(-1, 2))


def revolve(profile: npt.ArrayLike, segments: int = 48) -> Mesh:
    """Turn a profile of (radius, height) pairs about the y axis."""
    radius, height = np.asarray(profile, float).T[:, :, None]
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    points = np.stack(
        [radius * np.cos(angle), np.broadcast_to(height, (len(height), segments)), -radius * np.sin(angle)],
        -1,
    )
    return grid(points, wrap=True)


def tube(path: Array, radius: npt.ArrayLike, segments: int = 12) -> Mesh:
    """Sweep a circle along a path (N, 3), with one radius or one at each point."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = _perpendicular(along)
    up = np.cross(along, side)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)[None, :, None]
    around = np.cos(angle) * side[:, None] - np.sin(angle) * up[:, None]
    radii = np.broadcast_to(np.asarray(radius, float), len(path))[:, None, None]
    return grid(path[:, None] + radii * around, wrap=True)


def box(size: npt.ArrayLike, centre: npt.ArrayLike = (0, 0, 0)) -> Mesh:
    """Return a box with hard edges: its faces share no vertices."""
    sides = []
    for axis in range(3):
        for sign in (-1, 1):
            s, t = np.meshgrid([-0.5, 0.5], [-0.5, 0.5])
            points = np.empty((2, 2, 3))
            points[..., axis] = 0.5 * sign
            points[..., (axis + 1) % 3] = s * sign
            points[..., (axis + 2) % 3] = t
            sides.append(grid(points))
    return merge(sides).moved(centre, scale=size)


def scatter(mesh: Mesh, positions: Array, axes: Array, scales: Array, colors: Array) -> Mesh:
    """Place copies of a mesh, all in one array operation.

    Parameters
    ----------
    mesh : Mesh
        The model; its colours tint those of the copies.
    positions : ndarray, (K, 3)
        Where each copy's origin goes.
    axes : ndarray, (K, 3, 3)
        Where each copy's x, y and z axes point, one per row.
    scales : ndarray, (K,)
        Sizes.
    colors : ndarray, (K, 3)
        Colours, multiplied with the model's.
    """
    count, size = len(positions), len(mesh.vertices)
    vertices = positions[:, None] + scales[:, None, None] * (mesh.vertices @ axes)
    faces = mesh.faces + size * np.arange(count)[:, None, None]
    return Mesh(
        vertices.reshape(-1, 3),
        faces.reshape(-1, 3),
        (colors[:, None] * mesh.colors).reshape(-1, 3),
        np.tile(mesh.uv, (count, 1)),
    )


def frames(forward: Array, up: Array) -> Array:
    """Return axes (K, 3, 3) whose y points along `forward` and whose z points near `up`, both (K, 3)."""
    y = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    x = np.cross(y, up)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def fractal_noise(points: Array, *, octaves: int = 5, gain: float = 0.5, seed: int = 0) -> Array:
    """Sum octaves of smooth value noise at points (..., 3); each octave lies in [-1, 1] times its gain."""
    total = np.zeros(points.shape[:-1])
    for octave in range(octaves):
        total += gain**octave * _value_noise(points * 2.0**octave, seed + 101 * octave)
    return total


def bitmap(pixels: npt.ArrayLike) -> dict[str, Any]:
    """Return a texture from linear RGB pixels (H, W, 3)."""
    import mitsuba as mi

    return {"type": "bitmap", "bitmap": mi.Bitmap(np.asarray(pixels, np.float32)), "raw": True}


def to_mitsuba(mesh: Mesh, bsdf: dict[str, Any], *, smooth: bool = True) -> Any:
    """Return a Mitsuba mesh with that BSDF; its colours are the attribute ``vertex_color``."""
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    result = mi.Mesh(
        "mesh",
        vertex_count=len(mesh.vertices),
        face_count=len(mesh.faces),
        has_vertex_normals=smooth,
        has_vertex_texcoords=True,
        props=properties,
    )
    result.add_attribute("vertex_color", 3, mesh.colors.ravel().tolist())
    parameters = mi.traverse(result)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters["vertex_texcoords"] = mesh.uv.astype(np.float32).ravel()
    if smooth:
        parameters["vertex_normals"] = _normals(mesh).astype(np.float32).ravel()
    parameters.update()
    return result


def _normals(mesh: Mesh) -> Array:
    corners = mesh.vertices[mesh.faces]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.vertices)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(mesh.faces[:, corner], face[:, axis], len(normals))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    return normals


def _perpendicular(along: Array) -> Array:
    """Carry a perpendicular along a path without twisting it."""
    side = np.empty_like(along)
    start = np.cross(along[0], [0.0, 1.0, 0.0] if abs(along[0, 1]) < 0.9 else [1.0, 0.0, 0.0])
    for i, direction in enumerate(along):
        start = start - direction * (start @ direction)
        start /= np.linalg.norm(start)
        side[i] = start
    return side


def _value_noise(points: Array, seed: int) -> Array:
    cell = np.floor(points).astype(np.int64)
    t = points - cell
    t = t * t * t * (t * (6 * t - 15) + 10)
    total = np.zeros(points.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, t, 1 - t), axis=-1)
        total += weight * _lattice(cell + corner, seed)
    return total


def _lattice(cell: npt.NDArray[np.int64], seed: int) -> Array:
    mixed = (
        (cell[..., 0] * 73856093)
        ^ (cell[..., 1] * 19349663)
        ^ (cell[..., 2] * 83492791)
        ^ (seed * 2654435761)
    )
    mixed &= 0xFFFFFFFF
    for multiplier in (0x45D9F3B, 0x45D9F3B):
        mixed = ((mixed ^ (mixed >> 16)) * multiplier) & 0xFFFFFFFF
    result: Array = (mixed ^ (mixed >> 16)) / 2.0**31 - 1.0
    return result
