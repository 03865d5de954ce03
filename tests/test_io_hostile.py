"""Damaged files, in every format: a valid buffer or one SampleError; nothing else, and nothing large."""

from __future__ import annotations

import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fewrays.errors import SampleError
from fewrays.io import load, load_image, save, save_image
from fewrays.lens import Lens
from fewrays.samples import SampleBuffer
from lit_buffers import LIGHTS, lit_buffer

resource = pytest.importorskip("resource", reason="measures memory and makes pipes as POSIX systems do")

SAMPLES: dict[str, dict[str, Any]] = {
    "stored.npz": {},
    "deflated.npz": {"compressed": True},
    "lit.npz": {},
    "binary.tlfr": {},
    "text.txt": {},
    "zips.exr": {},
    "plain.exr": {"compression": "none"},
}
IMAGES = ("flat.exr", "flat.png", "flat.npy")
MEMORY = 8 << 20  # bytes that reading a damaged file of a few kilobytes may take
Load = Callable[[Path], object]


def small_buffer(name: str = "") -> SampleBuffer:
    if name.startswith("lit"):
        return lit_buffer((1, 2, 2), lights=LIGHTS[1:])
    rng = np.random.default_rng(7)
    shape = (1, 2, 2)
    return SampleBuffer(
        xy=rng.uniform(0, 3, (*shape, 2)),
        uv=rng.uniform(-0.7, 0.7, (*shape, 2)),
        depth=rng.uniform(1, 9, shape),
        color=rng.uniform(0, 2, (*shape, 3)),
        lens=Lens(-10.5, 2.25),
        time=rng.uniform(0, 1, shape),
        motion=rng.normal(size=(*shape, 3)),
    )


@pytest.fixture(params=[*SAMPLES, "text.txt.header", *IMAGES])
def case(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path, Load]:
    """A file to damage, the file to load, and how."""
    name: str = request.param
    damaged = tmp_path / name
    if name in IMAGES:
        save_image(damaged, np.random.default_rng(3).uniform(0, 1, (5, 4, 3)).astype(np.float32))
        return damaged, damaged, load_image
    loaded = tmp_path / name.removesuffix(".header")
    save(loaded, small_buffer(name), **SAMPLES[loaded.name])
    return damaged, loaded, load


def check(damaged: Path, loaded: Path, reader: Load, data: bytes) -> bool:
    """Load `data` in the file's place; return whether it was accepted."""
    damaged.write_bytes(data)
    tracemalloc.reset_peak()
    try:
        result = reader(loaded)
    except SampleError as error:
        assert error.file is not None
        assert Path(error.file).parent == loaded.parent
        assert error.problem
        assert "\n" not in str(error)
        accepted = False
    else:
        assert isinstance(result, SampleBuffer | np.ndarray)
        accepted = True
    assert tracemalloc.get_traced_memory()[1] < MEMORY
    return accepted


@pytest.fixture(autouse=True)
def _memory() -> Any:
    tracemalloc.start()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    tracemalloc.stop()
    # What the decoders allocate themselves; kilobytes on Linux, bytes on macOS.
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < (300 << 10) * (1024 if os.uname().sysname == "Darwin" else 1)


def positions(size: int, config: pytest.Config) -> list[int]:
    """Every byte with ``--slow``, else every one near both ends and some hundreds between."""
    between = range(100, max(size - 100, 100), 1 if config.getoption("--slow") else max(1, size // 300))
    return sorted({*range(min(100, size)), *between, *range(max(size - 100, 0), size)})


def test_truncated_anywhere(case: tuple[Path, Path, Load], pytestconfig: pytest.Config) -> None:
    damaged, loaded, reader = case
    data = damaged.read_bytes()
    accepted = [
        end for end in positions(len(data), pytestconfig) if check(damaged, loaded, reader, data[:end])
    ]
    # A text's last number and line end may be cut: the last column is not used.
    assert all(end >= len(data) - len("0.0\n") for end in accepted)
    assert not accepted or damaged.suffix in (".txt", ".header")


def test_flipped_bytes(case: tuple[Path, Path, Load], pytestconfig: pytest.Config) -> None:
    damaged, loaded, reader = case
    data = damaged.read_bytes()
    rng = np.random.default_rng(11)
    outcomes = set()
    for index in positions(len(data), pytestconfig):
        flipped = bytearray(data)
        flipped[index] ^= int(rng.integers(1, 256))
        outcomes.add(check(damaged, loaded, reader, bytes(flipped)))
    assert False in outcomes


def test_bytes_inserted_removed_or_shuffled(case: tuple[Path, Path, Load]) -> None:
    damaged, loaded, reader = case
    data = damaged.read_bytes()
    rng = np.random.default_rng(13)
    for _ in range(60):
        first, last = np.sort(rng.integers(0, len(data), 2))
        middle = data[first:last]
        for replacement in (b"", middle + middle, middle[::-1], b"\xff" * len(middle), bytes(len(middle))):
            check(damaged, loaded, reader, data[:first] + replacement + data[last:])


def test_wrong_content(case: tuple[Path, Path, Load]) -> None:
    damaged, loaded, reader = case
    for data in (
        b"",
        b"\0",
        b"\n",
        b"x" * 4000,
        bytes(4000),
        b"\xff" * 4000,
        b"PK\5\6" + bytes(18),
        b"\x80\x04N.",
    ):
        assert not check(damaged, loaded, reader, data)


@pytest.mark.parametrize("name", ["a.npz", "a.tlfr", "a.txt", "a.exr"])
def test_missing_directory_or_device(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with pytest.raises(SampleError, match="No such file"):
        load(path)
    path.mkdir()
    with pytest.raises(SampleError, match="not a regular file"):
        load(path)
    with pytest.raises(SampleError, match="not a regular file"):
        save(path, small_buffer())
    path.rmdir()
    os.mkfifo(path)
    with pytest.raises(SampleError, match="not a regular file"):
        load(path)
    with pytest.raises(SampleError, match="no directory"):
        save(tmp_path / "nowhere" / name, small_buffer())
    with pytest.raises(SampleError, match="cannot be read"):
        load(f"nul\0{name}")


@pytest.mark.parametrize("name", [*SAMPLES])
def test_a_failed_save_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    save(path, small_buffer(name), **SAMPLES[name])
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def fail(*_: object, **__: object) -> bytes:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("fewrays.io.npz._write_member", fail)
    monkeypatch.setattr("fewrays.io.tlfr._rows", fail)
    monkeypatch.setattr("fewrays.io.exr.pack_chunk", fail)
    with pytest.raises(SampleError, match="No space left") as caught:
        save(path, small_buffer(name), **SAMPLES[name])
    assert caught.value.file == str(path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_an_interrupted_save_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr("fewrays.io.exr.pack_chunk", interrupt)
    with pytest.raises(KeyboardInterrupt):
        save(tmp_path / "a.exr", small_buffer())
    assert not list(tmp_path.iterdir())


def test_a_symbolic_link_keeps_pointing(tmp_path: Path) -> None:
    target, link = tmp_path / "target.npz", tmp_path / "link.npz"
    save(target, small_buffer())
    link.symlink_to(target)
    save(link, small_buffer(), compressed=True)
    assert link.is_symlink()
    np.testing.assert_array_equal(load(target).depth, small_buffer().depth)
