"""The published method's native kernel against its reference, and what must not change its result."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, SampleError
from fewrays import reconstruct as reconstruct_with
from fewrays.layered_published import reference
from fewrays.lens import LensAperture, Sampling
from fewrays.samples import OFF_IMAGE
from rounding import change_by_rounding

LENS = Lens(-40.0, 8.0, aperture="gaussian", sampling="square")
METHODS = ["layered-published", "layered-axis-aligned"]

reconstruct = partial(reconstruct_with, method="layered-published")


def largest_number(samples: Any, _partition: Any, _layer: Any, layer_filter: Any, _plan: Any) -> float:
    """Return what positions in a layer's bins are computed from, at most, in pixels."""
    return float(np.abs(samples.xy).max(initial=0) + abs(layer_filter.eta))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"tile": 24, "ring": 10, "max_sigma_x": 5.0},
        {"max_layers": 2},
        {"partitions": 3, "bin_size": 1.0},
        {"sigma_pix": 1.2},
    ],
    ids=lambda options: ",".join(options) or "defaults",
)
def test_kernel_equals_reference(method: str, options: dict[str, Any]) -> None:
    samples = random_buffer(45, 70, 4, LENS, off_image=0.05)
    expected, expected_aovs = reconstruct_with(samples, method, device="reference", aovs=True, **options)
    actual, actual_aovs = reconstruct_with(samples, method, device="cpu", aovs=True, **options)
    assert_agree(actual, expected, tolerance=1e-4, flips=0.002, jump=0.2)
    for name, aov in expected_aovs.items():
        assert_agree(actual_aovs[name], aov, tolerance=1e-4, flips=0.002, jump=0.2)


@settings(max_examples=40)
@given(
    height=st.integers(1, 40),
    width=st.integers(1, 40),
    spp=st.integers(1, 6),
    aperture=st.sampled_from(["disc", "gaussian"]),
    sampling=st.sampled_from(["disc", "square", "gaussian"]),
    blur=st.sampled_from([0.0, 0.3, 2.0, 20.0, 300.0]),
    sigma=st.floats(0.2, 0.5),
    method=st.sampled_from(METHODS),
    off_image=st.sampled_from([0.0, 0.3]),
    seed=st.integers(0, 1000),
)
@example(
    height=34,
    width=37,
    spp=5,
    aperture="gaussian",
    sampling="gaussian",
    blur=20.0,
    sigma=0.2,
    method="layered-published",
    off_image=0.3,
    seed=745,
)
@example(
    height=32,
    width=26,
    spp=3,
    aperture="gaussian",
    sampling="gaussian",
    blur=0.3,
    sigma=0.2,
    method="layered-published",
    off_image=0.0,
    seed=523,
)
@example(
    height=13,
    width=3,
    spp=5,
    aperture="disc",
    sampling="square",
    blur=300.0,
    sigma=0.2,
    method="layered-published",
    off_image=0.3,
    seed=432,
)
@example(
    height=21,
    width=7,
    spp=6,
    aperture="gaussian",
    sampling="disc",
    blur=300.0,
    sigma=0.25,
    method="layered-axis-aligned",
    off_image=0.3,
    seed=771,
)
@example(
    height=17,
    width=1,
    spp=1,
    aperture="gaussian",
    sampling="gaussian",
    blur=20.0,
    sigma=0.5,
    method="layered-published",
    off_image=0.3,
    seed=516,
)
def test_kernel_equals_reference_on_any_buffer(
    height: int,
    width: int,
    spp: int,
    aperture: LensAperture,
    sampling: Sampling,
    blur: float,
    sigma: float,
    method: str,
    off_image: float,
    seed: int,
) -> None:
    lens = Lens(-5 * blur, blur, aperture, sampling, sigma)
    samples = random_buffer(height, width, spp, lens, seed=seed, off_image=off_image)
    by_reference = partial(reconstruct_with, samples, method, device="reference")
    expected = by_reference()
    actual = reconstruct_with(samples, method, device="cpu")
    if not np.allclose(actual, expected, rtol=1e-5, atol=1e-5):
        change = change_by_rounding(by_reference, (reference, "filter_layer"), largest_number)
        # Towards the kernel's image, as far as samples that rounding puts into a neighbouring bin explain.
        expected = np.clip(actual, expected - change, expected + change)
    assert_agree(actual, expected, tolerance=1e-4, flips=0.01 if height * width > 600 else 1.0, jump=0.5)
    assert np.median(np.abs(actual - expected)) <= 1e-5 * max(1.0, float(np.abs(expected).max()))


def test_threads_do_not_change_a_bit() -> None:
    samples = random_buffer(100, 150, 3, LENS)
    images = [reconstruct(samples, threads=threads) for threads in (1, 2, 5)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def _shuffled(samples: SampleBuffer, *, across_pixels: bool) -> SampleBuffer:
    rng = np.random.default_rng(5)
    shape = samples.depth.shape
    if across_pixels:
        order = rng.permutation(samples.depth.size)
    else:
        within = rng.permuted(np.broadcast_to(np.arange(shape[2]), shape), axis=2)
        order = (np.arange(shape[0] * shape[1]).reshape(*shape[:2], 1) * shape[2] + within).ravel()
    arrays = {
        name: getattr(samples, name).reshape(len(order), -1)[order].reshape(getattr(samples, name).shape)
        for name in samples.field_names()
    }
    return SampleBuffer(**arrays, lens=samples.lens)


@pytest.mark.parametrize("across_pixels", [False, True], ids=["inside a pixel", "across pixels"])
def test_order_of_samples_does_not_matter(across_pixels: bool) -> None:
    samples = random_buffer(50, 60, 4, LENS)
    shuffled = _shuffled(samples, across_pixels=across_pixels)
    assert not np.array_equal(shuffled.depth, samples.depth)
    assert_agree(reconstruct(shuffled), reconstruct(samples), tolerance=2e-5)


def test_dropped_samples_leave_no_trace() -> None:
    samples = random_buffer(40, 40, 4, LENS)
    color = samples.color.copy()
    color[::3, ::2, 1] = np.nan
    with pytest.warns(UserWarning, match="dropped"):
        dropped = SampleBuffer(samples.xy, samples.uv, samples.depth, color, samples.lens, nan="drop")
    xy = samples.xy.copy()
    xy[::3, ::2, 1] = OFF_IMAGE
    np.testing.assert_array_equal(reconstruct(dropped), reconstruct(replace(samples, xy=xy)))


def test_guard_band_is_used() -> None:
    """Samples outside the image reach it, and an image with a guard band equals the crop of a larger one."""
    lens = replace(LENS, c1=LENS.c1 / 4, c0=LENS.c0 / 4)
    large = random_buffer(96, 96, 4, lens)
    cropped = SampleBuffer(large.xy - 32, large.uv, large.depth, large.color, lens)
    inner = reconstruct(large)[32:64, 32:64]
    assert_agree(reconstruct(cropped)[:32, :32], inner, tolerance=1e-5)

    rows = columns = slice(32, 64)
    xy, uv, depth, color = (a[rows, columns] for a in (cropped.xy, large.uv, large.depth, large.color))
    inside_only = SampleBuffer(xy, uv, depth, color, lens)
    assert np.abs(reconstruct(inside_only) - inner).max() > 1e-3


def test_layers_composite_to_the_image() -> None:
    """Eq. 35 over the per-layer outputs gives the image."""
    samples = random_buffer(40, 50, 4, LENS)
    image, aovs = reconstruct(samples, aovs=True)
    assert aovs["layer_radiance"].shape == (40, 50, aovs["layer_opacity"].shape[2], 3)
    assert aovs["layer_count"].shape == (40, 50)
    assert aovs["layer_count"].max() <= aovs["layer_opacity"].shape[2]
    transmittance = np.ones((40, 50))
    radiance = np.zeros((40, 50, 3))
    for layer in range(aovs["layer_opacity"].shape[2]):
        radiance += transmittance[..., None] * aovs["layer_radiance"][:, :, layer]
        transmittance *= 1 - aovs["layer_opacity"][:, :, layer]
    assert_agree(image, radiance / (1 - transmittance)[..., None], tolerance=1e-5)


@pytest.mark.parametrize("limit", [1, 2, 4])
def test_number_of_layers_is_limited(limit: int) -> None:
    _, aovs = reconstruct(random_buffer(40, 40, 4, LENS, surfaces=12), aovs=True, max_layers=limit)
    assert aovs["layer_count"].max() == limit


def test_image_without_samples_is_black() -> None:
    samples = random_buffer(8, 8, 2, LENS)
    nowhere = replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))
    for device in ("cpu", "reference"):
        np.testing.assert_array_equal(reconstruct(nowhere, device=device), np.zeros((8, 8, 3), np.float32))


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"sigma_pix": 0.0}, "sigma_pix"),
        ({"tile": 2}, "tile"),
        ({"max_sigma_x": 9.0}, "max_sigma_x"),
        ({"max_layers": 0}, "max_layers"),
        ({"partitions": 0}, "partitions"),
        ({"k": 2.0}, "k"),
        ({"method": "layered-axis-aligned", "k": 0.0}, "k"),
        ({"no_such": 1}, "no_such"),
        ({"device": "abacus"}, "device"),
        ({"threads": 0}, "threads"),
        ({"method": "magic"}, "method"),
    ],
)
def test_bad_options_are_named(options: dict[str, Any], field: str) -> None:
    with pytest.raises(SampleError) as caught:
        reconstruct(random_buffer(4, 4, 1, LENS), **options)
    assert caught.value.field == field


def test_absurd_slopes_do_no_harm() -> None:
    """Depths and lenses at the edge of float32 give finite images, the same on both devices."""
    samples = random_buffer(20, 20, 3, LENS)
    rng = np.random.default_rng(3)
    depth = np.float32(10) ** rng.uniform(-8, 30, samples.depth.shape).astype(np.float32)
    for lens in (replace(LENS, c0=-1e25), replace(LENS, c1=1e25), replace(LENS, c0=-1e30, c1=-1e30)):
        absurd = replace(samples, depth=depth, lens=lens)
        expected = reconstruct(absurd, device="reference")
        assert_agree(reconstruct(absurd), expected, tolerance=1e-3, flips=1.0, jump=5.0)
