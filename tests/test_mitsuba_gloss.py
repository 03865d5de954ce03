"""Bandwidths of Mitsuba's surfaces: against lobes that it renders, for each material, for each hit."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fewrays import SampleBuffer
from fewrays.sources.mitsuba import render
from fewrays.sources.mitsuba_gloss import LEAST_BANDWIDTH, REFRACTED, SHARE

DEPTH, LENS_RADIUS = 2.0, 0.1
ROUGH = {"type": "roughconductor", "distribution": "beckmann", "alpha": 0.02}


def world(mi: ModuleType, *, fov: float = 30.0, **parts: Any) -> dict[str, Any]:
    """Return a scene whose camera looks along z from the origin, with light that shines along z as well."""
    return {
        "type": "scene",
        "integrator": {"type": "direct", "bsdf_samples": 0},
        "sensor": {
            "type": "perspective",
            "fov": fov,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 12, "height": 8},
        },
        "sun": {"type": "directional", "direction": [0, 0, 1]},
        **parts,
    }


def facing(mi: ModuleType, bsdf: dict[str, Any], depth: float = DEPTH, left: float = 0.0) -> dict[str, Any]:
    """Return a square of side 2 that faces the camera, shifted to the left of the image."""
    place = mi.ScalarTransform4f().translate([left, 0, depth]).rotate([0, 1, 0], 180)
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def trace(scene: Any, **options: Any) -> SampleBuffer:
    lens = {"lens_radius": LENS_RADIUS, "focus_distance": DEPTH}
    return render(scene, **{"spp": 4, "shading_spp": 1, "bandwidth": True, **lens, **options})


def expected(alpha: float, depth: float = DEPTH) -> float:
    """Return the bandwidth that the lobe's width makes, in lens radii."""
    return max(SHARE * math.sqrt(2) * alpha * depth / LENS_RADIUS, LEAST_BANDWIDTH)


def test_is_a_share_of_the_highlight_that_the_lens_sees(mi: ModuleType) -> None:
    samples = trace(world(mi, fov=0.05, mirror=facing(mi, ROUGH)), spp=16)
    assert samples.bandwidth is not None
    away2 = np.square(samples.uv).sum(axis=-1).ravel()
    slope, _ = np.polyfit(away2, np.log(samples.color[..., 1].ravel()), 1)
    np.testing.assert_allclose(samples.bandwidth, SHARE * math.sqrt(-0.5 / slope), rtol=0.02)


@pytest.mark.parametrize(
    ("bsdf", "alpha"),
    [
        ({"type": "diffuse"}, math.inf),
        ({"type": "mask", "opacity": 1.0, "bsdf": {"type": "diffuse"}}, math.inf),
        ({"type": "conductor"}, 0.0),
        ({"type": "dielectric"}, 0.0),
        ({"type": "plastic"}, 0.0),
        ({"type": "roughconductor", "alpha": 0.2}, 0.2),
        ({"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.05}, 0.05),
        ({"type": "roughdielectric", "alpha": 0.15}, REFRACTED * 0.15),
        ({"type": "twosided", "bsdf": {"type": "roughplastic", "alpha": 0.12}}, 0.12),
        ({"type": "principled", "roughness": 0.4}, 0.16),
        ({"type": "principled", "roughness": 0.4, "anisotropic": 0.5}, 0.16 * math.sqrt(0.55)),
        ({"type": "principled", "roughness": 0.8, "clearcoat": 0.5, "clearcoat_gloss": 0.2}, 0.0802),
        (
            {"type": "blendbsdf", "weight": 0.5, "a": {"type": "diffuse"}, "b": {**ROUGH, "alpha": 0.3}},
            0.3,
        ),
        (
            {**ROUGH, "alpha": {"type": "checkerboard", "color0": 0.4, "color1": 0.1}},
            0.1,
        ),
    ],
    ids=lambda value: value["type"] if isinstance(value, dict) else "",
)
def test_follows_the_sharpest_lobe_of_a_material(mi: ModuleType, bsdf: dict[str, Any], alpha: float) -> None:
    samples = trace(world(mi, square=facing(mi, bsdf)))
    assert samples.bandwidth is not None
    np.testing.assert_allclose(samples.bandwidth, expected(alpha), rtol=1e-5)


def test_unknown_roughness_counts_as_a_mirror(mi: ModuleType) -> None:
    class Velvet(mi.BSDF):  # type: ignore[misc, name-defined]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def sample(self, *_: Any) -> Any:
            return mi.BSDFSample3f(), mi.Color3f(0)

        def eval(self, *_: Any) -> Any:
            return mi.Color3f(0)

        def eval_pdf(self, *_: Any) -> Any:
            return mi.Color3f(0), mi.Float(0)

        def pdf(self, *_: Any) -> Any:
            return mi.Float(0)

    mi.register_bsdf("velvet", Velvet)
    samples = trace(world(mi, square=facing(mi, {"type": "velvet"})), shading_spp=1)
    np.testing.assert_array_equal(samples.bandwidth, np.float32(LEAST_BANDWIDTH))


def test_belongs_to_what_each_ray_hits(mi: ModuleType) -> None:
    near = facing(mi, {**ROUGH, "alpha": 0.1}, depth=1.5, left=1.1)
    behind = facing(mi, {"type": "diffuse"}, depth=4.0, left=0.3)
    group = {"type": "shapegroup", "square": facing(mi, {**ROUGH, "alpha": 0.05}, depth=DEPTH, left=-1.4)}
    copy = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    samples = trace(world(mi, near=near, behind=behind, group=group, copy=copy), background_depth=9.0)
    depth, bandwidth = samples.depth, samples.bandwidth
    assert bandwidth is not None
    for at, alpha in ((1.5, 0.1), (DEPTH, 0.05), (4.0, math.inf), (9.0, math.inf)):
        seen = np.isclose(depth, at)
        assert seen.any()
        np.testing.assert_allclose(bandwidth[seen], expected(alpha, at), rtol=1e-5)


def test_moving_shapes_keep_theirs(mi: ModuleType) -> None:
    slide = mi.ScalarTransform4f().translate([0.3, 0, 0])
    scene = world(mi, near=facing(mi, ROUGH, 1.5, 0.9), behind=facing(mi, {"type": "diffuse"}, 2.5))
    samples = trace(scene, motion={"near": slide}, time_slices=4, background_depth=9.0)
    assert samples.bandwidth is not None
    np.testing.assert_array_equal(np.isfinite(samples.bandwidth), np.isclose(samples.depth, 1.5))
    assert np.isfinite(samples.bandwidth).any()


def test_pinhole_sees_everything_from_one_place(mi: ModuleType) -> None:
    samples = trace(world(mi, square=facing(mi, ROUGH)), lens_radius=0.0)
    assert samples.bandwidth is not None
    assert np.isposinf(samples.bandwidth).all()


def test_changes_nothing_else(mi: ModuleType) -> None:
    scene = world(mi, square=facing(mi, ROUGH, 1.5, 0.4), behind=facing(mi, {"type": "diffuse"}, 3.0))
    plain, glossy = (trace(scene, bandwidth=wanted, shading_spp=4) for wanted in (False, True))
    assert plain.bandwidth is None
    for field in ("xy", "uv", "depth", "color"):
        np.testing.assert_array_equal(getattr(plain, field), getattr(glossy, field))
