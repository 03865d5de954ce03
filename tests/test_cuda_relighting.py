"""GPU kernels for light at locations, run on the CPU as phases, against the CPU's kernels and the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from agreement import assert_agree
from fewrays import SampleBuffer, reconstruct
from fewrays.parallel import Execution
from fewrays.pinhole import needs_order, with_order
from fewrays.sources.analytic_shadows import render_lit, true_image
from fewrays.temporal import TemporalOptions, reference, relighting_cuda
from fewrays.temporal import make_plan as plan_of
from fewrays.temporal.refine import smooth_bands
from lamp_scenes import KINDS, PLATE, SCENES, samples_of, scene_of, with_lights
from lit_buffers import lighting_of
from phases import ORDERS, PhasesMachine

Float32 = npt.NDArray[np.float32]


def image_of(samples: SampleBuffer, device: str, **options: Any) -> Float32:
    options = {"locations": 8, "light_at": "locations", **options}
    image: Float32 = reconstruct(samples, "temporal", device=device, **options)
    return image


def assert_twins(actual: Float32, expected: Float32, *, flips: float = 0.02) -> None:
    """Assert equality to rounding, relative to the mean.

    Flips are pixels one of whose locations sees another surface, or gets light for one twin alone, as
    rounding puts a sample at the rim of a radius. Among the pixels of `KINDS` there was none.
    """
    scale = float(expected.mean())
    assert scale > 0
    assert_agree(actual / scale, expected / scale, tolerance=1e-5, flips=flips)


@pytest.mark.parametrize("options", [{}, {"radius_scale": 0.6}, {"radius_scale": 4.0}], ids=",".join)
@pytest.mark.parametrize("kind", KINDS)
def test_images_agree_with_the_cpu(phases: PhasesMachine, kind: str, options: dict[str, Any]) -> None:
    samples = samples_of(kind)
    actual = image_of(samples, "cuda", **options)
    assert {"relighting_see", "relighting_light"} <= set(phases.launches)
    assert not {"temporal_resolve", "shadows_light", "temporal_mean"} & set(phases.launches)
    assert_twins(actual, image_of(samples, "cpu", **options))


@pytest.mark.usefixtures("phases")
@pytest.mark.parametrize(
    "options",
    [
        {"tent_scale": 0.0},
        {"pixel_filter": "mitchell"},
        {"blades": 5},
        {"smoothing": 0.0},
        {"shutter": (0.2, 0.6)},
        {"locations": 1},
    ],
    ids=",".join,
)
def test_options_agree_with_the_cpu(options: dict[str, Any]) -> None:
    for kind in ("defocus", "moving disc, textured"):
        samples = samples_of(kind)
        assert_twins(image_of(samples, "cuda", **options), image_of(samples, "cpu", **options))


@pytest.mark.usefixtures("phases")
@pytest.mark.parametrize("kind", ["two lamps", "defocus", "moving disc, textured"])
def test_images_agree_with_the_reference(kind: str) -> None:
    samples = samples_of(kind, 2)
    plan = plan_of(samples, TemporalOptions(locations=2, light_at="locations"))
    bands = np.zeros((samples.height, samples.width, len(plan.band_starts), 4), np.float32)
    ordered = with_order(samples) if needs_order(samples) else samples
    reference.reconstruct_tiles(ordered, plan, bands, Execution())
    expected = smooth_bands(bands, plan.band_starts, plan.rule.along_lens)
    assert_twins(image_of(samples, "cuda", locations=2), expected, flips=0.04)


@pytest.mark.usefixtures("phases")
@pytest.mark.parametrize("kind", ["half-plane", "two lamps", "box"])
def test_images_are_near_the_truth(kind: str) -> None:
    """Integrated over the lamp, with edges of shadows in a third of the picture."""
    scene = SCENES[kind]
    truth = true_image(scene, rays=16)
    image = image_of(render_lit(scene, 8), "cuda", locations=64)
    assert np.abs(image - truth).mean() <= 0.03 * truth.mean()


@pytest.mark.parametrize("kind", ["two lamps", "moving disc, textured"])
def test_order_of_threads_does_not_matter(phases: PhasesMachine, kind: str) -> None:
    samples = samples_of(kind)
    first = image_of(samples, "cuda")
    for order in ORDERS:
        phases.order = order
        np.testing.assert_array_equal(image_of(samples, "cuda"), first)


def test_parts_are_lit_as_the_whole(phases: PhasesMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last part is smaller than the others."""
    samples = samples_of("two lamps")
    whole = image_of(samples, "cuda")
    phases.launches.clear()
    monkeypatch.setattr(relighting_cuda, "_MOST_SHARES", 2 * 128)
    np.testing.assert_array_equal(image_of(samples, "cuda"), whole)
    parts = -(-samples.height * samples.width // 128)
    assert parts > 1
    assert phases.launches.count("relighting_see") == 8 * parts
    assert phases.launches.count("relighting_light") == 8 * parts * 2


@pytest.mark.usefixtures("phases")
def test_glossy_samples_count_as_with_the_cpu() -> None:
    samples = samples_of("defocus")
    rng = np.random.default_rng(2)
    bandwidth = np.where(
        rng.random(samples.depth.shape) < 0.3, np.inf, rng.uniform(0.02, 1, samples.depth.shape)
    )
    samples = replace(samples, bandwidth=bandwidth.astype(np.float32))
    actual = image_of(samples, "cuda")
    assert_twins(actual, image_of(samples, "cpu"))
    assert np.abs(actual - image_of(samples_of("defocus"), "cuda")).max() > 1e-3 * actual.mean()


@pytest.mark.usefixtures("phases")
def test_some_samples_have_no_light() -> None:
    """A lamp without light samples adds nothing, and samples without one get nothing of it."""
    samples = samples_of("two lamps")
    density = [each.density.copy() for each in lighting_of(samples).lights]
    density[0][:] = 0
    density[1][:5] = 0
    samples = with_lights(samples, lambda number, _: {"density": density[number]})
    assert_twins(image_of(samples, "cuda"), image_of(samples, "cpu"))


@pytest.mark.usefixtures("phases")
def test_without_any_light_what_is_not_the_lamps_stays() -> None:
    samples = with_lights(samples_of("disc"), lambda _, each: {"density": np.zeros_like(each.density)})
    image = image_of(samples, "cuda")
    assert_agree(image, image_of(samples, "cpu"), tolerance=1e-6)
    assert_agree(image, np.tile([0.01, 0.02, 0.03], (*image.shape[:2], 1)), tolerance=1e-6)


@pytest.mark.usefixtures("phases")
def test_crowds() -> None:
    """Many more samples within R than are looked at closely."""
    samples = render_lit(scene_of([PLATE], size=3), 100)
    options = {"radius_scale": 8.0, "locations": 16}
    assert_twins(image_of(samples, "cuda", **options), image_of(samples, "cpu", **options), flips=0.1)


def test_without_shadows_samples_keep_their_own_light(phases: PhasesMachine) -> None:
    samples = samples_of("two lamps")
    images = [image_of(samples, device, shadows=False) for device in ("cuda", "cpu")]
    assert not [name for name in phases.launches if name.startswith("relighting")]
    assert_agree(*images, tolerance=0.005, flips=0.03)


def test_images_stay_on_the_card(phases: PhasesMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = samples_of("disc")
    expected = image_of(samples, "cuda")
    fetched: list[tuple[int, ...]] = []

    def on_host(array: Any) -> Any:
        fetched.append(array.shape)
        return array

    monkeypatch.setattr(phases, "on_host", on_host)
    np.testing.assert_array_equal(image_of(samples, "cuda", output="device"), expected)
    assert expected.shape not in fetched
    image_of(samples, "cuda")
    assert expected.shape in fetched
