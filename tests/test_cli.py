from __future__ import annotations

import dataclasses
import inspect
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fewrays
from buffers import random_buffer
from fewrays import METHODS, Lens, SampleBuffer, SampleError, load, load_image, reconstruct, save, save_image
from fewrays.cli import COMMANDS, main, parse
from fewrays.cli.command import InputFlags
from fewrays.cli.info import effective_spp, placement
from fewrays.cli.render import Render
from lit_buffers import lit_buffer

DOCS = Path(__file__).parent.parent / "docs" / "cli.md"


@pytest.fixture
def buffer() -> SampleBuffer:
    return random_buffer(24, 32, 4, Lens(-20.0, 4.0, aperture="gaussian", sampling="square"), off_image=0.1)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, buffer: SampleBuffer) -> Path:
    """Where the command runs: a directory that holds samples.npz."""
    save(tmp_path / "samples.npz", buffer)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Return what was complained about, which is one line and nothing else."""
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"fewrays: error: [^\n]+\n", err)
    return err.removeprefix("fewrays: error: ").rstrip()


def run(*arguments: str, **settings: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fewrays", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **settings)


# Help.


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert re.search(rf"^  fewrays {name}", out, re.MULTILINE)


@pytest.mark.parametrize("line", [line for kind in COMMANDS.values() for line in kind.examples])
def test_examples_parse(line: str) -> None:
    program, *arguments = shlex.split(line)
    assert program == "fewrays"
    assert isinstance(parse(arguments), COMMANDS[arguments[0]])


def test_documented_commands_parse() -> None:
    blocks = re.findall(r"```sh\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines() if line]
    assert {shlex.split(line)[1] for line in lines} >= set(COMMANDS)
    for line in lines:
        program, *arguments = shlex.split(line, comments=True)
        assert program == "fewrays"
        if not arguments[0].startswith("-") and "--help" not in arguments:
            parse(arguments)


@pytest.mark.parametrize("name", METHODS)
def test_help_shows_the_options_of_the_method(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for choice in (["--method", name], [f"--method={name}"]):
        assert main(["reconstruct", *choice, "--help"]) == 0
        shown = capsys.readouterr().out
        own = {field.name for field in dataclasses.fields(METHODS[name].options)}
        others = {f.name for m in METHODS.values() for f in dataclasses.fields(m.options)} - own
        for option in own:
            assert re.search(rf"--{option.replace('_', '-')}[ ,]", shown)
        for option in others:
            assert f"--{option.replace('_', '-')} " not in shown


def test_overview_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for name, kind in COMMANDS.items():
        assert f"  {name} " in out
        assert kind.summary() in out


def test_without_a_command_shows_the_overview(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "commands:" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"fewrays {fewrays.__version__}\n"


def test_render_flags_are_those_of_the_function() -> None:
    from fewrays.sources.mitsuba import render

    parameters = inspect.signature(render).parameters
    for field in dataclasses.fields(Render):
        if field.name not in ("scene", "out"):
            assert parameters[field.name].default == field.default


def test_help_does_not_load_heavy_modules() -> None:
    code = (
        "import sys; from fewrays.cli import main; main(['reconstruct', '--help']);"
        "print(sorted({'mitsuba', 'skimage', 'scipy', 'flip_evaluator', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "[]"


# Reconstruct.


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.usefixtures("folder")
def test_reconstruct_equals_the_function(name: str, buffer: SampleBuffer) -> None:
    assert main(["reconstruct", "samples.npz", "--out", "clean.exr", "--method", name]) == 0
    np.testing.assert_array_equal(load_image("clean.exr"), reconstruct(buffer, name))


@pytest.mark.usefixtures("folder")
def test_reconstruct_passes_options_and_device(buffer: SampleBuffer) -> None:
    flags = "--method layered --sigma-pix 0.8 --layer-spacing 0.3 --device reference"
    assert main(["reconstruct", "samples.npz", "--out", "clean.npy", *flags.split()]) == 0
    expected = reconstruct(buffer, "layered", sigma_pix=0.8, layer_spacing=0.3, device="reference")
    np.testing.assert_array_equal(load_image("clean.npy"), expected)
    assert not np.array_equal(expected, reconstruct(buffer, "layered", device="reference"))


@pytest.mark.usefixtures("folder")
def test_reconstruct_looks_through_another_lens(buffer: SampleBuffer) -> None:
    flags = "--aperture disc --sigma 0.4 --focus-distance inf --aperture-scale 0.5"
    assert main(["reconstruct", "samples.npz", "--out", "clean.npy", *flags.split()]) == 0
    lens = dataclasses.replace(buffer.lens, aperture="disc", sigma=0.4).refocus(np.inf, 0.5)
    np.testing.assert_array_equal(load_image("clean.npy"), reconstruct(buffer.with_lens(lens)))


@pytest.mark.usefixtures("folder")
def test_reconstruct_reports_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstruct", "samples.npz", "--out", "clean.exr", "--method", "box"]) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(r"box: 32 x 24, 4 spp, \d+\.\d\d s -> clean\.exr \(0\.0 MiB\)\n", out)
    assert err == ""


@pytest.mark.usefixtures("folder")
def test_provenance_is_in_the_exr() -> None:
    assert main(["reconstruct", "samples.npz", "--out", "clean.exr", "--cells", "2"]) == 0
    content = Path("clean.exr").read_bytes()
    for text in (b"fewrays " + fewrays.__version__.encode(), b"multiplane", b"cells=2", b"samples.npz"):
        assert text in content


@pytest.mark.usefixtures("folder")
def test_exposure_brightens_a_png() -> None:
    xy = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1)[:, :, None].astype(np.float32) + 0.5
    color = np.full((4, 5, 1, 3), 0.1, np.float32)
    save("flat.npz", SampleBuffer(xy, 0 * xy, color[..., 0], color, Lens(-1.0, 10.0)))
    flags = ["--method", "box", "--exposure", "2"]
    assert main(["reconstruct", "flat.npz", "--out", "flat.png", *flags]) == 0
    np.testing.assert_allclose(load_image("flat.png"), 0.4, atol=0.004)


@pytest.mark.usefixtures("folder")
def test_aovs_are_written_as_images(buffer: SampleBuffer) -> None:
    assert (
        main(["reconstruct", "samples.npz", "--out", "clean.exr", "--aovs", "aovs", "--method", "layered"])
        == 0
    )
    _, aovs = reconstruct(buffer, "layered", aovs=True)
    assert aovs
    for name, array in aovs.items():
        if array.ndim == 2:
            np.testing.assert_array_equal(load_image(f"aovs/{name}.exr"), array)
        for layer in range(array.shape[2] if array.ndim > 2 else 0):
            np.testing.assert_array_equal(load_image(f"aovs/{name}.{layer:02}.exr"), array[:, :, layer])


@pytest.mark.usefixtures("folder")
def test_nan_drop_warns_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with np.load("samples.npz") as stored:
        arrays = dict(stored)
    arrays["color"][3, 4, 1] = np.nan
    np.savez("broken.npz", **arrays)
    assert main(["reconstruct", "broken.npz", "--out", "clean.exr"]) == 2
    assert "[3, 4, 1, 0]" in error_line(capsys)
    assert not Path("clean.exr").exists()
    assert main(["reconstruct", "broken.npz", "--out", "clean.exr", "--nan", "drop"]) == 0
    assert (
        capsys.readouterr().err == "fewrays: warning: dropped 1 of 3072 samples that hold NaN or infinity\n"
    )
    assert Path("clean.exr").exists()


# Compare, info, convert, demo.


@pytest.mark.usefixtures("folder")
def test_compare_prints_every_measure(capsys: pytest.CaptureFixture[str]) -> None:
    reference = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    save_image("reference.exr", reference)
    save_image("image.exr", reference * np.float32(0.9))
    assert main(["compare", "image.exr", "reference.exr", "--heatmap", "errors.png"]) == 0
    out = capsys.readouterr().out
    expected = 10 * np.log10(1 / np.square(0.1 * reference).mean())
    assert re.search(rf"PSNR \(linear\) +{expected:.2f} dB", out)
    for measure in ("gamma 2.2", "relMSE", "SSIM", "FLIP"):
        assert measure in out
    assert load_image("errors.png").shape == reference.shape


@pytest.mark.usefixtures("folder")
def test_info_describes_the_samples(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "samples.npz", "--focus-distance", "8"]) == 0
    out = capsys.readouterr().out
    for text in (
        "32 x 24 pixels, 4 spp",
        "-20 / depth + 2.5 px",
        "focused at 8",
        "xy uv depth color",
        "gaussian",
    ):
        assert text in out


def test_info_describes_lights(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    samples = lit_buffer((6, 8, 4), blocked=0.25)
    save(folder / "lit.npz", samples)
    assert main(["info", "lit.npz"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"light 0 +rectangle, 1\.649 x 0\.8246, at \(0\.3, -3, 4\) from the lens; ", out)
    assert re.search(r"light 1 +disc, 1 x 0\.8485, at \(-3, -3, 2\) from the lens, moving; ", out)
    assert samples.lighting is not None
    aimed = samples.lighting.lights[1].density > 0
    arrive = samples.lighting.arrives(samples, 1).sum() / aimed.sum()
    assert f"{aimed.mean():.2%} of the samples have a light sample, {arrive:.2%} of which arrive" in out
    assert re.search(r"unlit +mean 0\.\d+; .* differ from the radiance by 0\.0e\+00 of its mean", out)
    save(folder / "lit.npz", dataclasses.replace(samples, color=2 * samples.color))
    assert main(["info", "lit.npz"]) == 0
    assert "differ from the radiance by 5.0e-01 of its mean" in capsys.readouterr().out


def test_convert_says_that_lights_get_lost(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(folder / "lit.npz", lit_buffer((6, 8, 4)))
    assert main(["convert", "lit.npz", "lit.exr"]) == 0
    err = capsys.readouterr().err
    assert re.fullmatch(r"fewrays: warning: lit\.exr: lights and light samples are not written.*\n", err)
    assert main(["convert", "lit.npz", "again.npz"]) == 0
    assert capsys.readouterr().err == ""
    assert load("again.npz").lighting is not None


def test_placement_counts_samples() -> None:
    xy = np.full((1, 2, 2, 2), 0.5, np.float32)
    xy[0, 0, 1] = (1.5, 0.5)  # in the neighbour's pixel
    xy[0, 1, 0] = (1.0, 0.0)  # the corner belongs to the pixel
    xy[0, 1, 1] = (2.0, 0.5)  # the right border does not
    color = np.ones((1, 2, 2, 3), np.float32)
    samples = SampleBuffer(xy, 0 * xy, color[..., 0], color, Lens(-1.0, 1.0))
    assert placement(samples) == (0.5, 0.25)


def test_effective_spp_is_that_of_equal_weights() -> None:
    uv = np.random.default_rng(0).uniform(-1, 1, (40, 50, 8, 2)).astype(np.float32)
    color = np.ones((40, 50, 8, 3), np.float32)

    def effective(lens: Lens) -> float:
        return effective_spp(SampleBuffer(0 * uv, uv, color[..., 0], color, lens))

    assert effective(Lens(-1.0, 1.0, "gaussian", "square", sigma=100)) == pytest.approx(8)
    # A disc keeps π / 4 of the square's samples.
    assert effective(Lens(-1.0, 1.0, "disc", "square")) == pytest.approx(8 * np.pi / 4, rel=0.02)


@pytest.mark.parametrize("suffix", [".npz", ".txt", ".bin", ".exr"])
@pytest.mark.usefixtures("folder")
def test_convert_there_and_back(suffix: str, buffer: SampleBuffer) -> None:
    assert main(["convert", "samples.npz", f"other{suffix}"]) == 0
    flags = ["--aperture", "gaussian", "--sampling", "square"]
    assert main(["convert", f"other{suffix}", "back.npz", *flags]) == 0
    back = load("back.npz")
    assert back.lens.aperture == "gaussian"
    assert back.lens.sampling == "square"
    assert back.depth.size == buffer.depth.size
    np.testing.assert_allclose(np.sort(back.color.ravel()), np.sort(buffer.color.ravel()), rtol=1e-5)


@pytest.mark.usefixtures("folder")
def test_convert_stores_the_lens(buffer: SampleBuffer) -> None:
    flags = ["--compressed", "--half", "--aperture-scale", "2"]
    assert main(["convert", "samples.npz", "small.npz", *flags]) == 0
    assert load("small.npz").lens == buffer.lens.refocus(aperture_scale=2)
    assert Path("small.npz").stat().st_size < Path("samples.npz").stat().st_size


def test_demo_writes_its_sheet_and_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--out", str(tmp_path / "new" / "folder"), "--threads", "2"]) == 0
    out = capsys.readouterr().out
    measured = dict(re.findall(r"^([a-z-]+) +(\d+\.\d+) dB", out, re.MULTILINE))
    assert set(measured) == set(METHODS)
    assert float(measured["layered"]) > float(measured["box"]) + 5
    written = sorted(file.name for file in (tmp_path / "new" / "folder").iterdir())
    assert written == ["fewrays-demo.exr", "fewrays-demo.png"]


# What goes wrong.


@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        ("info missing.npz", "missing.npz: cannot be read: No such file or directory"),
        ("info .", "unknown extension"),
        ("info samples.jpg", "unknown extension '.jpg'"),
        ("reconstruct missing.npz --out a.exr", "missing.npz"),
        (
            "reconstruct samples.npz --out a.jpg",
            "a.jpg: cannot write this kind of file; use .exr, .png, .npy",
        ),
        ("reconstruct samples.npz --out none/a.exr", "none/a.exr: the directory none does not exist"),
        (
            "reconstruct samples.npz --out a.exr --method boxes",
            "unknown method 'boxes'; choose from multiplane",
        ),
        (
            "reconstruct samples.npz --out a.exr --method layered --tile 1",
            "tile: expected a value from 16 to 256 px, got 1",
        ),
        ("reconstruct samples.npz --out a.exr --threads 0", "threads: expected at least 1, got 0"),
        ("reconstruct samples.npz --out a.exr --exposure 1", "exposure: is for .png"),
        ("reconstruct samples.npz --out a.exr --aovs samples.npz", "samples.npz: is not a directory"),
        (
            "reconstruct samples.npz --out a.exr --focus-distance -1",
            "focus_distance: expected a positive number",
        ),
        ("reconstruct samples.npz --out a.exr --method box --device gpu", None),
        ("reconstruct samples.npz --out a.exr --method box --tile 16", None),
        ("reconstruct samples.npz", None),
        ("convert samples.npz samples.jpg", "samples.jpg: cannot write this kind of file"),
        ("compare samples.npz samples.npz", "samples.npz: unknown extension"),
        ("render scene.xml --out a.exr --spp many", None),
        ("paint", "unknown command 'paint'; choose from demo"),
    ],
)
def test_user_errors(
    command: str, complaint: str | None, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With complaint None, the parser explains in its own words and form."""
    assert main(command.split()) == 2
    if complaint is None:
        assert "--" in capsys.readouterr().err
    else:
        assert complaint in error_line(capsys)
    assert [file.name for file in folder.iterdir()] == ["samples.npz"]


def fail_with(error: BaseException) -> Any:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (KeyboardInterrupt(), 130, ""),
        (SampleError("too dark", file="x.npz", field="color"), 2, "x.npz: color: too dark"),
        (PermissionError(13, "Permission denied", "a.exr"), 2, "a.exr: Permission denied"),
        (MemoryError(), 2, "out of memory: use a smaller image or fewer samples per pixel"),
        (ImportError('flip is not installed; pip install "fewrays[metrics]" provides it'), 2, "flip is not"),
    ],
)
def test_failures_while_running_leave_no_output(
    error: BaseException,
    status: int,
    said: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("fewrays.cli.reconstruct.save_image", fail_with(error))
    assert main(["reconstruct", "samples.npz", "--out", "clean.exr"]) == status
    if said:
        assert said in error_line(capsys)
    else:
        assert capsys.readouterr() == ("", "")
    assert [file.name for file in folder.iterdir()] == ["samples.npz"]


@pytest.mark.usefixtures("folder")
def test_bugs_keep_their_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    for bug in (ZeroDivisionError("bug"), ImportError("cannot import name 'x'")):
        monkeypatch.setattr("fewrays.cli.reconstruct.save_image", fail_with(bug))
        with pytest.raises(type(bug)):
            main(["reconstruct", "samples.npz", "--out", "clean.exr"])


# As a process.


def test_process_says_what_is_wrong_without_a_traceback() -> None:
    done = run("info", "missing.npz")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.splitlines() == [
        "fewrays: error: missing.npz: cannot be read: No such file or directory"
    ]


@pytest.mark.usefixtures("folder")
def test_process_reconstructs() -> None:
    done = run("reconstruct", "samples.npz", "--out", "clean.exr")
    assert (done.returncode, done.stderr) == (0, "")
    assert load_image("clean.exr").shape == (24, 32, 3)


@pytest.mark.skipif(os.name == "nt", reason="pipes close differently")
def test_process_outlives_a_reader_that_stops() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "fewrays", "--help"], stdout=writer, stderr=subprocess.PIPE, timeout=60
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.usefixtures("folder")
def test_input_flags_leave_samples_alone_by_default(buffer: SampleBuffer) -> None:
    assert InputFlags().load(Path("samples.npz")).lens == buffer.lens
