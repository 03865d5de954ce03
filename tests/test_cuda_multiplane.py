"""The multiplane method's GPU kernels, run on the CPU as phases, against the CPU's own kernels."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, _native
from fewrays.cuda.samples import DeviceSamples
from fewrays.multiplane import MultiplaneOptions
from fewrays.multiplane.build import build_maps
from fewrays.multiplane.copies import Copies, copied_places
from fewrays.multiplane.cuda.build import build_planes
from fewrays.multiplane.cuda.planes import DevicePlanes
from fewrays.multiplane.cuda.render import render_planes
from fewrays.multiplane.cuda.smoothing import smooth_planes
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.render import render_maps
from fewrays.parallel import Execution
from fewrays.samples import OFF_IMAGE
from fewrays.sources.analytic import Plane, constant, disc, half_plane, motion_of, sample, smooth_noise
from phases import ORDERS, PhasesMachine

ONE_THREAD = Execution(threads=1)


def samples_of(kind: str, height: int = 21, width: int = 43, spp: int = 3, blur: float = 9.0) -> SampleBuffer:
    """Make random samples, each surface on its own way for ``"moving"``, with few lights for ``"HDR"``."""
    samples = random_buffer(height, width, spp, Lens(-5 * blur, blur), off_image=0.05)
    rng = np.random.default_rng(7)
    if kind == "moving":
        surface = np.unique(np.round(np.log(samples.depth) * 5), return_inverse=True)[1]
        velocity = rng.normal(0.0, 1.0, (int(surface.max()) + 1, 3)) * [8.0, 8.0, 0.2]
        motion = velocity[surface.reshape(samples.depth.shape)] * samples.depth[..., None]
        time = rng.random(samples.depth.shape, np.float32)
        return replace(samples, time=time, motion=motion.astype(np.float32))
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


@pytest.mark.parametrize(
    ("kernel", "options"),
    [
        ("1_1", {"cells": 1}),
        ("1_2", {"cells": 1, "smoothing": 0.6}),
        ("2_1", {"cells": 2, "fine_to": 100.0, "smoothing": 0.12}),
        ("2_2", {"cells": 2, "fine_to": 100.0}),
        ("2_4", {"cells": 2, "fine_to": 100.0, "smoothing": 0.6}),
        ("3_1", {"cells": 3, "fine_to": 100.0}),
    ],
)
def test_every_way_of_smoothing(kernel: str, options: dict[str, Any]) -> None:
    maps, chosen = built("still", **options)
    machine = PhasesMachine()
    assert_agree(
        image_of(machine, maps, chosen),
        render_maps(maps, None, chosen, ONE_THREAD),
        tolerance=0.003,
        flips=0.03,
    )
    assert f"multiplane_smooth_{kernel}" in machine.launches


def lights() -> SampleBuffer:
    """Make samples of two discs, one of which lies close to a block's corner, far in front of a plane."""
    lens = Lens(-225.0, 45.0)
    discs = [
        Plane(lens.depth(-30.0), constant(20.0), disc(centre, radius))
        for centre, radius in (((60.0, 44.0), 9.0), ((112.0, 60.0), 4.0))
    ]
    return sample([*discs, Plane(lens.depth(4.0), constant(0.5))], lens, 96, 160, 4)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("kernel", "cells", "from_sigma"),
    [
        ("1_1", 1, math.inf),
        ("1_2", 1, 1.5),
        ("2_2", 2, math.inf),
        ("2_4", 2, 1.5),
        ("3_1", 3, 1.5),
    ],
)
def test_smoothing_reaches_the_blocks_around_as_on_the_cpu(
    order: int, kernel: str, cells: int, from_sigma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Into those that it brings something to, and no others, at every resolution."""
    monkeypatch.setattr("fewrays.multiplane.copies._HALVED_SIGMA", from_sigma)
    options: dict[str, Any] = {"cells": cells, "fine_to": 100.0 if cells == 3 else 2.0}
    maps = build_maps(lights(), MultiplaneOptions(**options), ONE_THREAD)
    where = MultiplaneOptions(views=16).locations(maps.lens)
    smoothing = MultiplaneOptions(views=16, smoothing=1.0).smoothing_of(
        maps.shear.slope, maps.grid.cells, maps.lens, where
    )
    everywhere = np.full(maps.plane_count, 1e4)
    copies = Copies.of_maps(maps, smoothing)
    band = copies.smooth_band((0, maps.height), everywhere, ONE_THREAD)
    machine = PhasesMachine(order)
    smoothed = smooth_planes(machine, DevicePlanes.of_maps(machine, maps), copies)
    assert f"multiplane_smooth_{kernel}" in machine.launches
    np.testing.assert_array_equal(smoothed.slots, band.slots)
    own = copied_places(maps.slots >= 0, maps.grid, copies.grid, copies.is_halved)
    added = copies.touched & ~own
    assert (added & (band.slots >= 0)).any()
    assert (added & (band.slots < 0)).any()
    for place in np.flatnonzero(band.slots >= 0):
        plane = int(np.searchsorted(copies.grid.first_slot, place, side="right")) - 1
        if smoothing.sigma[plane] > 0:
            on_card, on_host = block_of(
                smoothed.texels, band.halves, int(band.slots[place]), int(copies.grid.cells[plane])
            )
            np.testing.assert_allclose(on_card, on_host, rtol=2e-3, atol=2e-4)


def block_of(texels: Any, halves: Any, first: int, cells: int) -> tuple[Any, Any]:
    """Return a block of the card's and the host's, each (channels, maps, cells of a map)."""
    unit, padding = _native.UNIT_HALVES, _native.HALF_PADDING
    on_card = texels[first : first + cells**2].transpose(2, 0, 1)
    own = halves[padding + first * unit : padding + (first + cells**2) * unit]
    on_card, on_host = (
        np.ascontiguousarray(block).view(np.float16).astype(np.float64)
        for block in (on_card, own.reshape(on_card.shape))
    )
    return on_card, on_host


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


def maps_of(machine: PhasesMachine, samples: SampleBuffer, options: MultiplaneOptions) -> Maps:
    """Planes that the kernels make."""
    return build_planes(machine, DeviceSamples.of_buffer(machine, samples), options).to_maps(machine)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"cells": 1},
        {"cells": 2, "fine_to": 100.0},
        {"cells": 3, "fine_to": 30.0},
        {"prior": 3.0},
        {"memory": 0.3},
    ],
    ids=lambda options: ",".join(options) or "defaults",
)
@pytest.mark.parametrize("kind", ["still", "moving", "HDR"])
def test_planes_agree_with_the_cpu(kind: str, options: dict[str, Any]) -> None:
    samples, chosen = samples_of(kind), MultiplaneOptions(**options)
    assert_same_planes(maps_of(PhasesMachine(), samples, chosen), build_maps(samples, chosen, ONE_THREAD))


def assert_same_planes(actual: Maps, expected: Maps, turned: float = 0.0) -> None:
    """Assert agreement to half precision, but for a share `turned` of cells that look along another way."""
    np.testing.assert_allclose(actual.shear.slope, expected.shear.slope, atol=1e-4)
    np.testing.assert_allclose(actual.shear.motion, expected.shear.motion, atol=1e-4)
    np.testing.assert_array_equal(actual.scale, expected.scale)
    np.testing.assert_array_equal(actual.grid.shape, expected.grid.shape)
    np.testing.assert_array_equal(actual.slots, expected.slots)
    seen, known = (maps.halves.view(np.float16).astype(np.float64) for maps in (actual, expected))
    # What a region's last blocks repeat of the next one differs on the CPU; half precision has 11 bits.
    apart = np.abs(seen - known) > 2e-4 * np.maximum(np.abs(known), 1) + 1e-3 * np.abs(known)
    assert apart.mean() < 1e-3 + turned
    far_apart = np.abs(seen - known) > 0.02 * np.abs(known) + 0.002 * np.abs(known).max()
    assert far_apart.mean() <= turned


def edges(kind: str) -> SampleBuffer:
    """Make samples of a disc and a half plane in focus, more than one of the CPU's regions wide."""
    lens = Lens(-100.0, 20.0)
    front, back = lens.depth(0.3), lens.depth(0.9)
    velocity = (3.0, -5.0) if kind == "moving" else (0.0, 0.0)
    planes = [
        Plane(front, constant(1.5, 0.4, 0.1), disc((40, 20), 13), motion_of(front, velocity)),
        Plane(back, smooth_noise(6), half_plane((85, 20), (2, 1)), motion_of(back, velocity)),
    ]
    return sample([*planes, Plane(lens.depth(5.0), smooth_noise(9, seed=1))], lens, 41, 120, 4)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"along_edges": 40.0},
        {"along_edges": 40.0, "cells": 2},
        {"fine_to": 30.0},
        {"fine_to": 0.25},
    ],
    ids=lambda options: ",".join(options) or "defaults",
)
@pytest.mark.parametrize("kind", ["still", "moving"])
def test_planes_with_edges_agree_with_the_cpu(kind: str, options: dict[str, Any]) -> None:
    samples, chosen = edges(kind), MultiplaneOptions(**options)
    machine = PhasesMachine()
    expected = build_maps(samples, chosen, ONE_THREAD)
    # Ways round into the neighbouring cell, or begin beside another of the CPU's regions.
    assert_same_planes(maps_of(machine, samples, chosen), expected, turned=3e-4)
    assert "multiplane_estimate_edges" in machine.launches
    without = build_maps(samples, replace(chosen, along_edges=0.0), ONE_THREAD)
    assert (expected.halves != without.halves).mean() > 0.02


@pytest.mark.parametrize("cells", [1, 3])
def test_planes_that_look_along_no_edges_take_the_short_way(cells: int) -> None:
    """With one cell per pixel, or if they are told so."""
    samples, machine = edges("still"), PhasesMachine()
    options = MultiplaneOptions(cells=cells, along_edges=2.3 if cells == 1 else 0.0)
    assert_same_planes(maps_of(machine, samples, options), build_maps(samples, options, ONE_THREAD))
    assert "multiplane_estimate_edges" not in machine.launches


@pytest.mark.parametrize("along", [0.0, 2.3, 40.0])
@pytest.mark.parametrize("kind", ["still", "moving", "edges"])
def test_order_of_samples_and_threads_does_not_matter(kind: str, along: float) -> None:
    """Bit for bit: sums are whole numbers."""
    samples = edges("still") if kind == "edges" else samples_of(kind)
    options = MultiplaneOptions(along_edges=along)
    found = [maps_of(PhasesMachine(order), samples, options) for order in ORDERS]
    for other in found[1:]:
        np.testing.assert_array_equal(found[0].slots, other.slots)
        np.testing.assert_array_equal(found[0].halves, other.halves)


@pytest.mark.parametrize("samples", [samples_of("still"), edges("moving")], ids=["still", "edges"])
def test_groups_of_planes_do_not_matter(samples: SampleBuffer, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = PhasesMachine()
    whole = maps_of(machine, samples, MultiplaneOptions())
    once = machine.launches.count("multiplane_evidence")
    monkeypatch.setattr("fewrays.multiplane.cuda.build._MOST_EVIDENCE", 100_000)
    parts = maps_of(machine, samples, MultiplaneOptions())
    np.testing.assert_array_equal(parts.halves, whole.halves)
    assert machine.launches.count("multiplane_evidence") > 3 * once


def test_many_motions_are_sorted_instead_of_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = samples_of("moving")
    counted = maps_of(PhasesMachine(), samples, MultiplaneOptions())
    monkeypatch.setattr("fewrays.multiplane.cuda.assign._MOST_KEYS", 0)
    np.testing.assert_array_equal(
        maps_of(PhasesMachine(), samples, MultiplaneOptions()).halves, counted.halves
    )


def test_dropped_samples_say_nothing() -> None:
    samples = samples_of("still")
    xy, color = samples.xy.copy(), samples.color.copy()
    xy[:, :, 1], color[:, :, 1] = OFF_IMAGE, 1e30
    parked = replace(samples, xy=xy, color=color)
    rest = {name: np.delete(getattr(samples, name), 1, axis=2) for name in samples.field_names()}
    without = SampleBuffer(**rest, lens=samples.lens)
    options = MultiplaneOptions(views=8)
    images = [
        image_of(PhasesMachine(), maps_of(PhasesMachine(), each, options), options)
        for each in (parked, without)
    ]
    assert_agree(*images, tolerance=5e-3)
    nothing = replace(samples, xy=np.full_like(xy, OFF_IMAGE))
    empty = maps_of(PhasesMachine(), nothing, options)
    np.testing.assert_array_equal(image_of(PhasesMachine(), empty, options), 0)
