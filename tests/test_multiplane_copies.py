"""Smoothed copies of planes at half the image's resolution."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from buffers import random_buffer
from fewrays import Lens, Multiplane, SampleBuffer
from fewrays.method import Image
from fewrays.metrics import psnr_display
from fewrays.multiplane import RenderOptions, copies
from fewrays.multiplane.copies import Copies, copied_places, gaussians, halved_planes
from fewrays.multiplane.maps import BLOCK
from fewrays.multiplane.smoothing import Smoothing
from fewrays.sources.analytic import Plane, constant, disc, half_plane, reference, sample, smooth_noise

LENS = Lens(-300.0, 60.0)


def smoothing_of(sigma: list[float], cells: list[int]) -> Smoothing:
    return Smoothing(np.array(sigma), np.array(cells, np.int32), np.array(cells, np.int32))


def leaves(height: int = 60, width: int = 150, spp: int = 8) -> tuple[SampleBuffer, list[Plane]]:
    """Two leaves far before, a light and a wall far behind something in focus, which hides half of them."""
    planes = [
        Plane(LENS.depth(-45.0), constant(0.8, 0.2, 0.1), disc((40.0, 30.0), 25.0)),
        Plane(LENS.depth(-35.0), constant(0.1, 0.6, 0.1), disc((100.0, 20.0), 22.0)),
        Plane(LENS.depth(0.0), smooth_noise(6, seed=1), half_plane((75.0, 30.0), (1.0, 0.3))),
        Plane(LENS.depth(30.0), constant(9.0), disc((120.0, 40.0), 6.0)),
        Plane(LENS.depth(40.0), smooth_noise(12, seed=2)),
    ]
    return sample(planes, LENS, height, width, spp), planes


def copies_of(planes: Multiplane, **options: Any) -> Copies:
    given, maps = RenderOptions(**options), planes.maps
    where = given.locations(maps.lens)
    return Copies.of_maps(maps, given.smoothing_of(maps.shear.slope, maps.grid.cells, maps.lens, where))


def at_full_resolution(planes: Multiplane, monkeypatch: pytest.MonkeyPatch, **options: Any) -> Image:
    with monkeypatch.context() as patch:
        patch.setattr(copies, "_HALVED_SIGMA", math.inf)
        return planes.render(threads=1, **options)


class TestWhichPlanes:
    def test_before_and_behind_all_others(self) -> None:
        """What is smooth but lies between sharper planes keeps its resolution."""
        smoothing = smoothing_of([5.0, 2.0, 0.4, 3.0, 0.0, 1.6, 9.0], [1] * 7)
        np.testing.assert_array_equal(halved_planes(smoothing), [1, 1, 0, 0, 0, 1, 1])

    def test_not_those_of_several_cells(self) -> None:
        np.testing.assert_array_equal(halved_planes(smoothing_of([5.0, 5.0, 5.0], [1, 3, 1])), [1, 0, 1])

    def test_all_of_them(self) -> None:
        assert halved_planes(smoothing_of([2.0, 2.0], [1, 1])).all()

    def test_by_the_views(self) -> None:
        """Fewer views are smoothed more."""
        planes = Multiplane.build(leaves()[0], threads=1)
        few, many = copies_of(planes, views=16), copies_of(planes, views=4096)
        none = copies_of(planes, views=16, smoothing=0.0)
        assert few.is_halved.sum() >= 3
        assert 0 < few.front_end < few.back_begin < planes.maps.plane_count
        assert not many.is_halved.any()
        assert not none.is_halved.any()
        assert (many.front_end, many.back_begin) == (0, planes.maps.plane_count)


def test_blocks_lie_around_those_of_their_planes() -> None:
    planes = Multiplane.build(leaves()[0], threads=1)
    made, maps = copies_of(planes, views=16), planes.maps
    kept = maps.slots >= 0
    copied = copied_places(kept, maps.grid, made.grid, made.is_halved)
    for plane in range(maps.plane_count):
        pitch = 2 if made.is_halved[plane] else 1
        expected = {
            tuple(place * BLOCK // (pitch * np.array(BLOCK)))
            for place in places_of(kept, maps.grid, plane) + maps.grid.corner[plane, ::-1] // BLOCK
        }
        found = places_of(copied, made.grid, plane) + made.grid.corner[plane, ::-1] // BLOCK
        assert {tuple(place) for place in found} == expected


def places_of(kept: npt.NDArray[np.bool_], grid: Any, plane: int) -> npt.NDArray[np.int64]:
    """Rows and columns (N, 2) of a plane's places that are kept."""
    columns, rows = grid.shape[plane]
    first = grid.first_slot[plane]
    return np.argwhere(kept[first : first + rows * columns].reshape(rows, columns))


class TestImages:
    @pytest.mark.parametrize("views", [16, 64])
    def test_as_at_full_resolution(self, views: int, monkeypatch: pytest.MonkeyPatch) -> None:
        planes = Multiplane.build(leaves()[0], threads=1)
        image = planes.render(views=views, threads=1)
        full = at_full_resolution(planes, monkeypatch, views=views)
        assert copies_of(planes, views=views).is_halved.any()
        error = np.abs(image - full) / np.maximum(full, 1)
        assert 0 < error.max() < 0.02
        assert np.sqrt(np.square(error).mean()) < 0.002

    def test_no_farther_from_the_truth(self, monkeypatch: pytest.MonkeyPatch) -> None:
        samples, scene = leaves(48, 150, 16)
        truth = reference(scene, LENS, 48, 150, spp=128, pixel_filter="box")
        planes = Multiplane.build(samples, threads=1)
        image, full = planes.render(views=32, threads=1), at_full_resolution(planes, monkeypatch, views=32)
        inner = (slice(8, -8), slice(8, -8))
        assert psnr_display(image[inner], truth[inner]) > psnr_display(full[inner], truth[inner]) - 0.05

    def test_blur_is_that_of_the_gaussian(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A light's second moments do not change, as half the resolution's own blur is taken off."""
        light = [Plane(LENS.depth(-12.0), constant(1.0), disc((64.0, 64.0), 3.0))]
        samples = sample([*light, Plane(LENS.depth(-11.0), constant(0.0))], LENS, 128, 128, 16)
        planes = Multiplane.build(samples, threads=1)
        widths = []
        for image in (
            planes.render(views=16, smoothing=0.5, threads=1),
            at_full_resolution(planes, monkeypatch, views=16, smoothing=0.5),
        ):
            at = np.arange(128) + 0.5
            light_of_columns = image[..., 0].sum(axis=0)
            widths.append(float((light_of_columns * np.square(at - 64)).sum() / light_of_columns.sum()))
        assert copies_of(planes, views=16, smoothing=0.5).is_halved.all()
        assert widths[0] == pytest.approx(widths[1], rel=0.01)

    def test_the_gaussian_gives_way(self) -> None:
        """Two interpolations between points two pixels apart instead of one, and means of four pixels."""
        smoothing = smoothing_of([2.0, 2.0, 0.3], [1, 1, 1])
        found = gaussians(smoothing, halved_planes(smoothing))
        np.testing.assert_allclose(np.square(found), [4 - 17 / 12, 4 - 17 / 12, 0.09])

    @pytest.mark.parametrize("size", [(3, 5), (17, 129), (33, 65)])
    def test_bands_and_threads(self, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
        samples = random_buffer(*size, 3, LENS)
        planes = Multiplane.build(samples, threads=1)
        assert copies_of(planes, views=8).is_halved.any()
        whole = planes.render(views=8, threads=1)
        np.testing.assert_array_equal(planes.render(views=8, threads=3), whole)
        monkeypatch.setattr(copies, "_MOST_BYTES", 1)
        np.testing.assert_array_equal(planes.render(views=8, threads=2), whole)

    def test_constant(self) -> None:
        """Whatever the resolution, there is one radiance to be seen, up to half precision."""
        samples = random_buffer(30, 41, 3, LENS)
        samples = replace(samples, color=np.full_like(samples.color, 0.7))
        planes = Multiplane.build(samples, threads=1)
        assert copies_of(planes, views=8).is_halved.any()
        np.testing.assert_allclose(planes.render(views=8, threads=1), 0.7, rtol=2e-3)
