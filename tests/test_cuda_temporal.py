"""The temporal method's GPU kernels, run on the CPU as phases, against the reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.cuda.samples import DeviceSamples
from fewrays.parallel import Execution
from fewrays.samples import OFF_IMAGE
from fewrays.temporal import TemporalOptions, cuda, make_plan, reconstruct_on_card, reference
from phases import ORDERS, PhasesMachine

Float32 = npt.NDArray[np.float32]


def samples_of(kind: str, blur: float = 6.0, height: int = 9, width: int = 13, spp: int = 6) -> SampleBuffer:
    """Make random samples: ``"still"``, ``"moving"`` with each surface on its own way, or ``"glossy"``."""
    samples = random_buffer(height, width, spp, Lens(-5 * blur, blur), off_image=0.05)
    rng = np.random.default_rng(3)
    shape = samples.depth.shape
    if kind == "moving":
        surface = np.unique(np.round(np.log(samples.depth) * 5), return_inverse=True)[1].reshape(shape)
        velocity = rng.normal(0.0, 6.0, (int(surface.max()) + 1, 3)) * [1, 1, 0.15]
        motion = (velocity[surface] * samples.depth[..., None]).astype(np.float32)
        return replace(samples, time=rng.random(shape, np.float32), motion=motion)
    if kind == "glossy":
        bandwidth = np.where(rng.random(shape) < 0.3, np.inf, rng.uniform(0.02, 1.0, shape))
        return replace(samples, bandwidth=bandwidth.astype(np.float32))
    return samples


def on_card(machine: PhasesMachine, samples: SampleBuffer, **options: Any) -> Float32:
    plan = make_plan(samples, TemporalOptions(**{"locations": 6, **options}))
    device = DeviceSamples.of_buffer(machine, samples)
    bands: Float32 = cuda.reconstruct_bands(machine, device, plan)
    return bands


def by_reference(samples: SampleBuffer, **options: Any) -> Float32:
    plan = make_plan(samples, TemporalOptions(**{"locations": 6, **options}))
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    reference.reconstruct_tiles(samples, plan, bands, Execution())
    return bands


@pytest.mark.parametrize("blur", [0.0, 1.5, 6.0, 25.0])
@pytest.mark.parametrize("kind", ["still", "moving", "glossy"])
def test_bands_agree_with_the_reference(kind: str, blur: float) -> None:
    samples = samples_of(kind, blur)
    # Where rounding decides what covers a location, another surface shows.
    assert_agree(on_card(PhasesMachine(), samples), by_reference(samples), tolerance=1e-3, flips=0.02)


@pytest.mark.parametrize(
    "options",
    [
        {"tent_scale": 0.0},
        {"radius_scale": 0.3},
        {"radius_scale": 4.0},
        {"pixel_filter": "mitchell"},
        {"blades": 5, "squeeze": 1.5},
    ],
    ids=",".join,
)
def test_options_agree_with_the_reference(options: dict[str, Any]) -> None:
    samples = samples_of("still")
    actual, expected = on_card(PhasesMachine(), samples, **options), by_reference(samples, **options)
    assert_agree(actual, expected, tolerance=1e-3, flips=0.03)


@pytest.mark.parametrize("kind", ["still", "moving"])
def test_order_of_threads_does_not_matter(kind: str) -> None:
    samples = samples_of(kind, 0.02 if kind == "still" else 6.0)  # one surface, and several
    bands = [on_card(PhasesMachine(order), samples) for order in ORDERS]
    np.testing.assert_array_equal(bands[0], bands[1])
    np.testing.assert_array_equal(bands[0], bands[2])


def test_of_a_crowd_the_nearest_count() -> None:
    """More samples around a location than are looked at: of one colour on one side, another on the other."""
    samples = samples_of("still", 4.0, 2, 3, 900)
    assert_agree(on_card(PhasesMachine(), samples, radius_scale=8.0),
                 by_reference(samples, radius_scale=8.0), tolerance=0.01, flips=0.1)  # fmt: skip


def test_dropped_samples_say_nothing() -> None:
    samples = samples_of("still")
    plan = make_plan(samples, TemporalOptions(locations=3))
    nowhere = replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))
    machine = PhasesMachine()
    bands = cuda.reconstruct_bands(machine, DeviceSamples.of_buffer(machine, nowhere), plan)
    np.testing.assert_array_equal(bands, 0)


def test_wider_cells_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = samples_of("still")
    expected = on_card(PhasesMachine(), samples)
    monkeypatch.setattr("fewrays.temporal.cuda._MOST_CELLS", 50)
    assert_agree(on_card(PhasesMachine(), samples), expected, tolerance=1e-5)


@pytest.mark.parametrize("kind", ["still", "moving", "glossy"])
def test_from_outside(phases: PhasesMachine, kind: str) -> None:
    """But for places where rounding decides what covers a location, images are the processor's."""
    samples = samples_of(kind, 5.0, 34, 39, 4)
    image = reconstruct(samples, "temporal", device="cuda", locations=8)
    assert {"temporal_holes", "temporal_resolve", "temporal_mean", "temporal_correct"} <= set(phases.launches)
    expected = reconstruct(samples, "temporal", device="cpu", locations=8)
    assert_agree(image, expected, tolerance=0.005, flips=0.03)


@pytest.mark.parametrize("kind", ["still", "moving", "glossy"])
def test_samples_on_the_card_give_the_same_image(phases: PhasesMachine, kind: str) -> None:
    samples = samples_of(kind, 5.0, 34, 39, 2)
    fields = {name: getattr(samples, name) for name in samples.field_names()}
    on_card = DeviceSamples.of_arrays(**fields, lens=samples.lens)
    image = reconstruct(on_card, "temporal", locations=4)
    np.testing.assert_array_equal(image, reconstruct(samples, "temporal", device="cuda", locations=4))
    assert phases.launches.count("temporal_mean") == 2


class TightLippedMachine(PhasesMachine):
    """A machine that notes what leaves it."""

    def __init__(self) -> None:
        super().__init__()
        self.left: list[int] = []

    def on_host(self, array: Any) -> Any:
        self.left.append(array.nbytes)
        return array

    def fetch(self, array: Any) -> Callable[[], Any]:
        return lambda: self.on_host(array)


def test_samples_do_not_leave_the_card() -> None:
    """Of them the host gets one number for each plane of the pattern, of the image nothing."""
    machine = TightLippedMachine()
    on_card = DeviceSamples.of_buffer(machine, samples_of("moving", 5.0, 34, 39, 2))
    reconstruct_on_card(machine, on_card, TemporalOptions(locations=2), timed=True)
    assert machine.left == [16 * 8]


@pytest.mark.usefixtures("phases")
def test_a_pinhole_s_moving_samples_get_an_order() -> None:
    samples = replace(samples_of("moving", 5.0, 12, 14, 4), lens=Lens(0.0, 0.0))
    image = reconstruct(samples, "temporal", device="cuda", locations=8)
    expected = reconstruct(samples, "temporal", device="cpu", locations=8)
    assert_agree(image, expected, tolerance=0.005, flips=0.03)


@pytest.mark.usefixtures("phases")
def test_times_of_what_stands_still_count_for_the_shutter() -> None:
    """Without motion, and with motions of 0, which the card is not given."""
    samples = replace(samples_of("moving", 5.0, 36, 38, 2), motion=None)
    still = replace(samples, motion=np.zeros_like(samples.color))
    for each in (samples, still):
        images = [
            reconstruct(each, "temporal", device=device, locations=4, shutter=(0.2, 0.5))
            for device in ("cuda", "cpu")
        ]
        assert_agree(*images, tolerance=0.005, flips=0.03)
