"""Pictures with depth, RGB+Z, as renderers and compositing packages write them.

One EXR holds colour and depth under names that differ from writer to writer (`rgbz_channels`); or depth
comes in a file of its own (`rgbz_files`). Depth is planar, a ray's length, or inverse (`rgbz_depth`). Deep
EXR holds several surfaces behind each other (`rgbz_deep`). All of it becomes layers of colour, planar depth
and coverage, the first one in front.
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.errors import SampleError, first_index
from fewrays.io.files import as_path, replace_files
from fewrays.io.images import load_image
from fewrays.io.rgbz_channels import DepthKind, find_color, find_depth
from fewrays.io.rgbz_deep import load_deep
from fewrays.io.rgbz_depth import DepthFormat, to_planar
from fewrays.io.rgbz_exr import Window, is_deep, open_flat
from fewrays.io.rgbz_files import load_depth

__all__ = ["RgbzImage", "RgbzSource", "load_rgbz", "save_rgbz"]

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class RgbzImage:
    """A picture with depth.

    Parameters
    ----------
    layers : tuple of DepthLayer
        The first one in front; more from deep files.
    full_width : int
        Width in pixels of the whole picture, which is more than that of the layers where these are a crop.
    lens : (float, float) or None
        The coefficients c0 and c1 of `fewrays.Lens`, where the file has them.
    """

    layers: tuple[DepthLayer, ...]
    full_width: int
    lens: tuple[float, float] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the layers."""
        height, width = self.layers[0].depth.shape
        return height, width


@dataclass(frozen=True)
class RgbzSource:
    """Where in the files colour and depth are.

    Parameters
    ----------
    depth : DepthFormat
        What the stored depth means.
    color_layer, depth_channel : str, optional
        Names of the EXR's layer and channel to take, where they are not found by themselves.
    focal_widths : float, optional
        Focal length in image widths, focal length / sensor width; needed where depth is a ray's length.
    use_alpha : bool
        Whether an alpha channel counts.
    deep_layers : int
        Most layers that a deep EXR is sorted into.
    """

    depth: DepthFormat = DepthFormat()  # noqa: RUF009  # frozen
    color_layer: str | None = None
    depth_channel: str | None = None
    focal_widths: float | None = None
    use_alpha: bool = True
    deep_layers: int = 4

    def planar(self, values: npt.NDArray[Any], kind: DepthKind, window: Window) -> Float32:
        """Return planar depth; `kind` is what the channel's name says."""
        form = dataclasses.replace(self.depth, kind=self.depth.kind or kind)
        focal = None if self.focal_widths is None else self.focal_widths * window.full_width
        return to_planar(values, form, focal_pixels=focal, centre=window.centre)


def load_rgbz(
    path: str | os.PathLike[str],
    depth: str | os.PathLike[str] | None = None,
    source: RgbzSource | None = None,
) -> RgbzImage:
    """Read a picture and its depth.

    Parameters
    ----------
    path : str or path
        ``.exr``, flat or deep, of one or many parts; with `depth` also ``.png`` (8 bit sRGB) and ``.npy``.
    depth : str or path, optional
        Depth from a file of its own: ``.exr``, ``.npy`` or 16 bit ``.png``.
    source : RgbzSource, optional
        What to take for colour and depth where that is not clear from the file.

    Returns
    -------
    RgbzImage

    Raises
    ------
    SampleError
        Naming the file and the channel that cannot be used.

    Examples
    --------
    >>> picture = load_rgbz("shot.exr")  # doctest: +SKIP
    """
    path, source = as_path(path), source or RgbzSource()
    try:
        if path.suffix.lower() == ".exr":
            if is_deep(path):
                return _load_deep(path, depth, source)
            return _load_flat(path, depth, source)
        if depth is None:
            raise SampleError("has no depth: give it as a file of its own (depth)")
        image = load_image(path)
        color = np.repeat(image[..., None], 3, axis=-1) if image.ndim == 2 else image
        window = Window.whole(color.shape[1], color.shape[0])
        planar = _depth_from(as_path(depth), window, source)
        return RgbzImage((DepthLayer(color, planar),), window.full_width)
    except SampleError as error:
        raise (error if error.file else error.in_file(path)) from None


def _load_flat(path: Path, depth: str | os.PathLike[str] | None, source: RgbzSource) -> RgbzImage:
    flat = open_flat(path)
    names = list(flat.channels)
    found = None if depth is not None else find_depth(names, source.depth_channel)
    channels = find_color(names, source.color_layer, beside=None if found is None else found.name)
    wanted = [*channels.rgb]
    if channels.alpha is not None and source.use_alpha:
        wanted.append(channels.alpha)
    if found is not None:
        wanted.append(found.name)
    windows = {flat.window(name) for name in wanted}
    if len(windows) > 1:
        raise SampleError(f"{', '.join(wanted)} lie in parts of different size or place", field="dataWindow")
    (window,) = windows
    planes = flat.read(wanted)
    color = _finite(np.stack(planes[:3], axis=-1), "colour")
    if found is None:
        assert depth is not None
        planar = _depth_from(as_path(depth), window, source)
    else:
        planar = source.planar(planes.pop(), found.kind, window)
    alpha = _coverage(planes[3], color) if len(planes) > 3 else None
    return RgbzImage((DepthLayer(color, planar, alpha),), window.full_width, _lens(flat.numbers))


def _load_deep(path: Path, depth: str | os.PathLike[str] | None, source: RgbzSource) -> RgbzImage:
    if depth is not None:
        raise SampleError("is deep and has depth of its own", field="depth")
    deep = load_deep(
        path,
        source.deep_layers,
        kind=source.depth.kind,
        color_layer=source.color_layer,
        depth_channel=source.depth_channel,
    )
    layers = tuple(
        DepthLayer(color, source.planar(depths, deep.kind, deep.window), alpha)
        for color, depths, alpha in zip(deep.color, deep.depth, deep.alpha, strict=True)
    )
    return RgbzImage(layers, deep.window.full_width, _lens(deep.numbers))


def _depth_from(path: Path, window: Window, source: RgbzSource) -> Float32:
    values, kind = load_depth(path, source.depth_channel)
    if values.shape != (window.height, window.width):
        raise SampleError(
            f"is {values.shape[1]} x {values.shape[0]} pixels, the picture {window.width} x {window.height}",
            file=path,
        )
    try:
        return source.planar(values, kind, window)
    except SampleError as error:
        raise error.in_file(path) from None


def _finite(values: npt.NDArray[Any], what: str) -> Float32:
    pixels = np.ascontiguousarray(values, np.float32)
    finite = np.isfinite(pixels)
    if not finite.all():
        index = first_index(~finite)
        raise SampleError(
            f"{finite.size - int(finite.sum())} values are NaN or infinite, the first at column {index[1]}, "
            f"row {index[0]}: {pixels[index]}",
            field=what,
        )
    return pixels


def _coverage(values: npt.NDArray[Any], color: Float32) -> Float32 | None:
    """Return alpha clipped to [0, 1], for filters with negative lobes overshoot; None if all is covered."""
    alpha = np.clip(_finite(values, "alpha"), 0, 1)
    if not alpha.any() and color.any():
        warnings.warn("alpha is 0 everywhere and is ignored", stacklevel=2)
        return None
    return None if (alpha == 1).all() else alpha


def _lens(numbers: Mapping[str, float]) -> tuple[float, float] | None:
    if "fewrays/c0" in numbers and "fewrays/c1" in numbers:
        return numbers["fewrays/c0"], numbers["fewrays/c1"]
    return None


def save_rgbz(
    path: str | os.PathLike[str],
    layer: DepthLayer,
    *,
    lens: tuple[float, float] | None = None,
    provenance: Mapping[str, str] | None = None,
    overwrite: bool = True,
) -> None:
    """Write one layer as a flat EXR with channels R, G, B, A if any, and Z; float32, ZIP.

    Parameters
    ----------
    path : str or path
        The file.
    layer : DepthLayer
        What to write; the background's depth stays infinite.
    lens : (float, float), optional
        The coefficients c0 and c1 of `fewrays.Lens`, for `load_rgbz` to find again.
    provenance : mapping of str to str, optional
        How the picture was made; stored as attributes ``fewrays/<name>``.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    SampleError
        For a file that cannot be written.
    """
    path = as_path(path)
    header: dict[str, object] = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    header |= {f"fewrays/{name}": value for name, value in (provenance or {}).items()}
    if lens is not None:
        header |= {"fewrays/c0": float(lens[0]), "fewrays/c1": float(lens[1])}
    channels: dict[str, Any] = {"RGB": layer.color}
    if layer.alpha is not None:
        channels = {"RGBA": np.dstack([layer.color, layer.alpha])}
    channels["Z"] = layer.depth
    with replace_files(path, overwrite=overwrite) as [temporary], OpenEXR.File(header, channels) as file:
        file.write(str(temporary))
