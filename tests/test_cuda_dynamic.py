"""The dynamic method's GPU kernels, run on the CPU as phases, against the reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agreement import assert_agree
from fewrays import Lens
from fewrays.dynamic import DefocusOptions, DepthLayer, cuda, make_light_field, reference
from fewrays.dynamic.plan import LightField
from fewrays.parallel import Execution
from phases import ORDERS, PhasesMachine

CASES: list[dict[str, Any]] = [
    {},
    {"prefilter": "mipmap", "growth": 1, "lens_points": "halton", "fill_reach": 0, "split_edges": False},
    {"prefilter": "none", "blades": 5, "surface_tolerance": 2.5},
    {"views": 1, "footprint": 1.0},
    {"cats_eye": 0.8, "squeeze": 1.5},
    {"cats_eye": 0.6, "darken": True, "views": 7},
]


def layer_of(height: int, width: int, seed: int, *, transparent: bool) -> DepthLayer:
    """Make slanted bars of random colours in front of a background at infinity."""
    rng = np.random.default_rng(seed)
    y, x = np.indices((height, width))
    depth = np.full((height, width), np.inf)
    for _ in range(4):
        left, right = np.sort(rng.uniform(0, width, 2))
        bar = (x >= left) & (x < right) & (y >= rng.uniform(0, 0.7) * height)
        surface = np.maximum(rng.uniform(0.7, 5.0) + 0.02 * rng.normal() * x, 0.3)
        depth = np.where(bar, np.minimum(depth, surface), depth)
    alpha = np.where(rng.random(depth.shape) < 0.3, rng.random(depth.shape), 1.0) if transparent else None
    color = rng.gamma(1.0, 1.0, (height, width, 3)) * (1 if alpha is None else alpha[..., None])
    as_float = [None if a is None else a.astype(np.float32) for a in (color, depth, alpha)]
    return DepthLayer(*as_float)  # type: ignore[arg-type]


def light_field(options: dict[str, Any], *, transparent: bool = False, blur: float = 9.37) -> LightField:
    """Prepare a picture of 41 x 29 pixels whose background has a circle of confusion of `blur` pixels."""
    layers = [layer_of(29, 41, 3, transparent=transparent)]
    layers += [layer_of(29, 41, 4, transparent=True)] if transparent else []
    return make_light_field(layers, Lens(-2 * blur, blur), DefocusOptions(**options), Execution("cpu"))


def sums_of(machine: PhasesMachine, field: LightField, vignetting: bool = True) -> Any:
    """Run the kernels; sums and weights side by side."""
    sums, passed = cuda.synthesize_views(machine, field, cuda.upload(machine, field), vignetting=vignetting)
    return np.concatenate([sums, passed[..., None]], axis=-1) if vignetting else sums


@pytest.mark.parametrize("options", CASES, ids=lambda options: ",".join(options) or "defaults")
@pytest.mark.parametrize("transparent", [False, True])
def test_phases_agree_with_reference(options: dict[str, Any], transparent: bool) -> None:
    field = light_field(options, transparent=transparent)
    sums, passed = np.zeros((29, 41, 5), np.float32), np.zeros((29, 41), np.float32)
    reference.synthesize(field, sums, Execution(), passed)
    expected = np.concatenate([sums, passed[..., None]], axis=-1) / len(field.views.uv)
    # A small cache: the image is made in several parts.
    actual = sums_of(PhasesMachine(cache_bytes=1), field) / np.float32(len(field.views.uv))
    assert_agree(actual, expected, tolerance=1e-4, flips=0.005, jump=0.3)


@pytest.mark.parametrize("cache_bytes", [1, 50 << 20])
def test_order_of_threads_does_not_matter(cache_bytes: int) -> None:
    field = light_field({"views": 11}, transparent=True)
    results = [sums_of(PhasesMachine(order, cache_bytes), field) for order in ORDERS]
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_parts_of_the_image_do_not_matter() -> None:
    field = light_field({"views": 9}, transparent=True, blur=3.0)
    machines = [PhasesMachine(cache_bytes=1), PhasesMachine()]
    parts, whole = (sums_of(machine, field) for machine in machines)
    np.testing.assert_array_equal(parts, whole)
    assert machines[0].launches.count("dynamic_warp") > machines[1].launches.count("dynamic_warp")


def test_corners_stand_for_what_lies_beyond_them() -> None:
    """Blur wider than the image: every border pixel covers so much that all threads write it together."""
    field = light_field({"views": 5, "prefilter": "none"}, blur=70.0)
    sums = np.zeros((29, 41, 5), np.float32)
    reference.synthesize(field, sums, Execution())
    actual = sums_of(PhasesMachine(), field, vignetting=False)
    assert_agree(actual / np.float32(5), sums / 5, tolerance=1e-4, flips=0.005)


def test_nothing_but_its_sums_is_written() -> None:
    """Without the weights of all rays, sums are the same."""
    field = light_field({"views": 3})
    np.testing.assert_array_equal(
        sums_of(PhasesMachine(), field)[..., :5], sums_of(PhasesMachine(), field, vignetting=False)
    )
