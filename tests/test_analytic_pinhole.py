"""Planes as a pinhole sees them: antialiased colours, and depths that are not."""

from __future__ import annotations

import numpy as np
import pytest

from fewrays import Lens
from fewrays.sources.analytic import Plane, constant, half_plane
from fewrays.sources.analytic_pinhole import pinhole

LENS = Lens(-20.0, 10.0)


@pytest.mark.parametrize("edge", [3.0, 3.25, 3.75])
def test_an_edge_is_averaged_in_colour_and_decided_in_depth(edge: float) -> None:
    planes = [Plane(1.0, constant(1.0), half_plane((edge, 0), (-1, 0))), Plane(4.0, constant(0.0))]
    layer = pinhole(planes, LENS, 4, 8, spp=64)
    covered = np.clip(edge - np.arange(8), 0, 1)
    np.testing.assert_allclose(layer.color, np.broadcast_to(covered[:, None], (4, 8, 3)), atol=0.04)
    expected = np.where(np.arange(8) + 0.5 <= edge, 1.0, 4.0)
    np.testing.assert_array_equal(layer.depth, np.broadcast_to(expected, (4, 8)))
