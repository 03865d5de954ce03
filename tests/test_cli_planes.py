"""Files of planes on the command line: written from samples, looked at, and rendered."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from buffers import random_buffer
from fewrays import Lens, Multiplane, SampleBuffer, load_image, save
from fewrays.cli import main
from fewrays.sources.analytic import Plane, constant, disc, motion_of, sample

LENS = Lens(-20.0, 4.0, aperture="gaussian", sampling="square")


@pytest.fixture
def buffer() -> SampleBuffer:
    return random_buffer(20, 24, 4, LENS)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, buffer: SampleBuffer) -> Path:
    """Where the command runs: a directory that holds samples.npz."""
    save(tmp_path / "samples.npz", buffer)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def planes(folder: Path, buffer: SampleBuffer) -> Multiplane:
    """Planes that lie in scene.planes."""
    planes = Multiplane.build(buffer)
    planes.save(folder / "scene.planes")
    return planes


def fewrays(command: str) -> int:
    return main(command.split())


@pytest.mark.usefixtures("folder")
def test_written_planes_are_those_of_the_function(
    buffer: SampleBuffer, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = "--thickness 1.5 --cells 2 --aperture-scale 0.5"
    assert fewrays(f"planes samples.npz --out out.planes {flags}") == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("planes: 24 x 20, 4 spp, ")
    stored = Multiplane.load("out.planes")
    expected = Multiplane.build(buffer.refocus(aperture_scale=0.5), thickness=1.5, cells=2)
    assert stored.lens == expected.lens
    np.testing.assert_array_equal(stored.maps.halves, expected.maps.halves)


def test_an_image_of_planes_needs_no_method(planes: Multiplane, capsys: pytest.CaptureFixture[str]) -> None:
    assert fewrays("reconstruct scene.planes --out i.npy --views 16 --blades 6 --focus-distance 3") == 0
    assert capsys.readouterr().out.startswith("multiplane: 24 x 20, planes, ")
    expected = planes.render(planes.lens.refocus(3.0), views=16, blades=6)
    np.testing.assert_array_equal(load_image("i.npy"), expected)


def test_lens_flags_replace_what_the_planes_say(planes: Multiplane) -> None:
    assert (
        fewrays("reconstruct scene.planes --out i.npy --views 16 --aperture disc --aperture-scale 0.3") == 0
    )
    lens = Lens(LENS.c0, LENS.c1, "disc", "square").refocus(aperture_scale=0.3)
    np.testing.assert_array_equal(load_image("i.npy"), planes.render(lens, views=16))


def test_info_tells_what_planes_hold(planes: Multiplane, capsys: pytest.CaptureFixture[str]) -> None:
    assert fewrays("info scene.planes --aperture-scale 2") == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert lines["size"] == "24 x 20 pixels"
    assert lines["lens"].startswith("slope = -40 / depth + 8 px")
    slope = 2 * planes.maps.shear.slope
    assert lines["planes"] == f"{len(slope)}, at slopes of {slope[0]:.4g} to {slope[-1]:.4g} px"
    assert lines["blocks"].startswith(f"{(planes.maps.slots >= 0).sum()} of ")
    assert f"{planes.nbytes / 480:.0f} bytes a pixel" in lines["memory"]
    assert "motion" not in lines


def test_info_tells_what_moves(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball = Plane(2.0, constant(0.5), disc((12, 10), 5), motion_of(2.0, (6.0, 0.0)))
    samples = sample([ball, Plane(8.0, constant(0.1))], LENS, 20, 24, 4)
    Multiplane.build(samples).save(folder / "moving.planes")
    assert fewrays("info moving.planes") == 0
    assert "\nmotion     on 1 planes, up to 6 px" in capsys.readouterr().out


@pytest.mark.usefixtures("planes")
@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        ("planes samples.npz --out out.npz", "out.npz: cannot write this kind of file; use .planes"),
        ("planes none.npz --out out.planes", "none.npz: cannot be read"),
        ("planes samples.npz --out out.planes --cells 4", "cells: expected a value of 1, 2 or 3, got 4"),
        (
            "reconstruct scene.planes --out i.png --method box",
            "prepared for method 'multiplane'; 'box' needs",
        ),
        ("reconstruct scene.planes --out i.png --thickness 1", "thickness: is decided when planes are made"),
        ("reconstruct scene.planes --out i.png --nan drop", "scene.planes: nan: is for samples"),
        ("reconstruct scene.planes --out i.png --sampling disc", "sampling: is for samples"),
        ("refocus scene.planes --out i.png --to 2 --prior 1", "prior: is decided when planes are made"),
        ("info scene.planes --header h", "scene.planes: header: is for samples"),
        ("info none.planes", "none.planes: "),
        ("info samples.planes", "samples.planes: "),
    ],
)
def test_user_errors(command: str, complaint: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy("samples.npz", "samples.planes")
    before = sorted(file.name for file in folder.iterdir())
    assert fewrays(command) == 2
    assert complaint in capsys.readouterr().err
    assert sorted(file.name for file in folder.iterdir()) == before
