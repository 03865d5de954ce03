"""The native format: a NumPy ``.npz`` archive, readable with ``numpy.load`` alone.

Members: ``version`` (1), the arrays of `SampleBuffer` under their own names in float32, and the lens as
``c0``, ``c1``, ``sigma`` (float64 scalars), ``aperture`` and ``sampling`` (text scalars). `npz_lighting` adds
those of area lights. Nothing is pickled.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from fewrays.errors import SampleError, first_index
from fewrays.io.files import open_file, replace_files
from fewrays.io.formats import Format, StoredSamples
from fewrays.io.npz_archive import NpzArchive
from fewrays.io.npz_lighting import LightingReader, lighting_members
from fewrays.parallel import progress_bar
from fewrays.samples import SampleBuffer

__all__ = ["FORMAT", "load", "save"]

_VERSION = 1
_COEFFICIENTS = ("c0", "c1")
_NUMBERS = (*_COEFFICIENTS, "sigma")
_TEXTS = ("aperture", "sampling")
_LEVEL = 4  # of zlib: float data gains 2 % from level 6 and takes twice as long
_CHUNK = 1 << 22


def load(path: Path, progress: bool) -> StoredSamples:
    """Read a ``.npz`` sample file.

    Parameters
    ----------
    path : Path
        The file.
    progress : bool
        Show a progress bar for work over two seconds.

    Returns
    -------
    StoredSamples

    Raises
    ------
    SampleError
        For anything but a complete, consistent archive of version 1; sizes are checked against the length of
        the file and the caps before an array is allocated.
    """
    with open_file(path) as (file, length), NpzArchive.open(file, length) as archive:
        version = archive.number("version")
        if version != _VERSION:
            raise SampleError(f"expected {_VERSION}, got {version:g}; update fewrays?", field="version")
        lens: dict[str, float | str] = {name: archive.number(name) for name in _COEFFICIENTS}
        if "sigma" in archive:
            lens["sigma"] = archive.number("sigma")
        lens |= {name: archive.text(name) for name in _TEXTS if name in archive}
        headers = archive.headers(SampleBuffer.CHANNELS, optional=SampleBuffer.OPTIONAL)
        lighting = LightingReader(archive)
        with progress_bar(len(headers) + lighting.count, "load", show=progress, unit="array") as bar:
            return StoredSamples(archive.arrays(headers, bar), lens, lighting.read(bar))


def save(
    path: Path,
    samples: SampleBuffer,
    overwrite: bool,
    progress: bool,
    *,
    compressed: bool = False,
    half: bool = False,
) -> None:
    """Write a ``.npz`` sample file.

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
    compressed : bool
        Compress with DEFLATE: smaller, but many times slower.
    half : bool
        Store the colour, and nothing else, as float16: 11 significant bits. Loading gives float32 again.

    Raises
    ------
    SampleError
        When a colour does not fit into float16, or the file cannot be written.
    """
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(samples, name) for name in samples.field_names()}
    if half:
        arrays["color"] = _as_half(samples.color)
    scalars: dict[str, npt.NDArray[Any]] = {"version": np.array(_VERSION, np.int64)}
    scalars |= {name: np.array(getattr(samples.lens, name), np.float64) for name in _NUMBERS}
    scalars |= {name: np.array(getattr(samples.lens, name)) for name in _TEXTS}
    if samples.lighting is not None:
        small, more = lighting_members(samples.lighting)
        scalars |= small
        arrays |= more
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    total = sum(array.nbytes for array in arrays.values())
    with (
        replace_files(path, overwrite=overwrite) as [temporary],
        zipfile.ZipFile(temporary, "w", method, compresslevel=_LEVEL if compressed else None) as archive,
        progress_bar(total, "save", show=progress, unit="B") as bar,
    ):
        for name, array in (scalars | arrays).items():
            _write_member(archive, name, array, bar)


def _write_member(archive: zipfile.ZipFile, name: str, array: npt.NDArray[Any], bar: tqdm[Any]) -> None:
    # A fixed date makes equal samples equal files.
    info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    info.compress_type = archive.compression
    with archive.open(info, "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, np.lib.format.header_data_from_array_1_0(array))
        data = array.reshape(-1).view(np.uint8)
        for start in range(0, len(data), _CHUNK):
            block = data[start : start + _CHUNK]
            member.write(block.data)
            bar.update(len(block) if array.ndim > 1 else 0)


def _as_half(color: npt.NDArray[np.float32]) -> npt.NDArray[np.float16]:
    with np.errstate(over="ignore"):
        half = color.astype(np.float16)
    bad = ~np.isfinite(half)
    if bad.any():
        index = first_index(bad)
        raise SampleError(
            f"value {color[index]} at {list(index)} does not fit into float16 "
            "(65504 at most); save without half",
            field="color",
        )
    return half


FORMAT = Format("npz", (".npz",), load, save, save_options=("compressed", "half"))
