"""Pinhole views from points of the lens, and what lies behind them, against planes of known place."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fewrays import SampleError
from fewrays.sources.mitsuba_views import PinholeViews

WIDTH, HEIGHT = 48, 32
CARD, WALL, FOCUS = 2.0, 5.0, 4.0


def planes(mi: ModuleType, closed: bool = False, kind: str = "thinlens") -> Any:
    """A glowing card, or a dark box with a glowing front, before a glowing wall, seen along z."""
    at = mi.ScalarTransform4f
    lens = {"aperture_radius": 0.2, "focus_distance": FOCUS} if kind == "thinlens" else {}
    content: dict[str, Any] = {
        "integrator": {"type": "path", "max_depth": 1},
        "sensor": {
            "type": kind,
            "fov": 60,
            "to_world": at().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
            **lens,
        },
    }
    for name, z, size, radiance in (("card", CARD, 0.4, 1.0), ("wall", WALL, 30.0, 0.25)):
        content[name] = {
            "type": "rectangle",
            "to_world": at().translate([0.05 * (name == "card"), 0, z]).rotate([0, 1, 0], 180).scale(size),
            "emitter": {"type": "area", "radiance": radiance},
        }
    if closed:
        content["back"] = {"type": "rectangle", "to_world": at().translate([0, 0, 3]).scale(3.0)}
    return mi.load_dict({"type": "scene", **content})


def centroid(weights: Any) -> Any:
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return np.array([(x * weights).sum(), (y * weights).sum()]) / weights.sum()


@pytest.mark.parametrize("uv", [(0.8, 0.0), (0.0, -0.6), (-0.5, 0.7)])
@pytest.mark.parametrize("kind", ["thinlens", "perspective"])
def test_views_see_surfaces_move_by_their_slope(mi: ModuleType, uv: tuple[float, float], kind: str) -> None:
    lens: dict[str, Any] = {"lens_radius": 0.2, "focus_distance": FOCUS} if kind == "perspective" else {}
    views = PinholeViews(planes(mi, kind=kind), spp=64, **lens)
    centre, moved = (centroid(views.view(point)[..., 0] - 0.25) for point in ((0.0, 0.0), uv))
    slope = float(views.lens.slope(CARD))
    assert slope < -1.5
    np.testing.assert_allclose(moved - centre, slope * np.array(uv), atol=0.02)


def test_layers_lie_behind_each_other(mi: ModuleType) -> None:
    front, behind = PinholeViews(planes(mi), spp=16).layers()
    card = front.depth < 3
    assert 0.05 < card.mean() < 0.5
    np.testing.assert_allclose(front.depth, np.where(card, CARD, WALL), rtol=1e-5)
    np.testing.assert_allclose(behind.depth[card], WALL, rtol=1e-5)
    assert np.isinf(behind.depth[~card]).all()
    np.testing.assert_allclose(behind.color[card], 0.25, rtol=1e-5)
    mixed = (front.color[..., 0] > 0.26) & (front.color[..., 0] < 0.99)
    assert 0 < mixed.mean() < 0.1  # colours are antialiased where depths are not


def test_the_inside_of_closed_things_is_passed(mi: ModuleType) -> None:
    front, behind = PinholeViews(planes(mi, closed=True), spp=16).layers()
    card = front.depth < 2.5
    np.testing.assert_allclose(behind.depth[card], WALL, rtol=1e-5)
    np.testing.assert_allclose(behind.color[card], 0.25, rtol=1e-5)


def test_values_out_of_range(mi: ModuleType) -> None:
    with pytest.raises(SampleError, match="spp"):
        PinholeViews(planes(mi), spp=0)
    with pytest.raises(SampleError, match="separation"):
        PinholeViews(planes(mi), spp=1).layers(separation=0)
