from __future__ import annotations

import numpy as np
import pytest

from agreement import assert_agree


def test_accepts_what_lies_within_the_tolerance() -> None:
    expected = np.ones((10, 10, 3))
    assert_agree(expected + 0.9e-4, expected, tolerance=1e-4)


def test_tolerance_is_relative_above_one() -> None:
    expected = np.full((4, 4), 1000.0)
    assert_agree(expected + 0.05, expected, tolerance=1e-4)
    with pytest.raises(AssertionError):
        assert_agree(expected + 0.2, expected, tolerance=1e-4)


def test_counts_flipped_pixels_not_values() -> None:
    expected = np.zeros((10, 10, 3))
    actual = expected.copy()
    actual[3, 4] = 0.5
    assert_agree(actual, expected, tolerance=1e-4, flips=0.01)
    with pytest.raises(AssertionError, match=r"1\.00% of the pixels differ"):
        assert_agree(actual, expected, tolerance=1e-4, flips=0.009)


def test_bounds_the_jump_of_a_flip() -> None:
    expected = np.zeros((10, 10))
    actual = expected.copy()
    actual[0, 0] = 0.5
    with pytest.raises(AssertionError, match="largest difference"):
        assert_agree(actual, expected, tolerance=1e-4, flips=0.5, jump=0.1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_rejects_what_is_not_finite(bad: float) -> None:
    actual = np.zeros((2, 2))
    actual[1, 1] = bad
    with pytest.raises(AssertionError, match="not finite"):
        assert_agree(actual, np.zeros((2, 2)), tolerance=1.0, flips=1.0)


def test_rejects_other_shapes() -> None:
    with pytest.raises(AssertionError, match="shape"):
        assert_agree(np.zeros((2, 2)), np.zeros((2, 3)), tolerance=1.0)
