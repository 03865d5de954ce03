"""Depth layers: where they begin and end, and which bins they get."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.layered.slabs import Slabs

SIGMA_PIX, SIGMA_U, PART_SIGMA = 0.5, 0.5, 0.27

spacings = st.floats(0.05, 1.0)
slopes = st.floats(-(2.0**15), 2.0**15, width=32)


def covering(c_min: float, c_max: float, spacing: float = 0.16) -> Slabs:
    return Slabs.covering(
        c_min, c_max, spacing=spacing, sigma_pix=SIGMA_PIX, sigma_u=SIGMA_U, part_sigma=PART_SIGMA
    )


@given(ends=st.tuples(slopes, slopes), spacing=spacings)
def test_there_is_one_boundary_between_two_layers(ends: tuple[float, float], spacing: float) -> None:
    slabs = covering(min(ends), max(ends), spacing)
    assert slabs.count == len(slabs.levels) == len(slabs.reaches) == len(slabs.boundaries) + 1
    assert (np.diff(slabs.boundaries) > 0).all()


@given(ends=st.tuples(slopes, slopes), spacing=spacings, seed=st.integers(0, 100))
def test_reach_holds_for_every_sample_of_a_layer(
    ends: tuple[float, float], spacing: float, seed: int
) -> None:
    slabs = covering(min(ends), max(ends), spacing)
    slope = np.random.default_rng(seed).uniform(min(ends), max(ends), 500).astype(np.float32)
    slope = np.concatenate([slope, slabs.boundaries, np.nextafter(slabs.boundaries, np.float32(-np.inf))])
    slope = np.clip(slope, min(ends), max(ends))
    assert (np.abs(slope) <= slabs.reaches[slabs.of_slope(slope)]).all()


@given(ends=st.tuples(slopes, slopes), spacing=spacings)
def test_layers_are_as_thick_as_asked(ends: tuple[float, float], spacing: float) -> None:
    boundaries = covering(min(ends), max(ends), spacing).boundaries.astype(np.float64)
    blur = boundaries * SIGMA_U
    steps = np.diff(np.arcsinh(blur / 2))
    sides = np.abs(np.stack([blur[:-1], blur[1:]]))
    wide, narrow = (sides >= 8).all(axis=0), (sides <= 8).all(axis=0)
    np.testing.assert_allclose(steps[narrow], spacing, rtol=1e-4)
    np.testing.assert_allclose(steps[wide], 2 * spacing, rtol=1e-4)
    between = steps[~(narrow | wide)]
    assert ((between > (1 - 1e-4) * spacing) & (between < 2.0002 * spacing)).all()


@pytest.mark.parametrize("spacing", [0.05, 0.16, 1.0])
def test_one_layer_is_centred_on_the_focal_plane(spacing: float) -> None:
    slabs = covering(-50, 80, spacing)
    focus = int(slabs.of_slope(np.zeros(1, np.float32))[0])
    assert slabs.boundaries[focus - 1] == pytest.approx(-slabs.boundaries[focus])
    assert slabs.boundaries[focus] == pytest.approx(2 / SIGMA_U * np.sinh(spacing / 2), rel=1e-6)
    assert slabs.levels[focus] == -2


def test_boundary_belongs_to_the_layer_behind() -> None:
    slabs = covering(-20, 30)
    np.testing.assert_array_equal(slabs.of_slope(slabs.boundaries), np.arange(1, slabs.count))
    in_front = np.nextafter(slabs.boundaries, np.float32(-np.inf))
    np.testing.assert_array_equal(slabs.of_slope(in_front), np.arange(slabs.count - 1))


def test_smaller_numbers_are_in_front() -> None:
    slabs = covering(-20, 30)
    layers = slabs.of_slope(np.linspace(-20, 30, 1000, dtype=np.float32))
    assert (np.diff(layers) >= 0).all()
    assert layers[0] == 0
    assert layers[-1] == slabs.count - 1


@given(ends=st.tuples(slopes, slopes), spacing=spacings)
def test_bins_grow_with_the_distance_from_focus(ends: tuple[float, float], spacing: float) -> None:
    slabs = covering(min(ends), max(ends), spacing)
    middle = np.diff(np.concatenate([[min(ends)], slabs.boundaries, [max(ends)]])) / 2
    center = np.concatenate([[min(ends)], slabs.boundaries]) + middle
    front, behind = slabs.levels[center < 0], slabs.levels[center > 0]
    assert (np.diff(front) <= 0).all()
    assert (np.diff(behind) >= 0).all()


def test_bins_are_no_wider_than_the_blur() -> None:
    """Or by a fifth at most; nor half as wide, a waste. The blur is that of one part of the aperture."""
    slabs = covering(-2000, 2000)
    inner = np.arange(1, slabs.count - 1)
    center = (slabs.boundaries[:-1] + slabs.boundaries[1:]).astype(np.float64) / 2
    sigmas = np.hypot(SIGMA_PIX, center * PART_SIGMA) / 2.0 ** np.maximum(slabs.levels[inner], 0)
    coarse = slabs.levels[inner] > 0
    assert (sigmas[coarse] > 0.98 * 2**-0.25).all()
    assert (sigmas[coarse] < 2.02 * 2**-0.25).all()
    assert slabs.levels.max() == 9


def test_fine_bins_are_for_layers_blurred_less_than_a_pixel() -> None:
    slabs = covering(-20, 20)
    blur = slabs.reaches * SIGMA_U
    assert (slabs.levels[blur < 0.25] == -2).all()
    assert (slabs.levels[(blur > 0.45) & (blur < 0.75)] == -1).all()
    assert (slabs.levels[blur > 1.3] >= 0).all()


@pytest.mark.parametrize("slope", [0.0, -3.0, 2.0**15])
def test_one_slope_needs_one_layer(slope: float) -> None:
    slabs = covering(slope, slope)
    assert slabs.count == 1
    assert slabs.reaches[0] == abs(slope)


def test_number_of_layers_grows_with_the_logarithm_of_blur() -> None:
    counts = [covering(-c, c).count for c in (10.0, 100.0, 1000.0, 10000.0)]
    growth = 2 * np.log(10) / (2 * 0.16)
    np.testing.assert_allclose(np.diff(counts[1:]), growth, atol=2.1)
