"""Samples as deep scan-line OpenEXR, for exchange with compositing packages.

Channels, float32: ``R``, ``G``, ``B``, ``A`` (1), ``Z`` (planar depth), ``position.x``, ``position.y``
(pixels), ``lens.u``, ``lens.v``, and optionally ``time``, ``motion.x``, ``motion.y``, ``motion.w`` and
``lens.bandwidth`` (infinite where the surface is matte). The lens is in the attributes ``fewrays/c0``,
``fewrays/c1``, ``fewrays/sigma`` (double), ``fewrays/aperture`` and ``fewrays/sampling`` (string); OpenEXR's
own ``focus`` repeats the focus distance, in scene units, for others.

Deep files of others hold a varying number of samples in their pixels. The missing ones are filled in and
parked off the image, where they contribute to nothing.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.io.exr_chunks import DEEP_COMPRESSIONS, DeepChunk, pack_chunk, read_chunk
from fewrays.io.exr_header import COMPRESSIONS, Channel, ExrHeader, format_header, read_header, read_offsets
from fewrays.io.files import open_file, replace_files
from fewrays.io.formats import Format, StoredSamples, check_size, warn_of_lighting
from fewrays.parallel import progress_bar
from fewrays.samples import OFF_IMAGE, SampleBuffer

__all__ = ["FORMAT", "load", "save"]

_CHANNELS = {
    "xy": ("position.x", "position.y"),
    "uv": ("lens.u", "lens.v"),
    "depth": ("Z",),
    "color": ("R", "G", "B"),
    "time": ("time",),
    "motion": ("motion.x", "motion.y", "motion.w"),
    "bandwidth": ("lens.bandwidth",),
}
_OPTIONAL = ("time", "motion", "bandwidth")
_PADDING = {"xy": OFF_IMAGE, "depth": 1.0, "bandwidth": 1.0}
_VERSION = 1
_OPAQUE = 1e-3  # largest distance of A from 1: a half float's rounding
_MOST_PADDING = 16  # times the file's own samples, above _SMALL
_SMALL = 1 << 20


def load(path: Path, progress: bool) -> StoredSamples:
    """Read a deep scan-line OpenEXR file.

    Parameters
    ----------
    path : Path
        The file. Compressed with ZIPS or RLE, or not at all; one part.
    progress : bool
        Show a progress bar for work over two seconds.

    Returns
    -------
    StoredSamples
        As many samples per pixel as the fullest pixel has.

    Raises
    ------
    SampleError
        For a missing channel or lens coefficient, samples that are not opaque, or a file whose parts
        disagree.
    """
    with open_file(path) as (file, length):
        header = read_header(file, length)
        if not header.deep:
            raise SampleError(
                "is a flat image; samples need a deep file (load_image reads flat ones)", field="type"
            )
        if header.compression >= len(DEEP_COMPRESSIONS):
            name = COMPRESSIONS[header.compression]
            raise SampleError(f"deep data cannot be {name}; save with ZIPS", field="compression")
        names = _wanted(header)
        lens = _lens(header)
        chunks = _chunks(file, header, length)
        spp = _samples_per_pixel(header, chunks)
        arrays = {
            name: np.full(
                (header.height, header.width, spp, len(names[name])), _PADDING.get(name, 0.0), np.float32
            )
            for name in names
        }
        with progress_bar(header.height, "load", show=progress, unit="line") as bar:
            for chunk in chunks:
                values = _split(chunk.read(file, header.compression), header, chunk)
                _check_opaque(values, chunk)
                row = chunk.y - header.origin[1]
                filled = np.arange(spp) < chunk.counts[:, None]
                for name, array in arrays.items():
                    for component, channel in enumerate(names[name]):
                        array[row, ..., component][filled] = values[channel]
                bar.update()
    _to_image_origin(arrays["xy"], header)
    return StoredSamples({n: a[..., 0] if a.shape[-1] == 1 else a for n, a in arrays.items()}, lens)


def save(
    path: Path,
    samples: SampleBuffer,
    overwrite: bool,
    progress: bool,
    *,
    compression: Literal["zips", "none"] = "zips",
) -> None:
    """Write a deep scan-line OpenEXR file.

    Parameters
    ----------
    path : Path
        The file.
    samples : SampleBuffer
        What to write.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : bool
        Show a progress bar for work over two seconds.
    compression : {"zips", "none"}
        Lossless either way; ``"none"`` is several times faster and larger.

    Raises
    ------
    SampleError
        For another compression, or a file that cannot be written.
    """
    if compression not in ("zips", "none"):
        raise SampleError(f"expected 'zips' or 'none', got {compression!r}", field="compression")
    warn_of_lighting(samples, path)
    header = _header(samples, DEEP_COMPRESSIONS.index(compression))
    sources = _sources(samples)
    counts = np.full(samples.width, samples.spp, np.int64)
    offsets = []
    with (
        replace_files(path, overwrite=overwrite) as [temporary],
        temporary.open("wb") as file,
        progress_bar(samples.height, "save", show=progress, unit="line") as bar,
    ):
        file.write(format_header(header))
        table = file.tell()
        file.write(bytes(8 * samples.height))
        for y in range(samples.height):
            offsets.append(file.tell())
            data = b"".join(sources[channel.name][y].astype("<f4").tobytes() for channel in header.channels)
            file.write(pack_chunk(y, counts, data, header.compression))
            bar.update()
        file.seek(table)
        file.write(struct.pack(f"<{len(offsets)}Q", *offsets))


def _header(samples: SampleBuffer, compression: int) -> ExrHeader:
    lens = samples.lens
    attributes: dict[str, int | float | str] = {
        "fewrays/version": _VERSION,
        "fewrays/c0": lens.c0,
        "fewrays/c1": lens.c1,
        "fewrays/sigma": lens.sigma,
        "fewrays/aperture": lens.aperture,
        "fewrays/sampling": lens.sampling,
        "maxSamplesPerPixel": samples.spp,
    }
    if 0 < lens.focus_distance < float(np.finfo(np.float32).max):
        attributes["focus"] = lens.focus_distance
    channels = tuple(Channel(name, "<f4") for name in sorted(_sources(samples)))
    return ExrHeader(True, None, (0, 0), samples.width, samples.height, channels, compression, attributes)


def _sources(samples: SampleBuffer) -> dict[str, npt.NDArray[np.float32]]:
    """Return the ``(H, W, S)`` values of each channel of the file."""
    sources = {"A": np.broadcast_to(np.float32(1), samples.depth.shape)}
    for name in samples.field_names():
        array = getattr(samples, name).reshape(*samples.depth.shape, -1)
        for component, channel in enumerate(_CHANNELS[name]):
            sources[channel] = array[..., component]
    return sources


def _wanted(header: ExrHeader) -> dict[str, tuple[str, ...]]:
    """Return the channels to read for each array; raise for the first one that is missing."""
    present = {channel.name for channel in header.channels}
    wanted = {}
    for name, channels in _CHANNELS.items():
        if name in _OPTIONAL and present.isdisjoint(channels):
            continue
        for channel in channels:
            if channel not in present:
                raise SampleError(
                    f"is missing; the file has {', '.join(sorted(present))}; every sample needs its image "
                    "and lens position, depth and colour",
                    field=f"channel {channel}",
                )
        wanted[name] = channels
    return wanted


def _lens(header: ExrHeader) -> dict[str, float | str]:
    version = header.attributes.get("fewrays/version", _VERSION)
    if version != _VERSION:
        raise SampleError(f"expected {_VERSION}, got {version!r}; update fewrays?", field="fewrays/version")
    lens: dict[str, float | str] = {}
    for name in ("c0", "c1", "sigma", "aperture", "sampling"):
        if f"fewrays/{name}" in header.attributes:
            lens[name] = header.attributes[f"fewrays/{name}"]
        elif name in ("c0", "c1"):
            raise SampleError(
                "this attribute is missing; it is the lens's slope coefficient, see fewrays.Lens",
                field=f"fewrays/{name}",
            )
    return lens


def _chunks(file: BinaryIO, header: ExrHeader, length: int) -> list[DeepChunk]:
    """Read every chunk's sizes and sample counts; each line of the image must occur once."""
    offsets = read_offsets(file, header, length, header.height)
    first = header.origin[1]
    chunks: list[DeepChunk] = []
    seen: set[int] = set()
    stored = 0
    for offset in offsets:
        chunk = read_chunk(file, offset, length, header.width, header.sample_bytes, header.compression)
        if not first <= chunk.y < first + header.height or chunk.y in seen:
            raise SampleError("lies outside the data window or occurs twice", field=f"line {chunk.y}")
        seen.add(chunk.y)
        stored += chunk.packed
        if stored > length:
            raise SampleError("chunks overlap", field=f"line {chunk.y}")
        chunks.append(chunk)
    return chunks


def _samples_per_pixel(header: ExrHeader, chunks: list[DeepChunk]) -> int:
    spp = max(int(chunk.counts.max()) for chunk in chunks)
    total = sum(int(chunk.counts.sum()) for chunk in chunks)
    if spp == 0:
        raise SampleError("holds no samples")
    check_size(header.height, header.width, spp, "sample counts")
    padded = header.height * header.width * spp
    if padded > max(_MOST_PADDING * total, _SMALL):
        raise SampleError(
            f"the fullest pixel has {spp} samples, the mean is {total / (header.width * header.height):.3g}: "
            f"filling all pixels up takes over {_MOST_PADDING} times the memory; thin out the fullest ones",
            field="sample counts",
        )
    return spp


def _split(
    data: npt.NDArray[np.uint8], header: ExrHeader, chunk: DeepChunk
) -> dict[str, npt.NDArray[np.generic]]:
    """Return the values of each channel of one line."""
    count = int(chunk.counts.sum())
    values = {}
    at = 0
    for channel in header.channels:
        end = at + count * channel.itemsize
        values[channel.name] = np.frombuffer(data[at:end].tobytes(), channel.dtype)
        at = end
    return values


def _check_opaque(values: dict[str, npt.NDArray[np.generic]], chunk: DeepChunk) -> None:
    if "A" not in values:
        return
    alpha = values["A"].astype(np.float32)
    clear = ~(np.abs(alpha - 1) <= _OPAQUE)
    if clear.any():
        raise SampleError(
            f"value {alpha[clear][0]} in line {chunk.y}: samples are single surface hits, with A = 1",
            field="channel A",
        )


def _to_image_origin(xy: npt.NDArray[np.float32], header: ExrHeader) -> None:
    """Shift positions so that the data window starts at 0; parked samples stay where they are."""
    for component, first in enumerate(header.origin):
        if first:
            values = xy[..., component]
            np.subtract(values, first, out=values, where=values != OFF_IMAGE)


FORMAT = Format("exr", (".exr",), load, save, save_options=("compression",))
