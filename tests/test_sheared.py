"""The sheared baseline: right where everything is alike, the plain average where it is not."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from buffers import random_buffer
from fewrays import Lens, SampleBuffer, SampleError
from fewrays.baselines import sheared
from fewrays.baselines.accumulation import Accumulator
from fewrays.baselines.sheared import METHOD, ShearedOptions
from fewrays.method import Image
from fewrays.parallel import Execution
from fewrays.sources.analytic import (
    Plane,
    checker,
    constant,
    disc,
    exact_waves,
    grating,
    half_plane,
    motion_of,
    sample,
    smooth_noise,
)

LENS = Lens(-24.0, 15.0, "gaussian", "square")  # C = 12 px at depth 8
HEIGHT, WIDTH = 48, 60
INSIDE = np.s_[14:-14, 18:-18]  # filters cut off by the border see only one side


def run(
    samples: SampleBuffer, *, threads: int | None = None, **options: Any
) -> tuple[Image, npt.NDArray[np.bool_]]:
    """Return the image, and which pixels were sheared."""
    result = METHOD.run(samples, ShearedOptions(**options), Execution(threads=threads, aovs=True))
    assert result.image.dtype == np.float32
    assert result.image.shape == (samples.height, samples.width, 3)
    return result.image, result.aovs["sheared"] > 0


def plain(samples: SampleBuffer) -> Image:
    """Return the average under the pixel filter and the aperture."""
    accumulator = Accumulator(samples.height, samples.width)
    accumulator.add(samples)
    return accumulator.image()


def rms(difference: npt.NDArray[np.floating]) -> float:
    return float(np.sqrt(np.square(difference[INSIDE]).mean()))


# Where everything is alike.


def test_a_defocused_plane_is_exact() -> None:
    texture = smooth_noise(9, contrast=0.25)
    samples = sample([Plane(8.0, texture)], LENS, HEIGHT, WIDTH, 4)
    truth = exact_waves(texture, 8.0, LENS, HEIGHT, WIDTH)
    image, mask = run(samples)
    assert mask.all()
    assert rms(image - truth) < 0.005
    assert rms(plain(samples) - truth) > 10 * rms(image - truth)


def test_a_disc_is_the_gaussian_of_its_second_moment() -> None:
    lens, frequency = Lens(-24.0, 15.0), (0.04, 0.01)
    samples = sample([Plane(4.0, grating(frequency))], lens, HEIGHT, WIDTH, 8)
    focused = exact_waves(grating(frequency), 4.0, lens.refocus(4.0), HEIGHT, WIDTH)
    blur = 0.5 * float(lens.slope(4.0))
    truth = 0.5 + (focused - 0.5) * math.exp(-2 * (math.pi * blur * math.hypot(*frequency)) ** 2)
    image, mask = run(samples)
    assert mask.all()
    assert rms(image - truth) < 0.01


@pytest.mark.parametrize("velocity", [(16.0, 6.0), (0.0, -12.0)])
@pytest.mark.parametrize("depth", [1.6, 8.0])  # in focus, defocused
def test_a_moving_plane_is_exact_for_a_gaussian_shutter(velocity: tuple[float, float], depth: float) -> None:
    frequency = (0.02, 0.025)  # up to half a cycle passes by
    texture, motion = grating(frequency), motion_of(depth, velocity)
    samples = sample([Plane(depth, texture, motion=motion)], LENS, HEIGHT, WIDTH, 8)
    middle = exact_waves(texture, depth, LENS, HEIGHT, WIDTH, motion=motion, shutter=(0.5, 0.5))
    passing = float(np.dot(frequency, velocity))
    truth = 0.5 + (middle - 0.5) * math.exp(-2 * math.pi**2 / 12 * passing**2)
    image, mask = run(samples)
    assert mask.all()
    assert rms(image - truth) < 0.008
    box = exact_waves(texture, depth, LENS, HEIGHT, WIDTH, motion=motion)
    assert rms(image - box) < 0.012  # what the Gaussian shutter costs
    assert rms(plain(samples) - box) > 3 * rms(image - box)


def test_a_plane_that_comes_closer_is_sheared_at_first_order() -> None:
    texture = smooth_noise(12, contrast=0.25)
    motion = motion_of(8.0, (10.0, 4.0), depth_change=-0.3, principal_point=(WIDTH / 2, HEIGHT / 2))
    samples = sample([Plane(8.0, texture, motion=motion)], LENS, HEIGHT, WIDTH, 8)
    truth = exact_waves(texture, 8.0, LENS, HEIGHT, WIDTH, motion=motion)
    image, mask = run(samples)
    assert mask[INSIDE].all()
    assert rms(image - truth) < 0.015
    assert rms(plain(samples) - truth) > 3 * rms(image - truth)


def test_a_plane_in_focus_keeps_the_pixel_filter() -> None:
    texture = grating((0.11, 0.07))
    samples = sample([Plane(1.6, texture)], LENS, HEIGHT, WIDTH, 64)
    image, mask = run(samples)
    assert mask.all()
    assert rms(image - exact_waves(texture, 1.6, LENS, HEIGHT, WIDTH)) < 0.01


# Where it is not.


def test_an_edge_in_depth_is_the_plain_average() -> None:
    planes = [Plane(2.0, checker(5), disc((30, 24), 9)), Plane(8.0, smooth_noise(9))]
    samples = sample(planes, LENS, HEIGHT, WIDTH, 8)
    image, mask = run(samples)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    distance = np.abs(np.hypot(rows - 24, columns - 30) - 9)
    assert not mask[distance < 4].any()  # the disc's edge is 3 px wide: C = 3
    np.testing.assert_array_equal(image[~mask], plain(samples)[~mask])


def test_the_sides_of_an_edge_are_sheared_beyond_the_footprint() -> None:
    planes = [Plane(1.4, constant(1), half_plane((40, 0), (1, 0))), Plane(1.9, constant(0))]
    samples = sample(planes, LENS, HEIGHT, 80, 4)  # C = -2.1 and 2.4
    image, mask = run(samples)
    assert not mask[:, 36:44].any()
    assert mask[:, :30].all()
    assert mask[:, 50:].all()
    np.testing.assert_array_equal(image[:, :30], 0)
    np.testing.assert_allclose(image[:, 50:], 1, rtol=1e-5)


@pytest.mark.parametrize(("velocity", "alike"), [((10, 0), True), ((-10, 0), False), ((10, 4), False)])
def test_neighbours_must_move_alike(velocity: tuple[float, float], alike: bool) -> None:
    lens = LENS.refocus(8.0)
    right = Plane(8.0, checker(6), half_plane((40, 0), (1, 0)), motion=motion_of(8.0, velocity))
    samples = sample([right, Plane(8.001, checker(4), motion=motion_of(8.001, (10, 0)))], lens, HEIGHT, 80, 4)
    image, mask = run(samples)
    assert mask[:, 38:42].all() == alike
    assert mask[:, :10].all()
    if not alike:
        assert not mask[:, 38:42].any()
        np.testing.assert_array_equal(image[~mask], plain(samples)[~mask])


def test_tolerance_zero_shears_single_slopes_only() -> None:
    samples = sample([Plane(8.0, smooth_noise(9))], LENS, HEIGHT, WIDTH, 4)
    assert run(samples, tolerance=0.0)[1].all()
    uneven = replace(samples, depth=samples.depth * np.linspace(1, 1.01, WIDTH, dtype=np.float32)[:, None])
    assert not run(uneven, tolerance=0.0)[1].any()
    assert run(uneven)[1].all()


def test_wide_footprints_are_left_out() -> None:
    samples = sample([Plane(8.0, smooth_noise(9))], LENS, HEIGHT, WIDTH, 4)
    image, mask = run(samples, max_radius=20)  # 12 px of slope and 3 x 4 px of blur
    assert not mask.any()
    np.testing.assert_array_equal(image, plain(samples))
    assert run(samples, max_radius=25)[1].all()


def test_glossy_samples_are_not_shared_over_the_lens() -> None:
    samples = sample([Plane(8.0, smooth_noise(9))], LENS, HEIGHT, WIDTH, 4)
    matte = np.full(samples.depth.shape, np.inf, np.float32)
    np.testing.assert_array_equal(run(replace(samples, bandwidth=matte))[0], run(samples)[0])
    matte[20, 20, 1] = 0.2
    image, mask = run(replace(samples, bandwidth=matte))
    assert not mask[10:30, 10:30].any()
    np.testing.assert_array_equal(image[20, 20], plain(samples)[20, 20])


def test_what_passes_the_lens_is_the_plain_average() -> None:
    samples = sample([Plane(8.0, smooth_noise(9))], LENS, HEIGHT, WIDTH, 4)
    time = np.full(samples.depth.shape, 0.25, np.float32)
    motion = np.zeros(samples.color.shape, np.float32)
    motion[..., 2] = -32  # depth 16 at t = 0, -16 at t = 1
    image, mask = run(replace(samples, time=time, motion=motion))
    assert not mask.any()
    np.testing.assert_array_equal(image, plain(samples))


@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(1, 9),
    width=st.integers(1, 9),
    most=st.integers(-1, 12),
)
def test_bounds_of_windows(seed: int, height: int, width: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    bounds = rng.normal(size=(6, height, width)).astype(np.float32)
    radius = rng.integers(-1, most + 1, (height, width))
    result = sheared._window_bounds(bounds, radius)
    for row, column in np.ndindex(height, width):
        r = radius[row, column]
        window = bounds[:, max(row - r, 0) : row + r + 1, max(column - r, 0) : column + r + 1]
        expected = window.min(axis=(1, 2)) if r >= 0 else -np.inf
        np.testing.assert_array_equal(result[:, row, column], expected)


# What every method owes its user.


def moving_scene(spp: int = 4) -> SampleBuffer:
    planes = [
        Plane(4.0, checker(5), disc((20, 24), 12), motion=motion_of(4.0, (5.0, -3.0))),
        Plane(8.0, smooth_noise(9)),
    ]
    return sample(planes, LENS, HEIGHT, WIDTH, spp)


def test_a_constant_stays_constant_even_at_one_sample_per_pixel() -> None:
    for lens in (LENS, Lens(-24.0, 15.0, "disc", "square")):  # the disc leaves some pixels without samples
        samples = sample([Plane(8.0, constant(0.25, 3.0, 7e3))], lens, HEIGHT, WIDTH, 1)
        for radius in (1, 64):
            image = run(samples, max_radius=radius)[0]
            np.testing.assert_allclose(image, np.broadcast_to([0.25, 3.0, 7e3], image.shape), rtol=1e-5)


def test_place_in_the_arrays_does_not_matter() -> None:
    samples = moving_scene()
    order = np.random.default_rng(3).permutation(samples.depth.size)
    scattered = {
        name: getattr(samples, name)
        .reshape(samples.depth.size, -1)[order]
        .reshape(getattr(samples, name).shape)
        for name in samples.field_names()
    }
    image, mask = run(samples)
    other, other_mask = run(replace(samples, **scattered))
    np.testing.assert_array_equal(mask, other_mask)
    assert 0.1 < mask.mean() < 0.9
    np.testing.assert_allclose(other, image, atol=1e-5)


def test_result_does_not_depend_on_threads() -> None:
    samples = moving_scene()
    images = [run(samples, threads=threads)[0] for threads in (1, 2, 5)]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_lost_and_dropped_samples_raise_no_numerical_warnings() -> None:
    scattered = random_buffer(20, 24, 2, Lens(-20.0, 4.0), off_image=0.3)
    color = scattered.color.copy()
    color[3:9, 4:12] = np.nan
    with pytest.warns(UserWarning, match="dropped"):
        holed = SampleBuffer(scattered.xy, scattered.uv, scattered.depth, color, scattered.lens, nan="drop")
    gone = replace(scattered, xy=scattered.xy + 1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(run(holed)[0]).all()
        np.testing.assert_array_equal(run(gone)[0], 0)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"sigma_pix": 0.0}, "sigma_pix"),
        ({"sigma_pix": math.nan}, "sigma_pix"),
        ({"tolerance": -0.1}, "tolerance"),
        ({"max_radius": 0}, "max_radius"),
    ],
)
def test_bad_options(options: dict[str, Any], field: str) -> None:
    with pytest.raises(SampleError) as error:
        ShearedOptions(**options)
    assert error.value.field == field
