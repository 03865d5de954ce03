"""The layered method's GPU kernels, run on the CPU as phases, against the reference and the CPU's kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, reconstruct
from fewrays.cuda.samples import DeviceSamples
from fewrays.demo import load_demo
from fewrays.layered import LayeredOptions, cuda
from fewrays.layered.aperture import aperture_variance
from fewrays.layered.plan import Plan
from fewrays.lens import Sampling
from fewrays.samples import OFF_IMAGE
from phases import ORDERS, PhasesMachine


def samples_of(blur: float, height: int = 26, width: int = 41, spp: int = 4) -> SampleBuffer:
    lens = Lens(-5 * blur, blur, aperture="gaussian", sampling="square")
    return random_buffer(height, width, spp, lens, off_image=0.02)


def on_card(machine: PhasesMachine, samples: SampleBuffer, **options: Any) -> Any:
    on_device = DeviceSamples.of_buffer(machine, samples)
    return cuda.reconstruct_image(machine, on_device, LayeredOptions(**options))[0]


def by_reference(samples: SampleBuffer, **options: Any) -> Any:
    return reconstruct(samples, "layered", device="reference", **options)


def lit_by_one(samples: SampleBuffer, brightness: float) -> SampleBuffer:
    """Return samples of radiance 1/4, but for the first, in the upper left corner."""
    color = np.full_like(samples.color, 0.25)
    color[0, 0, 0] = brightness
    return replace(samples, color=color)


class TestAgainstTheReference:
    @pytest.mark.parametrize("blur", [0.0, 0.7, 3.0, 11.0, 45.0])
    @pytest.mark.parametrize(
        "options",
        [
            {},
            {"tile": 16},
            {"tile": 25, "sigma_pix": 1.3},
            {"aperture_parts": 1},
            {"aperture_parts": 13, "layer_spacing": 0.3},
        ],
    )
    def test_images_agree(self, blur: float, options: dict[str, Any]) -> None:
        samples = samples_of(blur)
        actual = on_card(PhasesMachine(), samples, **options)
        # Samples on the border of two bins may fall into the other.
        assert_agree(actual, by_reference(samples, **options), tolerance=2e-3, flips=0.005, jump=0.1)

    @pytest.mark.parametrize("sampling", ["disc", "square", "gaussian"])
    @pytest.mark.parametrize("height", [1, 70])
    def test_lenses_and_sizes(self, sampling: Sampling, height: int) -> None:
        samples = random_buffer(height, 33, 3, Lens(-60.0, 12.0, sampling=sampling), off_image=0.2)
        assert_agree(
            on_card(PhasesMachine(), samples), by_reference(samples), tolerance=2e-3, flips=0.01, jump=0.1
        )

    def test_lights_agree(self) -> None:
        samples = samples_of(9.0)
        bright = np.random.default_rng(1).random((*samples.depth.shape, 1)) < 0.01
        color = np.where(bright, 1000 * samples.color, samples.color).astype(np.float32)
        samples = replace(samples, color=color)
        actual, expected = on_card(PhasesMachine(), samples), by_reference(samples)
        assert_agree(np.log1p(actual), np.log1p(expected), tolerance=2e-3, flips=0.02)

    def test_refocused_samples_that_left_their_pixels(self) -> None:
        samples = samples_of(12.0).refocus(9.0)
        assert_agree(
            on_card(PhasesMachine(), samples), by_reference(samples), tolerance=2e-3, flips=0.005, jump=0.1
        )

    def test_more_in_one_bin_than_there_is_room_for_at_first(self) -> None:
        """All samples of an image in one pixel: the patch is done again with more room until they fit."""
        samples = samples_of(0.5)
        samples = replace(
            samples,
            xy=np.full_like(samples.xy, 12.3),
            uv=np.zeros_like(samples.uv),
            depth=np.full_like(samples.depth, 5.0),
        )
        expected = by_reference(samples)
        assert np.count_nonzero(expected) > 0
        assert_agree(on_card(PhasesMachine(), samples), expected, tolerance=1e-4)


class TestAgainstTheProcessor:
    def test_the_demonstration_agrees(self) -> None:
        """Below 1/255 after tone mapping on 99.9 % of the pixels, and nowhere above 2/255."""
        samples, _ = load_demo()
        tone_mapped = [
            np.clip(image, 0, 1) ** (1 / 2.2)
            for image in (on_card(PhasesMachine(), samples), reconstruct(samples, "layered", device="cpu"))
        ]
        assert_agree(*tone_mapped, tolerance=1 / 255, flips=1e-3, jump=2 / 255)

    def test_aovs_agree(self, phases: PhasesMachine) -> None:
        samples = samples_of(11.0)
        options: dict[str, Any] = {"method": "layered", "aovs": True, "tile": 20}
        image, aovs = reconstruct(samples, device="cuda", **options)
        expected_image, expected = reconstruct(samples, device="cpu", **options)
        assert "layered_tiles" in phases.launches
        assert_agree(image, expected_image, tolerance=2e-3, flips=0.005)
        assert aovs.keys() == expected.keys()
        for name in ("layer_radiance", "layer_opacity"):
            assert_agree(aovs[name], expected[name], tolerance=2e-3, flips=0.005)
        assert (aovs["layer_count"] >= expected["layer_count"]).all()
        np.testing.assert_allclose(aovs["layer_radiance"].sum(axis=2), image, rtol=1e-5, atol=1e-6)

    def test_absurd_slopes(self) -> None:
        samples = random_buffer(20, 20, 3, Lens(-40.0, 8.0))
        depth = 10 ** np.random.default_rng(3).uniform(-8, 30, samples.depth.shape)
        for lens in (Lens(-1e5, 2e4), Lens(-1e30, 2.0), Lens(-40.0, 1e25)):
            absurd = replace(samples, depth=depth.astype(np.float32), lens=lens)
            expected = reconstruct(absurd, "layered", device="cpu")
            assert_agree(on_card(PhasesMachine(), absurd), expected, tolerance=1e-2, flips=1.0, jump=5.0)


class TestSharedMemory:
    @pytest.mark.parametrize("blur", [0.7, 11.0, 45.0])
    @pytest.mark.parametrize(("kib", "side"), [(48, 16), (64, 16), (99, 32), (163, 32)])
    def test_little_of_it_does_the_same(self, blur: float, kib: int, side: int) -> None:
        """Smaller patches, fewer layers at a time, strips, and maps of the whole image."""
        samples = samples_of(blur, 50, 70)
        machine = PhasesMachine(shared_bytes=kib << 10)
        assert cuda.patch_side(machine.shared_bytes) == side
        assert cuda.patch_side(PhasesMachine().shared_bytes) == 64
        actual, expected = on_card(machine, samples), on_card(PhasesMachine(), samples)
        assert_agree(actual, expected, tolerance=2e-3, flips=0.01, jump=0.1)

    @pytest.mark.parametrize("sigma_pix", [0.1, 0.5, 2.5, 4.0])
    @pytest.mark.parametrize("blur", [0.0, 2.0])
    def test_blurs_that_no_patch_has_room_for(self, sigma_pix: float, blur: float) -> None:
        samples = samples_of(blur)
        machine = PhasesMachine(shared_bytes=99 << 10)
        actual = on_card(machine, samples, sigma_pix=sigma_pix)
        assert ("layered_blur_down" in machine.launches) == (sigma_pix > 2)
        assert_agree(actual, by_reference(samples, sigma_pix=sigma_pix), tolerance=2e-3, flips=0.01, jump=0.1)


class TestWholeNumbers:
    @pytest.mark.parametrize("blur", [0.5, 8.0, 45.0])
    def test_order_of_threads_does_not_matter(self, blur: float) -> None:
        samples = samples_of(blur)
        images = [on_card(PhasesMachine(order), samples) for order in ORDERS]
        np.testing.assert_array_equal(images[0], images[1])
        np.testing.assert_array_equal(images[0], images[2])

    @pytest.mark.parametrize("blur", [0.0, 3.0, 12.0])
    def test_constant_radiance_stays_constant(self, blur: float) -> None:
        """Up to the rounding of samples, of 2^-23 for as many as bins have room for, and of float32."""
        samples = lit_by_one(samples_of(blur), 0.25)
        np.testing.assert_allclose(on_card(PhasesMachine(), samples), 0.25, rtol=1e-5)

    @pytest.mark.parametrize("brightness", [1e3, 1e5])
    def test_a_light_leaves_what_it_does_not_reach_as_dark(self, brightness: float) -> None:
        """Where a light sets the unit, samples are rounded by 2^(room - 30) of it at most; see the kernel."""
        samples = lit_by_one(samples_of(3.0, 32, 64), brightness)
        image = on_card(PhasesMachine(), samples)
        room = np.log2(max(64, 16 * samples.spp))
        assert image[:8, :8].max() > 1
        assert np.abs(image[:, 32:] - 0.25).max() <= brightness * 2 ** (room - 30) + 1e-5


def test_kernels_have_room_for_all_layers_that_there_can_be() -> None:
    """The thinnest that options allow, over all slopes that count, of the widest Gaussian there is."""
    lens = Lens(-1e30, 1e25, aperture="gaussian", sigma=1e3)
    assert aperture_variance(lens) <= 1 / 3
    plan = Plan.for_depths(
        lens, (720, 1280, 8), (1e-8, 1e30), sigma_pix=0.5, layer_spacing=0.05, aperture_parts=1, tile=128
    )
    assert 128 < plan.slabs.count <= cuda.MOST_LAYERS


def test_dropped_samples_say_nothing() -> None:
    samples = samples_of(6.0)
    nowhere = replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))
    np.testing.assert_array_equal(on_card(PhasesMachine(), nowhere), 0)


def test_from_outside(phases: PhasesMachine) -> None:
    samples = samples_of(5.0, 40, 60, 8)
    image = reconstruct(samples, "layered", device="cuda")
    assert "layered_tiles" in phases.launches
    assert_agree(image, reconstruct(samples, "layered", device="cpu"), tolerance=2e-3, flips=0.005, jump=0.1)
