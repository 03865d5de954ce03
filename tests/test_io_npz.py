"""The native format: readable with NumPy alone, never pickled, never larger in memory than it can be."""

from __future__ import annotations

import dataclasses
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
from fewrays.lighting import Lighting, LightSamples
from fewrays.samples import OFF_IMAGE, SampleBuffer
from lit_buffers import LIGHTS, lit_buffer

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


class TestLighting:
    """Area lights: members named as the fields are."""

    def stored(self, path: Path) -> dict[str, Any]:
        """Write a buffer with two lights and return its members."""
        save(path, lit_buffer(SHAPE))
        with np.load(path, allow_pickle=False) as file:
            return dict(file)

    @pytest.mark.parametrize("options", [{}, {"compressed": True}, {"half": True}])
    @pytest.mark.parametrize("moving", [False, True])
    def test_everything_comes_back(self, tmp_path: Path, options: dict[str, Any], moving: bool) -> None:
        samples = lit_buffer(SHAPE, moving=moving)
        save(tmp_path / "a.npz", samples, **options)
        after, before = load(tmp_path / "a.npz").lighting, samples.lighting
        assert after is not None
        assert before is not None
        assert after.projection == before.projection
        assert [each.light for each in after.lights] == list(LIGHTS)
        pairs: list[tuple[Lighting | LightSamples, Lighting | LightSamples]] = [(after, before)]
        pairs += zip(after.lights, before.lights, strict=True)
        for new, old in pairs:
            assert new.field_names() == old.field_names()
            for name in new.field_names():
                assert getattr(new, name).dtype == np.float32
                np.testing.assert_array_equal(getattr(new, name), getattr(old, name))

    def test_numpy_reads_the_members_that_are_documented(self, tmp_path: Path) -> None:
        stored = self.stored(tmp_path / "a.npz")
        for member in (
            *("lighting.projection.focal", "lighting.projection.center"),
            *("lighting.normal", "lighting.depth_gradient", "lighting.unlit"),
            *("light1.lxy", "light1.luv", "light1.depth", "light1.radiance", "light1.density"),
            *("light1.reflectance", "light1.motion", "light1.light.center", "light1.light.half_u"),
            *("light1.light.half_v", "light1.light.motion", "light1.light.plane_distance"),
        ):
            assert stored[member].dtype.kind == "f", member
        assert stored["light1.light.shape"] == "disc"
        assert "light2.lxy" not in stored
        documented = (Path(__file__).parents[1] / "docs" / "formats.md").read_text("utf-8")
        kinds = {name.replace("light1", "light0") for name in stored if not name.startswith("light0.")}
        assert [name for name in kinds if f"`{name}`" not in documented] == []

    def test_defaults_may_be_missing(self, tmp_path: Path) -> None:
        stored = self.stored(tmp_path / "a.npz")
        for name in (
            "light0.light.shape",
            "light0.light.motion",
            "light0.light.plane_distance",
            "light1.motion",
        ):
            del stored[name]
        np.savez(tmp_path / "b.npz", **stored)
        lighting = load(tmp_path / "b.npz").lighting
        assert lighting is not None
        light = lighting.lights[0].light
        assert (light.shape, light.motion, light.plane_distance) == ("rectangle", (0, 0, 0), 1)
        assert lighting.lights[1].motion is None

    @pytest.mark.parametrize(
        ("changed", "field", "words"),
        [
            ({"lighting.normal": None}, "lighting.normal", "is missing"),
            ({"lighting.projection.focal": None}, "lighting.projection.focal", "is missing"),
            ({"lighting.projection.focal": np.ones(3)}, "lighting.projection.focal", "2 numbers"),
            ({"lighting.projection.focal": -np.ones(2)}, "lighting.projection.focal", "positive"),
            ({"lighting.projection.center": "here"}, "lighting.projection.center", "2 numbers"),
            ({"lighting.normal": np.ones((*SHAPE, 3))}, "lighting.normal", "length"),
            ({"lighting.normal": np.ones((*SHAPE, 2))}, "lighting.normal", "(H, W, S, 3)"),
            ({"lighting.unlit": np.ones((1, 3, 4, 3))}, "lighting.unlit", "(2, 3, 4, 3)"),
            ({"lighting.unlit": np.ones((*SHAPE, 3), int)}, "lighting.unlit", "int64"),
            ({"light0.lxy": None}, "light0.lxy", "is missing"),
            ({"light0.lxy": np.full((*SHAPE, 2), np.nan)}, "light0.lxy", "NaN"),
            ({"light1.depth": np.zeros(SHAPE)}, "light1.depth", "positive"),
            ({"light1.motion": np.ones(SHAPE)}, "light1.motion", "(H, W, S, 3)"),
            ({"light1.luv": np.full((*SHAPE, 2), 2.0)}, "light1.luv", "2.0"),
            ({"light0.light.half_u": np.zeros(3)}, "light0.light.half_u", "length"),
            ({"light0.light.center": np.ones(2)}, "light0.light.center", "3 numbers"),
            ({"light0.light.center": np.full(3, np.nan)}, "light0.light.center", "finite"),
            ({"light1.light.shape": "hexagon"}, "light1.light.shape", "'hexagon'"),
            ({"light1.light.shape": 3}, "light1.light.shape", "a text"),
            ({"light1.light.plane_distance": 0.0}, "light1.light.plane_distance", "positive"),
            ({"light3.lxy": np.ones((*SHAPE, 2))}, "light2", "numbered from 0"),
            ({f"light{n}.depth": np.ones(SHAPE) for n in range(70)}, "lighting", "70 lights"),
            ({"time": None}, "lighting", "give time"),
        ],
    )
    def test_a_wrong_member_is_named(
        self, tmp_path: Path, changed: dict[str, Any], field: str, words: str
    ) -> None:
        stored = self.stored(tmp_path / "a.npz")
        both = {name: value for name, value in (stored | changed).items() if value is not None}
        np.savez(tmp_path / "b.npz", **both)
        with pytest.raises(SampleError) as caught:
            load(tmp_path / "b.npz")
        assert (caught.value.file, caught.value.field) == (str(tmp_path / "b.npz"), field)
        assert words in caught.value.problem

    def test_lighting_without_lights_is_none(self, tmp_path: Path) -> None:
        stored = self.stored(tmp_path / "a.npz")
        kept = {name: value for name, value in stored.items() if not name.startswith(("light0.", "light1."))}
        np.savez(tmp_path / "b.npz", **kept)
        with pytest.raises(SampleError, match="1 to 64 lights, got 0") as caught:
            load(tmp_path / "b.npz")
        assert caught.value.field == "lighting.lights"

    @pytest.mark.parametrize(
        ("name", "data", "words"),
        [
            ("light0.depth", raw_npy((60_000, 30_000, 1), b"abcd"), "takes 7200000000 bytes"),
            ("light1.radiance", raw_npy((2**40, 2**40, 2**40, 3), b""), "over the cap"),
            ("lighting.normal", raw_npy((2, -3, 4, 3), b""), "shape"),
            ("light0.light.center", raw_npy((3,), b"", "<f8"), "takes 24 bytes, the member has 0"),
            ("light0.light.center", raw_npy((2**40,), b"", "<f8"), "expected 3 numbers"),
            ("light0.light.shape", raw_npy((), b"", "<U1000000"), "expected a text"),
        ],
    )
    def test_claimed_sizes_are_checked_first(
        self, tmp_path: Path, name: str, data: bytes, words: str
    ) -> None:
        stored = self.stored(tmp_path / "a.npz")
        del stored[name]
        np.savez(tmp_path / "b.npz", **stored)
        with zipfile.ZipFile(tmp_path / "b.npz", "a") as archive:
            archive.writestr(f"{name}.npy", data)
        tracemalloc.start()
        with pytest.raises(SampleError, match=words) as caught:
            load(tmp_path / "b.npz")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
        tracemalloc.stop()
        assert caught.value.field == name

    @pytest.mark.parametrize("member", ["light1.radiance", "lighting.unlit", "color"])
    def test_dropping_reaches_all_that_belongs_together(self, tmp_path: Path, member: str) -> None:
        stored = self.stored(tmp_path / "a.npz")
        stored[member][1, 2, 0, 1] = np.nan
        np.savez(tmp_path / "b.npz", **stored)
        with pytest.warns(UserWarning, match="dropped 1 of 24 "):
            loaded = load(tmp_path / "b.npz", nan="drop")
        assert loaded.lighting is not None
        gone = np.zeros(SHAPE, bool)
        gone[1, 2, 0] = True
        np.testing.assert_array_equal(loaded.lighting.dropped(), gone)
        np.testing.assert_array_equal(loaded.xy[..., 0] == OFF_IMAGE, gone)
        np.testing.assert_allclose(loaded.lighting.color(loaded), loaded.color, rtol=1e-6)

    @pytest.mark.parametrize("name", ["a.tlfr", "a.bin", "a.txt", "a.exr"])
    def test_formats_without_lights_say_so(self, tmp_path: Path, name: str) -> None:
        samples = lit_buffer(SHAPE)
        with pytest.warns(UserWarning, match=r"not written.*save as \.npz") as caught:
            save(tmp_path / name, samples)
        assert caught[0].filename == __file__
        loaded = load(tmp_path / name, sampling="square")
        assert loaded.lighting is None
        np.testing.assert_array_equal(loaded.color, samples.color)
        save(tmp_path / name, dataclasses.replace(samples, lighting=None))  # asked for: no warning
