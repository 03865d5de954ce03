"""The native format: readable with NumPy alone, never pickled, never larger in memory than it can be."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fewrays.errors import SampleError
from fewrays.io import load, save
from fewrays.lens import Lens
from fewrays.samples import SampleBuffer

SHAPE = (2, 3, 4)


def members(**changed: Any) -> dict[str, Any]:
    """Return what a complete file holds, with `changed` members; None leaves one out."""
    arrays: dict[str, Any] = {
        "version": 1,
        "c0": -4.0,
        "c1": 1.0,
        "xy": np.zeros((*SHAPE, 2), np.float32),
        "uv": np.zeros((*SHAPE, 2), np.float32),
        "depth": np.ones(SHAPE, np.float32),
        "color": np.ones((*SHAPE, 3), np.float32),
    }
    return {name: value for name, value in (arrays | changed).items() if value is not None}


def raw_npy(shape: tuple[int, ...], data: bytes, dtype: str = "<f4") -> bytes:
    """Return a ``.npy`` file whose header claims `shape`, whatever the data."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue() + data


def replace_member(path: Path, name: str, data: bytes, method: int = zipfile.ZIP_STORED) -> None:
    stream = io.BytesIO()
    np.savez(stream, **members(**{name: None}))
    with zipfile.ZipFile(stream, "a", method) as archive:
        archive.writestr(f"{name}.npy", data)
    path.write_bytes(stream.getvalue())


def test_numpy_reads_what_we_write(tmp_path: Path) -> None:
    samples = SampleBuffer(
        **{k: v for k, v in members().items() if k in ("xy", "uv", "depth", "color")}, lens=Lens(-4, 1)
    )
    save(tmp_path / "a.npz", samples, compressed=True)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        assert set(stored) == {*members(), "sigma", "aperture", "sampling"}
        assert stored["color"].dtype == np.float32
        assert stored["aperture"] == "disc"
        assert stored["c0"] == -4


def test_we_read_what_numpy_writes(tmp_path: Path) -> None:
    depth = np.asfortranarray(np.arange(1, 25, dtype=">f8").reshape(SHAPE))
    np.savez(tmp_path / "a.npz", **members(depth=depth, sampling="square"))
    loaded = load(tmp_path / "a.npz")
    np.testing.assert_array_equal(loaded.depth, depth)
    assert loaded.depth.flags.c_contiguous
    assert loaded.lens == Lens(-4, 1, sampling="square")


@pytest.mark.parametrize("name", ["a.npz", "a.exr"])
def test_bandwidth_comes_back_with_its_infinities(tmp_path: Path, name: str) -> None:
    bandwidth = np.arange(1, 25, dtype=np.float32).reshape(SHAPE)
    bandwidth[1, 2] = np.inf
    arrays = {k: v for k, v in members().items() if k in ("xy", "uv", "depth", "color")}
    save(tmp_path / name, SampleBuffer(**arrays, lens=Lens(-4, 1), bandwidth=bandwidth))
    loaded = load(tmp_path / name)
    assert loaded.bandwidth is not None
    np.testing.assert_array_equal(loaded.bandwidth, bandwidth)


@pytest.mark.parametrize("name", ["a.tlfr", "a.txt"])
def test_a_format_without_bandwidth_refuses_it(tmp_path: Path, name: str) -> None:
    arrays = {k: v for k, v in members().items() if k in ("xy", "uv", "depth", "color")}
    samples = SampleBuffer(**arrays, lens=Lens(-4, 1), bandwidth=np.ones(SHAPE))
    with pytest.raises(SampleError, match="no column") as caught:
        save(tmp_path / name, samples)
    assert (caught.value.file, caught.value.field) == (str(tmp_path / name), "bandwidth")
    assert not list(tmp_path.iterdir())


def test_half_is_for_colour_only_and_must_fit(tmp_path: Path) -> None:
    color = np.random.default_rng(1).uniform(0, 60_000, (*SHAPE, 3)).astype(np.float32)
    arrays = {k: v for k, v in members(color=color).items() if k in ("xy", "uv", "depth", "color")}
    samples = SampleBuffer(**arrays, lens=Lens(-4, 1))
    save(tmp_path / "a.npz", samples, half=True)
    with np.load(tmp_path / "a.npz") as stored:
        assert (stored["color"].dtype, stored["depth"].dtype) == (np.float16, np.float32)
    loaded = load(tmp_path / "a.npz")
    assert loaded.color.dtype == np.float32
    np.testing.assert_allclose(loaded.color, color, rtol=2**-11)
    color[1, 0, 2, 1] = 65_520
    with pytest.raises(SampleError, match=r"65520\.0 at \[1, 0, 2, 1\] does not fit"):
        save(tmp_path / "b.npz", SampleBuffer(**arrays, lens=Lens(-4, 1)), half=True)
    assert not (tmp_path / "b.npz").exists()


@pytest.mark.parametrize(
    ("changed", "field", "words"),
    [
        ({"depth": None}, "depth", "is missing"),
        ({"version": None}, "version", "is missing"),
        ({"c0": None}, "c0", "is missing"),
        ({"version": 2}, "version", "expected 1, got 2"),
        ({"version": "1"}, "version", "expected a number"),
        ({"c1": np.ones(3)}, "c1", "expected a number"),
        ({"c0": 4.0}, "lens.c0", "c0 = 4"),
        ({"c0": np.nan}, "lens.c0", "finite"),
        ({"aperture": "hexagon"}, "lens.aperture", "'hexagon'"),
        ({"aperture": 3}, "aperture", "expected a text"),
        ({"depth": np.ones(SHAPE, np.int32)}, "depth", "int32"),
        ({"depth": np.ones(SHAPE, np.complex64)}, "depth", "complex64"),
        ({"depth": np.ones(SHAPE, [("z", "f4")])}, "depth", "plain numbers"),
        ({"depth": np.ones((2, 3))}, "depth", "(2, 3)"),
        ({"depth": np.ones((2, 4, 3))}, "xy", "(2, 3, 4, 2)"),
        ({"depth": np.zeros(SHAPE)}, "depth", "0.0"),
        ({"uv": np.full((*SHAPE, 2), 3.0)}, "uv", "3.0"),
        ({"xy": np.ones((*SHAPE, 5))}, "xy", "(2, 3, 4, 5)"),
        ({"xy": np.ones((0, 3, 4, 2))}, "xy", "positive sizes"),
        ({"motion": np.ones((*SHAPE, 3))}, "motion", "give time"),
        ({"time": np.full(SHAPE, 2.0)}, "time", "2.0"),
        ({"bandwidth": np.zeros(SHAPE)}, "bandwidth", "positive"),
        ({"bandwidth": np.full(SHAPE, np.nan)}, "bandwidth", "NaN"),
        ({"bandwidth": np.ones((*SHAPE, 2))}, "bandwidth", "expected shape (H, W, S)"),
    ],
)
def test_a_wrong_member_is_named(tmp_path: Path, changed: dict[str, Any], field: str, words: str) -> None:
    np.savez(tmp_path / "a.npz", **members(**changed))
    with pytest.raises(SampleError) as caught:
        load(tmp_path / "a.npz")
    assert (caught.value.file, caught.value.field) == (str(tmp_path / "a.npz"), field)
    assert words in caught.value.problem


def test_pickles_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **members(color=np.full(SHAPE, None)))
    with pytest.raises(SampleError, match="never unpickles") as caught:
        load(tmp_path / "a.npz")
    assert caught.value.field == "color"


@pytest.mark.parametrize(
    ("data", "method", "words"),
    [
        (
            raw_npy((60_000, 30_000, 1), b"abcd"),
            zipfile.ZIP_STORED,
            "takes 7200000000 bytes, the member has 4",
        ),
        (raw_npy((2**40, 2**40, 2**40), b""), zipfile.ZIP_STORED, "over the cap"),
        (raw_npy((-1, 3, 4), b""), zipfile.ZIP_STORED, "shape"),
        (raw_npy(SHAPE, bytes(100)), zipfile.ZIP_DEFLATED, "takes 96 bytes, the member has 100"),
        (raw_npy(SHAPE, bytes(92)), zipfile.ZIP_DEFLATED, "takes 96 bytes, the member has 92"),
        (raw_npy(SHAPE, bytes(96)), zipfile.ZIP_LZMA, "compression 14"),
        (raw_npy(SHAPE, bytes(96))[:20], zipfile.ZIP_STORED, "malformed"),
    ],
)
def test_claimed_sizes_are_checked_first(tmp_path: Path, data: bytes, method: int, words: str) -> None:
    replace_member(tmp_path / "a.npz", "depth", data, method)
    tracemalloc.start()
    with pytest.raises(SampleError, match=words) as caught:
        load(tmp_path / "a.npz")
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    assert caught.value.field == "depth"


def test_a_claim_beyond_what_deflate_can_do_is_refused(tmp_path: Path) -> None:
    """The directory of the archive says 2 GB where a kilobyte is stored."""
    replace_member(
        tmp_path / "a.npz", "depth", raw_npy((512, 1024, 1024), bytes(1 << 16)), zipfile.ZIP_DEFLATED
    )
    data = (tmp_path / "a.npz").read_bytes()
    at = data.rindex(b"PK\1\2") + 24  # uncompressed size in the last directory entry
    (tmp_path / "a.npz").write_bytes(data[:at] + (2**31 + 128).to_bytes(4, "little") + data[at + 4 :])
    with pytest.raises(SampleError, match="compressed bytes can hold"):
        load(tmp_path / "a.npz")
