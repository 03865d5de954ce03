"""Scenes of planes against closed forms: where rays land, what blur does to waves and edges."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.errors import SampleError
from fewrays.lens import Lens, LensAperture, Sampling
from fewrays.sources.analytic import (
    PixelFilter,
    Plane,
    checker,
    constant,
    disc,
    exact_waves,
    grating,
    half_plane,
    reference,
    sample,
    smooth_noise,
    stripes,
    trace,
)


def _bessel_j1(z: float) -> float:
    terms = [
        (-1) ** k / (math.factorial(k) * math.factorial(k + 1)) * (z / 2) ** (2 * k + 1) for k in range(40)
    ]
    return math.fsum(terms)


@pytest.mark.parametrize("depth", [1.0, 2.0, 3.0, 40.0])
@pytest.mark.parametrize("frequency", [(0.03, 0.0), (0.02, -0.05)])
def test_a_disc_attenuates_a_grating_by_its_jinc(depth: float, frequency: tuple[float, float]) -> None:
    lens = Lens(-30.0, 15.0)
    z = 2 * math.pi * math.hypot(*frequency) * abs(-30 / depth + 15)
    jinc = 2 * _bessel_j1(z) / z if z else 1.0
    pixel = math.exp(-2 * (math.pi * 0.5 * math.hypot(*frequency)) ** 2)
    image = exact_waves(grating(frequency, amplitude=(0.4, 0.2, 0.1)), depth, lens, 6, 9)
    y, x = np.mgrid[:6, :9] + 0.5
    wave = np.cos(2 * np.pi * (frequency[0] * x + frequency[1] * y))
    expected = 0.5 + jinc * pixel * wave[..., None] * [0.4, 0.2, 0.1]
    np.testing.assert_allclose(image, expected, atol=1e-6)


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.15])
def test_a_narrow_gaussian_attenuates_a_grating_as_theory_says(sigma: float) -> None:
    lens = Lens(-30.0, 15.0, aperture="gaussian", sampling="gaussian", sigma=sigma)
    slope, frequency = -15.0, 0.04
    variance = 0.7**2 + (slope * sigma) ** 2
    image = exact_waves(grating((0.0, frequency)), 1.0, lens, 12, 3, sigma_pix=0.7)
    y = np.arange(12) + 0.5
    expected = 0.5 + 0.4 * math.exp(-2 * math.pi**2 * frequency**2 * variance) * np.cos(
        2 * np.pi * frequency * y
    )
    np.testing.assert_allclose(image[:, 1, 2], expected, atol=1e-6)


@pytest.mark.parametrize("aperture", ["disc", "gaussian"])
@pytest.mark.parametrize("pixel_filter", ["gaussian", "box"])
@pytest.mark.parametrize("depth", [1.2, 2.0, 9.0])
def test_references_tend_to_the_exact_image(
    aperture: LensAperture, pixel_filter: PixelFilter, depth: float
) -> None:
    lens = Lens(-40.0, 20.0, aperture=aperture, sampling="square")
    texture = smooth_noise(6, seed=3)
    image = reference([Plane(depth, texture)], lens, 20, 30, spp=256, pixel_filter=pixel_filter)
    exact = exact_waves(texture, depth, lens, 20, 30, pixel_filter=pixel_filter)
    # Plain random samples would leave 0.15 / √256 = 9e-3 at the most blurred depths.
    assert np.sqrt(np.square(image - exact).mean()) < 3e-3
    assert exact.std() > 0.015


@pytest.mark.parametrize("sampling", ["disc", "square", "gaussian"])
def test_weighted_samples_tend_to_the_exact_image(sampling: Sampling) -> None:
    lens = Lens(-40.0, 20.0, aperture="disc" if sampling == "disc" else "gaussian", sampling=sampling)
    texture = smooth_noise(8, seed=4)
    samples = sample([Plane(8.0, texture)], lens, 16, 16, 1024, seed=2)
    weights = lens.weights(samples.uv)[..., None]
    image = (samples.color * weights).sum(axis=2) / weights.sum(axis=2)
    exact = exact_waves(texture, 8.0, lens, 16, 16, pixel_filter="box")
    assert np.abs(image - exact).max() < 5e-3


def test_sharp_edges_spread_over_the_circle_of_confusion() -> None:
    # A white half-plane at slope -10 on black: its coverage is the disc's area beyond a chord.
    lens = Lens(-20.0, 10.0)
    planes = [Plane(1.0, constant(1), half_plane((20, 0), (1, 0))), Plane(50.0, constant(0))]
    image = reference(planes, lens, 4, 40, spp=1024, sigma_pix=0.0)
    t = np.clip((np.arange(40) + 0.5 - 20) / 10, -1, 1)
    coverage = 0.5 + (t * np.sqrt(1 - t**2) + np.arcsin(t)) / np.pi
    np.testing.assert_allclose(image, np.broadcast_to(coverage[:, None], (4, 40, 3)), atol=6e-3)


@given(
    x=st.floats(0, 64),
    y=st.floats(0, 64),
    u=st.floats(-0.7, 0.7),
    v=st.floats(-0.7, 0.7),
    z=st.floats(0.3, 9),
)
def test_rays_land_where_the_slope_says(x: float, y: float, u: float, v: float, z: float) -> None:
    lens = Lens(-12.0, 6.0)
    color, depth = trace(
        [Plane(z, lambda p: np.concatenate([p, p[..., :1]], axis=-1))], lens, [[x, y]], [[u, v]]
    )
    c = -12 / z + 6
    np.testing.assert_allclose(color, [[x - c * u, y - c * v, x - c * u]], atol=1e-4)
    assert depth[0] == np.float32(z)


def test_the_nearest_plane_that_is_there_wins_in_any_order() -> None:
    lens = Lens(-10.0, 5.0)
    planes = [
        Plane(9.0, constant(0.1)),
        Plane(1.0, constant(0.9), disc((8, 8), 3)),
        Plane(2.0, constant(0.5), stripes(4)),
    ]
    centre = np.zeros((3, 2))
    color, depth = trace(planes, lens, [[8.5, 8.5], [12.5, 1], [15.5, 1]], centre)
    np.testing.assert_array_equal(depth, [1, 2, 9])
    np.testing.assert_allclose(color[:, 0], [0.9, 0.5, 0.1], rtol=1e-6)
    # From the rim the near disc, at slope -5, moves out of the way; the focused stripes stay.
    _, shifted = trace(planes, lens, [[8.5, 8.5], [12.5, 1], [15.5, 1]], np.array([1.0, 0]) + centre)
    np.testing.assert_array_equal(shifted, [2, 2, 9])


def test_textures_and_masks_by_hand() -> None:
    points = np.array([[0.5, 0.5], [2.5, 0.5], [-0.5, 0.5], [2.5, 2.5]])
    light_dark = np.asarray(checker(2, dark=(0, 0, 0), light=(1, 2, 3))(points))
    np.testing.assert_array_equal(light_dark, [[1, 2, 3], [0, 0, 0], [0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(constant(1, 2, 3)(points[:1]), [[1, 2, 3]])
    np.testing.assert_array_equal(constant(4)(points[:1]), [[4, 4, 4]])
    np.testing.assert_array_equal(disc((2, 2), 1)(points), [False, False, False, True])
    np.testing.assert_array_equal(half_plane((1, 0), (-1, 0))(points), [True, False, True, False])
    np.testing.assert_array_equal(stripes(4, fill=0.25)(points), [True, False, False, False])
    np.testing.assert_array_equal(stripes(4, direction=(0, 5))(points), [True, True, True, False])


def test_smooth_noise_has_the_contrast_and_band_asked_for() -> None:
    texture = smooth_noise(5, mean=(0.2, 0.4, 0.6), contrast=0.1, seed=1)
    values = texture(np.random.default_rng(0).uniform(0, 1e5, (200_000, 2)))
    np.testing.assert_allclose(values.mean(axis=0), [0.2, 0.4, 0.6], atol=2e-3)
    np.testing.assert_allclose(values.std(axis=0), 0.1, rtol=0.02)
    periods = 1 / np.hypot(*texture.frequency.T)
    assert periods.min() >= 5
    assert periods.max() <= 40


def test_seeds() -> None:
    planes, lens = [Plane(4.0, checker(3))], Lens(-10.0, 5.0)
    first, again, other = (sample(planes, lens, 5, 6, 4, seed=seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.xy, again.xy)
    np.testing.assert_array_equal(first.color, again.color)
    assert (first.uv != other.uv).any()


def test_each_sample_is_in_its_own_pixel() -> None:
    samples = sample([Plane(4.0, constant(1))], Lens(-10.0, 5.0), 7, 300, 16)
    rows, columns = np.mgrid[:7, :300]
    np.testing.assert_array_equal(
        np.floor(samples.xy[..., 0]), np.broadcast_to(columns[..., None], (7, 300, 16))
    )
    np.testing.assert_array_equal(
        np.floor(samples.xy[..., 1]), np.broadcast_to(rows[..., None], (7, 300, 16))
    )


def test_references_take_bounded_memory() -> None:
    planes = [Plane(1.0, constant(1), disc((16, 16), 8)), Plane(4.0, constant(0.5))]
    tracemalloc.start()
    try:
        reference(planes, Lens(-10.0, 5.0), 32, 32, spp=2048)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 40e6  # the positions alone, all at once, would be 34 MB, and 67 MB while they are traced


@pytest.mark.parametrize("planes", [[], [Plane(1.0, constant(1)), Plane(2.0, constant(1), disc((0, 0), 1))]])
def test_every_ray_must_end_somewhere(planes: list[Plane]) -> None:
    with pytest.raises(SampleError, match=r"^planes: .*cover"):
        sample(planes, Lens(-10.0, 5.0), 4, 4, 1)


@pytest.mark.parametrize("depth", [0.0, -1.0, math.nan, math.inf])
def test_bad_depths(depth: float) -> None:
    with pytest.raises(SampleError, match=r"^plane\.depth: "):
        Plane(depth, constant(1))


def test_bad_sizes_and_filters() -> None:
    planes, lens = [Plane(4.0, constant(1))], Lens(-10.0, 5.0)
    with pytest.raises(SampleError, match=r"^spp: .*0"):
        sample(planes, lens, 4, 4, 0)
    with pytest.raises(SampleError, match=r"^width: .*-2"):
        reference(planes, lens, 4, -2)
    with pytest.raises(SampleError, match=r"^pixel_filter: .*'tent'"):
        reference(planes, lens, 4, 4, pixel_filter="tent")  # type: ignore[arg-type]
    with pytest.raises(SampleError, match=r"^sigma_pix: .*nan"):
        exact_waves(grating((0.1, 0)), 1.0, lens, 4, 4, sigma_pix=math.nan)
