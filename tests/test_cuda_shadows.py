"""Shading's GPU kernels, run on the CPU as phases, against the CPU's kernels, the reference and the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from agreement import assert_agree
from fewrays import METHODS, Lighting, LightSamples, SampleBuffer, SampleError, reconstruct, shade
from fewrays.cuda import device
from fewrays.cuda.kernel import Kernel
from fewrays.sources.analytic_shadows import (
    Rectangle,
    aimed,
    render_lit,
    true_image,
)
from fewrays.temporal import shading
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.lamps import make_lamps
from fewrays.temporal.plan import SurfaceRule
from lamp_scenes import KINDS, PLATE, SCENES, samples_of, scene_of, textured, with_lights
from phases import ORDERS, PhasesMachine
from shadow_scenes import level

Float32 = npt.NDArray[np.float32]


class CountingMachine(PhasesMachine):
    """Notes how many samples each kernel was given."""

    def __init__(self, order: int = 0) -> None:
        super().__init__(order)
        self.counts: dict[str, list[int]] = {}

    def launch(
        self, kernel: Kernel, grid: tuple[int, int, int], *, shared_bytes: int = 0, **arguments: Any
    ) -> None:
        if "count" in arguments:
            self.counts.setdefault(kernel.name, []).append(arguments["count"])
        super().launch(kernel, grid, shared_bytes=shared_bytes, **arguments)


@pytest.fixture
def machine(phases: PhasesMachine, monkeypatch: pytest.MonkeyPatch) -> CountingMachine:
    counting = CountingMachine()
    monkeypatch.setattr(shading, "require_machine", lambda: counting)
    assert phases is not None
    return counting


def on_card(samples: SampleBuffer, **options: Any) -> Float32:
    return shaded(samples, "cuda", **options)


def shaded(samples: SampleBuffer, where: Any, **options: Any) -> Float32:
    options = {"light_points": 8 * samples.spp, "correction": 0.0, **options}
    color: Float32 = shade(samples, device=where, **options).color
    return color


def assert_twins(actual: Float32, expected: Float32, *, flips: float = 0.002) -> None:
    """Assert equality to rounding, relative to the mean, and the same light in all.

    Flips are samples one of whose light points shines for one twin alone, as rounding puts a light sample at
    the rim of a radius or over a tangent plane. Among the 16 000 of these scenes there was none.
    """
    scale = float(expected.mean())
    assert scale > 0
    height = expected.shape[0]
    actual, expected = actual.reshape(height, -1, 3) / scale, expected.reshape(height, -1, 3) / scale
    assert_agree(actual, expected, tolerance=1e-5, flips=flips)
    assert np.abs(actual - expected).mean() <= 1e-4


@pytest.mark.parametrize("radius_scale", [0.4, 1.4, 4.0])
@pytest.mark.parametrize("kind", KINDS)
def test_light_agrees_with_the_cpu(machine: CountingMachine, kind: str, radius_scale: float) -> None:
    samples = samples_of(kind)
    actual = on_card(samples, radius_scale=radius_scale)
    assert machine.launches[:3] == ["shadows_place", "shadows_clear", "shadows_light"]
    assert_twins(actual, shaded(samples, "cpu", radius_scale=radius_scale))


@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize("kind", ["half-plane", "moving disc, textured"])
def test_light_agrees_with_the_reference(kind: str) -> None:
    samples = samples_of(kind, 2)
    assert_twins(on_card(samples), shaded(samples, "reference"))


@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize("kind", ["half-plane", "box"])
def test_light_is_near_the_truth(kind: str) -> None:
    """Integrated over the lamp, with edges of shadows in a third of the picture."""
    scene = SCENES[kind]
    samples = render_lit(scene, 8)
    truth = true_image(scene, rays=16)
    image = on_card(samples, light_points=128).mean(axis=2)
    assert np.abs(image - truth).mean() <= 0.02 * truth.mean()


@pytest.mark.parametrize("kind", ["two lamps", "moving disc, textured"])
def test_order_of_threads_does_not_matter(
    machine: CountingMachine, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    samples = samples_of(kind)
    first = on_card(samples)
    for order in ORDERS:
        monkeypatch.setattr(machine, "order", order)
        np.testing.assert_array_equal(on_card(samples), first)


def test_what_all_of_a_lamp_shines_on_is_not_looked_up(machine: CountingMachine) -> None:
    bare = render_lit(scene_of([]), 3)
    on_card(bare)
    assert machine.counts == {"shadows_clear": [bare.depth.size], "shadows_light": [0]}
    machine.counts.clear()
    on_card(textured(bare))
    assert machine.counts == {"shadows_clear": [0], "shadows_light": [bare.depth.size]}
    machine.counts.clear()
    on_card(samples_of("moving disc"))
    (first, _), (left, _) = machine.counts["shadows_clear"], machine.counts["shadows_light"]
    assert 0 < first < bare.depth.size
    assert bare.depth.size - first <= left < bare.depth.size


@pytest.mark.usefixtures("machine")
def test_a_lamp_that_stands_in_the_ground() -> None:
    """Its lower half shines from below on normals of shading that lean to it, past what lies there."""
    cellar = level(-0.2, Rectangle((0.5, 0), (1, 2)), seen=False)
    lamp = aimed((3, 0, 0), (0, 0, 0), (0.5, 0.5), radiance=(40, 30, 20))
    scene = scene_of([cellar], (lamp,))
    samples = render_lit(scene, 3)
    old = samples.lighting
    assert old is not None
    leaning = old.normal + 0.8 * scene.camera.turn((1.0, 0.0, 0.0))
    leaning /= np.linalg.norm(leaning, axis=-1, keepdims=True)
    lighting = Lighting(old.projection, leaning, old.depth_gradient, old.unlit, old.lights)
    samples = replace(samples, lighting=lighting)
    assert_twins(on_card(samples), shaded(samples, "cpu"))


@pytest.mark.usefixtures("machine")
def test_crowds() -> None:
    """Many more samples within R than are looked at closely."""
    samples = render_lit(scene_of([PLATE], size=3), 100)
    assert_twins(on_card(samples, radius_scale=8.0, light_points=100),
                 shaded(samples, "cpu", radius_scale=8.0, light_points=100), flips=0.02)  # fmt: skip


@pytest.mark.usefixtures("machine")
def test_some_samples_have_no_light() -> None:
    """A lamp without light samples adds nothing, and samples without one get nothing of it."""

    def dimmed(number: int, each: LightSamples) -> dict[str, npt.NDArray[Any]]:
        left = each.density.copy()
        left[: None if number == 0 else 5] = 0
        return {"density": left}

    samples = with_lights(samples_of("two lamps"), dimmed)
    assert samples.lighting is not None
    actual = on_card(samples)
    np.testing.assert_allclose(actual[:5], samples.lighting.unlit[:5], rtol=1e-6)
    assert_twins(actual, shaded(samples, "cpu"))


def test_depth_first_order_is_a_walk_through_the_hierarchy() -> None:
    """Leaves hold all samples once, and behind an inner node's descendants lies what is not among them."""
    samples = samples_of("box")
    assert samples.lighting is not None
    (lamp,) = make_lamps(samples, samples.lighting)
    rule = SurfaceRule.for_samples(samples, 128, radius_scale=1.4, tent_scale=1)
    tree = Hierarchy(lamp.field, rule, lamp.density).native
    nodes, order = np.empty((tree.node_count, 18), np.int32), np.empty(samples.depth.size, np.int32)
    tree.write_depth_first(nodes, order)
    np.testing.assert_array_equal(np.sort(order), np.arange(samples.depth.size))
    first, second = nodes[:, 16], nodes[:, 17]
    leaf = first < 0
    assert leaf.sum() == tree.leaf_count
    assert second[0] == len(nodes)
    np.testing.assert_array_equal(first[~leaf], np.flatnonzero(~leaf) + 1)
    held = np.concatenate([order[~a:b] for a, b in zip(first[leaf], second[leaf], strict=True)])
    np.testing.assert_array_equal(np.sort(held), np.arange(samples.depth.size))
    for parent in np.flatnonzero(~leaf):
        end = second[parent]
        inside = slice(parent + 1, end)
        assert (second[inside][~leaf[inside]] <= end).all()
        # Two children: the first's descendants and the second's are all.
        middle = parent + 2 if leaf[parent + 1] else second[parent + 1]
        assert end == (middle + 1 if leaf[middle] else second[middle])


@pytest.mark.parametrize("method", sorted(METHODS))
def test_methods_shade_where_they_run(machine: CountingMachine, method: str) -> None:
    samples = samples_of("disc", 2)
    given: dict[str, Any] = {"temporal": {"locations": 4}, "multiplane": {"views": 4}}.get(method, {})
    reconstruct(samples, method, device="cpu", **given)
    assert "shadows_light" not in machine.launches
    reconstruct(samples, method, device="auto", **given)
    assert "shadows_light" in machine.launches


@pytest.mark.usefixtures("machine")
def test_from_outside() -> None:
    samples = samples_of("disc", 4)
    image = reconstruct(samples, "temporal", device="cuda", locations=8)
    assert_agree(
        image, reconstruct(samples, "temporal", device="cpu", locations=8), tolerance=0.005, flips=0.03
    )


@pytest.mark.skipif(not isinstance(device.find_device(), str), reason="there is a GPU")
def test_without_a_gpu_that_is_said() -> None:
    samples = samples_of("disc", 1)
    with pytest.raises(SampleError, match=r"device: (CuPy is not installed.*fewrays\[cuda\]|no NVIDIA GPU)"):
        shade(samples, device="cuda")
    np.testing.assert_array_equal(shade(samples).color, shade(samples, device="cpu").color)
