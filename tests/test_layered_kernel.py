"""The layered method's native kernels against their reference, and what must not change their result."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, SampleBuffer, SampleError
from fewrays import reconstruct as reconstruct_with
from fewrays.layered import reference, regions
from fewrays.layered.aperture import ApertureParts
from fewrays.layered.plan import Plan
from fewrays.layered.taps import gaussian_taps, tap_count
from fewrays.lens import LensAperture, Sampling
from fewrays.method import Image
from fewrays.samples import OFF_IMAGE
from rounding import change_by_rounding

reconstruct = partial(reconstruct_with, method="layered")

LENS = Lens(-40.0, 8.0)


def lens_of(blur: float, aperture: LensAperture = "disc", sampling: Sampling = "disc") -> Lens:
    """Return a lens focused at 5 that gives the far background a circle of confusion of `blur` pixels."""
    return Lens(-5 * blur, blur, aperture, sampling)


def levels_of(samples: SampleBuffer) -> set[int]:
    plan = Plan.for_samples(samples, sigma_pix=0.5, layer_spacing=0.16, aperture_parts=7, tile=128)
    present = plan.slabs.of_slope(samples.lens.slope(samples.depth).astype(np.float32))
    return set(plan.slabs.levels[present].ravel().tolist())


def assert_twins(actual: npt.ArrayLike, expected: npt.ArrayLike) -> None:
    """Assert equality to rounding.

    A sample that rounding puts into the neighbouring bin is the exception. It may be seen wherever its
    layer's blur spreads it, but faintly; of tens of thousands of samples one or none does that.
    """
    assert_agree(actual, expected, tolerance=1e-5, flips=0.5, jump=0.03)


def largest_number(samples: Any, layer: Any, window: Any, *_: Any) -> float:
    """Return what positions in a layer's bins are computed from, at most, in pixels."""
    return float(
        np.abs(samples.xy).max(initial=0) + abs(layer.slope) + max(abs(window.left), abs(window.top))
    )


@pytest.fixture
def two_gigabytes() -> Iterator[None]:
    """Let a test have no more memory than that on top of what is in use."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**31, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


class TestAgainstTheReference:
    @pytest.mark.parametrize("blur", [3.0, 10.0, 40.0, 160.0])
    @pytest.mark.parametrize(
        "options",
        [
            {},
            {"tile": 16},
            {"tile": 45},
            {"aperture_parts": 1},
            {"aperture_parts": 13, "tile": 33},
            {"aperture_parts": 19},
            {"aperture_parts": 19, "tile": 16},
            {"sigma_pix": 1.2, "layer_spacing": 0.4},
        ],
        ids=lambda options: ",".join(f"{name}={value}" for name, value in options.items()) or "defaults",
    )
    def test_every_output_agrees(self, blur: float, options: dict[str, Any]) -> None:
        samples = random_buffer(45, 70, 4, lens_of(blur), off_image=0.05, seed=1)
        expected, expected_aovs = reconstruct(samples, device="reference", aovs=True, **options)
        actual, actual_aovs = reconstruct(samples, device="cpu", aovs=True, **options)
        assert_twins(actual, expected)
        assert actual_aovs.keys() == expected_aovs.keys()
        for name in ("layer_radiance", "layer_opacity"):
            assert_twins(actual_aovs[name], expected_aovs[name])
        # The kernel may leave out layers that do not show.
        assert (actual_aovs["layer_count"] <= expected_aovs["layer_count"]).all()
        assert (actual_aovs["layer_count"] >= np.count_nonzero(actual_aovs["layer_opacity"], axis=2)).all()

    def test_those_buffers_have_bins_of_all_sizes(self) -> None:
        blurs = (3.0, 10.0, 40.0, 160.0)
        levels = [
            levels_of(random_buffer(45, 70, 4, lens_of(blur), off_image=0.05, seed=1)) for blur in blurs
        ]
        assert set().union(*levels) >= {-2, -1, 0, 1, 2, 3}

    @settings(max_examples=40)
    @given(
        height=st.integers(1, 40),
        width=st.integers(1, 40),
        spp=st.integers(1, 6),
        aperture=st.sampled_from(["disc", "gaussian"]),
        sampling=st.sampled_from(["disc", "square", "gaussian"]),
        blur=st.sampled_from([0.0, 0.3, 2.0, 12.0, 60.0, 300.0]),
        sigma=st.floats(0.2, 0.5),
        tile=st.integers(16, 40),
        parts=st.sampled_from(ApertureParts.COUNTS),
        off_image=st.sampled_from([0.0, 0.3]),
        seed=st.integers(0, 1000),
    )
    @example(
        height=15,
        width=1,
        spp=5,
        aperture="disc",
        sampling="gaussian",
        blur=12.0,
        sigma=0.25,
        tile=27,
        parts=13,
        off_image=0.0,
        seed=107,
    )
    @example(
        height=14,
        width=31,
        spp=6,
        aperture="gaussian",
        sampling="disc",
        blur=300.0,
        sigma=0.22991000109938686,
        tile=25,
        parts=13,
        off_image=0.0,
        seed=592,
    )
    @example(
        height=3,
        width=8,
        spp=1,
        aperture="disc",
        sampling="square",
        blur=300.0,
        sigma=0.25,
        tile=35,
        parts=7,
        off_image=0.3,
        seed=446,
    )
    @example(
        height=16,
        width=11,
        spp=4,
        aperture="disc",
        sampling="square",
        blur=60.0,
        sigma=0.25,
        tile=18,
        parts=19,
        off_image=0.0,
        seed=895,
    )
    @example(
        height=40,
        width=18,
        spp=1,
        aperture="disc",
        sampling="gaussian",
        blur=12.0,
        sigma=0.2,
        tile=19,
        parts=19,
        off_image=0.3,
        seed=142,
    )
    def test_any_buffer(
        self,
        height: int,
        width: int,
        spp: int,
        aperture: LensAperture,
        sampling: Sampling,
        blur: float,
        sigma: float,
        tile: int,
        parts: int,
        off_image: float,
        seed: int,
    ) -> None:
        lens = replace(lens_of(blur, aperture, sampling), sigma=sigma)
        samples = random_buffer(height, width, spp, lens, seed=seed, off_image=off_image)
        by_reference = partial(reconstruct, samples, device="reference", tile=tile, aperture_parts=parts)
        expected = by_reference()
        actual = reconstruct(samples, device="cpu", tile=tile, aperture_parts=parts)
        if not np.allclose(actual, expected, rtol=1e-5, atol=1e-5):
            change = change_by_rounding(by_reference, (reference, "_scatter"), largest_number)
            # As close to the kernel as samples that rounding puts into a neighbouring bin explain.
            expected = np.clip(actual, expected - change, expected + change)
        assert_agree(actual, expected, tolerance=1e-4, flips=0.01 if height * width > 600 else 1.0, jump=0.5)
        assert np.median(np.abs(actual - expected)) <= 1e-5 * max(1.0, float(np.abs(expected).max()))

    @pytest.mark.parametrize("sampling", ["disc", "square", "gaussian"])
    def test_lens_samplings(self, sampling: Sampling) -> None:
        samples = random_buffer(40, 50, 3, lens_of(15.0, "gaussian", sampling))
        expected = reconstruct(samples, device="reference")
        assert_twins(reconstruct(samples), expected)

    def test_refocused_samples_that_left_their_pixels(self) -> None:
        samples = random_buffer(60, 80, 3, lens_of(20.0), seed=1).refocus(9.0)
        pixels = np.stack(np.meshgrid(np.arange(80), np.arange(60)), axis=-1)[:, :, None]
        assert np.abs(samples.xy - pixels).max() > 5
        expected = reconstruct(samples, device="reference", tile=32)
        assert_twins(reconstruct(samples, tile=32), expected)

    @pytest.mark.parametrize("blur", [2.0, 8.0, 20.0, 60.0, 150.0, 300.0])
    @pytest.mark.parametrize(("depth", "u"), [(7.0, 0.0), (4.0, -0.99)])
    def test_few_samples_and_nothing_around_them(self, blur: float, depth: float, u: float) -> None:
        """A layer's map ends where its blur does, on whatever bins, and not before."""
        samples = random_buffer(120, 180, 2, lens_of(blur), seed=1)
        block = np.s_[48:64, 96:112]
        xy, uv = np.full_like(samples.xy, OFF_IMAGE), samples.uv.copy()
        xy[block], uv[block] = samples.xy[block], (u, 0.0)
        alone = replace(samples, xy=xy, uv=uv, depth=np.full_like(samples.depth, depth))
        expected = reconstruct(alone, device="reference", tile=64)
        assert np.count_nonzero(expected) > 0
        assert_twins(reconstruct(alone, tile=64), expected)

    @pytest.mark.parametrize("c1", [0.0, 60.0])
    def test_slopes_at_the_boundaries_of_layers(self, c1: float) -> None:
        """The kernel's table look-up puts them into the layer that a search among the boundaries finds."""
        lens = Lens(-40.0, c1)
        samples = random_buffer(64, 64, 4, lens)
        depth = np.geomspace(0.3, 40.0, samples.depth.size, dtype=np.float32)
        samples = replace(samples, depth=depth.reshape(samples.depth.shape))
        plan = Plan.for_samples(samples, sigma_pix=0.5, layer_spacing=0.16, aperture_parts=7, tile=128)
        at_boundary = lens.c0 / (plan.slabs.boundaries.astype(np.float64) - c1)
        ulps = np.float32(1) + np.arange(-8, 9, dtype=np.float32) * np.finfo(np.float32).eps
        critical = (at_boundary.astype(np.float32)[:, None] * ulps).ravel()
        rng = np.random.default_rng(0)
        depth = rng.permutation(np.resize(np.concatenate([critical, [depth[0], depth[-1]]]), depth.shape))
        samples = replace(samples, depth=depth.reshape(samples.depth.shape).astype(np.float32))
        _, expected = reconstruct(samples, device="reference", aovs=True)
        _, actual = reconstruct(samples, aovs=True)
        # Samples that rounding moves to another bin are a few; a look-up that is wrong anywhere moves
        # hundreds.
        assert_agree(actual["layer_opacity"], expected["layer_opacity"], tolerance=1e-4, flips=0.005)

    @pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on memory")
    @pytest.mark.usefixtures("two_gigabytes")
    @pytest.mark.parametrize(
        ("c0", "c1"), [(-1e4, 2e3), (-1e5, 2e4), (-1e30, 2.0), (-40.0, 1e25), (-1e30, -1e30)]
    )
    def test_absurd_slopes(self, c0: float, c1: float) -> None:
        """Lenses at the edge of float32 give finite images in little memory, the same on both devices."""
        samples = random_buffer(20, 20, 3, LENS)
        depth = 10 ** np.random.default_rng(3).uniform(-8, 30, samples.depth.shape)
        absurd = replace(samples, depth=depth.astype(np.float32), lens=Lens(c0, c1))
        expected = reconstruct(absurd, device="reference", threads=1)
        assert_agree(reconstruct(absurd, threads=1), expected, tolerance=1e-3, flips=1.0, jump=5.0)


class TestInvariance:
    def test_threads_do_not_change_a_bit(self) -> None:
        samples = random_buffer(100, 150, 3, lens_of(40.0))
        images = [reconstruct(samples, threads=threads, tile=32) for threads in (1, 2, 3)]
        np.testing.assert_array_equal(images[0], images[1])
        np.testing.assert_array_equal(images[0], images[2])

    @pytest.mark.parametrize("blur", [8.0, 60.0])
    def test_order_of_samples_within_a_pixel(self, blur: float) -> None:
        samples = random_buffer(50, 60, 4, lens_of(blur))
        order = np.random.default_rng(5).permuted(np.broadcast_to(np.arange(4), samples.depth.shape), axis=2)
        each = np.take_along_axis
        shuffled = replace(
            samples,
            xy=each(samples.xy, order[..., None], 2),
            uv=each(samples.uv, order[..., None], 2),
            depth=each(samples.depth, order, 2),
            color=each(samples.color, order[..., None], 2),
        )
        assert not np.array_equal(shuffled.depth, samples.depth)
        assert_agree(reconstruct(shuffled), reconstruct(samples), tolerance=2e-5)

    @pytest.mark.parametrize("blur", [8.0, 60.0])
    def test_size_of_tiles(self, blur: float) -> None:
        """Only a layer's mean slope comes from another neighbourhood, and coarse bins may lie elsewhere."""
        samples = random_buffer(90, 110, 4, lens_of(blur))
        difference = np.abs(reconstruct(samples, tile=32) - reconstruct(samples, tile=128))
        assert np.median(difference) < 2e-3
        assert np.quantile(difference, 0.99) < 0.03
        assert difference.max() < 0.15

    @pytest.mark.parametrize("blur", [30.0, 200.0])
    def test_size_of_regions(self, blur: float, monkeypatch: pytest.MonkeyPatch) -> None:
        """Images of several regions are no different, and agree with the reference."""
        samples = random_buffer(90, 110, 4, lens_of(blur))
        whole = reconstruct(samples, tile=16)
        monkeypatch.setattr(regions, "MAX_REGION", 48)
        assert levels_of(samples) >= {2, 3}
        parts = reconstruct(samples, tile=16)
        assert_twins(parts, reconstruct(samples, tile=16, device="reference"))
        difference = np.abs(parts - whole)
        assert np.median(difference) < 2e-3
        assert 0 < difference.max() < 0.03

    def test_dropped_samples_leave_no_trace(self) -> None:
        samples = random_buffer(40, 40, 4, LENS)
        color = samples.color.copy()
        color[::3, ::2, 1] = np.nan
        with pytest.warns(UserWarning, match="dropped"):
            dropped = SampleBuffer(samples.xy, samples.uv, samples.depth, color, samples.lens, nan="drop")
        xy = samples.xy.copy()
        xy[::3, ::2, 1] = OFF_IMAGE
        assert_twins(reconstruct(dropped), reconstruct(replace(samples, xy=xy)))
        assert_twins(reconstruct(dropped), reconstruct(dropped, device="reference"))

    def test_guard_band_is_used(self) -> None:
        """Samples outside the image reach it: with a guard band it equals the crop of a larger image."""
        large = random_buffer(96, 96, 4, lens_of(3.0))
        cropped = SampleBuffer(large.xy - 32, large.uv, large.depth, large.color, large.lens)
        inner = reconstruct(large, tile=32)[32:64, 32:64]
        assert_agree(reconstruct(cropped, tile=32)[:32, :32], inner, tolerance=1e-5)

        square = np.s_[32:64, 32:64]
        xy, uv, depth, color = (a[square] for a in (cropped.xy, large.uv, large.depth, large.color))
        inside_only = SampleBuffer(xy, uv, depth, color, large.lens)
        assert np.abs(reconstruct(inside_only) - inner).max() > 1e-3


class TestOutputs:
    @pytest.mark.parametrize("device", ["cpu", "reference"])
    @pytest.mark.parametrize("blur", [8.0, 60.0])
    def test_layers_add_up(self, device: str, blur: float) -> None:
        image, aovs = reconstruct(random_buffer(40, 50, 4, lens_of(blur)), device=device, aovs=True, tile=32)
        assert aovs["layer_radiance"].shape == (40, 50, aovs["layer_opacity"].shape[2], 3)
        np.testing.assert_allclose(aovs["layer_radiance"].sum(axis=2), image, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(aovs["layer_opacity"].sum(axis=2), 1, rtol=1e-5)
        assert aovs["layer_opacity"].min() >= 0
        assert aovs["layer_count"].shape == (40, 50)
        assert aovs["layer_count"].max() <= aovs["layer_opacity"].shape[2]

    def test_asking_for_layers_does_not_change_the_image(self) -> None:
        samples = random_buffer(40, 50, 4, LENS)
        assert_agree(reconstruct(samples, aovs=True)[0], reconstruct(samples), tolerance=1e-6)

    @pytest.mark.parametrize("device", ["cpu", "reference"])
    def test_image_without_samples_is_black(self, device: str) -> None:
        samples = random_buffer(8, 8, 2, LENS)
        nowhere = replace(samples, xy=np.full_like(samples.xy, OFF_IMAGE))
        black: Image = np.zeros((8, 8, 3), np.float32)
        np.testing.assert_array_equal(reconstruct(nowhere, device=device), black)

    @pytest.mark.parametrize("blur", [0.5, 8.0, 60.0, 500.0])
    def test_nothing_is_negative(self, blur: float) -> None:
        samples = random_buffer(60, 60, 2, lens_of(blur))
        color = samples.color.copy()
        color[::7, ::5] *= 1000
        assert reconstruct(replace(samples, color=color)).min() >= 0

    @pytest.mark.parametrize(
        ("options", "field"),
        [
            ({"sigma_pix": 0.0}, "sigma_pix"),
            ({"tile": 2}, "tile"),
            ({"layer_spacing": 0.01}, "layer_spacing"),
            ({"aperture_parts": 0}, "aperture_parts"),
            ({"aperture_parts": 9}, "aperture_parts"),
            ({"no_such": 1}, "no_such"),
            ({"device": "abacus"}, "device"),
            ({"threads": 0}, "threads"),
            ({"method": "magic"}, "method"),
        ],
    )
    def test_bad_options_are_named(self, options: dict[str, Any], field: str) -> None:
        with pytest.raises(SampleError) as caught:
            reconstruct(random_buffer(4, 4, 1, LENS), **options)
        assert caught.value.field == field


class TestTaps:
    @pytest.mark.parametrize("first", [0.0, 0.5])
    @given(beyond=st.floats(1e-8, 1e4))
    def test_variance_is_exact(self, first: float, beyond: float) -> None:
        variance = first**2 + beyond
        taps = gaussian_taps(variance, first, tap_count(variance, first))
        distance2 = (first + np.arange(len(taps))) ** 2
        twice = np.where(distance2 > 0, 2, 1)
        assert (twice * taps).sum() == pytest.approx(1)
        assert (twice * taps * distance2).sum() - first**2 == pytest.approx(beyond, rel=1e-6)
        assert (np.diff(taps) <= 0).all()

    def test_no_variance_is_a_single_tap(self) -> None:
        assert tap_count(0.0, 0.0) == 1
        np.testing.assert_array_equal(gaussian_taps(0.0, 0.0, 1), [1.0])

    def test_between_bins_the_least_is_one_tap_on_each_side(self) -> None:
        assert tap_count(0.1, 0.5) == 1
        np.testing.assert_array_equal(gaussian_taps(0.1, 0.5, 1), [0.5])

    def test_too_few_taps_give_a_box(self) -> None:
        np.testing.assert_allclose(gaussian_taps(100.0, 0.0, 3), [0.2, 0.2, 0.2])
        np.testing.assert_allclose(gaussian_taps(100.0, 0.5, 3), [1 / 6, 1 / 6, 1 / 6])

    @pytest.mark.parametrize("first", [0.0, 0.5])
    def test_wide_taps_are_those_of_a_gaussian(self, first: float) -> None:
        taps = gaussian_taps(400.0, first, tap_count(400.0, first))
        gaussian = np.exp(-((first + np.arange(len(taps))) ** 2) / 800) / np.sqrt(800 * np.pi)
        np.testing.assert_allclose(taps, gaussian, atol=0.02 * gaussian[0])
