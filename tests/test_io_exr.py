"""Deep OpenEXR: agreement with the official library both ways, and deep files that others wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest

from fewrays.errors import SampleError
from fewrays.io import load, save
from fewrays.lens import Lens
from fewrays.samples import OFF_IMAGE, SampleBuffer

NAMES = ("R", "G", "B", "A", "Z", "position.x", "position.y", "lens.u", "lens.v")
HEADER = {"type": OpenEXR.deepscanline, "fewrays/c0": -4.0, "fewrays/c1": 1.0}
COMPRESSIONS = [OpenEXR.NO_COMPRESSION, OpenEXR.RLE_COMPRESSION, OpenEXR.ZIPS_COMPRESSION]


def deep(values: list[list[list[float]]], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[np.object_]:
    """Return the library's form of a deep channel: an array of arrays."""
    pixels = np.empty((len(values), len(values[0])), object)
    for index in np.ndindex(pixels.shape):
        pixels[index] = np.array(values[index[0]][index[1]], dtype)
    return pixels


def foreign(
    counts: list[list[int]], **changed: npt.NDArray[np.object_]
) -> dict[str, npt.NDArray[np.object_]]:
    """Return channels with `counts` samples per pixel, opaque, inside the lens."""
    rng = np.random.default_rng(2)
    channels = {n: deep([[list(rng.uniform(0.1, 0.6, c)) for c in row] for row in counts]) for n in NAMES}
    channels["A"] = deep([[[1.0] * c for c in row] for row in counts])
    return channels | changed


def write(path: Path, channels: dict[str, Any], **header: Any) -> None:
    with OpenEXR.File(HEADER | {"compression": OpenEXR.ZIPS_COMPRESSION} | header, dict(channels)) as file:
        file.write(str(path))


def buffer(height: int = 5, width: int = 7, spp: int = 3) -> SampleBuffer:
    rng = np.random.default_rng(4)
    shape = (height, width, spp)
    return SampleBuffer(
        xy=rng.uniform(0, width, (*shape, 2)),
        uv=rng.uniform(-1, 1, (*shape, 2)),
        depth=np.full(shape, 4.0),  # compresses, so that both ways of storing a line occur
        color=rng.integers(0, 3, (*shape, 3)),
        lens=Lens(-1 / 3, 0.1, "gaussian", "square", 0.3),
        time=rng.uniform(0, 1, shape),
        motion=rng.normal(size=(*shape, 3)),
    )


@pytest.mark.parametrize("compression", ["zips", "none"])
def test_the_library_reads_what_we_write(tmp_path: Path, compression: str) -> None:
    samples = buffer()
    save(tmp_path / "a.exr", samples, compression=compression)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels, header = dict(file.channels()), dict(file.header())  # emptied when it closes
    expected = {
        "Z": samples.depth,
        "A": np.ones_like(samples.depth),
        "time": samples.time,
        **{name: samples.color[..., i] for i, name in enumerate("RGB")},
        **{f"position.{name}": samples.xy[..., i] for i, name in enumerate("xy")},
        **{f"lens.{name}": samples.uv[..., i] for i, name in enumerate("uv")},
    }
    assert samples.motion is not None
    expected |= {f"motion.{name}": samples.motion[..., i] for i, name in enumerate("xyw")}
    assert set(channels) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(np.array(channels[name].pixels.tolist()), values, err_msg=name)
    assert header["fewrays/aperture"] == "gaussian"
    assert header["fewrays/c0"] == -1 / 3  # exact: a double
    assert header["focus"] == np.float32(samples.lens.focus_distance)
    assert header["maxSamplesPerPixel"] == 3


@pytest.mark.parametrize("compression", COMPRESSIONS, ids=str)
@pytest.mark.parametrize("width", [1, 2, 64])
def test_we_read_what_the_library_writes(tmp_path: Path, compression: Any, width: int) -> None:
    rng = np.random.default_rng(width)
    # Few distinct values make long runs, so that run lengths and DEFLATE have something to do.
    arrays = {name: (rng.integers(1, 3, (3, width, 4)) / 4).astype(np.float32) for name in NAMES}
    arrays["A"][:] = 1
    write(tmp_path / "a.exr", {n: deep(a.tolist()) for n, a in arrays.items()}, compression=compression)
    loaded = load(tmp_path / "a.exr", sampling="square")
    np.testing.assert_array_equal(loaded.depth, arrays["Z"])
    np.testing.assert_array_equal(loaded.color, np.stack([arrays[n] for n in "RGB"], axis=-1))
    np.testing.assert_array_equal(loaded.uv, np.stack([arrays["lens.u"], arrays["lens.v"]], axis=-1))
    np.testing.assert_array_equal(loaded.xy, np.stack([arrays["position.x"], arrays["position.y"]], axis=-1))
    assert (loaded.lens.c0, loaded.lens.c1, loaded.time) == (-4.0, 1.0, None)


def test_missing_samples_are_parked_off_the_image(tmp_path: Path) -> None:
    counts = [[2, 0, 1], [3, 1, 2]]
    channels = foreign(counts)
    write(tmp_path / "a.exr", channels)
    loaded = load(tmp_path / "a.exr")
    assert loaded.depth.shape == (2, 3, 3)
    parked = (loaded.xy == OFF_IMAGE).all(axis=-1)
    np.testing.assert_array_equal(3 - parked.sum(axis=-1), counts)
    for index in np.ndindex(2, 3):
        np.testing.assert_array_equal(loaded.depth[index][: counts[index[0]][index[1]]], channels["Z"][index])
    assert not loaded.color[parked].any()


def test_half_floats_and_other_channels_are_understood(tmp_path: Path) -> None:
    counts = [[1, 2]]
    half = deep([[[0.5], [1.5, 2.5]]], np.float16)
    write(tmp_path / "a.exr", foreign(counts, G=half, id=deep([[[7], [8, 9]]], np.uint32)))
    np.testing.assert_array_equal(load(tmp_path / "a.exr").color[0, 1, :, 1], [1.5, 2.5])


def test_the_data_window_is_the_image(tmp_path: Path) -> None:
    channels = foreign([[1, 2]])
    channels["position.x"] = deep([[[10.25], [11.5, 11.75]]])
    channels["position.y"] = deep([[[-4.5], [-4.25, -4.75]]])
    window = (np.array([10, -5], np.int32), np.array([11, -5], np.int32))
    write(tmp_path / "a.exr", channels, dataWindow=window, displayWindow=window)
    xy = load(tmp_path / "a.exr").xy
    np.testing.assert_array_equal(xy[0, 1], [[1.5, 0.75], [1.75, 0.25]])
    np.testing.assert_array_equal(xy[0, 0], [[0.25, 0.5], [OFF_IMAGE, OFF_IMAGE]])


@pytest.mark.parametrize("name", [name for name in NAMES if name != "A"])
def test_a_missing_channel_is_named(tmp_path: Path, name: str) -> None:
    channels = foreign([[1, 1]])
    del channels[name]
    write(tmp_path / "a.exr", channels)
    with pytest.raises(SampleError, match="is missing") as caught:
        load(tmp_path / "a.exr")
    assert caught.value.field == f"channel {name}"


def test_half_a_motion_is_an_error_but_none_is_not(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", foreign([[1]], time=deep([[[0.5]]]), **{"motion.x": deep([[[0.5]]])}))
    with pytest.raises(SampleError, match="is missing") as caught:
        load(tmp_path / "a.exr")
    assert caught.value.field == "channel motion.y"


def test_what_a_sample_buffer_cannot_hold(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write(path, foreign([[1, 1]], A=deep([[[1.0], [0.25]]])))
    with pytest.raises(SampleError, match=r"0\.25 in line 0.*A = 1"):
        load(path)
    write(path, foreign([[0, 0]]))
    with pytest.raises(SampleError, match="holds no samples"):
        load(path)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.zeros((2, 2, 3), np.float32)}).write(str(path))
    with pytest.raises(SampleError, match="flat image"):
        load(path)
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Y": np.zeros((2, 2), "f4")}, n) for n in "ab"]
    OpenEXR.File(parts).write(str(path))
    with pytest.raises(SampleError, match="several parts"):
        load(path)


def test_the_lens_must_be_stated(tmp_path: Path) -> None:
    channels = foreign([[1]])
    OpenEXR.File({"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}, channels).write(
        str(tmp_path / "a.exr")
    )
    with pytest.raises(SampleError, match="slope coefficient") as caught:
        load(tmp_path / "a.exr")
    assert caught.value.field == "fewrays/c0"


def test_one_crowded_pixel_does_not_fill_the_memory(tmp_path: Path) -> None:
    counts = [[0] * 100 for _ in range(100)]
    counts[50][50] = 1000
    write(tmp_path / "a.exr", foreign(counts))
    with pytest.raises(SampleError, match="fullest pixel has 1000"):
        load(tmp_path / "a.exr")


def test_absurd_window_is_rejected_before_anything_is_allocated(tmp_path: Path) -> None:
    save(tmp_path / "a.exr", buffer())
    data = (tmp_path / "a.exr").read_bytes()
    at = data.index(b"dataWindow\0box2i\0") + len("dataWindow\0box2i\0") + 4
    for corner, words in (
        (2**31 - 1, "the cap is 65536"),
        (65_535, "claims 65536 chunks"),
        (-1, "the cap is"),
    ):
        value = int(corner).to_bytes(4, "little", signed=True)
        (tmp_path / "b.exr").write_bytes(data[: at + 8] + value + value + data[at + 16 :])
        with pytest.raises(SampleError, match=words):
            load(tmp_path / "b.exr")
