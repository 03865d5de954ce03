"""The multiplane method's native engines against its definition in NumPy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer
from fewrays.multiplane import MultiplaneOptions, reference
from fewrays.multiplane.build import build_maps
from fewrays.multiplane.maps import BLOCK, Maps
from fewrays.multiplane.render import render_maps
from fewrays.parallel import Execution
from fewrays.samples import OFF_IMAGE
from plane_layers import blocks_of

LENS = Lens(-40.0, 8.0)  # focused at 5
ONE_THREAD = Execution(threads=1)


def moving(samples: SampleBuffer, pixels: float, *, seed: int = 1) -> SampleBuffer:
    """Give every surface, that is the samples of like depth, a motion of its own, in depth as well."""
    rng = np.random.default_rng(seed)
    shape = samples.depth.shape
    surface = np.unique(np.round(np.log(samples.depth) * 5), return_inverse=True)[1].reshape(shape)
    velocity = rng.normal(0.0, 1.0, (int(surface.max()) + 1, 3)) * [pixels, pixels, 0.2]
    motion = (velocity[surface] * samples.depth[..., None]).astype(np.float32)
    return replace(samples, time=rng.random(shape, np.float32), motion=motion)


def make(kind: str, height: int, width: int, spp: int, blur: float, seed: int = 0) -> SampleBuffer:
    samples = random_buffer(height, width, spp, Lens(-5 * blur, blur), seed=seed, off_image=0.05)
    if kind == "moving":
        samples = moving(samples, 8.0)
    if kind == "HDR":
        bright = np.random.default_rng(seed).random(samples.depth.shape) < 0.02
        samples = replace(samples, color=np.where(bright[..., None], 500 * samples.color, samples.color))
    return samples


def both(
    samples: SampleBuffer, lens: Lens | None = None, **given: Any
) -> tuple[npt.ArrayLike, npt.ArrayLike]:
    """Image of the kernels and of the reference, (H, W, 4), 8 views unless told otherwise."""
    options = MultiplaneOptions(**{"views": 8, **given})
    native = render_maps(build_maps(samples, options, ONE_THREAD), lens, options, ONE_THREAD)
    planes = reference.build(samples, options, ONE_THREAD)
    return native, reference.render(planes, lens, options, ONE_THREAD)


def assert_twins(actual: npt.ArrayLike, expected: npt.ArrayLike, flips: float = 0.03) -> None:
    """Assert agreement to half precision, and to the 1 % of a view that kernels leave out behind the rest.

    Where a view has just that much left, rounding decides: in a share of `flips` of the pixels at most.
    """
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert_agree(actual, expected, tolerance=0.003, flips=flips, jump=0.01 * max(1.0, float(expected.max())))
    assert np.median(np.abs(actual - expected)) < 5e-4 * max(1.0, float(np.median(expected)))


class TestImages:
    @pytest.mark.parametrize("blur", [0.0, 0.5, 3.0, 12.0, 60.0])
    @pytest.mark.parametrize("kind", ["still", "moving", "HDR"])
    def test_agree(self, kind: str, blur: float) -> None:
        height, width = (11, 17) if kind == "moving" else (18, 37)
        assert_twins(*both(make(kind, height, width, 3, blur)))

    @pytest.mark.parametrize(
        "options",
        [
            {"thickness": 1.5, "linear_to": 2.0},
            {"cells": 1},
            {"cells": 2},
            {"cells": 3, "fine_to": 100.0},
            {"memory": 0.0},
            {"prior": 3.0},
            {"along_edges": 0.0},
            {"along_edges": 9.0},
            {"prior": 0.02},
            {"smoothing": 0.0},
            {"smoothing": 0.1},
            {"smoothing": 1.0},
            {"blades": 5, "rotation": 20.0},
            {"squeeze": 2.0},
            {"pixel_filter": "mitchell"},
            {"pixel_filter": "gaussian", "sigma_pix": 1.5},
            {"cats_eye": 0.8},
            {"cats_eye": 0.8, "darken": True},
            {"views": 1},
        ],
        ids=lambda options: ",".join(f"{name}={value}" for name, value in options.items()),
    )
    def test_options(self, options: dict[str, Any]) -> None:
        assert_twins(*both(make("still", 18, 37, 3, 8.0, seed=3), **options))

    @pytest.mark.parametrize(
        "options",
        [
            {"shutter": (0.2, 0.6)},
            {"shutter": (0.5, 0.5)},
            {"shutter": (1.0, 1.0)},
            {"shutter_response": "triangle"},
            {"motion_cell": 6.0},
        ],
        ids=lambda options: ",".join(f"{name}={value}" for name, value in options.items()),
    )
    def test_options_of_motion(self, options: dict[str, Any]) -> None:
        assert_twins(*both(make("moving", 14, 21, 3, 4.0, seed=3), **options))

    @pytest.mark.parametrize(
        "lens", [LENS.refocus(3.0, 0.5), LENS.refocus(30.0, 2.0), LENS.refocus(None, 0.0)]
    )
    def test_through_other_lenses(self, lens: Lens) -> None:
        assert_twins(*both(random_buffer(18, 37, 3, LENS, off_image=0.05), lens))

    def test_gaussian_aperture(self) -> None:
        lens = replace(LENS, aperture="gaussian", sampling="gaussian")
        assert_twins(*both(random_buffer(18, 37, 3, lens)))

    def test_samples_that_come_to_the_camera(self) -> None:
        samples = make("moving", 14, 21, 3, 4.0)
        assert samples.motion is not None
        motion = samples.motion.copy()
        motion[::2, ..., 2] = -2.5 * samples.depth[::2]
        assert_twins(*both(replace(samples, motion=motion)))

    def test_dropped_samples(self) -> None:
        samples = make("still", 18, 37, 3, 8.0)
        gone = np.random.default_rng(4).random(samples.depth.shape) < 0.8
        samples = replace(samples, xy=np.where(gone[..., None], np.float32(OFF_IMAGE), samples.xy))
        assert_twins(*both(samples))

    @pytest.mark.slow
    @pytest.mark.parametrize("options", [{}, {"fine_to": 100.0, "smoothing": 1.0}])
    def test_images_of_several_regions(self, options: dict[str, Any]) -> None:
        assert_twins(*both(make("still", 230, 260, 2, 15.0), **options))

    @settings(max_examples=25)
    @given(
        height=st.integers(1, 12),
        width=st.integers(1, 12),
        spp=st.integers(1, 4),
        kind=st.sampled_from(["still", "moving", "HDR"]),
        blur=st.sampled_from([0.0, 0.3, 3.0, 20.0]),
        seed=st.integers(0, 1000),
    )
    def test_any_buffer(self, height: int, width: int, spp: int, kind: str, blur: float, seed: int) -> None:
        # Among few pixels with few views, those at the limit may be a large share.
        assert_twins(*both(make(kind, height, width, spp, blur, seed), views=4), flips=0.25)


class TestMaps:
    """Plane by plane and cell by cell, where nothing averages differences away."""

    @staticmethod
    def planes(kind: str, blur: float, **given: Any) -> tuple[reference.Planes, Maps]:
        samples = make(kind, 18, 37, 3, blur)
        options = MultiplaneOptions(**given)
        return reference.build(samples, options, ONE_THREAD), build_maps(samples, options, ONE_THREAD)

    @pytest.mark.parametrize("blur", [0.0, 3.0, 20.0])
    @pytest.mark.parametrize("kind", ["still", "moving"])
    def test_agree(self, kind: str, blur: float) -> None:
        planes, maps = self.planes(kind, blur)
        assert maps.plane_count == len(planes.planes)
        for k, plane in enumerate(planes.planes):
            left, top = np.rint((maps.grid.corner[k] - plane.corner) * plane.cells).astype(int)
            for row, column, block in blocks_of(maps, k):
                i, j = top + row * BLOCK[0] * plane.cells, left + column * BLOCK[1] * plane.cells
                expected = plane.layer[i : i + block.shape[0], j : j + block.shape[1]]
                assert plane.kept[i, j]
                # Half precision has 11 bits; what is below 2^-14 counts as 0.
                own = np.s_[: -plane.cells, : -plane.cells]
                agrees = np.isclose(block[own], expected[own], rtol=2e-3, atol=2e-4)
                # The rest repeats the neighbours, which may lie in another region.
                resembles = np.isclose(block, expected, rtol=0.02, atol=0.002)
                # A way along an edge may round into the neighbouring cell, or begin beside another region.
                assert agrees.mean() > 0.995
                assert resembles.mean() > 0.998

    def test_keep_the_same_blocks(self) -> None:
        planes, maps = self.planes("still", 12.0, cells=1)
        for k, plane in enumerate(planes.planes):
            cells = plane.kept.sum()
            blocks = sum(1 for _ in blocks_of(maps, k))
            assert cells == blocks * BLOCK[0] * BLOCK[1]
