"""A building site: uneven earth with heaps and the tracks of machines, and what lies about on it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from scenes.geometry import Array, Mesh, fractal_noise, grid, merge, revolve, scatter
from scenes.metalwork import Body, bars, block, placed, rod, transform

__all__ = ["debris", "ground"]

_HEAPS = ((-3.1, -1.6, 1.25, 0.75), (-4.3, -0.6, 1.0, 0.45), (6.2, 7.5, 2.2, 1.1))
"""Heaps of earth: x, z, size and height."""

BRICK, WOOD = np.array([0.36, 0.12, 0.07]), np.array([0.40, 0.29, 0.17])
BLUE, RUSTY, ORANGE = np.array([0.05, 0.13, 0.26]), np.array([0.30, 0.14, 0.06]), np.array([0.62, 0.15, 0.03])


def ground(machines: Sequence[tuple[Array, float]]) -> Mesh:
    """Return the earth, with the tracks that machines have left and a bank at the far end.

    Parameters
    ----------
    machines : sequence of (ndarray, float)
        Where each machine stands, as a 4 x 4 matrix from its own axes, and half the distance of its tracks.
    """
    x, z = np.meshgrid(np.linspace(-16, 16, 900), np.linspace(-9, 26, 900))
    points = np.stack([x, 0 * x, z], -1)
    rough = fractal_noise(points * 0.55, octaves=4, seed=3)
    fine = fractal_noise(points * 6.0, octaves=3, seed=8)
    height = 0.05 * rough + 0.012 * fine + _heaps(x, z, 1 + 0.18 * rough) * (1 + 0.12 * fine)
    bank = np.clip((z + 0.15 * x - 13.5 + 2.5 * fractal_noise(points * 0.16, octaves=2, seed=21)) / 6.0, 0, 1)
    height += 4.6 * bank**2 * (3 - 2 * bank) + bank * (0.35 * rough + 0.05 * fine)
    trodden = np.zeros(x.shape, bool)
    for place, gauge in machines:
        ahead, _, across = np.moveaxis((points - place[:3, 3]) @ place[:3, :3], -1, 0)
        lane = (np.abs(np.abs(across) - gauge) < 0.29) & (ahead > -9) & (ahead < 1.8)
        cleats = 0.02 * (np.abs((ahead / 0.155) % 1 - 0.5) < 0.22)
        height = np.where(lane, np.minimum(height, 0.02) * 0.3 - 0.035 - cleats, height)
        trodden |= lane
    points[..., 1] = height
    tone = 0.5 + 0.5 * np.clip(1.3 * rough + 0.3 * fine, -1, 1)[..., None]
    color = np.array([0.27, 0.205, 0.15]) * (1 - tone) + np.array([0.46, 0.385, 0.30]) * tone
    color *= (1 + 0.16 * fine)[..., None] * np.where(trodden[..., None], 0.82, 1.0)
    return grid(points).painted(np.clip(color, 0.02, 0.9).reshape(-1, 3))


def debris() -> Body:
    """Return stones, bricks, planks, drums, cones, pipes and barriers; what is matte is ``earth``."""
    rng = np.random.default_rng(12)
    return {
        "earth": [_stones(rng), _bricks(rng), _pipes()],
        "paint": [_drums(), _cones()],
        "steel": [_barriers()],
    }


def _heaps(x: Array, z: Array, stretch: npt.ArrayLike = 1.0) -> Array:
    """Return the height of the heaps at places, whose distance from the middle is stretched by a factor."""
    total = np.zeros_like(x)
    for cx, cz, size, tall in _HEAPS:
        total += tall * np.exp(-1.6 * (np.hypot(x - cx, z - cz) / size * np.asarray(stretch)) ** 2)
    return total


def _stones(rng: np.random.Generator) -> Mesh:
    turn = np.linspace(0, np.pi, 9)
    ball = revolve(np.column_stack([np.sin(turn), -np.cos(turn)]), 12)
    lumps = 1 + 0.35 * fractal_noise(ball.vertices * 1.4, octaves=2, seed=5)[:, None]
    stone = Mesh(ball.vertices * lumps * [1, 0.7, 1], ball.faces, np.ones_like(ball.vertices), ball.uv)
    strewn, heaped = 420, 220
    at = np.column_stack([rng.uniform(-9, 9, strewn), np.zeros(strewn), rng.uniform(-5, 14, strewn)])
    at = np.concatenate([at, rng.normal([-3.2, 0, -1.7], [0.85, 0, 0.75], (heaped, 3))])
    size = np.concatenate(
        [rng.pareto(2.6, strewn).clip(0, 3) * 0.05 + 0.025, rng.uniform(0.03, 0.12, heaped)]
    )
    at[:, 1] = _heaps(at[:, 0], at[:, 2]) + 0.25 * size
    angle = rng.uniform(0, 2 * np.pi, len(at))
    axes = np.zeros((len(at), 3, 3))
    axes[:, 0, 0] = axes[:, 2, 2] = np.cos(angle)
    axes[:, 0, 2], axes[:, 2, 0] = np.sin(angle), -np.sin(angle)
    axes[:, 1, 1] = 1
    tone = rng.uniform(0.7, 1.3, (len(at), 1)) * [0.34, 0.30, 0.26]
    return scatter(stone, at, axes, size, tone)


def _bricks(rng: np.random.Generator) -> Mesh:
    """Stack bricks on a pallet, with some fallen off; planks lie beside it."""
    brick = block([0.285, 0.092, 0.135], (0, 0, 0), 0.008)
    parts = []
    for layer in range(4):
        for row in range(5):
            for column in range(3 if layer < 3 else 2):
                centre = [0.30 * column - 0.3, 0.16 + 0.1 * layer, 0.145 * row - 0.29]
                lie = transform(centre, degrees=float(rng.normal(0, 2)))
                parts.append(placed(brick, lie).painted(BRICK * rng.uniform(0.75, 1.3)))
    for x, z, angle in ((0.75, 0.3, 20), (0.62, -0.35, 75), (-0.75, 0.42, 130), (0.95, -0.05, 50)):
        parts.append(placed(brick, transform([x, 0.055, z], degrees=angle)).painted(BRICK * 1.1))
    parts += [block([1.1, 0.02, 0.12], [0, 0.1, z], 0.004).painted(WOOD) for z in np.linspace(-0.38, 0.38, 5)]
    parts += [block([0.1, 0.08, 0.88], [x, 0.045, 0], 0.004).painted(0.8 * WOOD) for x in (-0.48, 0, 0.48)]
    plank = block([2.1, 0.045, 0.2], (0, 0, 0), 0.006)
    for k in range(5):
        shift = [0.12 * k - 0.2, 0.04 + 0.05 * k, 0.95 + 0.07 * (k % 3)]
        lie = transform(shift, degrees=-14 + 5.0 * (k % 3) - 2 * k)
        parts.append(placed(plank, lie).painted(WOOD * rng.uniform(0.8, 1.25)))
    return placed(merge(parts), transform([0.3, 0.0, -1.95], degrees=24))


def _pipes() -> Mesh:
    """Return a stack of concrete pipes between stakes."""
    ring = [(0.30, -1.1), (0.30, 1.1), (0.235, 1.1), (0.235, -1.1), (0.30, -1.1)]
    edges = [revolve(pair, 48) for pair in pairwise(ring)]
    pipe = placed(merge(edges), transform(axis=[0, 0, 1], degrees=90)).painted([0.40, 0.39, 0.37])
    rows = [(0, k) for k in range(4)] + [(1, k) for k in range(3)] + [(2, k) for k in range(2)]
    parts = [pipe.moved([0.03 * ((3 * k + n) % 3), 0.30 + 0.52 * n, 0.6 * k + 0.3 * n]) for n, k in rows]
    parts += [
        rod([x, 0, z], [x, 0.75, z], 0.03).painted([0.2, 0.2, 0.2])
        for x in (-0.7, 0.7)
        for z in (-0.36, 2.16)
    ]
    return placed(merge(parts), transform([5.6, 0, 4.4], degrees=-20))


def _drums() -> Mesh:
    """Return oil drums."""
    wall = [(0.29, 0.05), (0.29, 0.28), (0.305, 0.30), (0.29, 0.32), (0.29, 0.56), (0.305, 0.58)]
    rim = [(0.29, 0.60), (0.29, 0.84), (0.30, 0.87), (0.28, 0.88), (0.27, 0.86), (0, 0.86)]
    drum = revolve([(0, 0), (0.29, 0), (0.30, 0.02), *wall, *rim], 40)
    lying = placed(drum, transform([0.0, 0.30, 0.0], axis=[0, 0, 1], degrees=90))
    return merge(
        [
            drum.painted(BLUE).moved([5.0, 0, 0.6]),
            drum.painted(RUSTY).moved([5.65, 0, 0.95]),
            drum.painted(0.8 * BLUE).moved([5.2, 0, 1.3]),
            lying.painted(RUSTY * 1.2).moved([5.1, 0, -0.35], turn=0.5),
        ]
    )


def _cones() -> Mesh:
    """Return traffic cones."""
    cone = revolve([(0.0, 0.60), (0.03, 0.60), (0.155, 0.03), (0.155, 0.0)], 36)
    body = merge([cone, block([0.42, 0.035, 0.42], [0, 0.018, 0], 0.01)]).painted(ORANGE)
    band = revolve([(0.083, 0.36), (0.108, 0.25)], 36).painted([0.75, 0.75, 0.72])
    marker = merge([body, band.moved([0, 0, 0], scale=[1.03, 1, 1.03])])
    return merge([marker.moved([x, 0.0, z]) for x, z in ((-3.3, 1.9), (-1.2, 5.6), (4.2, -1.9))])


def _barriers() -> Mesh:
    """Return a row of barriers of upright bars, whose shadows are as fine as they are."""
    upright = [[[x, 0.16, 0], [x, 0.98, 0]] for x in np.linspace(-0.72, 0.72, 13)]
    frame = [[[-0.8, y, 0], [0.8, y, 0]] for y in (0.16, 0.98)]
    frame += [[[x, 0.0, 0], [x, 1.02, 0]] for x in (-0.8, 0.8)]
    frame += [[[x, 0.03, -0.25], [x, 0.03, 0.25]] for x in (-0.7, 0.7)]
    panel = merge([bars(np.array(upright), 0.013, 8), bars(np.array(frame), 0.024, 10)])
    row = [
        placed(panel, transform([x, 0.0, z], degrees=angle))
        for x, z, angle in ((-2.0, 4.9, 12), (-3.62, 4.35, 24), (-5.1, 3.5, 34), (-6.5, 2.55, 30))
    ]
    return merge(row).painted([0.55, 0.56, 0.58])
