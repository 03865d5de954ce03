"""The sample buffer format of the 2011 paper (*temporal*), version 1.3, text and binary.

A data file and, beside it, ``<data file>.header``. Every sample is 16 float32, pixel by pixel, row by row
(see `tlfr_header.COLUMNS`): little-endian in binary, one comma-separated line in text. ``w`` is the planar
depth and x, y, u, v, t and the slope coefficients mean what they mean here.

*Motion.* With the ``perspective`` model, mv is the change of ``(x w, y w, w)`` over the shutter: ours. With
the old ``affine`` model a sample keeps its depth and moves by (mv_x, mv_y) pixels, whatever mv_w says: ``x
w`` then changes by ``w mv_x``, ``y w`` by ``w mv_y`` and w by 0. We write ``perspective``.

*What the format cannot say.* A file whose times are all 0 loads with ``time=None`` unless something moves,
and one whose motion is all 0 with ``motion=None``. It does not state the aperture or how the lens was
sampled. It has no column for the bandwidth: samples that have one are refused. Lights are left out, with a
warning. ``a``, ``z/w`` and the depth
gradients are ignored; we write 1, 0 and 0.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.io.files import open_file, replace_files
from fewrays.io.formats import Format, StoredSamples, warn_of_lighting
from fewrays.io.tlfr_header import COLUMNS, MAX_HEADER_BYTES, Header, parse_header
from fewrays.parallel import progress_bar
from fewrays.samples import SampleBuffer

__all__ = ["FORMAT", "load", "save"]

Float32 = npt.NDArray[np.float32]

_SAMPLE_BYTES = 4 * len(COLUMNS)
_LEAST_LINE = 2 * len(COLUMNS)  # bytes of the shortest text line: a digit and a separator per column
_BLOCK = 1 << 18  # samples read or written at a time: 16 MiB in binary
_TEXT_BLOCK = 1 << 22  # bytes of text parsed at a time
_BINARY_EXTENSIONS = (".tlfr", ".bin")


def load(path: Path, progress: bool, *, header: str | Path | None = None) -> StoredSamples:
    """Read a version 1.3 sample buffer.

    Parameters
    ----------
    path : Path
        The data file.
    progress : bool
        Show a progress bar for work over two seconds.
    header : path, optional
        The header file; ``<path>.header`` when omitted. A text file may also start with its header.

    Returns
    -------
    StoredSamples

    Raises
    ------
    SampleError
        For a malformed header, or data whose length or number of values disagrees with it.
    """
    header_path = path.with_name(path.name + ".header") if header is None else Path(header)
    with open_file(path) as (file, length):
        start = file.peek(8)[:8] if hasattr(file, "peek") else b""
        inline = header is None and start == b"Version " and not header_path.exists()
        info = _read_inline_header(file) if inline else _read_header_file(header_path)
        available = length - file.tell()
        if info.encoding == "binary":
            _check_length(available, info)
            blocks = _binary_blocks(file, info.count)
        else:
            _check_text_length(available, info)
            blocks = _text_blocks(file)
        with np.errstate(all="ignore"):
            return _collect(blocks, info, progress)


def save(
    path: Path,
    samples: SampleBuffer,
    overwrite: bool,
    progress: bool,
    *,
    encoding: Literal["text", "binary"] | None = None,
) -> None:
    """Write a version 1.3 sample buffer and its header.

    Parameters
    ----------
    path : Path
        The data file; the header gets the same name with ``.header`` added.
    samples : SampleBuffer
        What to write.
    overwrite : bool
        Whether existing files may be replaced.
    progress : bool
        Show a progress bar for work over two seconds.
    encoding : {"text", "binary"}, optional
        By default text for ``.txt`` and binary otherwise. Text holds the shortest digits that read back
        exactly.

    Raises
    ------
    SampleError
        For another encoding, samples with a bandwidth, or files that cannot be written.
    """
    if encoding is None:
        encoding = "binary" if path.suffix.lower() in _BINARY_EXTENSIONS else "text"
    if encoding not in ("text", "binary"):
        raise SampleError(f"expected 'text' or 'binary', got {encoding!r}", field="encoding")
    if samples.bandwidth is not None:
        raise SampleError(
            "version 1.3 has no column for it; save as .npz or .exr, or leave it out with "
            "dataclasses.replace(samples, bandwidth=None)",
            field="bandwidth",
        )
    warn_of_lighting(samples, path)
    lens = samples.lens
    info = Header(samples.width, samples.height, samples.spp, lens.c0, lens.c1, encoding=encoding)
    header_path = path.with_name(path.name + ".header")
    with (
        replace_files(path, header_path, overwrite=overwrite) as [data_file, header_file],
        data_file.open("wb") as file,
        progress_bar(info.count, "save", show=progress, unit="sample") as bar,
    ):
        header_file.write_bytes(info.format().encode("ascii"))
        for block in _rows(samples):
            file.write(block.tobytes() if encoding == "binary" else _format_text(block))
            bar.update(len(block))


def _read_header_file(path: Path) -> Header:
    with open_file(path) as (file, length):
        if length > MAX_HEADER_BYTES:
            raise SampleError(f"is {length} bytes long; a header has at most {MAX_HEADER_BYTES}")
        return parse_header(_decode(file.read(MAX_HEADER_BYTES)))


def _read_inline_header(file: BinaryIO) -> Header:
    """Read the header that starts a text file, up to the list of columns."""
    text = b""
    for line in iter(lambda: file.readline(MAX_HEADER_BYTES), b""):
        text += line
        if line.count(b",") == len(COLUMNS) - 1 or len(text) > MAX_HEADER_BYTES:
            break
    info = parse_header(_decode(text))
    if info.encoding == "binary":
        raise SampleError("binary samples need a header in a file of their own", field="Encoding")
    return info


def _decode(text: bytes) -> str:
    try:
        return text.decode("ascii")
    except UnicodeDecodeError as error:
        raise SampleError(
            f"byte {text[error.start]:#04x} at {error.start} of the header is not text"
        ) from None


def _check_length(available: int, info: Header) -> None:
    expected = info.count * _SAMPLE_BYTES
    if available != expected:
        raise SampleError(
            f"{info.width} x {info.height} pixels with {info.spp} spp take {expected} bytes, the file has "
            f"{available}",
            field="Width, Height, Samples per pixel",
        )


def _check_text_length(available: int, info: Header) -> None:
    least = info.count * _LEAST_LINE - 1  # the last line may lack its end
    if available < least:
        raise SampleError(
            f"{info.width} x {info.height} pixels with {info.spp} spp take at least {least} bytes of text, "
            f"the file has {available}",
            field="Width, Height, Samples per pixel",
        )


def _binary_blocks(file: BinaryIO, count: int) -> Iterator[Float32]:
    """Yield the samples as ``(n, 16)`` arrays."""
    for start in range(0, count, _BLOCK):
        data = file.read(min(_BLOCK, count - start) * _SAMPLE_BYTES)
        block = np.frombuffer(data, "<f4", len(data) // 4)
        yield block[: len(data) // _SAMPLE_BYTES * len(COLUMNS)].reshape(-1, len(COLUMNS))


def _text_blocks(file: BinaryIO) -> Iterator[Float32]:
    """Yield the samples as ``(n, 16)`` arrays, a few megabytes of text at a time."""
    rest = b""
    line = 0
    while data := file.read(_TEXT_BLOCK):
        complete, end, rest = (rest + data).rpartition(b"\n")
        if len(rest) > _TEXT_BLOCK:
            raise SampleError(f"is longer than {_TEXT_BLOCK} bytes", field=f"sample {line}")
        if complete.strip():
            block = _parse_text(complete + end, line)
            line += len(block)
            yield block
    if rest.strip():
        yield _parse_text(rest + b"\n", line)


def _parse_text(text: bytes, line: int) -> Float32:
    # The authors' own writer ends each line with a comma.
    plain = text.replace(b"\r", b"").replace(b",\n", b"\n")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            block = np.loadtxt(
                BytesIO(plain), np.float32, comments=None, delimiter=",", ndmin=2, encoding="ascii"
            )
    except (ValueError, UserWarning) as error:
        raise SampleError(
            f"is not text of {len(COLUMNS)} numbers: {error}", field=f"samples from {line}"
        ) from None
    if block.shape[1] != len(COLUMNS):
        raise SampleError(f"expected {len(COLUMNS)} numbers, got {block.shape[1]}", field=f"sample {line}")
    return block


def _collect(blocks: Iterator[Float32], info: Header, progress: bool) -> StoredSamples:
    """Sort the columns into arrays, and leave out time and motion when they say nothing."""
    count = info.count
    columns = {
        "xy": (0, 2),
        "depth": (3, 4),
        "uv": (4, 6),
        "time": (6, 7),
        "color": (7, 10),
        "motion": (11, 14),
    }
    # Zeros rather than empty: pages that nothing is written to cost no memory.
    arrays = {name: np.zeros((count, last - first), np.float32) for name, (first, last) in columns.items()}
    done = 0
    timed = moving = False
    with progress_bar(count, "load", show=progress, unit="sample") as bar:
        for block in blocks:
            stop = done + len(block)
            if stop > count:
                raise SampleError(f"the header says {count} samples, the file has more", field="samples")
            moves, times = bool(_bits(block[:, 11:14]).any()), bool(_bits(block[:, 6]).any())
            timed, moving = timed or times, moving or moves
            skipped = {"time": not times, "motion": not moves}
            for name, (first, last) in columns.items():
                if not skipped.get(name, False):
                    arrays[name][done:stop] = block[:, first:last]
            bar.update(len(block))
            done = stop
    if done != count:
        raise SampleError(f"the header says {count} samples, the file has {done}", field="samples")
    if moving and info.motion_model == "affine":
        arrays["motion"][:, :2] *= arrays["depth"]
        arrays["motion"][:, 2] = 0
    left_out = {"time": not (timed or moving), "motion": not moving}
    return _shaped({name: array for name, array in arrays.items() if not left_out.get(name, False)}, info)


def _shaped(arrays: dict[str, Float32], info: Header) -> StoredSamples:
    """Give flat ``(n, channels)`` arrays the shapes of a `SampleBuffer`."""
    grid = (info.height, info.width, info.spp)
    shaped = {n: a.reshape(grid if a.shape[1] == 1 else (*grid, a.shape[1])) for n, a in arrays.items()}
    return StoredSamples(shaped, {"c0": info.c0, "c1": info.c1})


def _rows(samples: SampleBuffer) -> Iterator[Float32]:
    """Yield the samples as ``(n, 16)`` arrays in the order of the file."""
    count = samples.depth.size
    flat = {name: getattr(samples, name).reshape(count, -1) for name in samples.field_names()}
    places = {"xy": slice(0, 2), "depth": slice(3, 4), "uv": slice(4, 6), "time": slice(6, 7)}
    places |= {"color": slice(7, 10), "motion": slice(11, 14)}
    for start in range(0, count, _BLOCK):
        stop = min(start + _BLOCK, count)
        block = np.zeros((stop - start, len(COLUMNS)), "<f4")
        block[:, COLUMNS.index("a")] = 1
        for name, array in flat.items():
            block[:, places[name]] = array[start:stop]
        yield block


def _format_text(block: Float32) -> bytes:
    """Format samples as lines of the shortest digits that read back as the same float32."""
    columns = [
        [str(column[0])] * len(column) if np.ptp(_bits(column)) == 0 else column.astype("U").tolist()
        for column in block.T
    ]
    return "".join(",".join(values) + "\n" for values in zip(*columns, strict=True)).encode("ascii")


def _bits(values: Float32) -> npt.NDArray[np.uint32]:
    """Return the bits of float32 values, which tell -0 from 0."""
    return values.view(np.uint32)


FORMAT = Format(
    "version 1.3",
    (*_BINARY_EXTENSIONS, ".txt"),
    load,
    save,
    load_options=("header",),
    save_options=("encoding",),
)
