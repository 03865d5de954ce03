"""The dynamic method's GPU kernels, run on the CPU as phases, against the reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from fewrays import Lens, SampleError
from fewrays.dynamic import (
    DefocusOptions,
    DepthLayer,
    DeviceLayer,
    cuda,
    defocus_rgba,
    make_light_field,
    reference,
)
from fewrays.dynamic.cuda_prepare import DeviceSheets, prepare_sheets
from fewrays.dynamic.plan import LightField, ViewRules
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.surfaces import slope_gradient
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
    alpha = None
    if transparent:
        alpha = np.where(rng.random(depth.shape) < 0.3, rng.random(depth.shape), 1.0)
        unseen = rng.random(depth.shape) < 0.1
        alpha[unseen], depth[unseen] = 0, np.nan
    color = rng.gamma(1.0, 1.0, (height, width, 3)) * (1 if alpha is None else alpha[..., None])
    as_float = [None if a is None else a.astype(np.float32) for a in (color, depth, alpha)]
    return DepthLayer(*as_float)  # type: ignore[arg-type]


def layers_of(*, transparent: bool = False) -> list[DepthLayer]:
    """Make a picture of 41 x 29 pixels, and one behind it if it is transparent."""
    layers = [layer_of(29, 41, 3, transparent=transparent)]
    return layers + ([layer_of(29, 41, 4, transparent=True)] if transparent else [])


def lens_of(blur: float) -> Lens:
    """Return a lens that gives the background a circle of confusion of `blur` pixels."""
    return Lens(-2 * blur, blur)


def light_field(options: dict[str, Any], *, transparent: bool = False, blur: float = 9.37) -> LightField:
    """Prepare the picture on the processor."""
    layers = layers_of(transparent=transparent)
    return make_light_field(layers, lens_of(blur), DefocusOptions(**options), Execution("cpu"))


def prepared(
    machine: PhasesMachine, layers: Sequence[DepthLayer], lens: Lens, options: dict[str, Any]
) -> DeviceSheets:
    """Prepare a picture by the kernels."""
    on_card = [DeviceLayer.of_layer(machine, layer) for layer in layers]
    return prepare_sheets(machine, on_card, lens, DefocusOptions(**options))


def sums_of(
    machine: PhasesMachine,
    options: dict[str, Any],
    *,
    transparent: bool = False,
    blur: float = 9.37,
    vignetting: bool = True,
) -> Any:
    """Run all kernels; sums and weights side by side."""
    sheets = prepared(machine, layers_of(transparent=transparent), lens_of(blur), options)
    rules = ViewRules.of_options(DefocusOptions(**options), lens_of(blur), 29, 41)
    cuda.blur_between_views(machine, sheets, rules)
    sums, passed = cuda.synthesize_views(machine, sheets, rules, vignetting=vignetting)
    return np.concatenate([sums, passed[..., None]], axis=-1) if vignetting else sums


def assert_same_sheets(actual: DeviceSheets, expected: Sequence[Sheet], numbers: Sequence[int]) -> None:
    """Compare sheets of given numbers; the others are to show nothing.

    Radiance that averages make may be rounded otherwise; all else is the same bit by bit.
    """
    tolerance = 1.0
    for number in set(range(len(actual.behind))) - set(numbers):
        assert (actual.pixels[number, ..., 1] < 0).all()
    for number, sheet in zip(numbers, expected, strict=True):
        texels, pixels = actual.texels[number], actual.pixels[number]
        np.testing.assert_array_equal(texels[..., 5], sheet.slope)
        np.testing.assert_array_equal(texels[..., 4], sheet.coverage)
        np.testing.assert_allclose(texels[..., :4], sheet.light, rtol=1e-6, atol=1e-7)
        spread = slope_gradient(sheet.slope, tolerance, sheet.shown)
        warped = sheet.shown & (sheet.coverage > 0)
        np.testing.assert_array_equal(pixels[..., 0], sheet.slope)
        np.testing.assert_array_equal(pixels[..., 1], np.where(warped, spread, -1))
        assert actual.behind[number] == np.float32(sheet.behind)
        partly = (sheet.coverage < 1) & warped
        assert actual.translucent[number] or not partly.any()
        assert actual.steepest >= 0.999999 * np.abs(sheet.slope).max()


@pytest.mark.parametrize("options", CASES, ids=lambda options: ",".join(options) or "defaults")
@pytest.mark.parametrize("transparent", [False, True])
def test_phases_agree_with_reference(options: dict[str, Any], transparent: bool) -> None:
    field = light_field(options, transparent=transparent)
    count = len(field.views.uv)
    sums, passed = np.zeros((29, 41, 5), np.float32), np.zeros((29, 41), np.float32)
    reference.synthesize(field, sums, Execution(), passed)
    expected = np.concatenate([sums, passed[..., None]], axis=-1) / count
    # A small cache: the image is made in several parts.
    actual = sums_of(PhasesMachine(cache_bytes=1), options, transparent=transparent) / np.float32(count)
    assert_agree(actual, expected, tolerance=1e-4, flips=0.005, jump=0.3)


@pytest.mark.parametrize("cache_bytes", [1, 50 << 20])
def test_order_of_threads_does_not_matter(cache_bytes: int) -> None:
    results = [
        sums_of(PhasesMachine(order, cache_bytes), {"views": 11}, transparent=True) for order in ORDERS
    ]
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_parts_of_the_image_do_not_matter() -> None:
    machines = [PhasesMachine(cache_bytes=1), PhasesMachine()]
    parts, whole = (sums_of(machine, {"views": 9}, transparent=True, blur=3.0) for machine in machines)
    np.testing.assert_array_equal(parts, whole)
    assert machines[0].launches.count("dynamic_warp") > machines[1].launches.count("dynamic_warp")


def test_corners_stand_for_what_lies_beyond_them() -> None:
    """Blur wider than the image: every border pixel covers so much that all threads write it together."""
    options = {"views": 5, "prefilter": "none"}
    sums = np.zeros((29, 41, 5), np.float32)
    reference.synthesize(light_field(options, blur=70.0), sums, Execution())
    actual = sums_of(PhasesMachine(), options, blur=70.0, vignetting=False)
    assert_agree(actual / np.float32(5), sums / 5, tolerance=1e-4, flips=0.005)


def test_nothing_but_its_sums_is_written() -> None:
    """Without the weights of all rays, sums are the same."""
    np.testing.assert_array_equal(
        sums_of(PhasesMachine(), {"views": 3})[..., :5],
        sums_of(PhasesMachine(), {"views": 3}, vignetting=False),
    )


# Preparation.

PREPARED: list[dict[str, Any]] = [
    {},
    {"split_edges": False},
    {"fill_reach": 0},
    {"fill_reach": 0, "split_edges": False},
    {"fill_reach": 3},
]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("options", PREPARED, ids=lambda options: ",".join(options) or "defaults")
@pytest.mark.parametrize("transparent", [False, True])
def test_sheets_are_those_of_the_processor(order: int, options: dict[str, Any], transparent: bool) -> None:
    layers = layers_of(transparent=transparent)
    field = make_light_field(layers, lens_of(9.37), DefocusOptions(**options), Execution("cpu"))
    actual = prepared(PhasesMachine(order), layers, lens_of(9.37), options)
    # Of opaque layers there is no emptiness, and what was made up comes right behind the layers.
    assert_same_sheets(actual, field.sheets, range(len(field.sheets)))


@settings(max_examples=40, deadline=None)
@given(
    height=st.integers(1, 24),
    width=st.integers(1, 24),
    blur=st.floats(0, 200, width=32),
    seed=st.integers(0, 999),
    kinds=st.lists(st.booleans(), min_size=1, max_size=3),
    options=st.sampled_from(PREPARED),
)
def test_sheets_of_any_layers(
    height: int, width: int, blur: float, seed: int, kinds: list[bool], options: dict[str, Any]
) -> None:
    """Also where emptiness has its place and shows nothing, and where nothing was made up."""
    layers = [layer_of(height, width, seed + k, transparent=kind) for k, kind in enumerate(kinds)]
    chosen = DefocusOptions(**options)
    expected = list(make_light_field(layers, lens_of(blur), chosen, Execution("cpu")).sheets)
    actual = prepared(PhasesMachine(seed % 3), layers, lens_of(blur), options)
    passing = np.all([layer.alpha < 1 for layer in layers if layer.alpha is not None], axis=0)
    empty = all(kinds) and bool(passing.any())
    numbers = list(range(len(layers) + empty))
    if len(expected) > len(numbers):
        numbers.append(len(actual.behind) - 1)
    assert_same_sheets(actual, expected, numbers)


def test_antialiased_edges_are_taken_apart() -> None:
    """A dark card whose edge mixes with a bright wall: what is kept of the mixture is the card's."""
    height, width = 12, 20
    share = np.clip(np.arange(width, dtype=np.float32) - 9.6, 0, 1) * np.ones((height, 1), np.float32)
    depth = np.where(share < 1, 1.0, 8.0).astype(np.float32)
    color = np.float32(0.1) + np.float32(0.8) * np.repeat(share[..., None], 3, axis=-1)
    sheets = prepared(PhasesMachine(), [DepthLayer(color, depth)], Lens(-10.0, 5.0), {})
    mixed = sheets.texels[0, :, 10]
    np.testing.assert_allclose(mixed[:, 4], 0.6, atol=1e-5)
    np.testing.assert_allclose(mixed[:, :3], 0.06, atol=1e-5)
    np.testing.assert_allclose(sheets.texels[1, :, 10, :3], 0.9, atol=1e-5)
    assert (sheets.pixels[1, :, 10, 1] >= 0).all()


def test_the_card_is_waited_for_once() -> None:
    """For four numbers of each layer, which come while the other kernels of the preparation run."""
    seen: list[str] = []

    class Watched(PhasesMachine):
        def on_host(self, array: Any) -> Any:
            raise AssertionError(f"waits for an array of {array.shape}")

        def fetch(self, array: Any) -> Callable[[], Any]:
            assert array.shape == (2, 4)
            seen.append(self.launches[-1])

            def wait() -> Any:
                seen.append(self.launches[-1])
                return array

            return wait

    machine = Watched()
    layers = [DeviceLayer.of_layer(machine, layer) for layer in layers_of(transparent=True)]
    image = cuda.defocus_layers(machine, layers, lens_of(9.37), DefocusOptions(views=4))
    assert seen == ["dynamic_layer", "dynamic_spread"]
    assert image.shape == (29, 41, 4)


class OnCard(np.ndarray[Any, Any]):
    """An array that says of itself that it is on a card, as the machine that runs phases has it."""

    __cuda_array_interface__: ClassVar[dict[str, Any]] = {}


def on_card(array: Any) -> OnCard:
    return np.ascontiguousarray(array, np.float32).view(OnCard)


@pytest.mark.parametrize("options", CASES, ids=lambda options: ",".join(options) or "defaults")
def test_pictures_on_the_card(phases: PhasesMachine, options: dict[str, Any]) -> None:
    front, back = layers_of(transparent=True)
    color, depth, alpha = (on_card(each) for each in (front.color, front.depth, front.alpha))
    behind = DeviceLayer.of_arrays(back.color, back.depth, back.alpha)
    lens = lens_of(9.37)
    image = defocus_rgba(color, depth, lens, alpha=alpha, behind=[behind], output="device", **options)
    assert "dynamic_split" in phases.launches
    host = (front.color, front.depth, lens)
    same = defocus_rgba(*host, alpha=front.alpha, behind=[back], device="cuda", **options)
    np.testing.assert_array_equal(image, same)
    expected = defocus_rgba(*host, alpha=front.alpha, behind=[back], device="cpu", **options)
    assert_agree(image, expected, tolerance=1e-4, flips=0.01, jump=0.3)


@pytest.mark.parametrize("prefilter", ["surface", "none"])
def test_where_no_ray_is_valid_the_centre_is_shown(phases: PhasesMachine, prefilter: str) -> None:
    """Two views, both of which see past a card whose back nothing is made up for."""
    options: dict[str, Any] = {"views": 2, "fill_reach": 0, "split_edges": False, "prefilter": prefilter}
    depth = np.where(np.abs(np.arange(41) - 20) < 9, 0.5, np.inf) * np.ones((29, 1))
    front = DepthLayer(np.random.default_rng(1).random((29, 41, 3), np.float32), depth.astype(np.float32))
    on_device = [DeviceLayer.of_layer(phases, front)]
    chosen = DefocusOptions(**options)
    sheets = prepare_sheets(phases, on_device, lens_of(6.0), chosen)
    rules = ViewRules.of_options(chosen, lens_of(6.0), 29, 41)
    sums, _ = cuda.synthesize_views(phases, sheets, rules)
    unseen = sums[..., 4] == 0
    assert unseen.any()
    image = cuda.defocus_layers(phases, on_device, lens_of(6.0), chosen)
    np.testing.assert_array_equal(image[unseen][:, :3], front.color[unseen])
    expected = defocus_rgba(front.color, front.depth, lens_of(6.0), device="cpu", **options)
    assert_agree(image, expected, tolerance=1e-4, flips=0.01)


@pytest.mark.usefixtures("phases")
def test_arrays_on_the_card_are_not_changed_or_copied() -> None:
    front = layers_of()[0]
    color, depth = on_card(front.color), on_card(front.depth)
    layer = DeviceLayer.of_arrays(color, depth)
    assert np.shares_memory(layer.color, color)
    defocus_rgba(color, depth, lens_of(9.37))
    np.testing.assert_array_equal(color, front.color)
    np.testing.assert_array_equal(depth, front.depth)


@pytest.mark.usefixtures("phases")
@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("color", np.nan, "color: expected finite radiance; 1 values"),
        ("color", np.inf, "color: expected finite"),
        ("depth", np.nan, "depth: expected depths > 0"),
        ("depth", 0.0, "invalid_depth"),
        ("alpha", 1.5, "alpha: expected opacities"),
        ("alpha", np.nan, "alpha: expected opacities"),
    ],
)
def test_impossible_values_on_the_card_are_refused(field: str, value: float, problem: str) -> None:
    front = layers_of(transparent=True)[0]
    arrays = {name: on_card(getattr(front, name)).copy() for name in ("color", "depth", "alpha")}
    arrays["alpha"][0, 5], arrays["depth"][0, 5] = 1, 2
    arrays[field].reshape(29, 41, -1)[0, 5, 0] = value
    with pytest.raises(SampleError, match=problem):
        defocus_rgba(arrays["color"], arrays["depth"], lens_of(9.37), alpha=arrays["alpha"])
    layer = DeviceLayer.of_arrays(arrays["color"], arrays["depth"], arrays["alpha"])
    good = layers_of()[0]
    with pytest.raises(SampleError, match=rf"behind\[0\]\.{field}: expected"):
        defocus_rgba(good.color, good.depth, lens_of(9.37), behind=[layer])


@pytest.mark.usefixtures("phases")
def test_invalid_depths_on_the_card_are_background_if_so_asked() -> None:
    front = layers_of()[0]
    broken, far = front.depth.copy(), front.depth.copy()
    broken[3:6, 4:9] = [np.nan, 0, -1, np.nan, -np.inf]
    far[3:6, 4:9] = np.inf
    chosen: dict[str, Any] = {"invalid_depth": "background", "views": 5}
    image = defocus_rgba(on_card(front.color), on_card(broken), lens_of(9.37), **chosen)
    np.testing.assert_array_equal(
        image, defocus_rgba(front.color, far, lens_of(9.37), device="cuda", views=5)
    )


def test_pictures_on_the_card_are_for_the_card() -> None:
    front = layers_of()[0]
    with pytest.raises(SampleError, match=r"depth: is on a GPU: use device='cuda'"):
        defocus_rgba(front.color, on_card(front.depth), lens_of(9.37), device="cpu")


@pytest.mark.usefixtures("phases")
def test_shapes_on_the_card_are_checked() -> None:
    front = layers_of()[0]
    with pytest.raises(SampleError, match=r"color: expected shape \(H, W, 3\)"):
        DeviceLayer.of_arrays(front.depth, front.depth)
    with pytest.raises(SampleError, match=r"depth: expected shape \(29, 41\)"):
        DeviceLayer.of_arrays(front.color, front.depth[:5])
    other = DeviceLayer.of_arrays(front.color[:5], front.depth[:5])
    with pytest.raises(SampleError, match=r"behind\[0\]: expected \(29, 41\) pixels"):
        defocus_rgba(on_card(front.color), on_card(front.depth), lens_of(9.37), behind=[other])
    with pytest.raises(SampleError, match=r"behind\[0\]: expected a DepthLayer or a DeviceLayer, got str"):
        defocus_rgba(front.color, front.depth, lens_of(9.37), behind=["?"], device="cuda")  # type: ignore[list-item]
