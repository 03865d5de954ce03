"""The correction of light towards what the samples' own light samples brought."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import SampleBuffer, shade
from fewrays.parallel import Execution
from fewrays.sources.analytic_shadows import Scene, render_lit
from fewrays.sources.outlines import Rectangle
from fewrays.temporal.settle import settle
from lit_buffers import lighting_of, lit_buffer
from shadow_scenes import FLOOR, WARM, aside, level

Float32 = npt.NDArray[np.float32]

ONE_THREAD = Execution(threads=1)


def unblocked(samples: SampleBuffer) -> Float32:
    """Return the light (H, W, S, 3) that the lamps would bring if nothing were in between."""
    lighting = lighting_of(samples)
    total: Float32 = sum(
        (lighting.direct(samples, number, occluded=False) for number in range(len(lighting.lights))),
        np.zeros_like(samples.color),
    )
    return total


def given(samples: SampleBuffer, share: float | Float32) -> Float32:
    """Return colours with a share of the light."""
    return (lighting_of(samples).unlit + share * unblocked(samples)).astype(np.float32)


def shelf_over_floor() -> SampleBuffer:
    """Make samples of a floor and of a shelf above it, which is as level."""
    shelf = level(0.5, Rectangle((0, 0), (4.0, 0.6)))
    return render_lit(Scene(aside(24, 32), [FLOOR, shelf], [WARM]), 4)


def bare_floor() -> SampleBuffer:
    """Make samples of a floor that gets all of a lamp's light."""
    return render_lit(Scene(aside(24, 32), [FLOOR], [WARM]), 4)


def on_shelf(samples: SampleBuffer) -> npt.NDArray[np.bool_]:
    """Tell which samples (H, W, S) lie on the shelf: nearer to the camera's height than the floor's plane."""
    lighting = lighting_of(samples)
    up = lighting.normal.reshape(-1, 3).mean(axis=0)
    height = lighting.points(samples) @ (up / np.linalg.norm(up))
    return np.asarray(height > height.min() + 0.25)


class TestTwins:
    @pytest.mark.parametrize("spp", [1, 2, 5])
    @pytest.mark.parametrize("sigma", [0.5, 0.8, 2.2])
    def test_agree(self, spp: int, sigma: float) -> None:
        samples = lit_buffer((7, 9, spp))
        color = given(samples, 0.7)
        native, definition = (
            settle(samples, color, sigma, Execution(device, 1)) for device in ("cpu", "reference")
        )
        assert not np.array_equal(native, color)
        np.testing.assert_allclose(native, definition, rtol=2e-4, atol=2e-5)

    def test_threads(self) -> None:
        samples = lit_buffer((33, 9, 2))
        color = given(samples, 0.7)
        one, three = (settle(samples, color, 0.5, Execution(threads=count)) for count in (1, 3))
        np.testing.assert_array_equal(one, three)


class TestWhatMustNotMatter:
    def test_order_of_samples(self) -> None:
        samples = shelf_over_floor()
        color = given(samples, 0.5)
        order = np.random.default_rng(0).permutation(4)
        lighting = lighting_of(samples)
        turned = {name: getattr(samples, name)[:, :, order] for name in ("xy", "uv", "depth", "color")}
        lights = [
            type(light)(
                light.light, **{name: getattr(light, name)[:, :, order] for name in light.field_names()}
            )
            for light in lighting.lights
        ]
        arrays = {name: getattr(lighting, name)[:, :, order] for name in lighting.field_names()}
        other = replace(
            samples, **turned, lighting=type(lighting)(lighting.projection, lights=lights, **arrays)
        )
        settled = settle(samples, color, 0.5, ONE_THREAD)[:, :, order]
        np.testing.assert_allclose(
            settle(other, np.ascontiguousarray(color[:, :, order]), 0.5, ONE_THREAD),
            settled,
            rtol=1e-4,
            atol=1e-5,
        )

    @pytest.mark.parametrize("factor", [1e-12, 1e-3, 1e6])
    def test_brightness(self, factor: float) -> None:
        samples = shelf_over_floor()
        lighting = lighting_of(samples)
        lights = [
            type(light)(
                light.light,
                **{name: getattr(light, name) for name in light.field_names()}
                | {"radiance": np.float32(factor) * light.radiance},
            )
            for light in lighting.lights
        ]
        arrays = {name: getattr(lighting, name) for name in lighting.field_names()}
        other = type(lighting)(lighting.projection, lights=lights, **arrays)
        bright = replace(samples, color=other.color(samples), lighting=other)
        expected = settle(samples, given(samples, 0.5), 0.5, ONE_THREAD)
        settled = settle(bright, given(bright, 0.5), 0.5, ONE_THREAD)
        np.testing.assert_allclose(settled / np.float32(factor), expected, rtol=1e-3, atol=1e-5)


class TestTruth:
    def test_what_is_right_stays(self) -> None:
        """Where own light samples say the same, nothing is corrected, bit by bit."""
        samples = lit_buffer((5, 6, 3), blocked=0.0)
        np.testing.assert_array_equal(settle(samples, samples.color, 0.5, ONE_THREAD), samples.color)

    def test_what_is_wrong_everywhere_is_put_right(self) -> None:
        samples = bare_floor()
        wrong = given(samples, 0.6)
        settled = settle(samples, wrong, 0.7, ONE_THREAD)
        assert np.abs(settled - samples.color).mean() < 1e-3 * np.abs(wrong - samples.color).mean()

    def test_surfaces_keep_to_themselves(self) -> None:
        """Light that is wrong on a shelf is put right there, and stays as it is on the floor beside it."""
        samples = shelf_over_floor()
        clear = replace(samples, color=given(samples, 1.0))
        shelf = on_shelf(samples)
        assert 0.2 < shelf.mean() < 0.8
        color = given(clear, np.where(shelf, np.float32(0.4), np.float32(1.0))[..., None])
        settled = settle(clear, color, 0.5, ONE_THREAD)
        mixed = shelf.any(axis=2, keepdims=True) & ~shelf.all(axis=2, keepdims=True)
        assert (mixed & shelf).sum() > 20
        before = np.abs(color - clear.color).sum(axis=-1)
        after = np.abs(settled - clear.color).sum(axis=-1)
        assert after[mixed & shelf].mean() < 0.1 * before[mixed & shelf].mean()
        assert after[mixed & ~shelf].max() < 0.01 * before[shelf].mean()

    def test_noise_does_not_come_back(self) -> None:
        """Where half of the light samples are blocked at random, half of the light stays nearly that."""
        samples = bare_floor()
        arrives = np.random.default_rng(1).integers(0, 2, samples.depth.shape)[..., None]
        noisy = replace(samples, color=given(samples, arrives.astype(np.float32)))
        color = given(samples, 0.5)
        settled = settle(noisy, color, 0.5, ONE_THREAD)
        assert np.abs(settled - color).mean() < 0.15 * np.abs(noisy.color - color).mean()

    def test_never_below_what_is_not_the_lamps(self) -> None:
        samples = lit_buffer((9, 8, 3), blocked=0.9)
        settled = settle(samples, given(samples, 0.1), 0.5, ONE_THREAD)
        assert (settled >= lighting_of(samples).unlit - 1e-7).all()


def test_shade_corrects() -> None:
    samples = shelf_over_floor()
    plain, corrected = (shade(samples, correction=correction).color for correction in (0, 0.5))
    assert not np.array_equal(plain, corrected)
    definition = shade(samples, device="reference", light_points=4, correction=0.5).color
    native = shade(samples, device="cpu", light_points=4, correction=0.5).color
    np.testing.assert_allclose(native, definition, rtol=1e-3, atol=1e-4)
