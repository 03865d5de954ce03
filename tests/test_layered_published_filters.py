"""Filters and partitions against the paper's equations, and the native twin against the Python one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import Lens, _native
from fewrays.layered_published.filters import FilterFamily, FilterRule, LayerFilter, layer_taps
from fewrays.layered_published.kernel import native_rule
from fewrays.layered_published.partitions import Partitions, active_layers
from fewrays.lens import Sampling

SAMPLINGS: tuple[Sampling, ...] = ("disc", "square", "gaussian")
FAMILIES: tuple[FilterFamily, ...] = ("sheared", "axis-aligned")

slopes = st.floats(-200, 200, width=32)


def rule(
    family: FilterFamily = "sheared",
    sampling: Sampling = "square",
    max_sigma_x: float = 8.0,
) -> FilterRule:
    lens = Lens(-1.0, 1.0, aperture="gaussian", sampling=sampling)
    return FilterRule.for_lens(lens, family, sigma_pix=0.5, max_sigma_x=max_sigma_x)


def lens_sigma(filter_: LayerFilter) -> float:
    return float(1 / np.sqrt(2 * filter_.falloff))


class TestSheared:
    @pytest.mark.parametrize(("c_min", "c_max"), [(4.0, 6.0), (12.0, 40.0), (-9.0, -2.0), (1.6, 30.0)])
    def test_transformed_axes_leave_the_filter_as_it_is(self, c_min: float, c_max: float) -> None:
        """Eq. 21: NᵀN = MᵀM, with M of Eq. 18 (Eq. 12, 13, 16) and u negated to this project's signs."""
        sigma_u = 1 / 3
        bandlimit = 1 / (2 * np.pi * sigma_u)
        sigma_x = 1 / (np.pi * bandlimit * abs(1 / c_min - 1 / c_max))
        c_avg = 2 * c_min * c_max / (c_min + c_max)
        m = np.diag([sigma_x, sigma_u]) @ [[1, 1 / c_avg], [0, 1]]

        filter_ = rule(max_sigma_x=1e9).filter(c_min, c_max)
        n = np.diag([np.sqrt(filter_.variance), lens_sigma(filter_)]) @ [[1, 0], [filter_.eta, 1]]
        np.testing.assert_allclose(n.T @ n, m.T @ m, rtol=1e-9)

    def test_small_shear(self) -> None:
        """Eq. 27 and 29."""
        filter_ = rule().filter(0.25, 1.25)
        assert filter_.eta == 0.75
        assert filter_.variance == 0.25
        assert lens_sigma(filter_) == pytest.approx(2 * 0.5 / (1.25 - 0.25))

    def test_wide_wedge_is_the_simple_filter(self) -> None:
        """Eq. 11."""
        filter_ = rule().filter(-3.0, 5.0)
        assert (filter_.eta, filter_.variance) == (0.0, 0.25)
        assert lens_sigma(filter_) == pytest.approx(1 / 3)

    def test_single_slope_is_limited_by_max_sigma_x(self) -> None:
        filter_ = rule().filter(24.0, 24.0)
        s = 8.0 / 24.0
        assert filter_.eta == pytest.approx(s * 8.0 / (1 / 9 + s**2))

    @given(slopes, slopes, st.sampled_from(SAMPLINGS))
    def test_screen_filter_is_never_narrower_than_the_pixel(
        self, a: float, b: float, sampling: Sampling
    ) -> None:
        assert rule(sampling=sampling).filter(min(a, b), max(a, b)).variance >= 0.25 * (1 - 1e-12)

    @given(st.floats(0.0, 1.5), st.floats(1.5, 60.0))
    def test_range_that_ends_at_the_focal_plane_has_no_pole(self, near_zero: float, c_max: float) -> None:
        filter_ = rule().filter(near_zero * 1e-30, c_max)
        assert filter_.eta == pytest.approx(0.0, abs=1e-6)
        assert np.isfinite([filter_.variance, filter_.falloff]).all()

    @given(slopes, slopes)
    def test_importance_samples_are_never_weighted_up(self, a: float, b: float) -> None:
        assert rule(sampling="gaussian").filter(min(a, b), max(a, b)).falloff >= 0

    def test_disc_has_the_filter_of_the_gaussian_of_equal_second_moment(self) -> None:
        """A disc's second moment along one axis is a quarter."""
        disc = FilterRule.for_lens(Lens(-1.0, 1.0, "disc", "disc"), "sheared", sigma_pix=0.5, max_sigma_x=8.0)
        gaussian = FilterRule.for_lens(
            Lens(-1.0, 1.0, "gaussian", "disc", sigma=0.5), "sheared", sigma_pix=0.5, max_sigma_x=8.0
        )
        assert disc.filter(4.0, 6.0) == gaussian.filter(4.0, 6.0)


def test_axis_aligned_width_follows_the_nearest_slope() -> None:
    axis_aligned = rule("axis-aligned")
    assert axis_aligned.filter(12.0, 20.0).variance == pytest.approx((12 / 3 / 2) ** 2)
    assert axis_aligned.filter(-20.0, -12.0).variance == axis_aligned.filter(12.0, 20.0).variance
    assert axis_aligned.filter(-1.0, 20.0).variance == pytest.approx(0.25)
    assert axis_aligned.filter(12.0, 20.0).eta == 0.0


@given(st.floats(0.25, 64.0), st.integers(1, 32))
def test_taps_are_the_sampled_gaussian(variance: float, ring: int) -> None:
    """Reaching over the whole ring and summing to one."""
    taps = layer_taps(variance, ring)
    assert len(taps) == ring + 1
    assert taps[0] + 2 * taps[1:].sum() == pytest.approx(1.0)
    expected = np.exp(-(np.arange(ring + 1) ** 2) / (2 * variance))
    np.testing.assert_allclose(taps / taps[0], expected, rtol=1e-12, atol=1e-300)


class TestNativeTwin:
    @given(slopes, slopes, st.sampled_from(FAMILIES), st.sampled_from(SAMPLINGS), st.floats(0.5, 32.0))
    def test_filters(
        self, a: float, b: float, family: FilterFamily, sampling: Sampling, max_sigma_x: float
    ) -> None:
        python = rule(family, sampling, max_sigma_x)
        expected = python.filter(min(a, b), max(a, b))
        actual = _native.layer_filter(min(a, b), max(a, b), native_rule(python))
        np.testing.assert_allclose(
            actual, [expected.eta, expected.variance, expected.falloff], rtol=1e-9, atol=1e-12
        )

    @given(st.floats(0.06, 100.0), st.integers(1, 40))
    def test_taps(self, variance: float, ring: int) -> None:
        np.testing.assert_allclose(_native.layer_taps(variance, ring), layer_taps(variance, ring), atol=1e-7)


class TestPartitions:
    def test_published_boundaries(self) -> None:
        """With sigma_u = 1/3 and 8 px boundaries lie at |C| = 12 / k px, rounded to bins of half a pixel."""
        partitions = Partitions.of_constant_energy(15, sigma_u=1 / 3, sigma_x=8.0, bin_size=0.5)
        slopes = np.arange(-20, 20, 0.25, dtype=np.float32) + np.float32(0.125)
        changes = slopes[1:][np.diff(partitions.of_slope(slopes).astype(int)) != 0] - 0.125
        one_side = [1, 1.5, 2, 2.5, 3, 4, 6, 12]
        np.testing.assert_array_equal(changes, [-c for c in reversed(one_side)] + [0] + one_side)

    def test_worst_case_filters_have_equal_energy(self) -> None:
        """sigma_x of Eq. 16 is the same for every bounded partition, when bins are fine."""
        partitions = Partitions.of_constant_energy(15, sigma_u=1 / 3, sigma_x=8.0, bin_size=1e-4)
        changes = partitions.first_bin + 1 + np.flatnonzero(np.diff(partitions.table.astype(int)))
        boundaries = [b * 1e-4 for b in changes if b > 0]
        for c_min, c_max in itertools.pairwise(boundaries):
            assert 2 / 3 / (1 / c_min - 1 / c_max) == pytest.approx(8.0, rel=5e-3)

    @given(st.lists(slopes, min_size=1, max_size=50), st.integers(1, 30), st.sampled_from([0.125, 0.5, 1.0]))
    def test_partitions_are_ordered_front_to_back(
        self, cs: list[float], per_side: int, bin_size: float
    ) -> None:
        partitions = Partitions.of_constant_energy(per_side, sigma_u=0.5, sigma_x=8.0, bin_size=bin_size)
        index = partitions.of_slope(np.sort(np.array(cs, np.float32)))
        assert (np.diff(index.astype(int)) >= 0).all()
        assert index.max() < partitions.count

    def test_extreme_slopes_fall_into_the_end_partitions(self) -> None:
        partitions = Partitions.of_constant_energy(15, sigma_u=1 / 3, sigma_x=8.0, bin_size=0.5)
        assert partitions.of_slope(np.array([-3e38, 3e38], np.float32)).tolist() == [0, partitions.count - 1]


class TestActiveLayers:
    partition = np.array([2, 2, 5, 7, 7, 9], np.uint8)
    slope = np.array([-6.0, -5.0, 0.2, 4.0, 4.5, 13.0], np.float32)

    def test_layers_are_the_partitions_with_samples(self) -> None:
        layers = active_layers(self.partition, self.slope, None)
        assert [(layer.first, layer.c_min, layer.c_max) for layer in layers] == [
            (2, -6.0, -5.0),
            (5, pytest.approx(0.2), pytest.approx(0.2)),
            (7, 4.0, 4.5),
            (9, 13.0, 13.0),
        ]

    def test_joins_where_the_filter_suffers_least(self) -> None:
        # 1/4 - 1/13 is the narrowest range of 1/c on one side of the focal plane.
        layers = active_layers(self.partition, self.slope, 3)
        assert [(layer.first, layer.last) for layer in layers] == [(2, 2), (5, 5), (7, 9)]

    @pytest.mark.parametrize("limit", [1, 2, 3, 4, 5])
    def test_keeps_to_the_limit_and_loses_no_slope(self, limit: int) -> None:
        layers = active_layers(self.partition, self.slope, limit)
        assert len(layers) == min(limit, 4)
        assert (layers[0].c_min, layers[-1].c_max) == (-6.0, 13.0)
