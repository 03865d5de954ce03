"""On an NVIDIA GPU: the kernels themselves, at sizes of real images, against the CPU's.

The tests of phases hold their arithmetic to the reference; what is left is what only a GPU does: races,
memory that nobody wrote, streams, and other libraries' arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, Multiplane, defocus, reconstruct, shade
from fewrays.aperture import Aperture
from fewrays.cuda.device import require_machine
from fewrays.cuda.samples import DeviceSamples
from fewrays.dynamic import DepthLayer, DeviceLayer, defocus_rgba
from fewrays.pixel_filter import PixelFilter
from fewrays.samples import SampleBuffer
from fewrays.sources.analytic import Plane, sample, smooth_noise, stripes
from fewrays.sources.analytic_shadows import Ball, Scene, render_lit
from fewrays.temporal import cuda_refine
from fewrays.temporal.cuda_dispersion import dispersion_on_card
from fewrays.temporal.cuda_mean import sample_mean_on_card
from fewrays.temporal.dispersion import dispersion
from fewrays.temporal.refine import correct, sample_mean
from fewrays.temporal.shutter import Shutter
from shadow_scenes import FLOOR, GREEN, WARM, aside

pytestmark = pytest.mark.gpu

LENS = Lens(-60.0, 12.0)
SIZES = [(720, 1280), (333, 517)]
OTHERS: dict[str, dict[str, Any]] = {"layered": {}, "temporal": {"locations": 4}}


@pytest.fixture(autouse=True)
def poisoned_memory() -> Iterator[None]:
    """Fill the pool with NaN, so that what is not written shows."""
    cupy = pytest.importorskip("cupy")
    cupy.full(1 << 28, np.nan, np.float32)
    yield
    cupy.get_default_memory_pool().free_all_blocks()


def tone_mapped(image: Any) -> Any:
    return np.clip(image, 0, 1) ** (1 / 2.2)


def assert_like_the_cpu(actual: Any, expected: Any) -> None:
    """Below 1/255 after tone mapping on 99.9 % of the pixels."""
    assert_agree(tone_mapped(actual), tone_mapped(expected), tolerance=1 / 255, flips=1e-3)


def samples_of(size: tuple[int, int], *, moving: bool = False) -> SampleBuffer:
    samples = random_buffer(*size, 8, LENS, surfaces=20)
    if not moving:
        return samples
    fields = {name: getattr(samples, name) for name in samples.field_names()}
    rng = np.random.default_rng(1)
    surface = np.round(np.log(samples.depth) * 5).astype(int)
    velocity = rng.normal(0.0, 6.0, (int(np.ptp(surface)) + 1, 3)) * [1, 1, 0]
    motion = velocity[surface - surface.min()] * samples.depth[..., None]
    return SampleBuffer(**fields, lens=LENS, time=rng.random(samples.depth.shape), motion=motion)


def lit_samples(size: tuple[int, int], *, moving: bool = False) -> SampleBuffer:
    """Balls on the ground under two lamps, a rectangle and a disc; one ball and one lamp may move."""
    shift = (0.3, 0.1, 0.0) if moving else (0.0, 0.0, 0.0)
    shapes = [
        FLOOR,
        Ball((-0.5, 0.5, 0), 0.5, motion=shift),
        Ball((0.6, 0.3, 0), 0.3),
    ]
    lamps = [WARM, replace(GREEN, light=replace(GREEN.light, motion=shift))]
    return render_lit(Scene(aside(*size, lens_radius=0.1), shapes, lamps), 2)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("moving", [False, True])
def test_multiplane(size: tuple[int, int], moving: bool) -> None:
    samples = samples_of(size, moving=moving)
    image = reconstruct(samples, device="cuda", views=64)
    assert_like_the_cpu(image, reconstruct(samples, device="cpu", views=64))


@pytest.mark.parametrize("size", SIZES)
def test_multiplane_along_edges(size: tuple[int, int]) -> None:
    """Of edges that are long enough to be followed; random samples have none."""
    bars = Plane(LENS.depth(0.5), smooth_noise(8), stripes(25.0, direction=(3.0, 1.0)))
    samples = sample([bars, Plane(LENS.depth(4.0), smooth_noise(8, seed=1))], LENS, *size, 4)
    image = reconstruct(samples, device="cuda", views=64)
    assert_like_the_cpu(image, reconstruct(samples, device="cpu", views=64))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("moving", [False, True])
def test_temporal(size: tuple[int, int], moving: bool) -> None:
    samples = samples_of(size, moving=moving)
    image = reconstruct(samples, "temporal", device="cuda", locations=8)
    assert_like_the_cpu(image, reconstruct(samples, "temporal", device="cpu", locations=8))


@pytest.mark.parametrize("moving", [False, True])
def test_temporal_of_samples_on_the_card(moving: bool) -> None:
    """Bandwidths, times and a shutter that is not always open, all of which stay there."""
    cupy = pytest.importorskip("cupy")
    samples = samples_of(SIZES[1], moving=moving)
    rng = np.random.default_rng(5)
    fields = {name: getattr(samples, name) for name in samples.field_names()}
    fields["time"] = fields.get("time", rng.random(samples.depth.shape, np.float32))
    fields["bandwidth"] = rng.uniform(0.2, 2.0, samples.depth.shape).astype(np.float32)
    on_card = DeviceSamples.of_arrays(
        **{name: cupy.asarray(each) for name, each in fields.items()}, lens=LENS
    )
    options: dict[str, Any] = {"locations": 8, "shutter": (0.1, 0.8), "blades": 5, "pixel_filter": "mitchell"}
    image = reconstruct(on_card, "temporal", output="device", **options)
    assert isinstance(image, cupy.ndarray)
    expected = reconstruct(SampleBuffer(**fields, lens=LENS), "temporal", device="cpu", **options)
    assert_like_the_cpu(cupy.asnumpy(image), expected)


@pytest.mark.parametrize("spp", [1, 8])
def test_holes_between_samples(spp: int) -> None:
    samples = random_buffer(64, 64, spp, LENS)
    machine = require_machine()
    on_card = DeviceSamples.of_buffer(machine, samples)
    assert dispersion_on_card(machine, on_card, timed=False) == pytest.approx(dispersion(samples), rel=1e-9)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("correction", [0.5, 1.8, 16.0])
def test_correction(size: tuple[int, int], correction: float) -> None:
    """With what single samples say as well, and a median of as many numbers as pixels."""
    machine = require_machine()
    samples = random_buffer(*size, 2, LENS, off_image=0.3)
    image = np.random.default_rng(6).gamma(2.0, 0.5, (*size, 3)).astype(np.float32)
    aperture, box, whole = Aperture.of_lens(LENS), PixelFilter(), Shutter()
    expected = correct(image, sample_mean(samples, aperture, box, whole), correction)
    mean = sample_mean_on_card(machine, DeviceSamples.of_buffer(machine, samples), aperture, box, whole)
    actual = cuda_refine.correct(machine, machine.on_device(image, np.float32), mean, correction)
    assert_agree(machine.on_host(actual), expected, tolerance=1e-4)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("moving", [False, True])
def test_shading(size: tuple[int, int], moving: bool) -> None:
    samples = lit_samples(size, moving=moving)
    image, expected = (
        shade(samples, light_points=16, correction=0.0, device=where).color.mean(axis=2)
        for where in ("cuda", "cpu")
    )
    assert_like_the_cpu(image, expected)
    assert abs(float(image.mean() / expected.mean()) - 1) < 1e-4


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("moving", [False, True])
def test_light_at_locations(size: tuple[int, int], moving: bool) -> None:
    cupy = pytest.importorskip("cupy")
    samples = lit_samples(size, moving=moving)
    options: dict[str, Any] = {"locations": 8, "light_at": "locations"}
    image = reconstruct(samples, "temporal", device="cuda", output="device", **options)
    assert isinstance(image, cupy.ndarray)
    actual, expected = cupy.asnumpy(image), reconstruct(samples, "temporal", device="cpu", **options)
    assert_like_the_cpu(actual, expected)
    assert abs(float(actual.mean() / expected.mean()) - 1) < 1e-4


@pytest.mark.parametrize("size", SIZES)
def test_layered(size: tuple[int, int]) -> None:
    samples = samples_of(size)
    image = reconstruct(samples, "layered", device="cuda")
    assert_like_the_cpu(image, reconstruct(samples, "layered", device="cpu"))


@pytest.mark.parametrize("size", SIZES)
def test_dynamic(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    color = rng.random((*size, 3))
    depth = np.repeat(np.repeat(rng.uniform(2, 30, (size[0] // 9 + 1, size[1] // 9 + 1)), 9, 0), 9, 1)
    depth = depth[: size[0], : size[1]]
    image = defocus(color, depth, LENS, device="cuda")
    assert_like_the_cpu(image, defocus(color, depth, LENS, device="cpu"))


def test_dynamic_layers() -> None:
    """A layer behind, opacities, and all that the kernels of the preparation do with them."""
    cupy = pytest.importorskip("cupy")
    rng = np.random.default_rng(4)
    shape = (333, 517)
    arrays = []
    for _ in range(2):
        depth = np.repeat(np.repeat(rng.uniform(2, 30, (38, 58)), 9, 0), 9, 1)[: shape[0], : shape[1]]
        alpha = np.where(rng.random(shape) < 0.3, rng.random(shape), 1.0)
        arrays.append((rng.random((*shape, 3)) * alpha[..., None], depth, alpha))
    layers = [DepthLayer(*(each.astype(np.float32) for each in given)) for given in arrays]
    front, back = layers
    expected = defocus_rgba(front.color, front.depth, LENS, alpha=front.alpha, behind=[back], device="cpu")
    color, depth, alpha = (cupy.asarray(each) for each in (front.color, front.depth, front.alpha))
    behind = DeviceLayer.of_arrays(*(cupy.asarray(each) for each in (back.color, back.depth, back.alpha)))
    image = defocus_rgba(color, depth, LENS, alpha=alpha, behind=[behind], output="device")
    assert isinstance(image, cupy.ndarray)
    assert_like_the_cpu(cupy.asnumpy(image), expected)


def test_repeats_are_the_same_bit_by_bit() -> None:
    samples = samples_of((360, 640))
    first = Multiplane.build(samples, device="cuda")
    image = first.render()
    rng = np.random.default_rng(3)
    color, depth = rng.random((360, 640, 3)), rng.uniform(2, 30, (360, 640))
    blurred = defocus(color, depth, LENS, device="cuda")
    others = {name: reconstruct(samples, name, device="cuda", **given) for name, given in OTHERS.items()}
    lit = lit_samples((180, 320))
    shaded = shade(lit, light_points=16, device="cuda").color
    for _ in range(10):
        np.testing.assert_array_equal(shade(lit, light_points=16, device="cuda").color, shaded)
        for name, given in OTHERS.items():
            np.testing.assert_array_equal(reconstruct(samples, name, device="cuda", **given), others[name])
        again = Multiplane.build(samples, device="cuda")
        np.testing.assert_array_equal(again.maps.halves, first.maps.halves)
        np.testing.assert_array_equal(again.render(), image)
        np.testing.assert_array_equal(defocus(color, depth, LENS, device="cuda"), blurred)


def test_a_sequence_allocates_once() -> None:
    cupy = pytest.importorskip("cupy")
    planes = Multiplane.build(samples_of((360, 640)), device="cuda")
    planes.render(output="device")
    pool = cupy.get_default_memory_pool()
    taken = pool.total_bytes()
    for distance in np.linspace(3.0, 8.0, 10):
        planes.render(planes.lens.refocus(float(distance)), output="device", smoothing=0.0)
    assert pool.total_bytes() == taken


def test_images_are_made_on_the_current_stream() -> None:
    cupy = pytest.importorskip("cupy")
    planes = Multiplane.build(samples_of((360, 640)), device="cuda")
    expected = planes.render()
    cupy.cuda.Device().synchronize()
    with cupy.cuda.Stream(non_blocking=True) as stream:
        image = planes.render(output="device")
        stream.synchronize()
    np.testing.assert_array_equal(cupy.asnumpy(image), expected)


def test_arrays_on_the_card_are_not_copied() -> None:
    cupy = pytest.importorskip("cupy")
    samples = samples_of((40, 60))
    arrays = {name: cupy.asarray(getattr(samples, name)) for name in ("xy", "uv", "depth", "color")}
    taken = DeviceSamples.of_arrays(**arrays, lens=LENS)
    for name, array in arrays.items():
        assert getattr(taken, name).data.ptr == array.data.ptr
    expected = reconstruct(samples, device="cuda", views=16)
    np.testing.assert_array_equal(reconstruct(taken, views=16), expected)
    assert isinstance(reconstruct(taken, views=16, output="device"), cupy.ndarray)


def test_tensors_of_pytorch_are_not_copied() -> None:
    torch = pytest.importorskip("torch")
    samples = samples_of((40, 60))
    names = ("xy", "uv", "depth", "color")
    arrays = {name: torch.from_numpy(getattr(samples, name)).cuda() for name in names}
    taken = DeviceSamples.of_arrays(**arrays, lens=LENS)
    for name, array in arrays.items():
        assert getattr(taken, name).data.ptr == array.data_ptr()
