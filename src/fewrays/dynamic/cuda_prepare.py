"""Sheets made on a GPU: ``native/cuda/dynamic_prepare.cu``, launched.

The twin of `fewrays.dynamic.prepare`. The host gets four numbers of each layer, which the first kernel finds
out: whether its values are possible, and how steep its slopes are, which says how far views shift pixels and
how wide the blur between them is. They come while the other kernels run. What else it would have to ask for
is not asked: sheets that may turn out empty have their place, and show nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.dynamic.device_layer import DeviceLayer
from fewrays.dynamic.fill import AGREEMENT
from fewrays.dynamic.options import DefocusOptions
from fewrays.dynamic.prepare import LEAST_REACH, greatest_slope
from fewrays.errors import SampleError
from fewrays.lens import Lens

__all__ = ["KERNELS", "DeviceSheets", "prepare_sheets"]

_MOST_PIXELS = 2**32 - 1  # of all sheets, which keys number
_SURVEY = 4  # numbers of ``LayerSurvey`` in the kernels: those of wrong values, and the steepest slope's bits
_EXPECTED = {
    "color": "finite radiance",
    "depth": 'depths > 0 (invalid_depth="background" takes others for background)',
    "alpha": "opacities from 0 to 1",
}

_LAYER = Kernel(
    "dynamic_prepare",
    "dynamic_layer",
    256,
    {
        **dict.fromkeys(("color", "depth", "alpha", "texels"), "*f4"),
        "shown": "*u1",
        "survey": "*u4",
        **dict.fromkeys(("height", "width", "mend"), "i4"),
        **dict.fromkeys(("c0", "c1", "most"), "f4"),
    },
)
_PREPARE = {
    **dict.fromkeys(("whole", "texels"), "*f4"),
    "shown": "*u1",
    **dict.fromkeys(("pixels", "light", "slope", "front"), "*f4"),
    **dict.fromkeys(("opaque", "edge", "in_front", "mixed", "needed"), "*u1"),
    "back": "*f4",
    **dict.fromkeys(("height", "width", "seen", "empty", "made_up", "split", "carry_on"), "i4"),
    **dict.fromkeys(("empty_slope", "tolerance", "most", "agreement"), "f4"),
    "reach": "i4",
}
_FRONT, _EDGES, _BACKGROUND, _SPLIT, _MADE_UP, _SPREAD = (
    Kernel("dynamic_prepare", f"dynamic_{name}", 256, _PREPARE)
    for name in ("front", "edges", "background", "split", "made_up", "spread")
)
KERNELS = (_LAYER, _FRONT, _EDGES, _BACKGROUND, _SPLIT, _MADE_UP, _SPREAD)
"""All kernels of the preparation."""


@dataclass(frozen=True, eq=False)
class DeviceSheets:
    """Sheets on the card, as views are made from them.

    Parameters
    ----------
    texels : array of float32, (sheets, H, W, 8)
        ``Texel`` in ``native/math/sheet_lookup.h``.
    pixels : array of float32, (sheets, H, W, 2)
        ``WarpPixel`` there.
    behind : ndarray of float32, (sheets,)
        Pixels of slope by which each stands back.
    translucent : ndarray of bool, (sheets,)
        Which may show pixels that they do not cover wholly.
    steepest : float
        Size in pixels that no slope exceeds, but for rounding.
    """

    texels: Any
    pixels: Any
    behind: npt.NDArray[np.float32]
    translucent: npt.NDArray[np.bool_]
    steepest: float

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.texels.shape[1])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.texels.shape[2])


@dataclass(frozen=True)
class _Numbers:
    """Which sheet is which; emptiness and what is made up are 0 where they can not be."""

    seen: int
    empty: int
    made_up: int

    @classmethod
    def of(cls, layers: Sequence[DeviceLayer], options: DefocusOptions) -> _Numbers:
        """Say so by what is known without a look at the layers' values."""
        count = len(layers)
        empty = count if all(layer.alpha is not None for layer in layers) else 0
        seen = count + (empty > 0)
        return cls(seen, empty, seen if options.split_edges or options.fill_reach > 0 else 0)

    @property
    def count(self) -> int:
        """Sheets in all."""
        return self.seen + (self.made_up > 0)


def prepare_sheets(
    machine: Machine, layers: Sequence[DeviceLayer], lens: Lens, options: DefocusOptions
) -> DeviceSheets:
    """Make sheets of layers, as `fewrays.dynamic.prepare.prepare_sheets` does.

    Parameters
    ----------
    machine : Machine
    layers : sequence of DeviceLayer
        All of one size, the nearest first.
    lens : Lens
    options : DefocusOptions

    Returns
    -------
    DeviceSheets
        One for each layer; emptiness where all of these have opacities; what was made up, unless nothing
        is to be. Colours are not yet blurred.

    Raises
    ------
    SampleError
        For impossible values, and for images of more pixels than keys can number.
    """
    xp, height, width = machine.xp, layers[0].height, layers[0].width
    numbers = _Numbers.of(layers, options)
    if numbers.count * height * width > _MOST_PIXELS:
        raise SampleError(
            f"{width} x {height} pixels in {numbers.count} sheets are more than the GPU's kernels can "
            "number; use device='cpu'",
            field="color",
        )
    whole = xp.empty((height, width, 8), np.float32)
    texels = xp.empty((numbers.count, height, width, 8), np.float32)
    shown = xp.empty((numbers.count, height, width), np.uint8)
    survey = _survey(machine, layers, lens, [whole, *texels[1:]], shown)
    limit = greatest_slope(height, width)
    farthest = float(np.clip(lens.c1, -limit, limit))
    pixels = xp.empty((numbers.count, height, width, 2), np.float32)
    sheets = {"whole": whole, "texels": texels, "shown": shown, "pixels": pixels}
    _complete(machine, numbers, options, sheets, farthest)
    steepest = max(_require_possible(survey()), abs(farthest) if numbers.empty else 0.0)
    behind = np.zeros(numbers.count, np.float32)
    translucent = np.zeros(numbers.count, bool)
    translucent[: len(layers)] = [layer.alpha is not None for layer in layers]
    translucent[0] |= options.split_edges
    if numbers.made_up:
        behind[numbers.made_up] = options.surface_tolerance
    return DeviceSheets(texels, pixels, behind, translucent, steepest)


def _survey(
    machine: Machine, layers: Sequence[DeviceLayer], lens: Lens, texels: Sequence[Any], shown: Any
) -> Callable[[], npt.NDArray[np.uint32]]:
    """Fill in every layer's texels and return what gives their surveys, (layers, 4)."""
    survey = machine.xp.zeros((len(layers), _SURVEY), np.uint32)
    height, width = layers[0].height, layers[0].width
    for number, layer in enumerate(layers):
        machine.launch(
            _LAYER,
            (blocks_for(height * width, _LAYER), 1, 1),
            color=layer.color,
            depth=layer.depth,
            alpha=layer.alpha,
            texels=texels[number],
            shown=shown[number],
            survey=survey[number],
            height=height,
            width=width,
            mend=layer.mend,
            c0=lens.c0,
            c1=lens.c1,
            most=greatest_slope(height, width),
        )
    return machine.fetch(survey)


def _require_possible(survey: npt.NDArray[np.uint32]) -> float:
    """Refuse values that no renderer means, and return the size of the steepest slope."""
    for number, counts in enumerate(survey[:, : len(_EXPECTED)].tolist()):
        for (name, expected), count in zip(_EXPECTED.items(), counts, strict=True):
            if count:
                field = name if number == 0 else f"behind[{number - 1}].{name}"
                raise SampleError(f"expected {expected}; {count} values are not", field=field)
    return float(survey[:, 3].max().view(np.float32))


def _complete(
    machine: Machine,
    numbers: _Numbers,
    options: DefocusOptions,
    sheets: dict[str, Any],
    farthest: float,
) -> None:
    """Take the first sheet's edges apart, make up what is behind them, and say how far pixels spread.

    Edges are searched behind twice, as `fewrays.dynamic.prepare` explains; in between `split` writes what
    the second search is to see. `farthest` is the slope of what is infinitely far: none is greater.
    """
    xp, (height, width) = machine.xp, sheets["whole"].shape[:2]
    per_pixel = {name: xp.empty((height, width), np.float32) for name in ("slope", "front")}
    marks = ("opaque", "edge", "in_front", "mixed", "needed")
    per_pixel |= {name: xp.empty((height, width), np.uint8) for name in marks}
    tolerance, carry_on = options.surface_tolerance, options.fill_reach > 0
    common = {
        **sheets,
        **per_pixel,
        "light": xp.empty((height, width, 4), np.float32),
        "back": xp.zeros((height, width, 6), np.float32),
        "height": height,
        "width": width,
        "seen": numbers.seen,
        "empty": numbers.empty,
        "made_up": numbers.made_up,
        "split": options.split_edges,
        "carry_on": carry_on,
        "empty_slope": farthest,
        "tolerance": tolerance,
        # Means of slopes are slopes as well, but for rounding.
        "most": farthest + tolerance,
        "agreement": AGREEMENT * tolerance,
        "reach": max(options.fill_reach, LEAST_REACH),
    }
    pixels = blocks_for(height * width, _FRONT)
    again = common | {"edge": per_pixel["mixed"]}
    stages = [(_FRONT, common), (_EDGES, common)]
    stages += [(_BACKGROUND, common)] if numbers.made_up else []
    stages += [(_SPLIT, common)]
    stages += [(_BACKGROUND, again)] if carry_on else []
    stages += [(_MADE_UP, common)] if numbers.made_up else []
    for kernel, arguments in stages:
        machine.launch(kernel, (pixels, 1, 1), **arguments)
    machine.launch(_SPREAD, (pixels, numbers.count, 1), **common)
