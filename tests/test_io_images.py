"""Images: exact where they hold radiance, right to half a step where they are for looking at."""

from __future__ import annotations

import struct
import tempfile
import zlib
from pathlib import Path

import hypothesis.extra.numpy as hnp
import numpy as np
import numpy.typing as npt
import OpenEXR
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.color import srgb_decode, srgb_encode
from fewrays.errors import SampleError
from fewrays.io import load_image, save_image

SIDES = st.integers(1, 40)
FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize("suffix", [".exr", ".npy"])
@given(
    image=st.one_of(st.tuples(SIDES, SIDES, st.just(3)), st.tuples(SIDES, SIDES)).flatmap(
        lambda shape: hnp.arrays(np.float32, shape, elements=FINITE)
    )
)
def test_radiance_and_maps_come_back_exactly(suffix: str, image: npt.NDArray[np.float32]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        save_image(path, image)
        loaded = load_image(path)
        assert [file.name for file in Path(folder).iterdir()] == [path.name]
    assert loaded.dtype == np.float32
    np.testing.assert_array_equal(loaded.view(np.uint32), image.view(np.uint32))


def test_png_is_right_to_half_a_step(tmp_path: Path) -> None:
    image = np.linspace(0, 1, 3000, dtype=np.float32).reshape(10, 100, 3)
    save_image(tmp_path / "a.png", image)
    stored = np.asarray(PIL.Image.open(tmp_path / "a.png"))
    assert np.abs(stored - 255.0 * srgb_encode(image)).max() <= 0.5 + 1e-3
    loaded = load_image(tmp_path / "a.png")
    assert np.abs(srgb_encode(loaded) - srgb_encode(image)).max() <= 0.5 / 255 + 1e-5
    save_image(tmp_path / "b.png", loaded)
    np.testing.assert_array_equal(load_image(tmp_path / "b.png"), loaded)


def test_exposure_is_in_stops_and_for_display_only(tmp_path: Path) -> None:
    image = np.full((2, 2, 3), 0.125, np.float32)
    save_image(tmp_path / "a.png", image, exposure=2)
    save_image(tmp_path / "b.png", 4 * image)
    np.testing.assert_array_equal(load_image(tmp_path / "a.png"), load_image(tmp_path / "b.png"))
    save_image(tmp_path / "c.png", image, exposure=500)  # overflows to white
    assert (load_image(tmp_path / "c.png") == 1).all()
    for name in ("a.exr", "a.npy"):
        with pytest.raises(SampleError, match=r"is for \.png") as caught:
            save_image(tmp_path / name, image, exposure=1)
        assert caught.value.field == "exposure"
    with pytest.raises(SampleError, match="finite number of stops"):
        save_image(tmp_path / "a.png", image, exposure=float("nan"))


def test_provenance_is_in_the_file(tmp_path: Path) -> None:
    notes = {"method": "layered", "options": "sigma_pix=0.5", "version": "0.1.0 – naïve"}
    image = np.ones((2, 3, 3), np.float32)
    save_image(tmp_path / "a.exr", image, provenance=notes)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header = dict(file.header())  # emptied when it closes
    assert {name: header[f"fewrays/{name}"] for name in notes} == notes
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    save_image(tmp_path / "a.png", image, provenance=notes)
    with PIL.Image.open(tmp_path / "a.png") as picture:
        picture.load()
        assert picture.info == notes
    for name in ("a.exr", "a.png"):
        for bad in ("", "x" * 300, "nul\0"):
            with pytest.raises(SampleError, match="expected 1 to"):
                save_image(tmp_path / name, image, provenance={bad: "x"})
    assert {file.name for file in tmp_path.iterdir()} == {"a.exr", "a.png"}


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "TILED"])
def test_flat_exr_files_of_others(tmp_path: Path, compression: str) -> None:
    image = np.random.default_rng(1).integers(0, 1000, (70, 50, 4)).astype(np.float16)
    header = {"type": OpenEXR.scanlineimage}
    if compression == "TILED":
        tiles = OpenEXR.TileDescription()
        tiles.xSize, tiles.ySize = 16, 32
        header = {"type": OpenEXR.tiledimage, "tiles": tiles}
    else:
        header["compression"] = getattr(OpenEXR, f"{compression}_COMPRESSION")
    with OpenEXR.File(header, {"RGBA": image}) as file:
        file.write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(load_image(tmp_path / "a.exr"), image[..., :3].astype(np.float32))


def test_exr_without_colour_names_the_missing_channel(tmp_path: Path) -> None:
    plane = np.zeros((2, 2), np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"R": plane, "B": plane}).write(str(tmp_path / "a.exr"))
    with pytest.raises(SampleError, match="the file has B, R") as caught:
        load_image(tmp_path / "a.exr")
    assert caught.value.field == "channel G"


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((2, 2, 4)), r"expected shape .* got \(2, 2, 4\)"),
        (np.zeros((0, 2, 3)), "got"),
        (np.zeros(3), "got"),
        (np.zeros((1, 70_000, 3), np.uint8), "cap of 65536"),
        (np.zeros((2, 2, 3), complex), "complex128"),
        (np.array([[[0, 1, np.nan]]]), r"first at \[0, 0, 2\]: nan"),
        (np.array([[[0, 1, 1e300]]]), r"first at \[0, 0, 2\]: inf"),
    ],
)
@pytest.mark.parametrize("suffix", [".exr", ".png", ".npy"])
def test_what_is_not_an_image(
    tmp_path: Path, suffix: str, image: npt.NDArray[np.generic], words: str
) -> None:
    path = tmp_path / f"a{suffix}"
    with pytest.raises(SampleError, match=words) as caught:
        save_image(path, image)
    assert (caught.value.file, caught.value.field) == (str(path), "image")
    assert not list(tmp_path.iterdir())
    if suffix == ".npy" and image.ndim == 3 and image.size < 100:
        np.save(path, image)
        with pytest.raises(SampleError, match=words):
            load_image(path)


def test_other_pngs(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    PIL.Image.new("L", (3, 2), 255).save(path)
    np.testing.assert_array_equal(load_image(path), np.ones((2, 3, 3)))
    PIL.Image.new("RGBA", (3, 2), (255, 255, 255, 128)).save(path)
    with pytest.raises(SampleError, match="transparent"):
        load_image(path)
    PIL.Image.new("I;16", (3, 2), 7).save(path)
    with pytest.raises(SampleError, match="at most 8 bits, got 16"):
        load_image(path)
    with pytest.raises(SampleError, match="three channels"):
        save_image(path, np.zeros((2, 2)))
    with pytest.raises(SampleError, match=r"images end in \.exr, \.png, \.npy"):
        load_image(tmp_path / "a.jpg")
    with pytest.raises(SampleError, match="expected a path"):
        load_image(3)  # type: ignore[arg-type]
    with pytest.raises(SampleError, match="overwrite=True"):
        save_image(path, np.zeros((2, 2, 3)), overwrite=False)


def test_a_png_bomb_is_refused(tmp_path: Path) -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    size = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    (tmp_path / "a.png").write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", size)
        + chunk(b"IDAT", zlib.compress(bytes(9999)))
        + chunk(b"IEND", b"")
    )
    with pytest.raises(SampleError, match="compressed bytes can hold"):
        load_image(tmp_path / "a.png")


def test_srgb_known_values_and_inverse() -> None:
    # From IEC 61966-2-1: middle grey 18 % is 46.1 %; the pieces meet; the ends are fixed.
    np.testing.assert_allclose(srgb_encode([0, 0.18, 1]), [0, 0.46135613, 1], atol=1e-6)
    np.testing.assert_allclose(srgb_encode([-1, 2]), [0, 1])
    codes = np.arange(256, dtype=np.float32) / 255
    np.testing.assert_allclose(srgb_encode(srgb_decode(codes)), codes, atol=2e-6)
    light = np.linspace(0, 1, 10_001, dtype=np.float32)
    assert (np.diff(srgb_encode(light)) > 0).all()
    np.testing.assert_allclose(srgb_decode(srgb_encode(light)), light, atol=2e-6)
