"""The image-space blur: discs of the right size and weight, and the faults that Figure 8 shows of it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import Lens, SampleError
from fewrays.baselines.gather import gather_blur

LENS = Lens(-20.0, 10.0)  # in focus at depth 2, at most 10 px of blur


def at_slope(slope: float) -> float:
    return LENS.depth(slope)


def disc_mean(
    image: npt.NDArray[np.float64], row: int, column: int, radius: float
) -> npt.NDArray[np.float64]:
    """Average over a disc by the area of its overlap with rows, in fine steps along each row."""
    height, width = image.shape[:2]
    total, area = np.zeros(3), 0.0
    for i in range(height):
        half = math.sqrt(max(radius**2 - (i - row) ** 2, 0))
        for j in range(width):
            overlap = min(column + 0.5 + half, j + 1) - max(column + 0.5 - half, j)
            if overlap > 0:
                total += overlap * image[i, j]
                area += overlap
    return total / area


def test_every_pixel_is_the_mean_over_its_own_disc() -> None:
    rng = np.random.default_rng(3)
    color = rng.random((13, 17, 3))
    slope = rng.uniform(-9, 9, (13, 17))
    depth = LENS.c0 / (slope - LENS.c1)
    blurred = gather_blur(color, depth, LENS)
    for row, column in ((0, 0), (6, 8), (12, 3), (5, 16)):
        expected = disc_mean(color, row, column, abs(slope[row, column]))
        np.testing.assert_allclose(blurred[row, column], expected, rtol=1e-5)


@given(height=st.integers(1, 9), width=st.integers(1, 9), slope=st.floats(-1e6, 9.9))
def test_a_constant_stays_constant(height: int, width: int, slope: float) -> None:
    image = gather_blur(np.full((height, width, 3), 2.5), np.full((height, width), at_slope(slope)), LENS)
    np.testing.assert_allclose(image, 2.5, rtol=1e-6)


@pytest.mark.parametrize("lens", [Lens(0.0, 0.0), LENS, LENS.refocus(aperture_scale=0.04)])
def test_in_focus_the_image_stays_as_it_is(lens: Lens) -> None:
    color = np.random.default_rng(0).random((8, 9, 3), np.float32)
    np.testing.assert_allclose(gather_blur(color, np.full((8, 9), 2.0), lens), color, rtol=1e-6)


def test_the_background_takes_the_slope_of_infinity() -> None:
    color = np.zeros((41, 41, 3))
    color[20, 20] = 1
    image = gather_blur(color, np.full((41, 41), np.inf), LENS)
    assert image.sum() == pytest.approx(3, rel=0.01)
    lit = image[..., 0] > 0
    assert lit.sum() == pytest.approx(math.pi * LENS.c1**2, rel=0.07)
    rows, columns = np.nonzero(lit)
    assert np.hypot(rows - 20, columns - 20).max() <= LENS.c1 + 1


def test_light_leaks_from_the_focused_foreground() -> None:
    # What the paper's Figure 8 is about: the wall is dark, and yet bright around the focused disc.
    color, depth = np.zeros((40, 40, 3)), np.full((40, 40), at_slope(8.0))
    color[:, 20:], depth[:, 20:] = 1.0, 2.0
    image = gather_blur(color, depth, LENS)
    assert image[20, 18, 0] > 0.3
    np.testing.assert_array_equal(image[:, 20:], 1)


def test_what_is_no_depth_is_refused() -> None:
    with pytest.raises(SampleError, match="depth"):
        gather_blur(np.ones((2, 2, 3)), np.zeros((2, 2)), LENS)
