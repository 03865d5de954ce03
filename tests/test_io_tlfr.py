"""Version 1.3 of the 2011 sample buffer format, as its authors describe and write it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from fewrays.errors import SampleError
from fewrays.io import load, save
from fewrays.io.tlfr_header import COLUMNS
from fewrays.lens import Lens
from fewrays.samples import SampleBuffer

HEADER = """Version 1.3
Width 2
Height 1
Samples per pixel 1
Motion model: perspective
CoC coefficients (coc radius = C0/w+C1): -15.242497,19.053122
Encoding = text
x,y,z/w,w,u,v,t,r,g,b,a,mv_x,mv_y,mv_w,dwdx,dwdy
"""
# x, y, z/w, w, u, v, t, r, g, b, a, mv_x, mv_y, mv_w, dw/dx, dw/dy
FIRST = (0.25, 0.5, 0.9, 4.0, 0.1, -0.2, 0.75, 1.0, 2.0, 3.0, 1.0, 8.0, -4.0, 2.0, 0.3, 0.4)
SECOND = (1.75, 0.125, 0.8, 2.0, -0.5, 0.5, 0.25, 4.0, 5.0, 6.0, 1.0, 6.0, 2.0, -1.0, 0.0, 0.0)


def write(path: Path, header: str = HEADER, lines: tuple[tuple[float, ...], ...] = (FIRST, SECOND)) -> Path:
    path.with_name(path.name + ".header").write_text(header)
    path.write_text("".join(",".join(f"{value:f}" for value in line) + "\n" for line in lines))
    return path


def check_contents(samples: SampleBuffer) -> None:
    np.testing.assert_array_equal(samples.xy[0, :, 0], [[0.25, 0.5], [1.75, 0.125]])
    np.testing.assert_array_equal(samples.depth[0, :, 0], [4, 2])
    np.testing.assert_array_equal(samples.uv[0, :, 0], np.array([[0.1, -0.2], [-0.5, 0.5]], np.float32))
    np.testing.assert_array_equal(samples.color[0, :, 0], [[1, 2, 3], [4, 5, 6]])
    assert samples.time is not None
    np.testing.assert_array_equal(samples.time[0, :, 0], [0.75, 0.25])
    assert samples.lens == Lens(-15.242497, 19.053122)


def test_the_documented_columns(tmp_path: Path) -> None:
    samples = load(write(tmp_path / "a.txt"))
    check_contents(samples)
    assert samples.motion is not None
    np.testing.assert_array_equal(samples.motion[0, :, 0], [[8, -4, 2], [6, 2, -1]])


def test_affine_motion_moves_pixels_at_constant_depth(tmp_path: Path) -> None:
    header = HEADER.replace("perspective", "affine")
    samples = load(write(tmp_path / "a.txt", header))
    assert samples.motion is not None
    assert samples.time is not None
    w, motion, xy = samples.depth[..., None], samples.motion, samples.xy
    for shift in (-samples.time[..., None], 1 - samples.time[..., None], 0.5):
        moved = np.concatenate([xy * w, w], axis=-1) + shift * motion
        np.testing.assert_allclose(moved[..., 2:], w)
        expected = xy + shift * np.reshape([[8, -4], [6, 2]], (1, 2, 1, 2))
        np.testing.assert_allclose(moved[..., :2] / moved[..., 2:], expected, rtol=1e-6)


def test_what_public_writers_do(tmp_path: Path) -> None:
    """Commas at line ends, Windows line ends, no motion model, no encoding, a header inside the file."""
    path = write(tmp_path / "a.txt")
    text = path.read_text()
    for lines in (
        text.replace("\n", ",\n"),
        text.replace("\n", ",\r\n"),
        text.rstrip("\n"),
        text.replace(",", ", "),
    ):
        path.write_text(lines, newline="")
        check_contents(load(path))
    header = HEADER.replace("Motion model: perspective\n", "").replace("Encoding = text\n", "\n")
    check_contents(load(write(path, header.replace("\n", "\r\n"))))
    check_contents(load(write(path, HEADER.replace("dwdx,dwdy", "dw/dx,dw/dy"))))
    (tmp_path / "inline.txt").write_text(HEADER + text)
    check_contents(load(tmp_path / "inline.txt"))


def test_binary_is_16_little_endian_floats(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(struct.pack("<32f", *FIRST, *SECOND))
    (tmp_path / "elsewhere").write_text(HEADER.replace("= text", "= binary"))
    check_contents(load(path, header=tmp_path / "elsewhere"))
    with pytest.raises(SampleError, match="No such file") as caught:
        load(path)
    assert caught.value.file == f"{path}.header"


def test_what_we_write(tmp_path: Path) -> None:
    samples = load(write(tmp_path / "a.txt"))
    save(tmp_path / "b.tlfr", samples)
    assert (tmp_path / "b.tlfr.header").read_text() == HEADER.replace("= text", "= binary")
    row = dict(zip(COLUMNS, struct.unpack("<32f", (tmp_path / "b.tlfr").read_bytes())[:16], strict=True))
    expected = dict(zip(COLUMNS, np.array(FIRST, np.float32).tolist(), strict=True))
    assert row == expected | {"z/w": 0, "a": 1, "dwdx": 0, "dwdy": 0}
    save(tmp_path / "b.txt", samples)
    line = (tmp_path / "b.txt").read_text().splitlines()[0]
    assert line == "0.25,0.5,0.0,4.0,0.1,-0.2,0.75,1.0,2.0,3.0,1.0,8.0,-4.0,2.0,0.0,0.0"


def test_a_still_buffer_comes_back_still(tmp_path: Path) -> None:
    still = (*FIRST[:6], 0.0, *FIRST[7:11], 0.0, 0.0, 0.0, *FIRST[14:])
    samples = load(write(tmp_path / "a.txt", lines=(still, still)))
    assert samples.time is None
    assert samples.motion is None


@pytest.mark.parametrize(
    ("old", "new", "field", "words"),
    [
        ("Version 1.3", "Version 1.2", "Version", "'1.2'"),
        ("Version 1.3", "Version 2.2", "Version", "'2.2'"),
        ("Width 2", "Width -2", "Width", "'Width -2'"),
        ("Width 2", "Width 0", "Width, Height", "0 x 1"),
        ("Width 2", "Width 999999999", "Width, Height", "over the cap"),
        ("Samples per pixel 1", "Samples per pixel 60000000", "Width, Height", "take at least"),
        ("Height 1\n", "", "Height", "'Samples per pixel 1'"),
        ("Height 1", "Height 3", "samples", "says 6 samples, the file has 2"),
        ("perspective", "projective", "Motion model", "'projective'"),
        ("-15.242497", "nan", "CoC coefficients", "nan"),
        ("-15.242497", "15.242497", "lens.c0", "15.2"),
        ("-15.242497", "-1e999", "lens.c0", "finite"),
        ("= text", "= ebcdic", "Encoding", "'ebcdic'"),
        ("x,y,z/w", "y,x,z/w", "columns", "y,x,z/w"),
        ("dwdx,dwdy", "dwdx", "columns", "dwdx'"),
    ],
)
def test_a_wrong_header_line_is_named(tmp_path: Path, old: str, new: str, field: str, words: str) -> None:
    assert HEADER.count(old) == 1
    with pytest.raises(SampleError) as caught:
        load(write(tmp_path / "a.txt", HEADER.replace(old, new)))
    assert caught.value.file is not None
    assert (caught.value.field or "").startswith(field)
    assert words in caught.value.problem


def test_data_that_disagrees_with_the_header(tmp_path: Path) -> None:
    path = write(tmp_path / "a.txt", lines=(FIRST, SECOND, SECOND))
    with pytest.raises(SampleError, match="says 2 samples, the file has more"):
        load(path)
    # One number moved from a line to the next: the sum is right, the lines are not.
    with pytest.raises(SampleError, match="not text of 16 numbers"):
        load(write(path, lines=(FIRST[:-1], (*SECOND, 0.0))))
    for old in ("0.250000", "1.750000"):
        write(path).write_text(path.read_text().replace(old, "zero"))
        with pytest.raises(SampleError, match="zero"):
            load(path)
    with pytest.raises(SampleError, match="take 128 bytes, the file has 127"):
        (tmp_path / "a.bin").write_bytes(bytes(127))
        load(tmp_path / "a.bin", header=_binary_header(tmp_path))
    with pytest.raises(SampleError, match="file of their own"):
        (tmp_path / "c.txt").write_text(HEADER.replace("= text", "= binary"))
        load(tmp_path / "c.txt")


def test_swapped_columns_are_noticed(tmp_path: Path) -> None:
    swapped = (*FIRST[:3], -1.0, *FIRST[4:])
    with pytest.raises(SampleError, match=r"-1\.0.*depth must be positive") as caught:
        load(write(tmp_path / "a.txt", lines=(swapped, SECOND)))
    assert caught.value.field == "depth"


def _binary_header(folder: Path) -> Path:
    path = folder / "binary.header"
    path.write_text(HEADER.replace("= text", "= binary"))
    return path
