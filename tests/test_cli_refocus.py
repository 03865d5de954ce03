"""The rack-focus command: which distances, which files, and that every frame is what `reconstruct` gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from buffers import random_buffer
from fewrays import METHODS, Lens, Multiplane, SampleBuffer, SampleError, load_image, reconstruct, save
from fewrays.cli import main
from fewrays.cli.refocus import depth_at
from fewrays.cli.sequence import Ease, focus_distances, frame_path
from fewrays.color import srgb_encode
from fewrays.multiplane.build import build_maps
from fewrays.sources.analytic import Plane, constant, disc, sample

LENS = Lens(-20.0, 4.0, aperture="gaussian", sampling="square")
EASES: list[Ease] = ["none", "in", "out", "in-out"]


@pytest.fixture
def buffer() -> SampleBuffer:
    return random_buffer(20, 24, 4, LENS)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, buffer: SampleBuffer) -> Path:
    """Where the command runs: a directory that holds samples.npz."""
    save(tmp_path / "samples.npz", buffer)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refocus(command: str) -> int:
    return main(["refocus", "samples.npz", *command.split()])


# Distances.


@given(
    first=st.floats(0.1, 100),
    last=st.floats(0.1, 100),
    frames=st.integers(2, 40),
    ease=st.sampled_from(EASES),
)
def test_frames_go_from_one_end_to_the_other(first: float, last: float, frames: int, ease: Ease) -> None:
    distances = focus_distances(first, last, frames, ease)
    assert len(distances) == frames
    assert (distances[0], distances[-1]) == (first, last)
    step = np.diff(1 / np.array(distances)) * np.sign(1 / last - 1 / first)
    assert (step >= -1e-12).all()


def test_equal_steps_of_blur_for_every_surface() -> None:
    distances = focus_distances(1.5, np.inf, 7)
    for depth in (0.5, 2.0, 30.0):
        slopes = [float(LENS.refocus(distance).slope(depth)) for distance in distances]
        np.testing.assert_allclose(np.diff(slopes), LENS.c0 * (1 / 1.5) / 6, rtol=1e-9)


def test_easing_is_slow_where_it_says() -> None:
    steps = {ease: np.abs(np.diff(1 / np.array(focus_distances(1.0, 4.0, 11, ease)))) for ease in EASES}
    even = 0.75 / 10
    np.testing.assert_allclose(steps["none"], even)
    for ease, slow in {"in": (True, False), "out": (False, True), "in-out": (True, True)}.items():
        assert (steps[ease][0] < 0.5 * even) == slow[0]  # type: ignore[index]
        assert (steps[ease][-1] < 0.5 * even) == slow[1]  # type: ignore[index]


def test_a_pixel_says_the_depth_of_its_nearest_surface() -> None:
    # The disc covers the wall where the lens centre sees it, though it is blurred by 10 px each way.
    samples = sample(
        [Plane(1.0, constant(1), disc((20, 12), 4)), Plane(8.0, constant(0))], Lens(-20, 10), 24, 40, 8
    )
    assert depth_at(samples, 20, 12) == 1.0
    assert depth_at(samples, 27, 12) == 8.0  # inside the blur and outside the disc
    assert depth_at(samples.refocus(1.0), 20, 12) == depth_at(samples.refocus(aperture_scale=3), 20, 12) == 1


def test_a_pixel_without_samples_takes_the_closest() -> None:
    xy = np.array([[[[0.5, 0.5]], [[0.4, 0.4]], [[0.3, 0.6]]]])
    samples = SampleBuffer(xy, 0 * xy, [[[3.0], [2.0], [9.0]]], np.ones((1, 3, 1, 3)), Lens(-1, 1))
    assert depth_at(samples, 2, 0) == 3.0
    with pytest.raises(SampleError, match=r"pixel \(3, 0\) lies outside the image of 3 x 1"):
        depth_at(samples, 3, 0)


# Files.


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("out/frame.png", "out/frame.0007.png"),
        ("frame.%03d.exr", "frame.007.exr"),
        ("%d.png", "7.png"),
        ("shot%6d_left.png", "shot000007_left.png"),
        ("a{}.npy", "a0007.npy"),
        ("a.b.png", "a.b.0007.png"),
    ],
)
def test_names_of_frames(pattern: str, name: str) -> None:
    assert frame_path(Path(pattern), 7) == Path(name)


@pytest.mark.parametrize("method", ["layered", "box"])
@pytest.mark.usefixtures("folder")
def test_frames_equal_the_function(method: str, buffer: SampleBuffer) -> None:
    assert refocus(f"--from 2 --to inf --frames 3 --method {method} --out r.exr") == 0
    for number, distance in enumerate([2.0, 4.0, np.inf], 1):
        expected = reconstruct(buffer.refocus(distance), method)
        np.testing.assert_array_equal(load_image(f"r.000{number}.exr"), expected)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.usefixtures("folder")
def test_every_method_works(method: str, folder: Path) -> None:
    assert refocus(f"--from 2 --to 3 --frames 2 --method {method} --out r.png") == 0
    assert sorted(f.name for f in folder.iterdir()) == ["r.0001.png", "r.0002.png", "samples.npz"]


@pytest.mark.usefixtures("folder")
def test_options_aperture_and_exposure_are_passed_on(buffer: SampleBuffer) -> None:
    flags = "--method layered --sigma-pix 0.8 --layer-spacing 0.3 --aperture-scale 0.5 --exposure -1"
    assert refocus(f"--from 2 --to 3 --frames 2 --out r.{{}}.png {flags}") == 0
    scene = buffer.refocus(None, 0.5).refocus(2.0)
    image = reconstruct(scene, "layered", sigma_pix=0.8, layer_spacing=0.3)
    shown = np.rint(srgb_encode(image / 2) * 255)
    with PIL.Image.open("r.0001.png") as picture:
        assert np.abs(np.asarray(picture) - shown).max() <= 1


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ("--to 2", (5.0, 2.0)),
        ("--from 2", (2.0, 5.0)),
        ("--to 2 --focus-distance 3", (3.0, 2.0)),
        ("--focus-at 5 6", (5.0, "a")),
        ("--focus-at 5 6 --from 2", (2.0, "a")),
        ("--focus-at 5 6 --to 2", ("a", 2.0)),
        ("--focus-at 5 6 --focus-at 15 9", ("a", "b")),
    ],
)
@pytest.mark.usefixtures("folder")
def test_ends(
    flags: str, expected: tuple[Any, Any], buffer: SampleBuffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def record(first: float, last: float, frames: int, ease: str) -> list[float]:
        asked.extend((first, last))
        return focus_distances(first, last, frames, "none" if ease == "none" else "in")

    monkeypatch.setattr("fewrays.cli.refocus.focus_distances", record)
    assert refocus(f"{flags} --frames 2 --method box --out r.npy") == 0
    depths = {"a": depth_at(buffer, 5, 6), "b": depth_at(buffer, 15, 9)}
    assert asked == pytest.approx([depths.get(end, end) for end in expected], rel=1e-6)


def animation(path: str) -> tuple[list[npt.NDArray[np.uint8]], list[int]]:
    with PIL.Image.open(path) as file:
        assert file.info["loop"] == 0
        frames, durations = [], []
        for index in range(getattr(file, "n_frames", 1)):
            file.seek(index)
            frames.append(np.asarray(file.convert("RGB")))
            durations.append(int(file.info["duration"]))
    return frames, durations


@pytest.mark.parametrize("suffix", ["gif", "webp"])
@pytest.mark.usefixtures("folder")
def test_animation_shows_the_same_frames(suffix: str, folder: Path) -> None:
    flags = "--from 1.5 --to inf --frames 4 --aperture-scale 2 --exposure -1 --fps 20"
    assert refocus(f"{flags} --out r.{suffix}") == 0
    assert [f.name for f in folder.iterdir() if f.name.startswith("r")] == [f"r.{suffix}"]
    assert refocus(f"{flags} --out p.png") == 0
    frames, durations = animation(f"r.{suffix}")
    assert durations == [50] * 4
    stills = [np.asarray(PIL.Image.open(f"p.000{number}.png")) for number in (1, 2, 3, 4)]
    error = [[np.abs(f.astype(float) - s).mean() for s in stills] for f in frames]
    assert np.argmin(error, axis=1).tolist() == [0, 1, 2, 3]
    assert max(np.diag(error)) < 10


# What methods prepare once.


@pytest.mark.usefixtures("folder")
def test_planes_are_built_once(buffer: SampleBuffer, monkeypatch: pytest.MonkeyPatch) -> None:
    builds: list[SampleBuffer] = []

    def build(samples: SampleBuffer, *rest: Any) -> Any:
        builds.append(samples)
        return build_maps(samples, *rest)

    monkeypatch.setattr("fewrays.multiplane.engine.build_maps", build)
    flags = "--from 2 --to inf --frames 3 --method multiplane --views 16 --aperture-scale 0.5"
    assert refocus(f"{flags} --thickness 1 --out r.exr") == 0
    assert len(builds) == 1
    planes = Multiplane.build(buffer.refocus(aperture_scale=0.5), thickness=1.0)
    for number, distance in enumerate([2.0, 4.0, np.inf], 1):
        expected = planes.render(planes.lens.refocus(distance), views=16)
        np.testing.assert_array_equal(load_image(f"r.000{number}.exr"), expected)


@pytest.mark.usefixtures("folder")
def test_frames_of_stored_planes_are_those_of_the_samples(buffer: SampleBuffer) -> None:
    Multiplane.build(buffer).save("scene.planes")
    flags = ["--from", "2", "--to", "5", "--frames", "2", "--views", "16"]
    assert main(["refocus", "scene.planes", *flags, "--out", "stored.npy"]) == 0
    assert main(["refocus", "samples.npz", *flags, "--method", "multiplane", "--out", "fresh.npy"]) == 0
    for number in ("0001", "0002"):
        np.testing.assert_array_equal(load_image(f"stored.{number}.npy"), load_image(f"fresh.{number}.npy"))


@pytest.mark.usefixtures("folder")
def test_stored_planes_have_no_pixels_to_focus_at(
    buffer: SampleBuffer, capsys: pytest.CaptureFixture[str]
) -> None:
    Multiplane.build(buffer).save("scene.planes")
    assert main(["refocus", "scene.planes", "--focus-at", "3", "4", "--out", "r.png"]) == 2
    assert "scene.planes: focus_at: needs samples to find a depth" in capsys.readouterr().err


# What goes wrong.


@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        ("--out r.png", "to: say where the focus goes: --to, --from or --focus-at"),
        ("--out r.jpg --to 2", "r.jpg: cannot write this kind of file; use .exr, .png, .npy, .gif, .webp"),
        ("--out none/r.png --to 2", "none/r.png: the directory none does not exist"),
        ("--out r.png --to 2 --frames 1", "frames: expected a value of at least 2, got 1"),
        ("--out r.gif --to 2 --fps 0", "fps: expected a value above 0 and up to 100, got 0.0"),
        ("--out r.exr --to 2 --exposure 1", "exposure: is for .png, .gif and .webp"),
        ("--out r.png --from -2", "from: expected a value above 0, as a focus distance is, got -2.0"),
        ("--out r.png --to nan", "to: expected a value above 0, as a focus distance is, got nan"),
        ("--out r.png --to 2 --from 1 --focus-at 1 1", "two ends; got --from, --to, --focus-at"),
        ("--out r.png --focus-at 24 1", "focus_at: pixel (24, 1) lies outside the image of 24 x 20"),
        ("--out r.png --to 2 --aperture-scale 0", "lens: is a pinhole"),
        ("--out r.png --to 2 --method boxes", "unknown method 'boxes'"),
        ("--out r.png --to 2 --method layered --tile 1", "tile: expected a value from 16"),
    ],
)
def test_user_errors(command: str, complaint: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refocus(command) == 2
    assert complaint in capsys.readouterr().err
    assert [file.name for file in folder.iterdir()] == ["samples.npz"]


@pytest.mark.parametrize("out", ["r.gif", "r.png"])
def test_a_failure_leaves_whole_files_only(out: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("PIL.Image.Image.save", fail)
    assert refocus(f"--from 2 --to 3 --frames 2 --method box --out {out}") == 130
    assert [file.name for file in folder.iterdir()] == ["samples.npz"]


@pytest.mark.usefixtures("folder")
def test_report_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert refocus("--from 2 --to inf --frames 2 --method box --out r.npy") == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("box: 2 frames focused at 2 to inf, 24 x 20, 4 spp, ")
    assert out.endswith("-> r.0001.npy ... r.0002.npy\n")
