"""The multiplane method's GPU kernels, run on the CPU as phases, against the CPU's own kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer
from fewrays.multiplane import MultiplaneOptions
from fewrays.multiplane.build import build_maps
from fewrays.multiplane.cuda.planes import DevicePlanes
from fewrays.multiplane.cuda.render import render_planes
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.render import render_maps
from fewrays.parallel import Execution
from phases import ORDERS, PhasesMachine

ONE_THREAD = Execution(threads=1)


def samples_of(kind: str, height: int = 21, width: int = 43, spp: int = 3, blur: float = 9.0) -> SampleBuffer:
    """Make random samples, each surface moving on its own for ``"moving"``, with a few lights for ``"HDR"``."""
    samples = random_buffer(height, width, spp, Lens(-5 * blur, blur), off_image=0.05)
    rng = np.random.default_rng(7)
    if kind == "moving":
        surface = np.unique(np.round(np.log(samples.depth) * 5), return_inverse=True)[1]
        velocity = rng.normal(0.0, 1.0, (int(surface.max()) + 1, 3)) * [8.0, 8.0, 0.2]
        motion = velocity[surface.reshape(samples.depth.shape)] * samples.depth[..., None]
        return replace(samples, time=rng.random(samples.depth.shape, np.float32), motion=motion)
    if kind == "HDR":
        bright = rng.random((*samples.depth.shape, 1)) < 0.02
        return replace(samples, color=np.where(bright, 500 * samples.color, samples.color))
    return samples


def built(kind: str, **given: Any) -> tuple[Maps, MultiplaneOptions]:
    """Planes that the CPU made."""
    options = MultiplaneOptions(**{"views": 8, **given})
    return build_maps(samples_of(kind), options, ONE_THREAD), options


def image_of(machine: PhasesMachine, maps: Maps, options: MultiplaneOptions, lens: Lens | None = None) -> Any:
    return render_planes(machine, DevicePlanes.of_maps(machine, maps), lens, options)


@pytest.mark.parametrize("kind", ["still", "moving"])
def test_planes_come_back_as_they_went(kind: str) -> None:
    machine = PhasesMachine()
    maps, _ = built(kind, cells=3, fine_to=20.0)
    back = DevicePlanes.of_maps(machine, maps).to_maps(machine)
    np.testing.assert_array_equal(back.slots, maps.slots)
    np.testing.assert_array_equal(back.halves, maps.halves)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"views": 40, "smoothing": 0.0},
        {"smoothing": 1.0},
        {"cells": 1},
        {"cells": 2, "fine_to": 100.0},
        {"cells": 3, "fine_to": 100.0, "smoothing": 0.6},
        {"pixel_filter": "mitchell", "blades": 5},
        {"cats_eye": 0.8},
        {"cats_eye": 1.0, "darken": True},
        {"shutter": (0.2, 0.6)},
    ],
    ids=lambda options: ",".join(options) or "defaults",
)
@pytest.mark.parametrize("kind", ["still", "moving", "HDR"])
def test_images_agree_with_the_cpu(kind: str, options: dict[str, Any]) -> None:
    maps, chosen = built(kind, **options)
    expected = render_maps(maps, None, chosen, ONE_THREAD)
    actual = image_of(PhasesMachine(), maps, chosen)
    # They stop at other transmittances, below 1 %.
    assert_agree(actual, expected, tolerance=0.003, flips=0.03, jump=0.01 * max(1.0, float(expected.max())))
    assert np.median(np.abs(actual - expected)) < 1e-4


def test_images_through_another_lens() -> None:
    maps, options = built("still", blades=6)
    lens = maps.lens.refocus(3.0, aperture_scale=1.4)
    expected = render_maps(maps, lens, options, ONE_THREAD)
    assert_agree(image_of(PhasesMachine(), maps, options, lens), expected, tolerance=0.003, flips=0.03)


@pytest.mark.parametrize("kind", ["still", "moving"])
def test_order_of_threads_does_not_matter(kind: str) -> None:
    maps, options = built(kind, smoothing=1.0, cats_eye=0.5)
    images = [image_of(PhasesMachine(order), maps, options) for order in ORDERS]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_every_pixel_is_written() -> None:
    """Of images that no tile fits: arrays are full of poison at first."""
    for height, width in [(1, 1), (33, 31), (5, 70)]:
        maps = build_maps(samples_of("still", height, width), MultiplaneOptions(), ONE_THREAD)
        image = image_of(PhasesMachine(), maps, MultiplaneOptions(views=4))
        assert image.shape == (height, width, 4)
        assert_agree(
            image, render_maps(maps, None, MultiplaneOptions(views=4), ONE_THREAD), tolerance=0.01, flips=0.05
        )
