"""Pixel filters: values, moments, and offsets that integrate under the filter."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import SampleError
from fewrays.pixel_filter import PixelFilter

Float64 = npt.NDArray[np.float64]

FILTERS = (
    PixelFilter("box"),
    PixelFilter("gaussian"),
    PixelFilter("gaussian", sigma_pix=0.01),
    PixelFilter("gaussian", sigma_pix=1.7),
    PixelFilter("blackman-harris"),
    PixelFilter("mitchell"),
)
MIDDLES = (np.arange(2**14) + 0.5) / 2**14


def variance(pixel_filter: PixelFilter) -> float:
    """Second moment of a filter along one axis in pixels², in closed form."""
    if pixel_filter.shape == "box":
        return 1 / 12
    if pixel_filter.shape == "mitchell":
        return 1 / 9  # B / 3 on the line 2 C + B = 1: 0 for Catmull-Rom, 1/3 for the cubic B-spline
    if pixel_filter.shape == "blackman-harris":
        terms = -0.48829 + 0.14128 / 4 - 0.01168 / 9  # the integral of x² cos(j π x / R) is ±4 R³ / (j π)²
        return 4 / 3 + 8 * terms / (math.pi**2 * 0.35875)
    sigma = pixel_filter.sigma_pix
    end = max(1.5 / sigma, 3.0)
    tail = math.sqrt(2 / math.pi) * end * math.exp(-0.5 * end**2) / math.erf(end / math.sqrt(2))
    return sigma**2 * (1 - tail)


def integral(pixel_filter: PixelFilter, low: float, high: float) -> float:
    """Integral of a filter's magnitude between positions, by Gauss-Legendre quadrature between its kinks."""
    zero = 8 / 7  # where the outer cubic of Mitchell and Netravali crosses 0, besides the double root at 2
    kinks = sorted({low, high, *(k for k in (-2, -zero, -1, 0, 1, zero, 2) if low < k < high)})
    nodes, weights = np.polynomial.legendre.leggauss(40)
    return sum(
        float((b - a) / 2 * (weights * np.abs(pixel_filter.weight((a + b + (b - a) * nodes) / 2))).sum())
        for a, b in pairwise(kinks)
    )


def test_values() -> None:
    mitchell = PixelFilter("mitchell")
    assert mitchell.weight([0, 0.5, 1, 8 / 7, 1.5, 2, -0.5]) == pytest.approx(
        [8 / 9, 77 / 144, 1 / 18, 0, -5 / 144, 0, 77 / 144], abs=1e-15
    )
    window = PixelFilter("blackman-harris")
    assert window.weight([0, 1, -2]) == pytest.approx([1, 0.35875 - 0.14128, 6e-5])
    assert PixelFilter("gaussian", sigma_pix=0.5).weight([0.5, -1]) == pytest.approx(np.exp([-0.5, -2]))
    assert PixelFilter().weight([[-0.5, 0.4], [0.0, 0.5]]).tolist() == [[1, 1], [1, 1]]


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=repr)
def test_filters_end_at_their_radius(pixel_filter: PixelFilter) -> None:
    radius = pixel_filter.radius
    assert (pixel_filter.weight([-1.001 * radius, 1.001 * radius, 2 * radius, math.inf]) == 0).all()
    assert pixel_filter.reach == math.ceil(radius - 0.5)
    x = np.linspace(-radius, radius, 101)
    assert pixel_filter.weight(x) == pytest.approx(pixel_filter.weight(-x))


@pytest.mark.parametrize("shape", ["box", "mitchell"])
def test_shifted_copies_add_up_to_one(shape: str) -> None:
    pixel_filter = PixelFilter("box" if shape == "box" else "mitchell")
    x = np.linspace(-0.49, 0.49, 50)
    total = sum(pixel_filter.weight(x + shift) for shift in range(-3, 4))
    assert total == pytest.approx(np.ones(50))


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=repr)
def test_offsets_integrate_polynomials_under_the_filter(pixel_filter: PixelFilter) -> None:
    offset, weight = pixel_filter.offsets(MIDDLES)
    assert weight.mean() == pytest.approx(1, abs=2e-4)
    assert (weight * offset).mean() == pytest.approx(0, abs=1e-9)
    assert (weight * offset**2).mean() == pytest.approx(variance(pixel_filter), rel=2e-3)


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=repr)
def test_offsets_leave_their_share_of_the_magnitude_to_the_left(pixel_filter: PixelFilter) -> None:
    end = min(pixel_filter.radius, 9 * pixel_filter.sigma_pix) if pixel_filter.shape == "gaussian" else None
    radius = end or pixel_filter.radius
    xi = np.array([0.0, 0.003, 0.01, 0.02, 0.1, 0.37, 0.5, 0.8, 0.97, 0.99, 0.999])
    offset, _ = pixel_filter.offsets(xi)
    whole = integral(pixel_filter, -radius, radius)
    shares = [integral(pixel_filter, -radius, float(x)) / whole for x in offset]
    assert shares == pytest.approx(xi, abs=1e-6)


@pytest.mark.parametrize("shape", ["box", "gaussian", "blackman-harris"])
def test_filters_without_lobes_have_unit_weights(shape: str) -> None:
    pixel_filter = next(f for f in FILTERS if f.shape == shape)
    assert (pixel_filter.offsets(MIDDLES)[1] == 1).all()


def test_negative_lobes_of_mitchell_netravali() -> None:
    mitchell = PixelFilter("mitchell")
    offset, weight = mitchell.offsets(MIDDLES)
    lobes = np.abs(offset) > 8 / 7
    assert ((weight < 0) == lobes).all()
    magnitude = integral(mitchell, -2, 2)
    assert np.abs(weight) == pytest.approx(np.full(len(weight), magnitude))
    negative = 2 * integral(mitchell, 8 / 7, 2) / magnitude
    assert lobes.mean() == pytest.approx(negative, abs=2e-4)
    assert 0.02 < negative < 0.06


@given(
    pixel_filter=st.sampled_from(FILTERS),
    xi=st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=50),
)
def test_offsets_keep_order_and_stay_inside(pixel_filter: PixelFilter, xi: list[float]) -> None:
    offset, weight = pixel_filter.offsets(sorted(xi))
    assert (np.diff(offset) >= 0).all()
    assert np.abs(offset).max() <= pixel_filter.radius
    assert np.isfinite(weight).all()
    again, _ = PixelFilter(pixel_filter.shape, pixel_filter.sigma_pix).offsets(sorted(xi))
    assert (offset == again).all()


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"shape": "tent"}, "pixel_filter"),
        ({"sigma_pix": 0.0}, "sigma_pix"),
        ({"sigma_pix": math.nan}, "sigma_pix"),
        ({"sigma_pix": 5.0}, "sigma_pix"),
    ],
)
def test_bad_filters_are_named(options: dict[str, object], field: str) -> None:
    with pytest.raises(SampleError) as error:
        PixelFilter(**options)  # type: ignore[arg-type]
    assert error.value.field == field
