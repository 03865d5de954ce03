"""Asserts for twins: tight inside, with room for the few places where a threshold makes results jump."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def assert_agree(
    actual: npt.ArrayLike,
    expected: npt.ArrayLike,
    *,
    tolerance: float,
    flips: float = 0.0,
    jump: float = np.inf,
) -> None:
    """Assert that arrays agree to `tolerance`, but for a share of at most `flips` pixels.

    Parameters
    ----------
    actual, expected : array_like, (H, W, …)
        The arrays; a pixel differs where any of its values does.
    tolerance : float
        Largest difference, relative to ``max(|expected|, 1)``.
    flips : float
        Share of pixels that may differ by more, because a rounded position or a layer boundary fell on the
        other side.
    jump : float
        Largest difference that even those may have.
    """
    actual, expected = np.asarray(actual, np.float64), np.asarray(expected, np.float64)
    assert actual.shape == expected.shape, f"shape {actual.shape} is not {expected.shape}"
    assert np.isfinite(actual).all(), "not finite"
    difference = np.abs(actual - expected) / np.maximum(np.abs(expected), 1.0)
    difference = difference.reshape(*difference.shape[:2], -1).max(axis=-1)
    share = float(np.mean(difference > tolerance))
    assert share <= flips, (
        f"{share:.2%} of the pixels differ by more than {tolerance:g} (allowed: {flips:.2%}), "
        f"the most by {difference.max():g} at {np.unravel_index(difference.argmax(), difference.shape)}"
    )
    assert difference.max() <= jump, f"the largest difference is {difference.max():g} (allowed: {jump:g})"
