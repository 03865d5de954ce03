"""Files of planes: what is read is what was written, and damaged ones are refused."""

from __future__ import annotations

import itertools
import json
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from buffers import random_buffer
from fewrays import Lens, Multiplane, SampleError, _native
from fewrays.multiplane import files
from fewrays.multiplane.maps import Grid, Maps, Shear

MEMORY = 96 << 20  # bytes that a damaged file of 87 kB may take: what as many deflated bytes can hold
MAGIC = b"FEWRAYS-PLANES\r\n"
TABLES = ("slope", "motion", "scale", "cells", "corner", "shape")
STEPS = (8, 16, 8, 4, 8, 8)  # bytes of a plane in each


@pytest.fixture(scope="module")
def planes() -> Multiplane:
    """Planes of 1 and 3 cells per pixel, some of whose blocks have neighbours, and some moving."""
    samples = random_buffer(9, 40, 1, Lens(-40.0, 8.0, "gaussian", "square", 0.4), seed=1)
    motion = np.zeros((*samples.depth.shape, 3), np.float32)
    motion[..., 0] = np.where(samples.depth < np.median(samples.depth), 9 * samples.depth, 0)
    samples = replace(samples, time=np.full(samples.depth.shape, 0.25, np.float32), motion=motion)
    return Multiplane.build(samples, threads=1, thickness=4.0, motion_cell=8.0, fine_to=3.0, memory=0.2)


class Written(bytes):
    """A file's content, which test reports shall not show."""

    def __repr__(self) -> str:
        return f"<{len(self)} bytes>"


@pytest.fixture(scope="module")
def written(planes: Multiplane, tmp_path_factory: pytest.TempPathFactory) -> Written:
    path = tmp_path_factory.mktemp("planes") / "a.planes"
    planes.save(path)
    return Written(path.read_bytes())


def assert_same(actual: Maps, expected: Maps) -> None:
    for name in ("height", "width", "lens"):
        assert getattr(actual, name) == getattr(expected, name), name
    for part, names in (("shear", TABLES[:2]), ("grid", TABLES[3:])):
        for name in names:
            array, other = getattr(getattr(actual, part), name), getattr(getattr(expected, part), name)
            assert array.dtype == other.dtype, name
            np.testing.assert_array_equal(array, other, name)
    np.testing.assert_array_equal(actual.scale, expected.scale)
    assert actual.slots.dtype == np.int32
    assert actual.halves.dtype == np.uint16
    np.testing.assert_array_equal(actual.slots, expected.slots)
    np.testing.assert_array_equal(actual.halves, expected.halves)


class TestRoundTrip:
    def test_every_bit(self, planes: Multiplane, tmp_path: Path) -> None:
        assert set(planes.maps.grid.cells) == {1, 3}
        assert planes.maps.shear.motion.any()
        planes.save(tmp_path / "a.planes")
        loaded = Multiplane.load(tmp_path / "a.planes")
        assert_same(loaded.maps, planes.maps)
        lens = planes.lens.refocus(3.0)
        np.testing.assert_array_equal(
            loaded.render(lens, views=8, threads=1), planes.render(lens, views=8, threads=1)
        )

    @settings(max_examples=15)
    @given(
        seed=st.integers(0, 999),
        cells=st.lists(st.integers(1, 3), min_size=1, max_size=3),
        share=st.floats(0, 1),
    )
    def test_any_blocks(
        self, seed: int, cells: list[int], share: float, tmp_path_factory: pytest.TempPathFactory
    ) -> None:
        """Whatever bits they hold, and whichever of them there are."""
        rng = np.random.default_rng(seed)
        count = len(cells)
        shear = Shear(np.sort(rng.normal(size=count)), rng.normal(size=(count, 2)))
        shape = rng.integers(1, 5, (count, 2)).astype(np.int32)
        grid = Grid(np.array(cells, np.int32), rng.integers(-99, 9, (count, 2)).astype(np.int32), shape)
        kept = rng.random(grid.slot_count) < share
        units = np.repeat(grid.cells.astype(np.int64) ** 2, shape.prod(axis=1)) * kept
        slots = np.where(kept, np.cumsum(units) - units, -1).astype(np.int32)
        halves = np.zeros(units.sum() * _native.UNIT_HALVES + 2 * _native.HALF_PADDING, np.uint16)
        for slot, size in zip(slots[kept], units[kept], strict=True):
            begin = _native.HALF_PADDING + slot * _native.UNIT_HALVES
            own = halves[begin : begin + size * _native.UNIT_HALVES].reshape(4, -1)
            own[0] = rng.integers(0, 0x3C01, own[0].shape)
            own[1:] = rng.integers(0, 0x7C00, own[1:].shape) | rng.integers(0, 2, own[1:].shape) << 15
        scale = np.ldexp(1.0, rng.integers(-99, 99, count))
        maps = Maps(7, 5, Lens(-1.0, 0.3), shear, grid, slots, halves, scale)
        path = tmp_path_factory.mktemp("planes") / "a.planes"
        files.save_maps(path, maps)
        assert_same(files.load_maps(path), maps)

    def test_a_second_file_is_the_same(self, planes: Multiplane, written: bytes, tmp_path: Path) -> None:
        planes.save(tmp_path / "b.planes")
        assert (tmp_path / "b.planes").read_bytes() == written

    def test_memory_beside_the_planes(self, tmp_path: Path) -> None:
        samples = random_buffer(200, 300, 1, Lens(-40.0, 8.0))
        planes = Multiplane.build(samples, threads=1, fine_to=60.0)
        assert planes.nbytes > 25e6
        tracemalloc.start()
        planes.save(tmp_path / "a.planes")
        assert tracemalloc.get_traced_memory()[1] < 12e6
        tracemalloc.reset_peak()
        Multiplane.load(tmp_path / "a.planes")
        assert tracemalloc.get_traced_memory()[1] < planes.nbytes + 12e6
        tracemalloc.stop()

    def test_is_compact(self, planes: Multiplane, written: bytes) -> None:
        """Smaller than the plain numbers deflated."""
        assert len(written) < 0.85 * len(zlib.compress(planes.maps.halves.tobytes(), 6))


def parts_of(written: bytes) -> tuple[dict[str, Any], bytearray]:
    """Return the description of a file and what its stream holds."""
    length = struct.unpack_from("<I", written, 20)[0]
    description: dict[str, Any] = json.loads(written[24 : 24 + length])
    return description, bytearray(zlib.decompress(written[24 + length :]))


def file_of(description: Any, stream: bytes | bytearray, version: int = 2) -> bytes:
    text = json.dumps(description).encode()
    return MAGIC + struct.pack("<II", version, len(text)) + text + zlib.compress(bytes(stream), 1)


def decoded(written: bytes) -> list[tuple[int, dict[tuple[int, int], npt.NDArray[np.uint16]]]]:
    """Read a file as ``docs/formats.md`` describes it, number by number.

    Of each plane the cells per pixel n, and the bits (4, 9n, 33n) of its blocks by row and column.
    """
    description, stream = parts_of(written)
    tables, at = {}, 0
    for name, step in zip(TABLES, STEPS, strict=True):
        kind = "<i4" if name in ("cells", "corner", "shape") else "<f8"
        tables[name] = np.frombuffer(stream, kind, step // int(kind[2]) * description["planes"], at)
        at += step * description["planes"]
    shapes = tables["shape"].reshape(-1, 2)
    count = int(shapes.prod(axis=1).sum())
    bits = "".join(f"{byte:08b}" for byte in stream[at : at + (count + 7) // 8])
    at += (count + 7) // 8
    first, planes = 0, []
    for n, (columns, rows) in zip(tables["cells"].tolist(), shapes.tolist(), strict=True):
        places = [(k // columns, k % columns) for k in range(rows * columns) if bits[first + k] == "1"]
        first += rows * columns
        blocks = {place: np.zeros((4, 9 * n, 33 * n), np.uint16) for place in places}
        for begin in range(0, len(places), 64):
            run = places[begin : begin + 64]
            size = len(run) * 4 * 9 * n * 33 * n
            upper, lower = (stream[at + k * size : at + (k + 1) * size] for k in (0, 1))
            at += 2 * size
            numbers = (256 * u + v for u, v in zip(upper, lower, strict=True))
            for place in run:
                for cells in blocks[place]:
                    for i, j in np.ndindex(8 * n, 32 * n):
                        before = cells[i, j - 1] if j else cells[i - 1, 0] if i else 0
                        cells[i, j] = (next(numbers) + int(before)) % 2**16
            for last in ((8, 1), (1, 32), (1, 1)):  # columns, rows, corners
                for place, channel, b, a, i, j in itertools.product(
                    run, range(4), range(n), range(n), range(last[0]), range(last[1])
                ):
                    row, column = (i if last[0] > 1 else 8) * n + b, (j if last[1] > 1 else 32) * n + a
                    blocks[place][channel, row, column] = next(numbers)
        edges = {
            (0, 1): np.s_[:, : 8 * n, 32 * n :],
            (1, 0): np.s_[:, 8 * n :, : 32 * n],
            (1, 1): np.s_[:, 8 * n :, 32 * n :],
        }
        for ((row, column), cells), ((below, right), edge) in itertools.product(
            blocks.items(), edges.items()
        ):
            beside = blocks.get((row + below, column + right))
            if beside is not None:
                _, height, width = cells[edge].shape
                cells[edge] += beside[:, :height, :width]
        planes.append((n, blocks))
    assert at == len(stream)
    return planes


def test_files_are_as_documented(planes: Multiplane, written: bytes) -> None:
    maps = planes.maps
    slots = iter(maps.slots)
    shapes = maps.grid.shape.tolist()
    for (n, blocks), (columns, rows) in zip(decoded(written), shapes, strict=True):
        for place in np.ndindex(rows, columns):
            slot = int(next(slots))
            assert (slot >= 0) == (place in blocks)
            if slot >= 0:
                begin = _native.HALF_PADDING + slot * _native.UNIT_HALVES
                stored = maps.halves[begin : begin + n * n * _native.UNIT_HALVES].reshape(4, n, n, 9, 33)
                for b, a in np.ndindex(n, n):
                    np.testing.assert_array_equal(blocks[place][:, b::n, a::n], stored[:, b, a])


class TestWriting:
    def test_a_failed_save_leaves_the_old_file_and_nothing_else(
        self, planes: Multiplane, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "a.planes"
        path.write_bytes(b"old")

        def fail(*_: object) -> bytes:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(files, "_encode", fail)
        with pytest.raises(SampleError, match="No space left") as caught:
            planes.save(path)
        assert caught.value.file == str(path)
        assert [file.name for file in tmp_path.iterdir()] == ["a.planes"]
        assert path.read_bytes() == b"old"

    def test_what_could_not_be_read_is_not_written(self, planes: Multiplane, tmp_path: Path) -> None:
        shear = replace(planes.maps.shear, slope=planes.maps.shear.slope * 1e9)
        with pytest.raises(SampleError, match="slope"):
            Multiplane(replace(planes.maps, shear=shear)).save(tmp_path / "a.planes")
        assert not list(tmp_path.iterdir())

    def test_no_directory(self, planes: Multiplane, tmp_path: Path) -> None:
        with pytest.raises(SampleError, match="no directory"):
            planes.save(tmp_path / "nowhere" / "a.planes")


def load(path: Path, data: bytes | bytearray) -> Multiplane | SampleError:
    """Load `data` from a file: planes, or one line that says what is wrong, in little memory."""
    path.write_bytes(data)
    tracemalloc.start()
    try:
        return Multiplane.load(path)
    except SampleError as error:
        assert error.file == str(path)
        assert "\n" not in str(error)
        return error
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MEMORY


def refused(path: Path, data: bytes) -> SampleError:
    """Load `data`, which must be refused."""
    result = load(path, data)
    assert isinstance(result, SampleError)
    return result


PLACES = st.tuples(st.integers(0, 2**20), st.sampled_from([300, 2**20]))
"""A number, and how far into the file it may point: the tables and what describes them are in front."""


def index_of(place: tuple[int, int], length: int) -> int:
    number, most = place
    return number % min(most, length)


class TestHostileFiles:
    def test_this_test_can_write_files(self, written: bytes, planes: Multiplane, tmp_path: Path) -> None:
        loaded = load(tmp_path / "a.planes", file_of(*parts_of(written)))
        assert isinstance(loaded, Multiplane)
        assert_same(loaded.maps, planes.maps)

    @settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(place=PLACES)
    def test_truncated(self, written: bytes, tmp_path: Path, place: tuple[int, int]) -> None:
        refused(tmp_path / "a.planes", written[: index_of(place, len(written))])

    @settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(place=PLACES, flip=st.integers(1, 255))
    def test_flipped_bytes(
        self, written: bytes, planes: Multiplane, tmp_path: Path, place: tuple[int, int], flip: int
    ) -> None:
        """Refused, unless zlib does not use that bit, or another legal description comes of it."""
        index = index_of(place, len(written))
        flipped = bytearray(written)
        flipped[index] ^= flip
        loaded = load(tmp_path / "a.planes", flipped)
        if isinstance(loaded, Multiplane):
            if 24 <= index < 24 + struct.unpack_from("<I", written, 20)[0]:
                np.testing.assert_array_equal(loaded.maps.halves, planes.maps.halves)
            else:
                assert_same(loaded.maps, planes.maps)

    @settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(changes=st.lists(st.tuples(PLACES, st.integers(0, 255)), min_size=1, max_size=3))
    def test_tampered_streams(
        self, written: bytes, tmp_path: Path, changes: list[tuple[tuple[int, int], int]]
    ) -> None:
        """With checksums that are right: what is accepted can be rendered."""
        description, stream = parts_of(written)
        for place, value in changes:
            stream[index_of(place, len(stream))] = value
        loaded = load(tmp_path / "a.planes", file_of(description, stream))
        if isinstance(loaded, Multiplane):
            assert np.isfinite(loaded.render(views=2, threads=1)).all()
        else:
            assert loaded.field in (*TABLES, "kept", "blocks"), loaded

    @pytest.mark.parametrize(
        ("change", "field"),
        [
            ({"height": 0}, "description"),
            ({"width": 2**17}, "description"),
            ({"width": True}, "width"),
            ({"height": 2.5}, "height"),
            ({"planes": 0}, "planes"),
            ({"planes": 2**15}, "planes"),
            ({"planes": 32767}, "slope"),
            ({"planes": "1"}, "planes"),
            ({"lens": None}, "lens"),
            ({"lens": {"c0": -1.0}}, "lens"),
            ({"extra": 1}, "description"),
            ({"lens": {name: [] for name in ("c0", "c1", "aperture", "sampling", "sigma")}}, "lens.c0"),
        ],
    )
    def test_descriptions(self, written: bytes, tmp_path: Path, change: dict[str, Any], field: str) -> None:
        description, stream = parts_of(written)
        error = refused(tmp_path / "a.planes", file_of(description | change, stream))
        assert error.field == field

    @pytest.mark.parametrize(
        ("table", "value", "kind"),
        [
            ("slope", float("nan"), "<d"),
            ("slope", float("inf"), "<d"),
            ("slope", 1e30, "<d"),
            ("motion", float("-inf"), "<d"),
            ("scale", 0.0, "<d"),
            ("scale", float("nan"), "<d"),
            ("scale", float("inf"), "<d"),
            ("scale", 1e300, "<d"),
            ("cells", 0, "<i"),
            ("cells", 4, "<i"),
            ("cells", -1, "<i"),
            ("corner", -(2**31), "<i"),
            ("corner", 2**23, "<i"),
            ("shape", 0, "<i"),
            ("shape", -3, "<i"),
            ("shape", 2**31 - 1, "<i"),
        ],
    )
    def test_tables(self, written: bytes, tmp_path: Path, table: str, value: float, kind: str) -> None:
        description, stream = parts_of(written)
        index = TABLES.index(table)
        struct.pack_into(kind, stream, sum(STEPS[:index]) * description["planes"], value)
        assert refused(tmp_path / "a.planes", file_of(description, stream)).field == table

    def test_slopes_out_of_order(self, written: bytes, tmp_path: Path) -> None:
        description, stream = parts_of(written)
        struct.pack_into("<d", stream, 8, -4e6)
        assert refused(tmp_path / "a.planes", file_of(description, stream)).field == "slope"

    def test_more_places_than_the_file_can_speak_of(self, written: bytes, tmp_path: Path) -> None:
        description, stream = parts_of(written)
        shape = sum(STEPS[:5]) * description["planes"]
        struct.pack_into("<ii", stream, shape, 2**13, 2**14)
        assert refused(tmp_path / "a.planes", file_of(description, stream)).field == "kept"
        struct.pack_into("<ii", stream, shape, 2**17, 2**19)
        assert refused(tmp_path / "a.planes", file_of(description, stream)).field == "shape"

    @pytest.mark.parametrize("more", [True, False])
    def test_another_number_of_blocks(self, written: bytes, tmp_path: Path, more: bool) -> None:
        description, stream = parts_of(written)
        first = sum(STEPS) * description["planes"]
        byte = next(i for i in range(first, len(stream)) if 0 < stream[i] < 255)
        lowest = stream[byte] & -stream[byte]
        stream[byte] = 255 if more else stream[byte] ^ lowest
        assert refused(tmp_path / "a.planes", file_of(description, stream)).field == "blocks"

    @pytest.mark.parametrize("bits", [0x3C01, 0x7C00, 0x7E00, 0x8001, 0xFFFF])
    @pytest.mark.parametrize("channel", [0, 1, 3])
    def test_bits_that_are_no_opacity_or_radiance(
        self, planes: Multiplane, tmp_path: Path, bits: int, channel: int
    ) -> None:
        halves = planes.maps.halves.copy()
        cells = int(planes.maps.grid.cells[0])
        begin = _native.HALF_PADDING + channel * cells**2 * _native.UNIT_HALVES // 4
        halves[begin + 5] = bits
        path = tmp_path / "a.planes"
        Multiplane(replace(planes.maps, halves=halves)).save(path)
        if channel and bits & 0x7FFF < 0x7C00:
            assert Multiplane.load(path).maps.halves[begin + 5] == bits
        else:
            with pytest.raises(SampleError) as caught:
                Multiplane.load(path)
            assert caught.value.field == "blocks"

    def test_version_and_kind(self, written: bytes, tmp_path: Path) -> None:
        path = tmp_path / "a.planes"
        assert refused(path, file_of(*parts_of(written), version=1)).field == "version"
        make: list[Callable[[], bytes]] = [
            lambda: b"",
            lambda: b"\0" * 4000,
            lambda: b"PK\3\4" + written,
            lambda: written.replace(b"\r\n", b"\n", 1),
            lambda: MAGIC + struct.pack("<II", 2, 2**32 - 1) + written,
            lambda: MAGIC + struct.pack("<II", 2, 4000) + b"[" * 4000,
            lambda: MAGIC + struct.pack("<II", 2, 4) + b"null" + zlib.compress(b""),
            lambda: MAGIC + struct.pack("<II", 2, 4) + b"\xff\xff\xff\xff",
            lambda: written + b"\0",
        ]
        for data in make:
            refused(path, data())

    def test_what_is_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(SampleError, match="No such file"):
            Multiplane.load(tmp_path / "a.planes")
        with pytest.raises(SampleError, match="not a regular file"):
            Multiplane.load(tmp_path)
        with pytest.raises(SampleError, match="expected a path"):
            Multiplane.load(None)  # type: ignore[arg-type]
