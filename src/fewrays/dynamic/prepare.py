"""From layers with depth to the sheets that are warped.

What an image shows is taken apart at its edges (`edges`), what is missing behind them is made up (`fill`),
and what is known to be empty gets a sheet of its own. Colours are not yet blurred: that depends on the views
(`prefilter`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.dynamic.edges import Split, split_edges
from fewrays.dynamic.fill import Background
from fewrays.dynamic.sheet import Sheet
from fewrays.dynamic.surfaces import edges_of_surfaces, front_slopes
from fewrays.lens import Lens
from fewrays.parallel import Execution

__all__ = ["LEAST_REACH", "Completion", "GuessBackground", "greatest_slope", "prepare_sheets"]

Float32 = npt.NDArray[np.float32]
GuessBackground = Callable[
    [Float32, Float32, Float32, npt.NDArray[np.bool_], npt.NDArray[np.bool_], float, int, Execution],
    Background,
]

LEAST_REACH = 2
"""Pixels in which a mixed pixel's background is looked for at least."""


@dataclass(frozen=True)
class Completion:
    """What is done about the edges of an image.

    Parameters
    ----------
    guess : callable
        `fewrays.dynamic.fill.guess_background`, or what computes the same.
    execution : Execution
    tolerance : float
        Slopes in pixels by which neighbours of one surface may differ.
    fill_reach : int
        Pixels from an edge up to which the surface behind it is carried on; 0 leaves these rays out.
    split : bool
        Take mixed pixels apart.
    """

    guess: GuessBackground
    execution: Execution
    tolerance: float
    fill_reach: int
    split: bool

    def guess_behind(
        self,
        light: Float32,
        slope: Float32,
        front: Float32,
        edge: npt.NDArray[np.bool_],
        needed: npt.NDArray[np.bool_],
    ) -> Background:
        """Guess what is behind the pixels that need it, as far as the completion reaches."""
        reach = max(self.fill_reach, LEAST_REACH)
        return self.guess(light, slope, front, edge, needed, self.tolerance, reach, self.execution)


def prepare_sheets(layers: Sequence[DepthLayer], lens: Lens, completion: Completion) -> list[Sheet]:
    """Make sheets of layers.

    Parameters
    ----------
    layers : sequence of DepthLayer
        All of one size, the nearest first.
    lens : Lens
    completion : Completion

    Returns
    -------
    list of Sheet
        One for each layer, the emptiness behind them if any is seen, and what was made up.
    """
    sheets = [_sheet_of_layer(layer, lens) for layer in layers]
    empty = _emptiness(sheets, lens)
    sheets += [] if empty is None else [empty]
    first, back, wanted = _complete(sheets, completion)
    sheets[0] = Sheet(first.light, first.coverage, first.slope, first.coverage > 0)
    if wanted.any():
        sheets.append(_made_up(sheets[0], back, wanted, completion.tolerance))
    return sheets


def greatest_slope(height: int, width: int) -> int:
    """Return where slopes are cut off, in pixels.

    That is four times the image's size: what is blurred so much is spread beyond it anyway.
    """
    return 4 * max(height, width)


def _sheet_of_layer(layer: DepthLayer, lens: Lens) -> Sheet:
    """Return a layer as it is, seen through a lens."""
    most = np.float32(greatest_slope(layer.height, layer.width))
    coverage = np.ones(layer.depth.shape, np.float32) if layer.alpha is None else layer.alpha
    depth = np.where(coverage > 0, layer.depth, np.float32(np.inf))
    with np.errstate(divide="ignore", over="ignore"):
        slope = np.clip(lens.slope(depth), -most, most).astype(np.float32)
    light = np.concatenate([layer.color, coverage[..., None]], axis=-1)
    return Sheet(light, coverage, slope, coverage > 0)


def _emptiness(sheets: Sequence[Sheet], lens: Lens) -> Sheet | None:
    """Return what is seen where all layers let light pass: nothing, infinitely far away."""
    passing = np.prod([1 - sheet.coverage.astype(np.float64) for sheet in sheets], axis=0)
    if not passing.any():
        return None
    shape = sheets[0].slope.shape
    most = greatest_slope(*shape)
    slope = np.full(shape, np.clip(lens.c1, -most, most), np.float32)
    return Sheet(np.zeros((*shape, 4), np.float32), np.ones(shape, np.float32), slope, passing > 0)


def _complete(
    sheets: Sequence[Sheet], completion: Completion
) -> tuple[Split, Background, npt.NDArray[np.bool_]]:
    """Take the first sheet's edges apart, and make up what is behind them.

    What is behind edges is guessed first, from pixels that are none. With these taken apart, the rest is
    guessed from all pixels: thin things have nothing but edges.

    Returns
    -------
    first : Split
        The first sheet.
    back : Background
        What is believed to be behind it.
    wanted : ndarray of bool, (H, W)
        Where that is to be shown.
    """
    tolerance = completion.tolerance
    light, slope, opaque = _nearest_visible(sheets)
    edge = edges_of_surfaces(slope, tolerance) | ~opaque
    nearest = front_slopes(slope)
    in_front = slope <= nearest + tolerance
    seen = _nearest_opaque(sheets[1:], slope + tolerance)
    seen = replace(seen, known=seen.known & in_front)
    front = np.where(seen.known, seen.slope, np.where(edge, nearest, slope))
    whole = Split(sheets[0].light, sheets[0].coverage, sheets[0].slope)
    back = completion.guess_behind(light, slope, front, edge, edge & opaque)
    first = whole
    if completion.split:
        splittable = edge & (sheets[0].coverage >= 1)
        first = split_edges(whole, splittable, _either(seen, back, seen.known), tolerance)
    mixed = first.coverage < whole.coverage
    if completion.fill_reach == 0:
        return first, back, back.known & mixed & ~seen.known
    apart = mixed & ~in_front
    light = np.where(apart[..., None], back.light, light)
    slope = np.where(apart, back.slope, slope)
    rest = completion.guess_behind(light, slope, front, mixed & in_front, opaque & ~mixed)
    back = _either(back, rest, mixed)
    return first, back, back.known & opaque


def _either(one: Background, other: Background, where: npt.NDArray[np.bool_]) -> Background:
    """Return one background where that is asked for, the other elsewhere."""
    return Background(
        np.where(where[..., None], one.light, other.light),
        np.where(where, one.slope, other.slope),
        np.where(where, one.known, other.known),
    )


def _nearest_visible(sheets: Sequence[Sheet]) -> tuple[Float32, Float32, npt.NDArray[np.bool_]]:
    """Return light and slope of the first sheet that shows anything, and whether it covers its pixel."""
    light, slope, coverage = (part.copy() for part in (sheets[0].light, sheets[0].slope, sheets[0].coverage))
    for sheet in sheets[1:]:
        missing = (coverage == 0) & sheet.shown
        light[missing], slope[missing] = sheet.light[missing], sheet.slope[missing]
        coverage[missing] = sheet.coverage[missing]
    light /= np.where(coverage > 0, coverage, 1)[..., None]
    return light, slope, coverage >= 1


def _nearest_opaque(sheets: Sequence[Sheet], beyond: Float32) -> Background:
    """Return the first thing that the sheets show that is opaque and has a slope greater than `beyond`."""
    found = Background(np.zeros((*beyond.shape, 4), np.float32), beyond.copy(), np.zeros(beyond.shape, bool))
    for sheet in sheets:
        new = ~found.known & sheet.shown & (sheet.coverage >= 1) & (sheet.slope > beyond)
        found.light[new], found.slope[new] = sheet.light[new], sheet.slope[new]
        found.known[new] = True
    return found


def _made_up(first: Sheet, back: Background, wanted: npt.NDArray[np.bool_], tolerance: float) -> Sheet:
    """Return the sheet of what is believed to be behind.

    Elsewhere it repeats the first sheet, so that lookups between pixels find its surfaces going on.
    """
    return Sheet(
        np.where(wanted[..., None], back.light, first.light),
        np.where(wanted, np.float32(1), first.coverage),
        np.where(wanted, back.slope, first.slope),
        wanted,
        behind=tolerance,
    )
