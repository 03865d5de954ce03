"""The layered method's GPU kernels, run on the CPU as phases, against the reference with one tile."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, SampleError, reconstruct
from fewrays.cuda.samples import DeviceSamples
from fewrays.layered import LayeredOptions, cuda, reference
from fewrays.layered.plan import Plan
from fewrays.parallel import Execution
from fewrays.samples import OFF_IMAGE
from phases import ORDERS, PhasesMachine


def samples_of(blur: float, height: int = 26, width: int = 41, spp: int = 4) -> SampleBuffer:
    lens = Lens(-5 * blur, blur, aperture="gaussian", sampling="square")
    return random_buffer(height, width, spp, lens, off_image=0.02)


def on_card(machine: PhasesMachine, samples: SampleBuffer, **options: Any) -> Any:
    return cuda.reconstruct_image(
        machine, DeviceSamples.of_buffer(machine, samples), LayeredOptions(**options)
    )


def by_reference(samples: SampleBuffer, **options: Any) -> npt.NDArray[np.float32]:
    """Image of the reference, whose one tile is the image."""
    plan = Plan.for_samples(samples, **asdict(LayeredOptions(**options)) | {"tile": 64})
    image = np.zeros((samples.height, samples.width, 3), np.float32)
    counts = np.zeros(plan.tile_count, np.int32)
    assert plan.tile_count == 1
    reference.reconstruct_tiles(samples, plan, image, counts, None, Execution())
    return image


@pytest.mark.parametrize("blur", [0.0, 0.7, 3.0, 11.0, 45.0])
@pytest.mark.parametrize("options", [{}, {"aperture_parts": 1}, {"aperture_parts": 13, "layer_spacing": 0.3}])
def test_images_agree_with_the_reference(blur: float, options: dict[str, Any]) -> None:
    samples = samples_of(blur)
    actual = on_card(PhasesMachine(), samples, **options)
    # Samples on the border of two bins may fall into the other.
    assert_agree(actual, by_reference(samples, **options), tolerance=2e-3, flips=0.02, jump=0.1)


def test_lights_agree_with_the_reference() -> None:
    samples = samples_of(9.0)
    bright = np.random.default_rng(1).random((*samples.depth.shape, 1)) < 0.01
    samples = replace(samples, color=np.where(bright, 1000 * samples.color, samples.color).astype(np.float32))
    actual, expected = on_card(PhasesMachine(), samples), by_reference(samples)
    assert_agree(np.log1p(actual), np.log1p(expected), tolerance=2e-3, flips=0.02)


def test_order_of_threads_does_not_matter() -> None:
    samples = samples_of(8.0)
    images = [on_card(PhasesMachine(order), samples) for order in ORDERS]
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_constant_radiance_stays_constant() -> None:
    samples = samples_of(12.0)
    samples = replace(samples, color=np.full_like(samples.color, 0.25))
    np.testing.assert_allclose(on_card(PhasesMachine(), samples), 0.25, rtol=1e-4)


def test_dropped_samples_say_nothing() -> None:
    samples = samples_of(6.0)
    nowhere = replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))
    np.testing.assert_array_equal(on_card(PhasesMachine(), nowhere), 0)


def test_many_layers_are_tallied_without_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """More layers than a block of threads adds up by itself."""
    samples = samples_of(8.0)
    expected = on_card(PhasesMachine(), samples)
    launch = PhasesMachine.launch

    def with_more(self: PhasesMachine, kernel: Any, grid: Any, **arguments: Any) -> None:
        if kernel.name == "layered_assign":
            arguments["boundaries"] = np.append(arguments["boundaries"], np.full(2000, 1e9, np.float32))
            tallies = arguments["tallies"]
            arguments["tallies"] = np.zeros(tallies.size + 2000 * 16, np.uint8)
            launch(self, kernel, grid, **arguments | {"layers": arguments["layers"] + 2000})
            tallies[:] = arguments["tallies"][: tallies.size]
        else:
            launch(self, kernel, grid, **arguments)

    monkeypatch.setattr(PhasesMachine, "launch", with_more)
    np.testing.assert_array_equal(on_card(PhasesMachine(), samples), expected)


def test_from_outside(phases: PhasesMachine) -> None:
    samples = samples_of(5.0, 40, 60, 8)
    image = reconstruct(samples, "layered", device="cuda")
    assert "layered_composite" in phases.launches
    # The CPU's kernels take the slope of a layer from the samples around each tile.
    expected = reconstruct(samples, "layered", device="cpu")
    assert_agree(image, expected, tolerance=0.02, flips=0.02, jump=0.2)
    with pytest.raises(SampleError, match=r"aovs.*cuda"):
        reconstruct(samples, "layered", device="cuda", aovs=True)
