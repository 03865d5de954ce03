"""The dynamic light field's native kernels against its reference, and what must not change the image."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from fewrays import Lens, SampleError
from fewrays.dynamic import DefocusOptions, DepthLayer, defocus, defocus_rgba, kernel, make_light_field
from fewrays.parallel import Execution

Float32 = npt.NDArray[np.float32]


def lens_of(blur: float) -> Lens:
    """Return a lens focused at 2 that gives the far background a circle of confusion of `blur` pixels."""
    return Lens(-2 * blur, blur)


def random_layer(height: int, width: int, seed: int, *, transparent: bool = False) -> DepthLayer:
    """Make an image of a few slanted surfaces in front of a background at infinity."""
    rng = np.random.default_rng(seed)
    depth = np.full((height, width), np.inf)
    y, x = np.indices((height, width))
    for _ in range(4):
        a, b = sorted(rng.uniform(0, 1, 2))
        where = (x >= a * width) & (x < b * width) & (y >= rng.uniform(0, 0.7) * height)
        surface = rng.uniform(0.7, 5.0) + 0.02 * rng.normal() * x
        depth = np.where(where, np.minimum(depth, np.maximum(surface, 0.3)), depth)
    color = rng.gamma(1.0, 1.0, (height, width, 3))
    alpha = None
    if transparent:
        alpha = np.where(rng.random((height, width)) < 0.3, rng.uniform(0, 1, (height, width)), 1.0)
        alpha[rng.random((height, width)) < 0.1] = 0
        color = color * alpha[..., None]
    as_float = [None if a is None else a.astype(np.float32) for a in (color, depth, alpha)]
    return DepthLayer(*as_float)  # type: ignore[arg-type]


def run(layer: DepthLayer, blur: float, **options: Any) -> Float32:
    return defocus_rgba(layer.color, layer.depth, lens_of(blur), alpha=layer.alpha, **options)


CASES: list[dict[str, Any]] = [
    {},
    {"prefilter": "mipmap", "growth": 1, "lens_points": "halton", "fill_reach": 0, "split_edges": False},
    {"prefilter": "none", "blades": 5, "rotation": 20.0, "roundness": 0.5},
    {"views": 1, "footprint": 1.0},
    {"cats_eye": 0.8, "squeeze": 1.5},
    {"cats_eye": 0.6, "darken": True, "lens_points": "halton"},
    {"views": 7, "falloff_f_number": 1.0, "fill_reach": 3, "surface_tolerance": 2.5},
]


@pytest.mark.parametrize("options", CASES, ids=lambda options: ",".join(options) or "defaults")
@pytest.mark.parametrize("transparent", [False, True])
def test_kernel_agrees_with_reference(options: dict[str, Any], transparent: bool) -> None:
    layer = random_layer(37, 53, seed=3, transparent=transparent)
    behind = [random_layer(37, 53, seed=4, transparent=True)] if transparent else []
    # No whole number: positions would be rounded where two pixels meet.
    images = [run(layer, 9.37, behind=behind, device=device, **options) for device in ("cpu", "reference")]
    # Where a rounded position or a border between surfaces falls on the other side, a view changes.
    assert_agree(*images, tolerance=1e-4, flips=0.005, jump=0.3)


@settings(max_examples=15, deadline=None)
@given(
    height=st.integers(1, 20),
    width=st.integers(1, 20),
    blur=st.floats(0, 60, width=32),
    seed=st.integers(0, 99),
    transparent=st.booleans(),
    views=st.integers(1, 9),
)
def test_any_size_and_blur(
    height: int, width: int, blur: float, seed: int, transparent: bool, views: int
) -> None:
    layer = random_layer(height, width, seed, transparent=transparent)
    image = run(layer, blur, views=views)
    assert_agree(image, run(layer, blur, views=views, device="reference"), tolerance=1e-3, flips=0.05)
    assert image.shape == (height, width, 4)
    assert image.min() >= 0
    assert image[..., :3].max() <= layer.color.max() * 1.0001 / (1 if layer.alpha is None else 0.04)
    assert image[..., 3].max() <= 1 + 1e-5


@pytest.mark.parametrize("shape", [(150, 131), (5, 300), (1, 1), (129, 2)])
def test_results_do_not_depend_on_threads(shape: tuple[int, int]) -> None:
    layer = random_layer(*shape, seed=1)
    images = [run(layer, 20.0, threads=threads, views=9) for threads in (1, 2, 5)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_tiles_leave_no_seam() -> None:
    """An image that is cut into other tiles, by a border beyond the reach of the blur, is the same."""
    layer = random_layer(150, 170, seed=5)
    whole = run(layer, 6.0, views=9)
    part = DepthLayer(layer.color[:, 40:], layer.depth[:, 40:])
    cut = run(part, 6.0, views=9)
    assert_agree(cut[:, 60:], whole[:, 100:], tolerance=1e-5)


@pytest.mark.parametrize("device", ["cpu", "reference"])
def test_what_is_in_focus_is_untouched(device: str) -> None:
    color = np.random.default_rng(0).gamma(1.0, 10.0, (31, 45, 3)).astype(np.float32)
    image = defocus(color, np.full((31, 45), 2.0), lens_of(20.0), device=device)
    np.testing.assert_allclose(image, color, rtol=1e-5)


def test_a_closed_aperture_changes_nothing() -> None:
    layer = random_layer(40, 50, seed=2)
    np.testing.assert_allclose(run(layer, 0.0)[..., :3], layer.color, rtol=2e-5, atol=1e-6)


@pytest.mark.parametrize("options", [case for case in CASES if "darken" not in case], ids=",".join)
def test_a_constant_image_stays_constant(options: dict[str, Any]) -> None:
    depth = random_layer(40, 50, seed=6).depth
    color = np.full((40, 50, 3), [0.2, 3.0, 70.0], np.float32)
    image = defocus(color, depth, lens_of(8.0), **options)
    np.testing.assert_allclose(image, color, rtol=1e-4)


def test_a_background_without_distance() -> None:
    color = np.random.default_rng(1).random((30, 40, 3)).astype(np.float32)
    far = defocus(color, np.full((30, 40), np.inf), lens_of(5.0))
    np.testing.assert_allclose(far, defocus(color, np.full((30, 40), 1e12), lens_of(5.0)), atol=1e-5)


def test_an_empty_image_is_empty() -> None:
    nothing = np.zeros((9, 12))
    rgba = defocus_rgba(np.zeros((9, 12, 3)), nothing, lens_of(5.0), alpha=nothing)
    np.testing.assert_array_equal(rgba, 0)


def test_extreme_depths_give_finite_images() -> None:
    depth = np.array([1e-30, 1e-6, 1.0, 2.0, 1e30, np.inf]) * np.ones((8, 1))
    image = defocus(np.full((8, 6, 3), 1e30), depth, Lens(-1e30, 1e30), views=4)
    assert np.isfinite(image).all()


def test_stages_are_timed_apart() -> None:
    layer = random_layer(60, 80, seed=0)
    field = make_light_field([layer], lens_of(5.0), DefocusOptions(), Execution())
    seconds = kernel.synthesize(field, np.zeros((60, 80, 5), np.float32), Execution())
    assert seconds.warping > 0
    assert seconds.synthesis > 0


def good() -> dict[str, Any]:
    return {"color": np.ones((6, 8, 3)), "depth": np.full((6, 8), 3.0), "lens": lens_of(4.0)}


def with_value(array: npt.NDArray[Any], value: float) -> npt.NDArray[Any]:
    array = array.copy()
    array[2, 3] = value
    return array


@pytest.mark.parametrize(
    ("changes", "field", "problem"),
    [
        ({"color": np.ones((6, 8))}, "color", r"\(H, W, 3\)"),
        ({"color": np.ones((0, 8, 3))}, "color", "not empty"),
        ({"color": with_value(np.ones((6, 8, 3)), np.nan)}, "color", r"nan at \(2, 3, 0\)"),
        ({"color": with_value(np.ones((6, 8, 3)), np.inf)}, "color", "inf at"),
        ({"color": [["a"]]}, "color", "real numbers"),
        ({"depth": np.ones((6, 9))}, "depth", "expected shape"),
        ({"depth": with_value(np.ones((6, 8)), np.nan)}, "depth", r"nan at \(2, 3\)"),
        ({"depth": np.zeros((6, 8))}, "depth", "48 values are not.*|depths > 0"),
        ({"depth": with_value(np.ones((6, 8)), -1.0)}, "depth", "invalid_depth"),
        ({"alpha": np.full((6, 8), 1.5)}, "alpha", "from 0 to 1"),
        ({"alpha": np.ones((6, 7))}, "alpha", "expected shape"),
        ({"behind": [np.ones((6, 8))]}, r"behind\[0\]", "DepthLayer"),
        ({"behind": [DepthLayer(*(np.ones((5, 5, 3), "f"), np.ones((5, 5), "f")))]}, r"behind\[0\]", "6, 8"),
        ({"views": 0}, "views", "1 to"),
        ({"views": 2.5}, "views", "whole"),
        ({"footprint": -1.0}, "footprint", "0 to 8"),
        ({"footprint": np.nan}, "footprint", "0 to 8"),
        ({"lens_points": "sobol"}, "lens_points", "vogel, halton"),
        ({"prefilter": "box"}, "prefilter", "surface, mipmap"),
        ({"falloff_f_number": 0.0}, "falloff_f_number", "from 0.1"),
        ({"surface_tolerance": 0.0}, "surface_tolerance", "0.01"),
        ({"invalid_depth": "drop"}, "invalid_depth", "background"),
        ({"blades": 2}, "blades", "3 to 64"),
        ({"cats_eye": 1.5}, "cats_eye", "0 to 1"),
        ({"squeeze": 0.0}, "squeeze", "0.125"),
        ({"device": "gpu"}, "device", "auto, cpu, reference"),
        ({"threads": 0}, "threads", "at least 1"),
        ({"samples": 3}, "samples", "no such option for defocus"),
    ],
)
def test_what_cannot_be_used_is_refused(changes: dict[str, Any], field: str, problem: str) -> None:
    with pytest.raises(SampleError, match=rf"{field}.*({problem})"):
        defocus(**{**good(), **changes})


def test_invalid_depths_are_background_if_so_asked() -> None:
    depth = np.full((6, 8), 3.0)
    depth[1:4, 2] = [np.nan, 0.0, -2.0]
    image = defocus(np.ones((6, 8, 3)), depth, lens_of(4.0), invalid_depth="background")
    expected = defocus(np.ones((6, 8, 3)), np.where(depth > 0, depth, np.inf), lens_of(4.0))
    np.testing.assert_array_equal(image, expected)


def test_depth_does_not_matter_where_nothing_is_seen() -> None:
    alpha = np.ones((6, 8))
    alpha[2, 3] = 0
    depth = with_value(np.full((6, 8), 3.0), np.nan)
    color = np.ones((6, 8, 3)) * alpha[..., None]
    assert np.isfinite(defocus(color, depth, lens_of(4.0), alpha=alpha)).all()
