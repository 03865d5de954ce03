"""The aperture's parts, and its second moment."""

from __future__ import annotations

import numpy as np
import pytest

from fewrays import Lens
from fewrays.layered.aperture import ApertureParts, aperture_variance
from fewrays.sources.patterns import sample_pattern

COUNTS = ApertureParts.COUNTS


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("variance", [0.01, 0.25])
def test_parts_have_the_moments_of_the_aperture(count: int, variance: float) -> None:
    aperture = ApertureParts.split(variance, count)
    assert aperture.parts.shape == (count, 3)
    weight = aperture.parts[:, 2].astype(np.float64)
    assert weight.sum() == pytest.approx(1, abs=1e-6)
    centers = aperture.parts[:, :2].astype(np.float64)
    np.testing.assert_allclose(weight @ centers, 0, atol=1e-7)
    np.testing.assert_allclose(weight @ centers**2 + aperture.sigma**2, variance, rtol=1e-6)
    assert weight @ centers.prod(axis=1) == pytest.approx(0, abs=1e-7)


@pytest.mark.parametrize("count", COUNTS)
def test_parts_add_up_to_a_gaussian(count: int) -> None:
    """All over the lens, to within 7.5 % of its peak."""
    aperture = ApertureParts.split(0.25, count)
    axis = np.linspace(-2, 2, 81)
    u = np.stack(np.meshgrid(axis, axis), axis=-1)
    distance2 = ((u[..., None, :] - aperture.parts[:, :2]) ** 2).sum(axis=-1)
    mixture = np.exp(-0.5 * distance2 / aperture.sigma**2) @ aperture.parts[:, 2] * (0.25 / aperture.sigma**2)
    assert np.abs(mixture - np.exp(-2 * (u**2).sum(axis=-1))).max() < 0.075


@pytest.mark.parametrize("count", COUNTS)
def test_central_weight_is_that_of_the_parts_on_an_axis(count: int) -> None:
    aperture = ApertureParts.split(0.25, count)
    on_axis = [aperture.parts[aperture.parts[:, axis] == 0, 2].sum() for axis in (0, 1)]
    assert np.mean(on_axis) == pytest.approx(aperture.central_weight)


@pytest.mark.parametrize("count", COUNTS)
def test_parts_look_the_same_from_six_sides(count: int) -> None:
    u, v, _ = ApertureParts.split(0.25, count).parts.T
    centers = u + 1j * v
    turned = centers * np.exp(1j * np.pi / 3)
    assert np.abs(turned[:, None] - centers).min(axis=1).max() < 1e-6


def test_parts_are_narrower_the_more_there_are() -> None:
    sigmas = [ApertureParts.split(0.25, count).sigma for count in COUNTS]
    assert sigmas[0] == 0.5
    assert (np.diff(sigmas) < 0).all()


@pytest.mark.parametrize(
    "lens",
    [
        Lens(-1, 1, "disc", "disc"),
        Lens(-1, 1, "gaussian", "square"),
        Lens(-1, 1, "gaussian", "disc", 0.2),
        Lens(-1, 1, "gaussian", "gaussian", 0.5),
        Lens(-1, 1, "gaussian", "gaussian", 20.0),
    ],
    ids=lambda lens: f"{lens.aperture}-{lens.sigma:.2g}",
)
def test_variance_is_that_of_rays_through_the_aperture(lens: Lens) -> None:
    _, uv = sample_pattern(64, 64, 16, seed=1, sampling=lens.aperture, sigma=lens.sigma)
    assert aperture_variance(lens) == pytest.approx(np.square(uv.astype(np.float64)).mean(), rel=0.005)


def test_variance_does_not_depend_on_how_the_lens_was_sampled() -> None:
    variances = {
        aperture_variance(Lens(-1, 1, "disc", sampling)) for sampling in ("disc", "square", "gaussian")
    }
    assert variances == {0.25}
