"""Deep OpenEXR as a few depth layers: what is seen first, and what lies behind it or shows through.

A deep pixel is a list of samples with depth, premultiplied colour and alpha, which composite front to back.
Sorted by depth, the k-th sample of every pixel goes to layer k. Samples at almost the same depth share a
layer, and so do all that come after the last one: within a layer they are composited with `over`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError, require_option
from fewrays.io.exr_chunks import DEEP_COMPRESSIONS, DeepChunk, read_chunk
from fewrays.io.exr_header import COMPRESSIONS, ExrHeader, read_header, read_offsets
from fewrays.io.files import open_file
from fewrays.io.rgbz_channels import ColorChannels, DepthKind, find_color, find_depth
from fewrays.io.rgbz_exr import Window

__all__ = ["MAX_LAYERS", "DeepLayers", "load_deep"]

MAX_LAYERS = 16
"""Most layers that a deep image is sorted into."""

_SAME_DEPTH = 0.01  # relative difference of depths that share a layer

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class DeepLayers:
    """A deep image, sorted into layers; the first one is in front.

    Parameters
    ----------
    color : ndarray of float32, (layers, H, W, 3)
        Premultiplied.
    alpha : ndarray of float32, (layers, H, W)
        0 where a layer has nothing.
    depth : ndarray of float32, (layers, H, W)
        As the file has it, of the nearest sample; infinite where a layer has nothing (0 for inverse depth).
    kind : {"planar", "distance", "inverse"}
        What the depth is.
    window : Window
        Where the pixels lie in the picture.
    numbers : mapping of str to float
        The header's attributes that are numbers.
    """

    color: Float32
    alpha: Float32
    depth: Float32
    kind: DepthKind
    window: Window
    numbers: Mapping[str, float]


def load_deep(
    path: Path,
    layers: int = 4,
    *,
    kind: DepthKind | None = None,
    color_layer: str | None = None,
    depth_channel: str | None = None,
) -> DeepLayers:
    """Read a deep scan-line OpenEXR file of one part.

    Parameters
    ----------
    path : Path
        Compressed with ZIPS or RLE, or not at all.
    layers : int
        Most layers to sort the samples into, 1 to `MAX_LAYERS`.
    kind : {"planar", "distance", "inverse"}, optional
        What the depth is; what the channel's name says unless given.
    color_layer, depth_channel : str, optional
        As for `find_color` and `find_depth`.

    Raises
    ------
    SampleError
        For missing or ambiguous channels, values that are not finite, or a file whose parts disagree.
    """
    require_option("layers", layers, 1 <= layers <= MAX_LAYERS, f"from 1 to {MAX_LAYERS}")
    with open_file(path) as (file, length):
        header = read_header(file, length)
        if header.compression >= len(DEEP_COMPRESSIONS):
            raise SampleError(
                f"deep data cannot be {COMPRESSIONS[header.compression]}; save with ZIPS", field="compression"
            )
        names = [channel.name for channel in header.channels]
        depth = find_depth(names, depth_channel)
        kind = kind or depth.kind
        color = find_color(names, color_layer, beside=depth.name)
        stack = _Stack(layers, header.height, header.width, reverse=kind == "inverse")
        for row, chunk in _lines(file, header, length):
            values = _values(chunk.read(file, header.compression), header, chunk)
            stack.add_line(row, chunk.counts, *_samples(values, color, depth.name))
    used = max(1, int((stack.alpha > 0).any(axis=(1, 2)).sum()))
    numbers = {n: float(v) for n, v in header.attributes.items() if not isinstance(v, str)}
    window = Window.whole(header.width, header.height)
    return DeepLayers(stack.color[:used], stack.alpha[:used], stack.depth[:used], kind, window, numbers)


class _Stack:
    """Layers that lines of samples are sorted into."""

    def __init__(self, layers: int, height: int, width: int, *, reverse: bool) -> None:
        self.color = np.zeros((layers, height, width, 3), np.float32)
        self.alpha = np.zeros((layers, height, width), np.float32)
        self.depth = np.full((layers, height, width), 0 if reverse else np.inf, np.float32)
        self._order = -1 if reverse else 1

    def add_line(
        self, row: int, counts: npt.NDArray[np.int64], depth: Float32, color: Float32, alpha: Float32
    ) -> None:
        """Composite the samples of one line, (N,), (N, 3) and (N,), pixel after pixel in the file."""
        pixel = np.repeat(np.arange(len(counts)), counts)
        seen = (alpha > 0) | (color != 0).any(axis=-1)
        order = np.lexsort((self._order * depth, pixel))
        order = order[seen[order]]
        pixel = pixel[order]
        starts = np.searchsorted(pixel, pixel)
        rank = np.arange(len(pixel)) - starts
        slot = np.full(len(counts), -1)
        last = np.zeros(len(counts), np.float32)
        for number in range(int(rank.max(initial=-1)) + 1):
            sample = order[rank == number]
            at = pixel[rank == number]
            near = np.abs(depth[sample] - last[at]) <= _SAME_DEPTH * np.abs(last[at])
            fresh = (slot[at] < 0) | ~near & (slot[at] < len(self.alpha) - 1)
            slot[at[fresh]] += 1
            last[at[fresh]] = depth[sample[fresh]]
            self.depth[slot[at[fresh]], row, at[fresh]] = depth[sample[fresh]]
            clear = 1 - self.alpha[slot[at], row, at]
            self.color[slot[at], row, at] += clear[:, None] * color[sample]
            self.alpha[slot[at], row, at] += clear * alpha[sample]


def _lines(file: BinaryIO, header: ExrHeader, length: int) -> list[tuple[int, DeepChunk]]:
    """Return each line's number and chunk; every line of the image must occur once."""
    found = {}
    for offset in read_offsets(file, header, length, header.height):
        chunk = read_chunk(file, offset, length, header.width, header.sample_bytes, header.compression)
        row = chunk.y - header.origin[1]
        if not 0 <= row < header.height or row in found:
            raise SampleError("lies outside the data window or occurs twice", field=f"line {chunk.y}")
        found[row] = chunk
    return sorted(found.items())


def _values(data: npt.NDArray[np.uint8], header: ExrHeader, chunk: DeepChunk) -> dict[str, Float32]:
    """Return the values of each channel of one line."""
    count = int(chunk.counts.sum())
    values = {}
    at = 0
    for channel in header.channels:
        end = at + count * channel.itemsize
        values[channel.name] = np.frombuffer(data[at:end].tobytes(), channel.dtype).astype(np.float32)
        at = end
    return values


def _samples(
    values: Mapping[str, Float32], color: ColorChannels, depth: str
) -> tuple[Float32, Float32, Float32]:
    """Return depth (N,), colour (N, 3) and alpha (N,) of a line's samples; opaque without A."""
    rgb = np.stack([values[name] for name in color.rgb], axis=-1)
    alpha = np.ones(len(rgb), np.float32) if color.alpha is None else values[color.alpha]
    for what, array in (("colour", rgb), ("alpha", alpha)):
        if not np.isfinite(array).all():
            raise SampleError(f"{int((~np.isfinite(array)).sum())} values are NaN or infinite", field=what)
    return values[depth], rgb, np.clip(alpha, 0, 1)
