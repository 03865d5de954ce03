"""Filters and partitions against the paper's equations, and the native twin against the Python one."""

from __future__ import annotations

import itertools
from typing import Literal

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fewrays import Lens, _native
from fewrays.layered.filters import FilterRule, LayerFilter, lens_moment, screen_taps
from fewrays.layered.kernel import native_rule
from fewrays.layered.partitions import Layer, Partitions, active_layers, occlusion
from fewrays.lens import Sampling

SAMPLINGS: tuple[Sampling, ...] = ("disc", "square", "gaussian")
FAMILIES: tuple[Literal["paper", "matched", "axis-aligned"], ...] = ("paper", "matched", "axis-aligned")

slopes = st.floats(-200, 200, width=32)


def rule(
    family: Literal["paper", "matched", "axis-aligned"] = "paper",
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
        filter_ = rule("matched").filter(near_zero * 1e-30, c_max)
        assert filter_.eta == pytest.approx(0.0, abs=1e-6)
        assert np.isfinite([filter_.variance, filter_.falloff]).all()


class TestMatched:
    @given(slopes, slopes, st.sampled_from(SAMPLINGS))
    def test_point_gets_the_variance_of_pixel_and_aperture(
        self, a: float, b: float, sampling: Sampling
    ) -> None:
        """The image of a point at the layer's central slope, to the second moment."""
        c_min, c_max = min(a, b), max(a, b)
        filter_ = rule("matched", sampling).filter(c_min, c_max)
        small = max(-c_min, c_max) < 1.5
        if small:
            center = (c_min + c_max) / 2
        else:
            center = 0.0 if c_min * c_max <= 0 else 2 * c_min * c_max / (c_min + c_max)
        precision = 2 * filter_.falloff + (9.0 if sampling == "gaussian" else 0.0)
        residual = (center - filter_.eta) ** 2 * lens_moment(precision, sampling)
        expected = 0.25 + center**2 * lens_moment(9.0, "square")
        assert filter_.variance + residual == pytest.approx(expected)

    @given(slopes, slopes)
    def test_importance_samples_are_never_weighted_up(self, a: float, b: float) -> None:
        assert rule("matched", "gaussian").filter(min(a, b), max(a, b)).falloff >= 0


def test_axis_aligned_width_follows_the_nearest_slope() -> None:
    axis_aligned = rule("axis-aligned")
    assert axis_aligned.filter(12.0, 20.0).variance == pytest.approx((12 / 3 / 2) ** 2)
    assert axis_aligned.filter(-20.0, -12.0).variance == axis_aligned.filter(12.0, 20.0).variance
    assert axis_aligned.filter(-1.0, 20.0).variance == pytest.approx(0.25)
    assert axis_aligned.filter(12.0, 20.0).eta == 0.0


@pytest.mark.parametrize("precision", [0.0, 1e-6, 1e-3, 0.0199, 0.0201, 0.049, 0.051, 1.0, 9.0, 400.0])
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_lens_moment_is_the_integral(precision: float, sampling: Sampling) -> None:
    if sampling == "disc":
        r = (np.arange(200_000) + 0.5) / 200_000
        density = r * np.exp(-0.5 * precision * r**2)
        expected = 0.5 * (density * r**2).sum() / density.sum()
    else:
        u = (np.arange(200_000) + 0.5) / 100_000 - 1
        density = np.exp(-0.5 * precision * u**2)
        expected = (density * u**2).sum() / density.sum()
    assert lens_moment(precision, sampling) == pytest.approx(expected, rel=1e-7)


@given(st.floats(0.0625, 64.0), st.sampled_from([16, 32]))
def test_kernel_and_bins_have_the_variance_asked_for(variance: float, ring: int) -> None:
    kernel = rule("matched").kernel(variance, ring)
    distance = np.arange(-kernel.radius, kernel.radius + 1) / kernel.bins_per_pixel
    taps = np.concatenate([kernel.taps[:0:-1], kernel.taps])
    bins = 1 / kernel.bins_per_pixel**2 / 12
    assert taps @ distance**2 + bins == pytest.approx(variance, rel=1e-6)
    assert kernel.radius <= ring * kernel.bins_per_pixel


@pytest.mark.parametrize(("sigma", "bins_per_pixel"), [(0.5, 5), (0.6, 3), (1.5, 3), (1.7, 1), (8.0, 1)])
def test_bins_are_finer_than_the_filter(sigma: float, bins_per_pixel: int) -> None:
    assert rule("matched").kernel(sigma**2, 16).bins_per_pixel == bins_per_pixel
    assert rule("paper").kernel(sigma**2, 16).bins_per_pixel == 1


@given(st.floats(0.01, 80.0), st.integers(4, 40))
def test_exact_taps_have_the_variance_asked_for(variance: float, ring: int) -> None:
    assume(variance < ring * (ring + 1) / 3 * 0.999)
    taps = screen_taps(variance, ring, exact=True)
    kernel = np.concatenate([taps[:0:-1], taps])
    assert kernel.sum() == pytest.approx(1.0)
    assert kernel @ np.arange(-ring, ring + 1) ** 2 == pytest.approx(variance, rel=1e-6)


def test_taps_of_a_width_that_does_not_fit_are_a_box() -> None:
    np.testing.assert_allclose(screen_taps(1000.0, 4, exact=True), np.full(5, 1 / 9))


def test_taps_of_no_width_are_a_point() -> None:
    np.testing.assert_array_equal(screen_taps(0.0, 3, exact=True), [1, 0, 0, 0])


class TestNativeTwin:
    @given(
        slopes,
        slopes,
        st.sampled_from(FAMILIES),
        st.sampled_from(SAMPLINGS),
        st.floats(0.5, 32.0),
        st.floats(0, 1),
    )
    def test_filters(
        self,
        a: float,
        b: float,
        family: Literal["paper", "matched", "axis-aligned"],
        sampling: Sampling,
        max_sigma_x: float,
        occlusion: float,
    ) -> None:
        python = rule(family, sampling, max_sigma_x)
        expected = python.filter(min(a, b), max(a, b), occlusion)
        actual = _native.layer_filter(min(a, b), max(a, b), occlusion, native_rule(python))
        np.testing.assert_allclose(
            actual, [expected.eta, expected.variance, expected.falloff], rtol=1e-9, atol=1e-12
        )

    @given(st.floats(0.06, 100.0), st.integers(1, 40), st.sampled_from(FAMILIES))
    def test_taps(
        self, variance: float, ring: int, family: Literal["paper", "matched", "axis-aligned"]
    ) -> None:
        expected = rule(family).kernel(variance, ring)
        native = _native.FilterFamily(FAMILIES.index(family))
        bins_per_pixel, taps = _native.layer_taps(variance, ring, native)
        assert bins_per_pixel == expected.bins_per_pixel
        np.testing.assert_allclose(taps, expected.taps, atol=1e-6)


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

    def test_counts_samples(self) -> None:
        assert [layer.count for layer in active_layers(self.partition, self.slope, None)] == [2, 1, 2, 1]
        assert [layer.count for layer in active_layers(self.partition, self.slope, 1)] == [6]


class TestOcclusion:
    @staticmethod
    def layers(*slopes: float) -> list[Layer]:
        return [Layer(i, i, c, c, 10) for i, c in enumerate(slopes)]

    def test_nothing_covers_the_front(self) -> None:
        assert occlusion(self.layers(-20.0, 5.0), 0) == 0

    def test_a_cover_of_another_slope_counts_in_full(self) -> None:
        assert occlusion(self.layers(-20.0, 5.0), 1) == pytest.approx(0.5)

    def test_a_cover_of_the_same_slope_does_not_count(self) -> None:
        assert occlusion(self.layers(20.0, 20.0), 1) == 0
        assert occlusion(self.layers(16.0, 20.0), 1) == pytest.approx(0.5 * 0.5 * 4 / 20)

    @given(st.floats(0, 1))
    def test_limit_falls_from_open_to_covered(self, share: float) -> None:
        lens = Lens(-1.0, 1.0, aperture="gaussian", sampling="square")
        limited = FilterRule.for_lens(lens, "matched", sigma_pix=0.5, max_sigma_x=8.0, occluded_sigma_x=2.0)
        assert 2.0 <= limited.sigma_x_limit(share) <= 8.0
        assert limited.sigma_x_limit(0.0) == 8.0
        assert limited.sigma_x_limit(0.5) == 2.0
