"""What is saved is what is loaded: bit for bit, in every format, for any buffer."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as hnp
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.errors import SampleError
from fewrays.io import FORMATS, load, save
from fewrays.lens import Lens
from fewrays.samples import SampleBuffer

WAYS: list[tuple[str, dict[str, Any]]] = [
    ("a.npz", {}),
    ("a.npz", {"compressed": True}),
    ("a.tlfr", {}),
    ("a.bin", {}),
    ("a.txt", {}),
    ("a.tlfr", {"encoding": "text"}),
    ("a.exr", {}),
    ("a.exr", {"compression": "none"}),
]


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(float(np.float32(low)), float(np.float32(high)), width=32)


@st.composite
def buffers(draw: st.DrawFn) -> SampleBuffer:
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 5), st.integers(1, 4)))

    def array(low: float, high: float, *channels: int) -> npt.NDArray[np.float32]:
        return draw(hnp.arrays(np.float32, (*shape, *channels), elements=floats(low, high)))

    timed = draw(st.booleans())
    moving = timed and draw(st.booleans())
    return SampleBuffer(
        xy=array(-1e6, 1e6, 2),
        uv=array(-1, 1, 2),
        depth=array(1e-20, 3e38),
        color=array(-3e38, 3e38, 3),
        lens=Lens(
            draw(st.floats(-1e10, 0)),
            draw(st.floats(-1e10, 1e10)),
            draw(st.sampled_from(["disc", "gaussian"])),
            draw(st.sampled_from(["square", "gaussian"])),
            draw(st.floats(0.01, 100)),
        ),
        time=array(0, 1) if timed else None,
        motion=array(-3e38, 3e38, 3) if moving else None,
    )


def assert_equal_bits(actual: npt.NDArray[np.float32], expected: npt.NDArray[np.float32], name: str) -> None:
    assert actual.dtype == expected.dtype == np.float32
    np.testing.assert_array_equal(actual.view(np.uint32), expected.view(np.uint32), err_msg=name)


@pytest.mark.parametrize(("name", "options"), WAYS, ids=[f"{n}-{o}" for n, o in WAYS])
@given(samples=buffers())
def test_every_field_comes_back(name: str, options: dict[str, Any], samples: SampleBuffer) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        save(path, samples, **options)
        if path.suffix in (".npz", ".exr"):
            loaded = load(path)
            assert loaded.lens == samples.lens
        else:  # version 1.3 does not say how the lens was sampled
            lens = samples.lens
            loaded = load(path, aperture=lens.aperture, sampling=lens.sampling, sigma=lens.sigma)
            assert loaded.lens == lens
        left = {file.name for file in Path(folder).iterdir()}
        assert left in ({name}, {name, f"{name}.header"})
    for field in ("xy", "uv", "depth", "color", "time", "motion"):
        before, after = getattr(samples, field), getattr(loaded, field)
        if before is None or after is None:
            # Version 1.3 always has times and motion, and zeros there mean that nothing was given.
            assert path.suffix not in (".npz", ".exr") or before is after
            assert before is None or not before.any()
            assert after is None or not after.any()
        else:
            assert_equal_bits(after, before, field)


def test_text_is_exact_for_every_kind_of_float(tmp_path: Path) -> None:
    """Decimal digits go through double precision on the way back: 300 000 random bit patterns survive it."""
    rng = np.random.default_rng(5)
    bits = rng.integers(0, 2**32, 300_000, dtype=np.uint32).view(np.float32)
    color = np.where(np.isfinite(bits), bits, np.float32(0)).reshape(100, 100, 10, 3)
    shape = color.shape[:3]
    samples = SampleBuffer(np.zeros((*shape, 2)), np.zeros((*shape, 2)), np.ones(shape), color, Lens(-1, 1))
    save(tmp_path / "a.txt", samples)
    assert_equal_bits(load(tmp_path / "a.txt").color, color, "color")


@pytest.mark.parametrize("name", ["a.npz", "a.tlfr", "a.txt", "a.exr"])
def test_saving_twice_gives_equal_files_and_overwrite_is_asked(tmp_path: Path, name: str) -> None:
    samples = SampleBuffer(
        np.zeros((2, 3, 1, 2)), np.zeros((2, 3, 1, 2)), np.ones((2, 3, 1)), np.ones((2, 3, 1, 3)), Lens(-1, 1)
    )
    path = tmp_path / name
    save(path, samples)
    first = path.read_bytes()
    save(path, samples)
    assert path.read_bytes() == first
    with pytest.raises(SampleError, match="exists") as caught:
        save(path, samples, overwrite=False)
    assert caught.value.file == str(path)
    assert path.read_bytes() == first


def test_overrides_replace_what_the_file_says(tmp_path: Path) -> None:
    corner = np.full((1, 1, 1, 2), 0.9)
    samples = SampleBuffer(
        np.zeros((1, 1, 1, 2)),
        corner,
        np.ones((1, 1, 1)),
        np.ones((1, 1, 1, 3)),
        Lens(-1, 1, sampling="square"),
    )
    for form in FORMATS:
        path = tmp_path / f"a{form.extensions[0]}"
        save(path, samples)
        loaded = load(path, aperture="gaussian", sampling="gaussian", sigma=0.25)
        assert loaded.lens == Lens(-1, 1, "gaussian", "gaussian", 0.25)
        with pytest.raises(SampleError, match="unit disc") as caught:
            load(path, sampling="disc")
        assert (caught.value.file, caught.value.field) == (str(path), "uv")


def test_dropping_bad_samples_is_asked_for(tmp_path: Path) -> None:
    shape = (2, 3, 4)
    arrays: dict[str, Any] = {
        "xy": np.zeros((*shape, 2), np.float32),
        "uv": np.zeros((*shape, 2), np.float32),
        "depth": np.ones(shape, np.float32),
        "color": np.ones((*shape, 3), np.float32),
    }
    arrays["color"][1, 2, 3, 0] = np.nan
    np.savez(tmp_path / "a.npz", version=1, c0=-1.0, c1=1.0, **arrays)
    with pytest.raises(SampleError, match="NaN") as caught:
        load(tmp_path / "a.npz")
    assert caught.value.field == "color"
    with pytest.warns(UserWarning, match="dropped 1 of 24"):
        loaded = load(tmp_path / "a.npz", nan="drop")
    assert loaded.xy[1, 2, 3, 0] < -1e6


def test_unknown_extension_option_and_type_are_named(tmp_path: Path) -> None:
    samples = SampleBuffer(
        np.zeros((1, 1, 1, 2)), np.zeros((1, 1, 1, 2)), np.ones((1, 1, 1)), np.ones((1, 1, 1, 3)), Lens(-1, 1)
    )
    with pytest.raises(SampleError, match=r"\.npz, \.tlfr, \.bin, \.txt, \.exr"):
        load(tmp_path / "a.jpg")
    with pytest.raises(SampleError, match="compressed, half"):
        save(tmp_path / "a.npz", samples, encoding="text")
    with pytest.raises(SampleError, match="'text' or 'binary'"):
        save(tmp_path / "a.tlfr", samples, encoding="utf-8")
    with pytest.raises(SampleError, match="'zips' or 'none'"):
        save(tmp_path / "a.exr", samples, compression="zip")
    with pytest.raises(SampleError, match=r"name its data file, a\.bin"):
        load(tmp_path / "a.bin.header")
    with pytest.raises(SampleError, match="SampleBuffer, got int"):
        save(tmp_path / "a.npz", 3)  # type: ignore[arg-type]
    with pytest.raises(SampleError, match="expected a path"):
        load(3)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
