"""Pictures with depth from files: kinds of depth, windows, parts, alpha, deep layers, damage."""

from __future__ import annotations

import contextlib
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import SampleError, save_image
from fewrays.dynamic import DepthLayer
from fewrays.io.rgbz import RgbzSource, load_rgbz, save_rgbz
from fewrays.io.rgbz_deep import load_deep
from fewrays.io.rgbz_depth import DepthFormat, to_planar

HEIGHT, WIDTH = 7, 10
FOCAL = 1.2  # image widths


@pytest.fixture
def color() -> npt.NDArray[np.float32]:
    return np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32) * 4


@pytest.fixture
def depth() -> npt.NDArray[np.float32]:
    return np.random.default_rng(1).uniform(1, 9, (HEIGHT, WIDTH)).astype(np.float32)


def write(path: Path, channels: dict[str, Any], **header: Any) -> Path:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **header}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


# Kinds of depth.


def test_distances_become_planar_by_the_angle_of_each_ray(depth: npt.NDArray[np.float32]) -> None:
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    focal = FOCAL * WIDTH
    points = np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1) * depth[..., None]
    distance = np.linalg.norm(points, axis=-1)
    planar = to_planar(distance, DepthFormat("distance"), focal_pixels=focal)
    np.testing.assert_allclose(planar, depth, rtol=1e-6)
    with pytest.raises(SampleError, match="give the angle of view"):
        to_planar(distance, DepthFormat("distance"))


def test_inverse_depth_and_scale(depth: npt.NDArray[np.float32]) -> None:
    np.testing.assert_allclose(to_planar(1 / depth, DepthFormat("inverse")), depth, rtol=1e-6)
    np.testing.assert_allclose(to_planar(-5 * depth, DepthFormat("planar", scale=-0.2)), depth, rtol=1e-6)
    np.testing.assert_allclose(to_planar(2 / depth, DepthFormat("inverse", scale=0.5)), depth, rtol=1e-6)


@pytest.mark.parametrize("value", [1e10, 1e30, math.inf, 65504.0, np.finfo(np.float32).max])
@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_where_nothing_was_hit_depth_is_infinite(value: float, dtype: type) -> None:
    with np.errstate(over="ignore"):
        values: npt.NDArray[Any] = np.array([[value, 2.0]], dtype)
    np.testing.assert_array_equal(to_planar(values, DepthFormat()), [[np.inf, 2]])
    np.testing.assert_array_equal(
        to_planar(np.array([[0, 0.5]], dtype), DepthFormat("inverse")), [[np.inf, 2]]
    )
    np.testing.assert_array_equal(
        to_planar(np.array([[900, 2]], dtype), DepthFormat(background=500)), [[np.inf, 2]]
    )


@given(bad=st.sampled_from([math.nan, 0.0, -0.0, -1.0, -math.inf]), row=st.integers(0, 2))
def test_no_depth_is_an_error_or_background(bad: float, row: int) -> None:
    values = np.full((3, 4), 2.0)
    values[row, 1] = bad
    with pytest.raises(
        SampleError, match=rf"1 of 12 pixels.*column 1, row {row}.*invalid_depth='background'"
    ):
        to_planar(values, DepthFormat())
    assert to_planar(values, DepthFormat(invalid="background"))[row, 1] == np.inf


@pytest.mark.parametrize(
    "wrong", [{"kind": "flat"}, {"scale": 0.0}, {"scale": math.nan}, {"background": 0.0}, {"invalid": "drop"}]
)
def test_formats_out_of_range(wrong: dict[str, Any]) -> None:
    with pytest.raises(SampleError, match="expected a value"):
        DepthFormat(**wrong)


# Flat files.


@pytest.mark.parametrize("alpha", [None, 0.25])
def test_what_is_saved_is_loaded(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32], alpha: float | None
) -> None:
    depth[2, 3] = np.inf
    opacity = None if alpha is None else np.full(depth.shape, alpha, np.float32)
    save_rgbz(tmp_path / "a.exr", DepthLayer(color, depth, opacity), lens=(-57.25, 17.5))
    picture = load_rgbz(tmp_path / "a.exr")
    assert picture.lens == (-57.25, 17.5)
    assert (picture.size, picture.full_width) == ((HEIGHT, WIDTH), WIDTH)
    (layer,) = picture.layers
    np.testing.assert_array_equal(layer.color, color)
    np.testing.assert_array_equal(layer.depth, depth)
    assert (layer.alpha is None) == (alpha is None)
    if layer.alpha is not None:
        np.testing.assert_array_equal(layer.alpha, np.float32(alpha or 0))


def test_parts_are_layers(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32]
) -> None:
    content = {"DiffDir": {"RGB": np.zeros_like(color)}, "Combined": {"RGB": color}, "Depth": {"Z": depth}}
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, channels, f"ViewLayer.{name}")
        for name, channels in content.items()
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "a.exr"))
    (layer,) = load_rgbz(tmp_path / "a.exr").layers
    np.testing.assert_array_equal(layer.color, color)
    np.testing.assert_array_equal(layer.depth, depth)


def test_crops_keep_the_optical_axis(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32]
) -> None:
    # A ray's length depends on where in the whole picture of 40 x 30 the crop lies.
    left, top, full = 25, 4, (40, 30)
    x = np.arange(WIDTH) + 0.5 + left - full[0] / 2
    y = np.arange(HEIGHT) + 0.5 + top - full[1] / 2
    distance = depth * np.sqrt(1 + (x[None] ** 2 + y[:, None] ** 2) / (FOCAL * full[0]) ** 2)
    path = write(
        tmp_path / "crop.exr",
        {"RGB": color, "Z": distance.astype(np.float32)},
        dataWindow=(
            np.array([left, top], np.int32),
            np.array([left + WIDTH - 1, top + HEIGHT - 1], np.int32),
        ),
        displayWindow=(np.array([0, 0], np.int32), np.array([full[0] - 1, full[1] - 1], np.int32)),
    )
    picture = load_rgbz(path, source=RgbzSource(DepthFormat("distance"), focal_widths=FOCAL))
    np.testing.assert_allclose(picture.layers[0].depth, depth, rtol=1e-5)
    assert picture.full_width == 40


def test_alpha_that_covers_nothing_at_all_is_ignored(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32]
) -> None:
    path = write(tmp_path / "a.exr", {"RGBA": np.dstack([color, 0 * depth]), "Z": depth})
    with pytest.warns(UserWarning, match="alpha is 0 everywhere"):
        assert load_rgbz(path).layers[0].alpha is None
    path = write(tmp_path / "b.exr", {"RGBA": np.dstack([color, 0.5 + 0 * depth]), "Z": depth})
    assert load_rgbz(path).layers[0].alpha is not None
    assert load_rgbz(path, source=RgbzSource(use_alpha=False)).layers[0].alpha is None


def test_depth_from_another_file(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32]
) -> None:
    save_image(tmp_path / "c.exr", color)
    save_image(tmp_path / "c.npy", color)
    np.save(tmp_path / "d.npy", depth)
    save_image(tmp_path / "d.exr", depth)
    save_image(tmp_path / "e.exr", np.repeat(depth[..., None], 3, axis=-1))
    millimetres = np.rint(depth * 1000).astype(np.uint16)
    PIL.Image.fromarray(millimetres).save(tmp_path / "d.png")
    for picture in ("c.exr", "c.npy"):
        for name, scale in (("d.npy", 1.0), ("d.exr", 1.0), ("e.exr", 1.0), ("d.png", 1e-3)):
            source = RgbzSource(DepthFormat(scale=scale))
            (layer,) = load_rgbz(tmp_path / picture, tmp_path / name, source).layers
            np.testing.assert_allclose(layer.depth, depth, atol=0.51 * (scale < 1) * scale)
            np.testing.assert_array_equal(layer.color, color)


def test_files_that_do_not_fit_are_named(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32]
) -> None:
    save_image(tmp_path / "c.exr", color)
    save_image(tmp_path / "c.png", color)
    np.save(tmp_path / "small.npy", depth[:3])
    PIL.Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint8)).save(tmp_path / "eight.png")
    for picture, other, message in (
        ("c.exr", None, r"c.exr: channels: no channel has a name known for depth"),
        ("c.png", None, r"c.png: has no depth"),
        ("c.png", "small.npy", r"small.npy: is 10 x 3 pixels, the picture 10 x 7"),
        ("c.png", "eight.png", r"eight.png: IHDR: expected grey of 16 bits, got 8"),
        ("c.png", "d.tif", r"d.tif: depth comes as"),
        ("none.exr", None, r"none.exr: cannot be read"),
    ):
        with pytest.raises(SampleError, match=message):
            load_rgbz(tmp_path / picture, None if other is None else tmp_path / other)


def test_colours_that_are_not_finite_are_refused(
    tmp_path: Path, color: npt.NDArray[np.float32], depth: npt.NDArray[np.float32]
) -> None:
    color[4, 5, 1] = np.nan
    with pytest.raises(SampleError, match=r"a.exr: colour: 1 values are NaN.*column 5, row 4"):
        load_rgbz(write(tmp_path / "a.exr", {"RGB": color, "Z": depth}))


@pytest.mark.parametrize("keep", [0.3, 0.7, 0.99])
def test_files_that_were_cut_short_are_refused(
    tmp_path: Path,
    color: npt.NDArray[np.float32],
    depth: npt.NDArray[np.float32],
    keep: float,
    capfd: pytest.CaptureFixture[str],
) -> None:
    data = write(tmp_path / "a.exr", {"RGB": color, "Z": depth}).read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(SampleError, match=r"cut.exr: (is damaged|is not a readable)"):
        load_rgbz(tmp_path / "cut.exr")
    capfd.readouterr()  # the library complains on its own as well


@given(data=st.data(), deep=st.booleans())
def test_damaged_files_are_refused_or_read(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, deep: bool
) -> None:
    folder = tmp_path_factory.getbasetemp()
    if deep:
        path = write_deep(folder / "whole.exr", [[[(1.0, 0.1, 0.5), (2.0, 0.2, 1.0)], []]])
    else:
        path = write(
            folder / "whole.exr", {"RGB": np.ones((2, 3, 3), np.float32), "Z": np.ones((2, 3), np.float32)}
        )
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    (folder / "damaged.exr").write_bytes(bytes(content))
    with contextlib.suppress(SampleError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # alpha that damage has made 0
        assert load_rgbz(folder / "damaged.exr").layers


# Deep files.


def write_deep(path: Path, pixels: list[list[list[tuple[float, float, float]]]], depth: str = "Z") -> Path:
    """Write rows of pixels of samples (depth, grey, alpha)."""
    shape = (len(pixels), len(pixels[0]))
    channels: dict[str, Any] = {}
    for number, names in enumerate(((depth,), ("R", "G", "B"), ("A",))):
        plane = np.empty(shape, object)
        for row, line in enumerate(pixels):
            for column, samples in enumerate(line):
                plane[row, column] = np.array([sample[number] for sample in samples], np.float32)
        channels |= dict.fromkeys(names, plane)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


def test_deep_samples_are_sorted_into_layers(tmp_path: Path) -> None:
    glass, leaf, wall = (1.0, 0.1, 0.25), (2.0, 0.5, 1.0), (8.0, 3.0, 1.0)
    path = write_deep(tmp_path / "deep.exr", [[[wall, glass], [wall]], [[], [wall, leaf, glass]]])
    layers = load_rgbz(path).layers
    assert len(layers) == 3
    inf = np.inf
    depth = np.array([[[1, 8], [inf, 1]], [[8, inf], [inf, 2]], [[inf, inf], [inf, 8]]])
    grey = np.array([[[0.1, 3], [0, 0.1]], [[3, 0], [0, 0.5]], [[0, 0], [0, 3]]])
    alpha = np.array([[[0.25, 1], [0, 0.25]], [[1, 0], [0, 1]], [[0, 0], [0, 1]]])
    np.testing.assert_array_equal([layer.depth for layer in layers], depth)
    np.testing.assert_allclose([layer.color[..., 1] for layer in layers], grey)
    np.testing.assert_allclose([layer.alpha for layer in layers if layer.alpha is not None], alpha)


@given(
    samples=st.lists(
        st.tuples(st.floats(0.5, 20), st.floats(0, 2), st.floats(0, 1)).map(
            lambda s: (s[0], s[1] * s[2], s[2])
        ),
        max_size=12,
    ),
    layers=st.integers(1, 5),
)
def test_layers_composite_to_what_the_samples_do(
    tmp_path_factory: pytest.TempPathFactory, samples: list[tuple[float, float, float]], layers: int
) -> None:
    path = write_deep(tmp_path_factory.getbasetemp() / "deep.exr", [[samples, [(3.0, 1.0, 1.0)]]])
    deep = load_deep(path, layers)
    assert len(deep.color) <= layers
    light, clear = 0.0, 1.0
    for _, grey, alpha in sorted(samples):
        light += clear * grey
        clear *= 1 - alpha
    found, left = 0.0, 1.0
    for color, alpha in zip(deep.color[:, 0, 0, 0], deep.alpha[:, 0, 0], strict=True):
        found += left * float(color)
        left *= 1 - float(alpha)
    if len({depth for depth, _, _ in samples}) == len(samples):  # else their order is open
        assert found == pytest.approx(light, abs=1e-5)
    assert left == pytest.approx(clear, abs=1e-5)
    assert (np.diff(deep.depth[:, 0, 0]) > 0)[np.isfinite(deep.depth[1:, 0, 0])].all()


def test_deep_files_of_inverse_depth_are_sorted_the_other_way(tmp_path: Path) -> None:
    path = write_deep(tmp_path / "deep.exr", [[[(0.1, 3.0, 1.0), (0.5, 0.1, 0.5)]]])
    layers = load_rgbz(path, source=RgbzSource(DepthFormat("inverse"))).layers
    np.testing.assert_allclose([layer.depth[0, 0] for layer in layers], [2, 10])


def test_deep_files_that_hold_nothing_are_one_empty_layer(tmp_path: Path) -> None:
    (layer,) = load_rgbz(write_deep(tmp_path / "deep.exr", [[[], []]])).layers
    assert layer.alpha is not None
    assert not layer.alpha.any()
    assert np.isinf(layer.depth).all()
