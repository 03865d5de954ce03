"""The command that gives pictures with depth depth of field: lenses, focus, files, and what it refuses."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest

from fewrays import Lens, SampleError, defocus, load_image, save_image
from fewrays.cli import main, parse
from fewrays.cli.camera import CameraFlags, depth_at
from fewrays.cli.defocus import Defocus
from fewrays.color import srgb_encode
from fewrays.dynamic import DefocusOptions, DepthLayer, defocus_rgba
from fewrays.io.rgbz import RgbzImage, load_rgbz, save_rgbz

HEIGHT, WIDTH = 14, 20
LENS = Lens(-20.0, 8.0)
FAST = "--views 5"


def scene() -> DepthLayer:
    """Return a card in front of a wall that reaches to infinity."""
    rng = np.random.default_rng(2)
    color = rng.random((HEIGHT, WIDTH, 3), np.float32)
    depth = np.full((HEIGHT, WIDTH), 6.0, np.float32)
    depth[:, 15:] = np.inf
    depth[4:9, 3:9] = 2.0
    return DepthLayer(color, depth)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the command runs: with shot.exr, which knows its lens, and bare.exr, which does not."""
    save_rgbz(tmp_path / "shot.exr", scene(), lens=(LENS.c0, LENS.c1))
    save_rgbz(tmp_path / "bare.exr", scene())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: str) -> int:
    return main(["defocus", *command.split()])


def lens_of(command: str) -> Lens:
    """Return the lens of the first frame that a command line asks for."""
    parsed = parse(["defocus", *command.split()])
    assert isinstance(parsed, Defocus)
    return parsed._lenses(load_rgbz(parsed.image))[0]


# The lens.


@pytest.mark.usefixtures("folder")
def test_every_way_to_say_the_lens() -> None:
    shown = {
        "shot.exr": LENS,
        "shot.exr --focus-distance 4": LENS.refocus(4.0),
        "shot.exr --focus-distance inf": LENS.refocus(np.inf),
        "shot.exr --aperture-scale 0.5": LENS.refocus(None, 0.5),
        "shot.exr --focus-at 5 6": LENS.refocus(2.0),
        "bare.exr --focus-distance 4 --max-coc 9": Lens(-36.0, 9.0),
        "bare.exr --focus-at 0 0 --max-coc 9": Lens(-54.0, 9.0),
        "bare.exr --focus-distance 4 --f-number 2 --focal-length 50": Lens.thin_lens(
            WIDTH, focus_distance=4, focal_length=50, f_number=2
        ),
        "bare.exr --focus-distance 400 --f-number 2 --focal-length 50 --units-per-metre 100": Lens.thin_lens(
            WIDTH, focus_distance=400, focal_length=50, f_number=2, units_per_metre=100
        ),
        "shot.exr --focus-distance 4 --lens-radius 0.1 --fov 40": Lens.thin_lens(
            WIDTH, focus_distance=4, fov=40, lens_radius=0.1
        ),
    }
    for command, expected in shown.items():
        lens = lens_of(f"{command} --out a.exr")
        assert lens.c0 == pytest.approx(expected.c0)
        assert lens.c1 == pytest.approx(expected.c1)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--max-coc 3", "focus_distance: say what is in focus"),
        ("--focus-distance 3", "lens: say how large the blur is"),
        ("--focus-distance 3 --f-number 2", "f_number: needs focal_length"),
        ("--focus-distance 3 --lens-radius 2", "lens_radius: needs fov"),
        ("--focus-distance 3 --f-number 2 --focal-length 50 --max-coc 3", "max_coc: give only one of"),
        ("--focus-distance 3 --max-coc 0", "max_coc: expected a value in pixels, above 0"),
        ("--focus-distance inf --max-coc 3", "max_coc: needs a finite focus distance"),
        ("--focus-distance -3 --max-coc 3", "focus_distance: expected a value above 0"),
        ("--focus-distance 3 --fov 40 --focal-length 50 --max-coc 3", "fov: give either"),
        ("--focus-at 20 3 --max-coc 3", r"pixel \(20, 3\) lies outside the picture of 20 x 14"),
        ("--focus-at 1 3 --focus-distance 3 --max-coc 3", "too much says where the focus is"),
        ("--focus-at 1 3 --focus-at 2 3 --to 3 --max-coc 3", "too much says where the focus is"),
        ("--focus-distance 3 --max-coc 3 --views 0", "views: expected a value"),
        ("--focus-distance 3 --max-coc 3 --exposure 1", "exposure: is for .png"),
        (
            "--focus-distance 3 --max-coc 3 --depth-kind distance",
            "depth_kind: the depth is the length of rays",
        ),
        ("--focus-distance 3 --max-coc 3 --depth-channel N.Z", "bare.exr: channel 'N.Z': is not there"),
        ("--focus-distance 3 --max-coc 3 --to 4 --frames 1", "frames: expected a value of at least 2"),
        ("--focus-distance 3 --max-coc 3 --to 0", "to: expected a value above 0"),
        ("--focus-distance 3 --max-coc 3 --aperture-scale 0 --to 4", "is a pinhole"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_what_cannot_work_is_one_plain_line(
    flags: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(f"bare.exr --out a.exr {flags}") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(rf"fewrays: error: [^\n]*{message}[^\n]*\n", err), err
    assert not Path("a.exr").exists()


@pytest.mark.usefixtures("folder")
def test_outputs_are_refused_before_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    for out, message in (("a.gif", "an animation needs --to"), ("a.jpg", "cannot write"), ("no/a.exr", "no")):
        assert run(f"nowhere.exr --out {out} --focus-distance 3 --max-coc 3") == 2
        assert message in capsys.readouterr().err


# Pictures.


@pytest.mark.usefixtures("folder")
def test_the_image_is_that_of_the_function(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(f"shot.exr --out a.exr --focus-distance 3 {FAST}") == 0
    assert "focused at 3, 20 x 14, 5 views" in capsys.readouterr().out
    layer = scene()
    expected = defocus(layer.color, layer.depth, LENS.refocus(3.0), views=5)
    np.testing.assert_allclose(load_image("a.exr"), expected, rtol=1e-6)
    assert run(f"shot.exr --out a.png --focus-distance 3 --exposure -1 {FAST}") == 0
    with PIL.Image.open("a.png") as picture:
        shown = np.rint(srgb_encode(expected / 2) * 255)
        assert np.abs(np.asarray(picture) - shown).max() <= 1


@pytest.mark.usefixtures("folder")
def test_a_pinhole_gives_the_picture_back() -> None:
    assert run(f"shot.exr --out a.exr --aperture-scale 0 {FAST}") == 0
    np.testing.assert_allclose(load_image("a.exr"), scene().color, rtol=1e-5)


@pytest.mark.usefixtures("folder")
def test_depth_from_a_file_gives_the_same() -> None:
    layer = scene()
    save_image("color.exr", layer.color)
    np.save("depth.npy", 1 / layer.depth)
    assert run(f"shot.exr --out a.exr {FAST}") == 0
    flags = "--depth depth.npy --depth-kind inverse --focus-distance 2.5 --max-coc 8"
    assert run(f"color.exr --out b.exr {flags} {FAST}") == 0
    np.testing.assert_allclose(load_image("b.exr"), load_image("a.exr"), rtol=1e-4, atol=1e-6)


@pytest.mark.usefixtures("folder")
def test_what_lies_behind_counts() -> None:
    layer = scene()
    behind = DepthLayer(layer.color[::-1], np.full_like(layer.depth, 6.0))
    save_rgbz("behind.exr", behind)
    assert run(f"shot.exr --behind behind.exr --out a.exr --focus-distance 6 {FAST}") == 0
    expected = defocus(layer.color, layer.depth, LENS.refocus(6.0), behind=[behind], views=5)
    np.testing.assert_allclose(load_image("a.exr"), expected, rtol=1e-6)
    save_rgbz("small.exr", DepthLayer(layer.color[:5], layer.depth[:5]))
    with pytest.raises(SampleError, match=r"small.exr: is 20 x 5 pixels, shot.exr 20 x 14"):
        parse(["defocus", "shot.exr", "--behind", "small.exr", "--out", "a.exr"]).run()


@pytest.mark.parametrize("suffix", [".exr", ".npy", ".png"])
@pytest.mark.usefixtures("folder")
def test_alpha_goes_in_and_comes_out(suffix: str) -> None:
    layer = scene()
    alpha = np.where(np.isinf(layer.depth), 0, 1).astype(np.float32)
    clear = DepthLayer(layer.color * alpha[..., None], layer.depth, alpha)
    save_rgbz("clear.exr", clear, lens=(LENS.c0, LENS.c1))
    assert run(f"clear.exr --out a{suffix} {FAST}") == 0
    expected = defocus_rgba(clear.color, clear.depth, LENS, alpha=alpha, views=5)
    assert 0.05 < expected[..., 3].mean() < 0.95
    np.testing.assert_allclose(load_rgba(f"a{suffix}", expected), expected, rtol=1e-5, atol=1e-6)


def load_rgba(path: str, like: npt.NDArray[np.float32]) -> Any:
    """Return an image with alpha; of a .png, what should have been written where it is within rounding."""
    if path.endswith(".npy"):
        return np.load(path)
    if path.endswith(".exr"):
        import OpenEXR

        with OpenEXR.File(path) as file:
            return file.channels()["RGBA"].pixels
    with PIL.Image.open(path) as picture:
        stored = np.asarray(picture) / 255
    alpha = np.clip(like[..., 3:], 1e-9, 1)
    wanted = np.concatenate([srgb_encode(like[..., :3] / alpha), alpha], axis=-1)
    assert stored.shape == like.shape
    seen = like[..., 3] > 0.01
    assert np.abs(stored - wanted)[seen].max() <= 0.5 / 255 + 1e-4
    return like


# Focus pulls.


@pytest.mark.usefixtures("folder")
def test_frames_go_where_the_focus_goes() -> None:
    assert run(f"shot.exr --out f.exr --focus-at 5 6 --focus-at 18 3 --frames 3 {FAST}") == 0
    layer = scene()
    for number, distance in enumerate([2.0, 4.0, np.inf], 1):
        expected = defocus(layer.color, layer.depth, LENS.refocus(distance), views=5)
        np.testing.assert_allclose(load_image(f"f.000{number}.exr"), expected, rtol=1e-5)
    assert not Path("f.0004.exr").exists()


@pytest.mark.parametrize("flags", ["--to 6", "--focus-distance 2 --to 6", "--focus-at 5 6 --to 6"])
@pytest.mark.usefixtures("folder")
def test_animations_hold_every_frame(flags: str) -> None:
    assert run(f"shot.exr --out pull.gif {flags} --frames 4 --fps 10 {FAST}") == 0
    with PIL.Image.open("pull.gif") as animation:
        assert (getattr(animation, "n_frames", 1), animation.size) == (4, (WIDTH, HEIGHT))
        assert animation.info["duration"] == 100


def test_the_page_explains_every_option() -> None:
    page = (Path(__file__).parents[1] / "docs" / "dynamic.md").read_text(encoding="utf-8")
    shown: dict[str, str] = {}
    for line in re.findall(r"^\| (`.*) \|$", page.partition("## Options")[2], re.MULTILINE):
        names, values, _ = line.split(" | ")
        defaults = (value.replace("`", "").split()[0] for value in values.split(", "))
        shown |= dict(zip(re.findall(r"`(\w+)`", names), defaults, strict=True))
    expected = {f.name: str(f.default).lower().removesuffix(".0") for f in dataclasses.fields(DefocusOptions)}
    assert shown == expected


def test_autofocus_looks_through_what_is_clear() -> None:
    shape = (2, 2)
    color = np.zeros((*shape, 3), np.float32)
    glass = DepthLayer(color, np.full(shape, 1.0, np.float32), np.full(shape, 0.25, np.float32))
    alpha = np.array([[1, 0], [1, 1]], np.float32)
    wall = DepthLayer(color, np.full(shape, 5.0, np.float32), alpha)
    picture = RgbzImage((glass, wall), 2)
    assert depth_at(picture, 0, 0) == 5.0
    with pytest.raises(SampleError, match=r"nothing opaque is in pixel \(1, 0\)"):
        depth_at(picture, 1, 0)


def test_the_angle_of_view_is_that_of_the_whole_picture() -> None:
    assert CameraFlags(fov=90).focal_widths == pytest.approx(0.5)
    assert CameraFlags(focal_length=50, sensor_width=25).focal_widths == pytest.approx(2)
    crop = RgbzImage((scene(),), full_width=4 * WIDTH)
    lens = CameraFlags(fov=90, lens_radius=0.5).lens(crop, 2.0)
    assert lens.c0 == pytest.approx(-0.5 * 0.5 * 4 * WIDTH)
