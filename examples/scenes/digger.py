"""An excavator, in bodies that may move apart from each other.

Its own axes: x forward, y up, the ground at y = 0, the middle of its tracks at the origin.
"""

from __future__ import annotations

import numpy as np

from scenes.geometry import Array, Mesh, merge, tube
from scenes.metalwork import (
    BLACK,
    CHROME,
    HOSE,
    IRON,
    RUST,
    Body,
    bars,
    beam,
    block,
    cab,
    cylinder,
    hose,
    joined,
    placed,
    post,
    railing,
    rod,
    track,
    transform,
)

__all__ = ["BUCKET_PIN", "excavator"]

Line = list[tuple[float, float]]
"""Points of the side view."""

YELLOW, RED = np.array([0.78, 0.40, 0.030]), np.array([0.50, 0.03, 0.02])

BUCKET_PIN = np.array([3.92, 1.02, 0.0])
"""Where the excavator's bucket hangs, about an axis along z."""


def excavator() -> dict[str, Body]:
    """Return an excavator's bodies: ``base`` (tracks), ``house``, ``arm`` (boom and stick) and ``bucket``."""
    return {"base": _base(), "house": _house(), "arm": _arm(), "bucket": _bucket()}


def _base() -> Body:
    """Return the tracks, and what joins them."""
    steel, dark = [], []
    for side in (-1, 1):
        shoes, inside = track(3.2, 0.37, 0.56, side * 1.0, 46, 0.3)
        steel.append(shoes.painted(0.55 * IRON + 0.35 * RUST))
        dark.append(inside.painted([0.085, 0.08, 0.075]))
    centre = merge([block([1.5, 0.26, 1.5], [0, 0.58, 0], 0.05), rod([0, 0.66, 0], [0, 0.86, 0], 0.62, 48)])
    return {"steel": steel, "dark": [*dark, centre.painted([0.07, 0.065, 0.06])]}


def _house() -> Body:
    """Return what turns on the tracks: platform, engine, counterweight, cab, and the boom's lugs."""
    panels = [
        block([2.9, 0.16, 2.1], [-0.28, 0.96, 0], 0.03),
        block([1.25, 0.86, 1.98], [-0.92, 1.45, 0], 0.07),
        block([0.9, 0.42, 0.62], [0.30, 1.24, -0.72], 0.05),
        block([0.62, 0.28, 0.5], [-0.55, 1.98, -0.45], 0.05),
        *(block([0.5, 0.62, 0.06], [0.62, 1.30, z], 0.02) for z in (-0.22, 0.22)),
    ]
    weight = beam(
        [(-1.5, 1.82), (-1.72, 1.78), (-1.92, 1.62)], [(-1.5, 0.94), (-1.72, 0.96), (-1.92, 1.10)], 2.06
    )
    stripe = block([0.02, 0.16, 1.9], [-1.935, 1.36, 0], 0.004)
    hoses = [
        hose([(0.1, 1.12, z), (0.35, 1.52, z), (0.62, 1.62, z), (0.95, 1.84, z)], 0.022)
        for z in (-0.10, -0.05, 0.0, 0.05, 0.10)
    ]
    lifts = [cylinder((1.02, 1.10, z), (1.72, 2.42, z), 0.085, 0.5) for z in (-0.30, 0.30)]
    body: Body = {
        "paint": [
            merge([*panels, *(barrel for barrel, _ in lifts)]).painted(YELLOW),
            stripe.painted(RED),
        ],
        "dark": [weight.painted([0.055, 0.055, 0.06]), merge(hoses).painted(HOSE)],
        "steel": [merge([piston for _, piston in lifts]).painted(CHROME)],
    }
    return joined(body, _engine_deck(), cab((1.15, 1.30, 0.78), (0.50, 1.04, 0.66), YELLOW))


def _engine_deck() -> Body:
    """Return grilles, railings, a ladder, the exhaust and the air cleaner."""
    slats = [
        block([0.5, 0.022, 0.03], [-0.95, y, z], 0.006)
        for z in (1.0, -1.0)
        for y in np.arange(1.20, 1.76, 0.06)
    ]
    slats += [block([0.022, 0.02, 0.9], [x, 1.89, 0.35], 0.005) for x in np.arange(-1.35, -0.75, 0.055)]
    decks = [
        railing([(-1.42, 1.88, 0.92), (-0.9, 1.88, 0.92), (-0.36, 1.88, 0.92)], 0.42),
        railing(
            [(-1.42, 1.88, -0.92), (-0.9, 1.88, -0.92), (-0.36, 1.88, -0.92), (-0.36, 1.88, -0.35)], 0.42
        ),
    ]
    ladder = [[[0.62, y, -1.04], [0.34, y, -1.04]] for y in (0.70, 0.90, 1.10)]
    ladder += [[[x, 0.62, -1.04], [x, 1.9, -1.02]] for x in (0.62, 0.34)]
    bend = [[-0.62, 2.38, 0.62], [-0.63, 2.47, 0.62], [-0.70, 2.54, 0.62], [-0.80, 2.56, 0.62]]
    exhaust = [
        rod([-0.62, 1.85, 0.62], [-0.62, 2.38, 0.62], 0.065, 24),
        tube(np.array(bend), 0.045, 16),
        rod([-0.62, 1.98, 0.62], [-0.62, 2.24, 0.62], 0.10, 24),
    ]
    cleaner = [
        rod([-0.22, 1.86, 0.30], [-0.22, 2.10, 0.30], 0.11, 24),
        rod([-0.22, 2.10, 0.30], [-0.22, 2.16, 0.30], 0.15, 24),
    ]
    return {
        "dark": [
            merge(slats).painted(HOSE),
            merge([*decks, bars(np.array(ladder), 0.018)]).painted(BLACK),
        ],
        "steel": [merge(exhaust).painted(0.8 * RUST), merge(cleaner).painted(0.5 * CHROME)],
    }


def _arm() -> Body:
    """Return the boom, which bends like a goose's neck, the stick, and what drives and feeds them."""
    top = [(0.60, 1.52), (0.98, 2.30), (1.50, 2.98), (2.05, 3.20), (2.75, 3.14), (3.48, 2.95)]
    low = [(0.82, 1.34), (1.22, 1.98), (1.72, 2.52), (2.16, 2.74), (2.75, 2.78), (3.40, 2.75)]
    boom = [beam(top, low, 0.30), *_flanges(top, low, (0, 0.012), (0, 0.014), 0.37)]
    boom += [
        rod([x, y, -0.24], [x, y, 0.24], r, 24)
        for x, y, r in ((0.72, 1.42, 0.13), (3.42, 2.86, 0.10), (1.72, 2.46, 0.09), (2.02, 3.16, 0.09))
    ]
    boom += [
        beam([(1.86, 3.14), (2.0, 3.32), (2.2, 3.16)], [(1.86, 3.1), (2.0, 3.1), (2.2, 3.1)], 0.04, z)
        for z in (-0.1, 0.1)
    ]
    top = [(3.02, 3.30), (3.40, 3.14), (3.68, 2.5), (4.02, 1.16)]
    low = [(2.94, 3.12), (3.22, 2.72), (3.44, 2.2), (3.80, 0.98)]
    stick = [beam(top, low, 0.24), *_flanges(top, low, (0.01, 0.01), (0.012, 0.012), 0.30)]
    stick.append(rod([3.90, 1.06, -0.2], [3.90, 1.06, 0.2], 0.085, 20))
    stick.append(rod([3.78, 1.62, -0.17], [3.78, 1.62, 0.17], 0.06, 20))
    crowd = cylinder((2.02, 3.26, 0), (3.0, 3.24, 0), 0.085, 0.42)
    curl = cylinder((3.32, 3.05, 0), (4.20, 1.66, 0), 0.075, 0.40)
    links = [post([3.78, 1.62, z], [4.20, 1.66, z], 0.05) for z in (-0.15, 0.15)]
    links += [post([4.20, 1.66, z], [4.22, 1.22, z], 0.05) for z in (-0.11, 0.11)]
    lamps = [block([0.09, 0.09, 0.12], [1.52, 2.48, z], 0.01) for z in (-0.22, 0.22)]
    return {
        "paint": [merge([*boom, *stick, crowd[0], curl[0]]).painted(YELLOW)],
        "dark": [merge([*_hoses(), *links, *lamps]).painted(HOSE)],
        "steel": [merge([crowd[1], curl[1]]).painted(CHROME), _pipes().painted(0.5 * CHROME)],
    }


def _flanges(
    top: Line, low: Line, out: tuple[float, float], half: tuple[float, float], width: float
) -> list[Mesh]:
    """Return plates along the top and the bottom of a beam, wider than the beam is."""
    flanges = []
    for line, sign in ((top, 1), (low, -1)):
        rim = np.array(line) + sign * np.array(out)
        flanges.append(beam(rim + np.array(half), rim - np.array(half), width))
    return flanges


def _hoses() -> list[Mesh]:
    """Return hydraulic hoses that hang loose along the boom."""
    path = [(0.95, 1.84), (1.28, 2.52), (1.75, 3.14), (2.1, 3.40), (2.7, 3.34), (3.05, 3.48)]
    end = [(3.30, 3.32), (3.50, 2.95)]
    hoses = []
    for z, slack in ((-0.09, 0.0), (-0.03, 0.05), (0.03, 0.02), (0.09, 0.06)):
        points = [(x, y + (slack if k else 0), z) for k, (x, y) in enumerate(path)]
        hoses.append(hose([*points, *((x, y, z) for x, y in end)], 0.02))
    return hoses


def _pipes() -> Mesh:
    """Return steel pipes on the boom."""
    bends = [[(1.55, 3.03), (2.05, 3.25)], [(2.05, 3.25), (2.75, 3.19)]]
    pairs = [[(x, y, z) for x, y in pair] for z in (-0.14, 0.14) for pair in bends]
    return bars(np.array(pairs), 0.018)


def _bucket() -> Body:
    """Return the bucket: a curved sheet between two cheeks, with a lip, teeth and ribs."""
    angle = np.linspace(np.radians(62), np.radians(262), 15)
    curve = np.column_stack([0.30 + 0.46 * np.cos(angle), -0.26 + 0.46 * np.sin(angle)])
    curve = np.concatenate([[[0.62, 0.16]], curve, [[0.56, -0.70]]])
    inner = curve + 0.03 * _inward(curve)
    width = 0.92
    sheet = beam(curve, inner, width)
    mouth = np.column_stack([np.linspace(0.62, 0.56, len(curve)), np.linspace(0.16, -0.70, len(curve))])
    cheeks = [beam(curve, 0.06 * curve + 0.94 * mouth, 0.03, z) for z in (-width / 2, width / 2)]
    ribs = [beam(curve - 0.022 * _inward(curve), curve, 0.07, z) for z in (-0.3, 0.0, 0.3)]
    lip = block([0.05, 0.14, width + 0.04], [0.58, -0.70, 0], 0.012)
    teeth = []
    for z in np.linspace(-0.42, 0.42, 6):
        tooth = beam(
            [(0.52, -0.62), (0.55, -0.84), (0.60, -0.96)],
            [(0.64, -0.62), (0.64, -0.82), (0.62, -0.96)],
            0.085,
            float(z),
        )
        teeth.append(tooth)
    ears = [
        beam(
            [(-0.10, 0.10), (0.05, 0.14), (0.34, 0.26)], [(-0.06, -0.12), (0.1, -0.06), (0.34, 0.0)], 0.045, z
        )
        for z in (-0.15, 0.15)
    ]
    pins = [rod([x, y, -0.2], [x, y, 0.2], 0.045, 16) for x, y in ((0.0, 0.03), (0.28, 0.18))]
    at = transform(BUCKET_PIN, axis=[0, 0, 1], degrees=-38)
    return {
        "paint": [placed(merge([sheet, *cheeks, *ribs]), at).painted(0.55 * YELLOW + 0.05)],
        "steel": [
            placed(merge([lip, *teeth]), at).painted(0.55 * CHROME),
            placed(merge([*ears, *pins]), at).painted(IRON),
        ],
    }


def _inward(curve: Array) -> Array:
    """Return unit normals (N, 2) of a curve."""
    along = np.gradient(curve, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(np.column_stack([-along[:, 1], along[:, 0]]))
