"""A crawler crane with a lattice boom, in bodies that may move apart from each other.

Its own axes: x forward, y up, the ground at y = 0, the middle of its tracks at the origin.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from scenes.geometry import Array, Mesh, merge, tube
from scenes.metalwork import (
    BLACK,
    HOSE,
    IRON,
    RUST,
    Body,
    bars,
    block,
    cab,
    drum,
    joined,
    railing,
    rod,
    track,
)

__all__ = ["CRANE_TIP", "crane"]

TEAL, CREAM = np.array([0.030, 0.20, 0.23]), np.array([0.62, 0.56, 0.42])
ORANGE = np.array([0.62, 0.15, 0.03])

CRANE_TIP = np.array([4.9, 3.45, 0.0])
"""Where the crane's ropes leave its boom."""


def crane() -> dict[str, Body]:
    """Return a crane's bodies: ``carrier``, which is all that drives, and ``load``, which hangs from it."""
    driver = cab((1.05, 1.35, 0.75), (0.72, 1.0, 0.68), TEAL)
    return {"carrier": joined(_base(), _house(), _rigging(), driver), "load": _load()}


def _base() -> Body:
    """Return the tracks, and what joins them."""
    steel, dark = [], []
    for side in (-1, 1):
        shoes, inside = track(3.4, 0.36, 0.52, side * 1.08, 50, 0.1)
        steel.append(shoes.painted(0.6 * IRON + 0.3 * RUST))
        dark.append(inside.painted([0.08, 0.08, 0.075]))
    base = merge([block([1.6, 0.24, 1.7], [0, 0.56, 0], 0.05), rod([0, 0.62, 0], [0, 0.86, 0], 0.62, 48)])
    return {"steel": steel, "dark": [*dark, base.painted([0.07, 0.07, 0.07])]}


def _house() -> Body:
    """Return platform, engine room, counterweight, railings, exhaust and winch."""
    panels = [
        block([3.2, 0.16, 2.0], [-0.45, 0.95, 0], 0.03),
        block([1.9, 1.02, 1.9], [-0.85, 1.54, 0], 0.06),
    ]
    panels += [
        block([0.55, 0.78, 0.03], [x, 1.5, s * 0.955], 0.012) for x in (-1.45, -0.85, -0.25) for s in (-1, 1)
    ]
    weight = [block([0.42, 0.30, 2.1], [-2.05, 1.10 + 0.32 * k, 0], 0.03) for k in range(3)]
    slats = [
        block([0.42, 0.02, 0.03], [x, y, s * 0.98], 0.005)
        for x in (-1.45, -0.25)
        for s in (-1, 1)
        for y in np.arange(1.5, 1.84, 0.05)
    ]
    decks = [railing([(x, 2.05, s * 0.9) for x in (-1.75, -1.2, -0.6, 0.02)], 0.42) for s in (-1, 1)]
    decks.append(railing([(-1.75, 2.05, z) for z in (-0.9, 0.0, 0.9)], 0.42))
    stack = [
        rod([-1.3, 2.0, 0.4], [-1.3, 2.5, 0.4], 0.07, 20),
        rod([-1.3, 2.1, 0.4], [-1.3, 2.36, 0.4], 0.11, 20),
    ]
    winch = [drum(0.30, 0.9, [0.28, 1.36, 0]), rod([0.28, 1.36, -0.5], [0.28, 1.36, 0.5], 0.24, 28)]
    return {
        "paint": [merge(panels).painted(TEAL)],
        "dark": [
            merge(weight).painted([0.09, 0.09, 0.09]),
            merge(slats).painted(HOSE),
            merge(decks).painted(BLACK),
        ],
        "steel": [merge(stack).painted(RUST), merge(winch).painted(0.6 * IRON)],
    }


def _rigging() -> Body:
    """Return the boom, the frame behind it, and the ropes that hold it."""
    mast = np.array([[[x, 2.05, s * 0.5], [-1.15, 3.25, s * 0.18]] for x in (-0.6, -1.7) for s in (-1, 1)])
    frame = merge([bars(mast, 0.045, 12), rod([-1.15, 3.25, -0.3], [-1.15, 3.25, 0.3], 0.07, 16)])
    ropes = [
        [[-1.15, 3.28, s * 0.12], CRANE_TIP + np.array([-0.12, 0.14, s * 0.10])] for s in (-1, -0.33, 0.33, 1)
    ]
    ropes += [[[0.28, 1.62, s * 0.06], CRANE_TIP + np.array([0.02, 0.16, s * 0.05])] for s in (-1, 1)]
    boom = _lattice(np.array([0.85, 1.15, 0.0]), CRANE_TIP)
    return {
        "paint": [boom.painted(CREAM), frame.painted(TEAL)],
        "dark": [bars(np.array(ropes, float), 0.011, 6).painted(HOSE)],
    }


def _lattice(foot: Array, tip: Array, bays: int = 13) -> Mesh:
    """Return a boom of four chords that taper at both ends, braced by diagonals, with sheaves at the tip."""
    along = (tip - foot) / np.linalg.norm(tip - foot)
    across = np.array([0.0, 0.0, 1.0])
    up = np.cross(across, along)
    t = np.linspace(0, 1, bays + 1)
    half = 0.30 * np.clip(np.minimum(t / 0.2, (1 - t) / 0.2), 0.16, 1)
    middle = foot + t[:, None] * (tip - foot)
    corners = np.stack(
        [
            middle + half[:, None] * (a * up + b * 1.05 * across)
            for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))
        ],
        axis=1,
    )
    chords = [tube(corners[:, k], 0.034, 10) for k in range(4)]
    braces = []
    for i in range(bays):
        for k in range(4):
            n = (k + 1) % 4
            first, second = (k, n) if (i + k) % 2 else (n, k)
            braces.append([corners[i, first], corners[i + 1, second]])
            braces.append([corners[i, k], corners[i, n]])
    wheels = [drum(0.17, 0.05, tip + np.array([0, 0, z]), 24, 0.3) for z in (-0.06, 0.0, 0.06)]
    return merge([*chords, bars(np.array(braces), 0.017, 8), *wheels])


def _load() -> Body:
    """Return the hoist ropes, the hook block, and a bundle of pipes in slings."""

    def below(y: float, x: float = 0.0, z: float = 0.0) -> Array:
        return np.asarray(CRANE_TIP + np.array([0.17 + x, y, z]))

    ropes = [[below(0, z=s * 0.06), below(-1.15, z=s * 0.06)] for s in (-1, 1)]
    hook = merge([block([0.16, 0.34, 0.16], below(-1.25), 0.03), rod(below(-1.45), below(-1.59), 0.03)])
    pipes, slings = [], []
    for y, z in ((0, -0.2), (0, 0), (0, 0.2), (0.17, -0.1), (0.17, 0.1), (0.34, 0)):
        path = np.array([below(y - 2.35, x, z) for x in (-1.15, 1.15)])
        pipes += [tube(path, 0.095, 20), tube(path, 0.075, 20)]
    for x in (-0.7, 0.7):
        around = ((-1.87, 0), (-2.33, 0.32), (-2.46, 0.2), (-2.46, -0.2), (-2.33, -0.32), (-1.87, 0))
        slings += list(pairwise([below(y, x, z) for y, z in around]))
        slings.append((below(-1.57), below(-1.87, x)))
    return {
        "dark": [
            bars(np.array(ropes), 0.013, 6).painted(HOSE),
            bars(np.array(slings), 0.014, 6).painted(HOSE),
        ],
        "steel": [merge(pipes).painted([0.30, 0.27, 0.24])],
        "paint": [hook.painted(ORANGE)],
    }
