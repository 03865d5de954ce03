"""Methods asked for ``device="cuda"``, from the outside; a machine that runs phases stands for the GPU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agreement import assert_agree
from buffers import random_buffer
from fewrays import Lens, Multiplane, SampleError, defocus, reconstruct, save
from fewrays.cli import main
from fewrays.cuda.samples import DeviceSamples
from fewrays.samples import SampleBuffer
from phases import PhasesMachine

LENS = Lens(-40.0, 8.0)


@pytest.fixture
def samples() -> SampleBuffer:
    return random_buffer(19, 37, 3, LENS)


def device_samples(samples: SampleBuffer, **changes: object) -> DeviceSamples:
    fields = {name: getattr(samples, name) for name in samples.field_names()}
    return DeviceSamples.of_arrays(**{"lens": samples.lens, **fields, **changes})


def test_multiplane(phases: PhasesMachine, samples: SampleBuffer) -> None:
    image = reconstruct(samples, device="cuda", views=8)
    assert {"multiplane_evidence", "multiplane_estimate", "multiplane_render"} <= set(phases.launches)
    assert_agree(image, reconstruct(samples, device="cpu", views=8), tolerance=0.003, flips=0.03, jump=0.1)


def test_auto_takes_the_gpu_where_the_method_knows_it(phases: PhasesMachine, samples: SampleBuffer) -> None:
    np.testing.assert_array_equal(reconstruct(samples, views=8), reconstruct(samples, device="cuda", views=8))
    launches = len(phases.launches)
    reconstruct(samples, "box")
    assert len(phases.launches) == launches


def test_dynamic(phases: PhasesMachine) -> None:
    rng = np.random.default_rng(0)
    color, depth = rng.random((17, 23, 3)), np.where(np.arange(23) < 9, 1.2, 6.0) * np.ones((17, 1))
    image = defocus(color, depth, LENS, device="cuda", views=7, darken=True, cats_eye=0.5)
    assert "dynamic_synthesize" in phases.launches
    expected = defocus(color, depth, LENS, device="cpu", views=7, darken=True, cats_eye=0.5)
    assert_agree(image, expected, tolerance=1e-4, flips=0.01)


def test_planes_stay_on_the_card(phases: PhasesMachine, samples: SampleBuffer, tmp_path: Path) -> None:
    planes = Multiplane.build(samples, device="cuda")
    built = phases.launches.count("multiplane_evidence")
    image = planes.render(views=8)
    np.testing.assert_array_equal(planes.render(views=8, output="device"), image)
    assert phases.launches.count("multiplane_evidence") == built
    planes.save(tmp_path / "a.planes")
    loaded = Multiplane.load(tmp_path / "a.planes")
    np.testing.assert_array_equal(loaded.render(views=8, device="cuda"), image)
    np.testing.assert_array_equal(loaded.on_card().render(views=8), image)
    assert_agree(loaded.render(views=8), image, tolerance=0.003, flips=0.03, jump=0.1)


@pytest.mark.usefixtures("phases")
def test_samples_on_the_card(samples: SampleBuffer) -> None:
    rng = np.random.default_rng(1)
    time, bandwidth = rng.uniform(0.1, 1.0, (2, *samples.depth.shape)).astype(np.float32)
    samples = replace(samples, time=time, bandwidth=bandwidth)
    on_card = device_samples(samples)
    np.testing.assert_array_equal(reconstruct(on_card, views=8), reconstruct(samples, device="cuda", views=8))
    np.testing.assert_array_equal(
        Multiplane.build(on_card).render(views=8), reconstruct(samples, device="cuda", views=8)
    )
    back = on_card.to_buffer()
    for name in samples.field_names():
        np.testing.assert_array_equal(getattr(back, name), getattr(samples, name))
    for scale in (1.0, 0.5, 0.0):
        lens = samples.lens.refocus(3.0, scale)
        seen, expected = on_card.with_lens(lens), samples.with_lens(lens)
        np.testing.assert_allclose(seen.xy, expected.xy, rtol=1e-6)
        assert expected.bandwidth is not None
        np.testing.assert_allclose(seen.bandwidth, expected.bandwidth, rtol=1e-6)
    with pytest.raises(SampleError, match=r"are on a GPU.*'box'.*to_buffer"):
        reconstruct(on_card, "box")
    with pytest.raises(SampleError, match=r"are on a GPU.*'cpu'"):
        reconstruct(on_card, device="cpu")


@pytest.mark.usefixtures("phases")
@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("depth", -1.0, "1 of 2109 values are not positive"),
        ("depth", np.nan, "positive and finite"),
        ("uv", 1.5, r"not in \[-1, 1\]"),
        ("xy", np.inf, "not finite"),
        ("color", np.nan, "not finite"),
        ("bandwidth", 0.0, "not positive"),
        ("bandwidth", np.nan, "not positive"),
    ],
)
def test_impossible_samples_on_the_card_are_refused(
    samples: SampleBuffer, field: str, value: float, problem: str
) -> None:
    # An infinite bandwidth is that of a matte surface.
    array = np.full_like(samples.depth, np.inf) if field == "bandwidth" else getattr(samples, field).copy()
    array.flat[5] = value
    with pytest.raises(SampleError, match=f"{field}: .*{problem}"):
        device_samples(samples, **{field: array})
    device_samples(samples, **{field: array}, check=False)


@pytest.mark.usefixtures("phases")
def test_shapes_on_the_card_are_checked(samples: SampleBuffer) -> None:
    with pytest.raises(SampleError, match=r"uv: expected shape \(19, 37, 3, 2\)"):
        device_samples(samples, uv=samples.depth)
    with pytest.raises(SampleError, match=r"depth: expected shape \(H, W, S\)"):
        device_samples(samples, depth=samples.uv)
    with pytest.raises(SampleError, match=r"motion: .*give time"):
        device_samples(samples, motion=np.zeros_like(samples.color))


def test_command_line(phases: PhasesMachine, samples: SampleBuffer, tmp_path: Path) -> None:
    save(tmp_path / "samples.npz", samples)
    for device in ("cuda", "cpu"):
        main(["reconstruct", str(tmp_path / "samples.npz"), "--out", str(tmp_path / f"{device}.npy"),
              "--device", device, "--views", "8"])  # fmt: skip
    images = [np.load(tmp_path / f"{device}.npy") for device in ("cuda", "cpu")]
    assert_agree(*images, tolerance=0.003, flips=0.03, jump=0.1)
    assert "multiplane_render" in phases.launches


def test_unknown_places_are_refused(samples: SampleBuffer) -> None:
    with pytest.raises(SampleError, match=r"output: .*out of host, device"):
        reconstruct(samples, output="card")
