"""Through a pinhole slopes tell no depths apart: what moves must be in front of, or behind, what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.metrics import psnr_display
from fewrays.pinhole import needs_order, with_order
from fewrays.sources.analytic import Plane, checker, constant, disc, motion_of, reference, sample, stripes
from fewrays.temporal.dispersion import dispersion

PINHOLE = Lens(0.0, 0.0)
SIDE = 48
FENCE = (0.9, 0.1, 0.1)
RED, BLUE = constant(*FENCE), constant(0.1, 0.2, 0.9)


def scene(*, front_moves: bool) -> list[Plane]:
    """A fence before a disc before a wall: the fence moves, or the disc behind it."""
    of_fence = motion_of(1.0, (14, 5)) if front_moves else (0.0, 0.0, 0.0)
    of_disc = (0.0, 0.0, 0.0) if front_moves else motion_of(2.0, (14, 5))
    return [
        Plane(1.0, RED, stripes(9.0, fill=0.4), of_fence),
        Plane(2.0, BLUE, disc((20, 22), 12), of_disc),
        Plane(6.0, checker(6)),
    ]


def test_a_fence_that_moves_covers_what_is_behind_it() -> None:
    planes = scene(front_moves=True)
    truth = reference(planes, PINHOLE, SIDE, SIDE, pixel_filter="box")
    image = reconstruct(sample(planes, PINHOLE, SIDE, SIDE, 16), "multiplane")
    assert psnr_display(image, truth) > 32.5  # 30.7 with all planes at one depth


@pytest.mark.parametrize("method", ["multiplane", "temporal"])
def test_a_fence_covers_what_moves_behind_it(method: str) -> None:
    planes = scene(front_moves=False)
    image = reconstruct(sample(planes, PINHOLE, SIDE, SIDE, 16), method, pixel_filter="box")
    truth = reference(planes, PINHOLE, SIDE, SIDE, pixel_filter="box")
    fence = np.isclose(truth, FENCE, atol=1e-3).all(axis=-1)
    assert fence.sum() > 800
    assert np.abs(image - truth)[fence].mean(axis=-1).max() < 0.08  # 0.14 of temporal with all at one depth


class TestOrder:
    def test_of_a_lens_is_its_own(self) -> None:
        assert not needs_order(buffer(Lens(-4.0, 1.0), moving=True))

    def test_of_what_is_at_rest_does_not_matter(self) -> None:
        assert not needs_order(buffer(PINHOLE, moving=False))

    def test_leaves_samples_where_they_are(self) -> None:
        samples = buffer(PINHOLE, moving=True)
        assert needs_order(samples)
        ordered = with_order(samples)
        assert np.abs(ordered.xy - samples.xy).max() < 1e-3
        slope = ordered.lens.slope(ordered.depth)
        np.testing.assert_array_equal(np.argsort(slope, axis=None), np.argsort(samples.depth, axis=None))


def test_lens_points_of_a_pinhole_mean_nothing() -> None:
    samples = buffer(PINHOLE, moving=False)
    at_center = replace(samples, uv=np.zeros_like(samples.uv))
    assert dispersion(samples) == dispersion(at_center)
    assert dispersion(samples) < dispersion(replace(samples, lens=Lens(-4.0, 1.0)))


def buffer(lens: Lens, *, moving: bool) -> SampleBuffer:
    motion = motion_of(2.0, (3, 1)) if moving else (0.0, 0.0, 0.0)
    return sample([Plane(2.0, RED, disc((24, 24), 9), motion), Plane(6.0, checker(6))], lens, SIDE, SIDE, 4)
