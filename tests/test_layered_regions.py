"""Regions of an image, and the coarse maps that they need."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.layered.regions import DEEPEST_TILE_LEVEL, MAX_REGION, CoarsePass, RegionPlan
from fewrays.tiling import Tiling

extents = st.integers(1, 9000)


@given(height=extents, width=extents, tile=st.integers(16, 256))
def test_every_pixel_is_in_one_region_and_every_tile_too(height: int, width: int, tile: int) -> None:
    tiling = Tiling(height=height, width=width, tile=tile)
    plan = RegionPlan.covering(tiling, 5)
    assert sum((r.right - r.left) * (r.bottom - r.top) for r in plan.regions) == height * width
    numbers = np.concatenate([region.tiles for region in plan.regions])
    np.testing.assert_array_equal(np.sort(numbers), np.arange(tiling.tile_count))
    for region in plan.regions:
        assert max(region.right - region.left, region.bottom - region.top) < MAX_REGION + tile
        for number in region.tiles[[0, -1]]:
            row, column, rows, columns = tiling.tile_rectangle(int(number))
            assert region.top <= row
            assert row + rows <= region.bottom
            assert region.left <= column
            assert column + columns <= region.right


@given(height=extents, width=extents, deepest=st.integers(0, 12))
def test_each_coarse_level_has_one_map_for_every_region(height: int, width: int, deepest: int) -> None:
    plan = RegionPlan.covering(Tiling(height=height, width=width, tile=128), deepest)
    for region in plan.regions:
        passes = plan.passes_for(region) + plan.passes_for_all()
        levels = [level for each in passes for level in range(each.first, each.last + 1)]
        assert levels == list(range(DEEPEST_TILE_LEVEL + 1, deepest + 1))


@given(height=extents, width=extents, deepest=st.integers(2, 9))
def test_tiles_of_a_pass_cover_its_maps(height: int, width: int, deepest: int) -> None:
    plan = RegionPlan.covering(Tiling(height=height, width=width, tile=100), deepest)
    for each in plan.passes_for(plan.regions[-1]) + plan.passes_for_all():
        for level in range(each.first, each.last + 1):
            assert_covered(each, level)


def assert_covered(each: CoarsePass, level: int) -> None:
    """Assert that a map's bins are the tiles', and reach around the region by the margin."""
    row, column, rows, columns = each.map_window(level)
    size = 2**level
    assert each.side % size == each.left % size == each.top % size == 0
    assert each.left <= column * size <= each.region.left - 11 * size
    assert each.top <= row * size <= each.region.top - 11 * size
    assert (column + columns) * size >= each.region.right + 11 * size
    assert (row + rows) * size >= each.region.bottom + 11 * size
    assert each.left + each.columns * each.side >= each.right >= (column + columns - 1) * size
    assert each.top + each.rows * each.side >= each.bottom >= (row + rows - 1) * size


@pytest.mark.parametrize("size", [(1, 1), (720, 1280), (1080, 1856)])
def test_usual_images_are_one_region(size: tuple[int, int]) -> None:
    plan = RegionPlan.covering(Tiling(height=size[0], width=size[1], tile=128), 6)
    assert len(plan.regions) == 1
    assert not plan.passes_for_all()
