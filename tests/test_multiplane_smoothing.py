"""How far apart lens points are, which decides how widely planes are smoothed."""

from __future__ import annotations

import math

import pytest

from fewrays.aperture import Aperture
from fewrays.multiplane.smoothing import distance_between
from fewrays.pixel_filter import PixelFilter
from fewrays.temporal.locations import make_locations

SQUARE_OF_ALL_LENSES = 4.0


def distance(aperture: Aperture, count: int) -> float:
    return distance_between(aperture, make_locations(count, aperture, PixelFilter()))


@pytest.mark.parametrize("count", [1, 16, 128, 1000])
@pytest.mark.parametrize(
    "aperture",
    [
        Aperture(),
        Aperture("polygon", blades=5),
        Aperture("polygon", blades=8, roundness=0.5, squeeze=2.0),
    ],
)
def test_even_apertures_are_shared_out_evenly(aperture: Aperture, count: int) -> None:
    assert distance(aperture, count) == pytest.approx(math.sqrt(aperture.area / count))


@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.2])
def test_a_gaussian_is_sparser_at_its_foot(sigma: float) -> None:
    """Without the cut at the square, the k-th of N points has ``2 π σ² / (N - k - 1/2)`` to itself."""
    count = 128
    areas = [2 * math.pi * sigma**2 / (count - k - 0.5) for k in range(count)]
    found = distance(Aperture("gaussian", sigma=sigma), count)
    assert found**2 == pytest.approx(sum(areas) / count, rel=0.02)


@pytest.mark.parametrize("sigma", [0.33, 1.0, 1000.0])
def test_no_more_than_there_is(sigma: float) -> None:
    """Rare points in next to no light count as no more than all the area there is."""
    shared = distance(Aperture("gaussian", sigma=sigma), 128) ** 2 * 128
    assert 0.85 * SQUARE_OF_ALL_LENSES < shared <= SQUARE_OF_ALL_LENSES * (1 + 1e-9)
