"""Pictures for people: tone mapping, labelled panels, and sheets that compare images with a reference.

A *panel* is a picture with a title and a note. `sheet` sets rows of panels; `comparison_sheet` makes the
before/after/reference sheet: whole images, magnified crops, error maps. All images of a sheet share one
exposure, and the crops are chosen by rule, never by hand (`choose_windows`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from fewrays.color import srgb_encode
from fewrays.io.files import replace_files
from fewrays.method import Image as LinearImage

__all__ = [
    "Candidate",
    "Panel",
    "Window",
    "auto_exposure",
    "choose_windows",
    "comparison_sheet",
    "error_picture",
    "save_picture",
    "sheet",
    "tone_map",
]

Picture = npt.NDArray[np.uint8]  # (H, W, 3), sRGB

BACKGROUND = (22, 24, 29)
INK = (236, 238, 241)
MUTED = (154, 160, 170)
FRAMES = ((255, 166, 43), (64, 196, 255), (255, 92, 160))
"""Colours of the crops' frames, in the order of `choose_windows`."""

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_MARGIN, _COLUMN_GAP, _GAP, _FRAME = 28, 26, 12, 3  # pixels

ERROR_RANGE = 0.25
"""The error that `error_picture` shows in its brightest colour, as a share of white."""

_HEAT = (
    (0, 0, 0),
    (52, 12, 82),
    (132, 26, 104),
    (208, 58, 70),
    (246, 128, 22),
    (252, 204, 60),
    (255, 252, 190),
)
_FRAME_MEANINGS = (
    "where the first image errs most",
    "where the reference has the most detail",
    "where the image next to the reference errs most",
)


def auto_exposure(image: LinearImage, *, percentile: float = 98.0, target: float = 0.8) -> float:
    """Return the stops that bring an image's highlights just under white.

    Parameters
    ----------
    image : ndarray, (H, W, 3)
        Linear radiance.
    percentile : float
        The share of pixels that should stay below `target` luminance.
    target : float
        Linear display luminance, white = 1.

    Returns
    -------
    float
        Stops to pass to `tone_map`; 0 for a black image.
    """
    level = float(np.percentile(image @ _LUMINANCE, percentile))
    return math.log2(target / level) if level > 0 else 0.0


def tone_map(image: LinearImage, exposure: float = 0.0) -> Picture:
    """Return an 8-bit sRGB picture of linear radiance: scaled by ``2**exposure``, clipped to white.

    Parameters
    ----------
    image : ndarray, (H, W, 3)
        Linear radiance.
    exposure : float
        Stops.

    Returns
    -------
    ndarray, (H, W, 3)
        uint8.
    """
    return _quantized(srgb_encode(image * np.float32(2.0**exposure)))


@dataclass(frozen=True)
class Panel:
    """A picture ``(H, W, 3)``, a title, and a note that stands beneath the title."""

    picture: Picture
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class Candidate:
    """An image ``(H, W, 3)`` of linear radiance to be compared with a reference, and its caption."""

    image: LinearImage
    title: str
    note: str = ""


@dataclass(frozen=True)
class Window:
    """A square part of an image, in pixels."""

    row: int
    column: int
    size: int

    def of(self, picture: Picture) -> Picture:
        """Return that part of a picture."""
        return picture[self.row : self.row + self.size, self.column : self.column + self.size]

    def overlaps(self, other: Window) -> bool:
        """Whether two windows of one size share pixels."""
        return max(abs(self.row - other.row), abs(self.column - other.column)) < self.size


def error_picture(picture: Picture, reference: Picture) -> Picture:
    """Return where two pictures differ: black for equal to pale yellow for `ERROR_RANGE` or more.

    The error of a pixel is the root mean square over its three sRGB channels, as a share of white.
    """
    return _heat(_display_error(picture, reference) / ERROR_RANGE)


def choose_windows(scores: Sequence[npt.NDArray[np.floating]], size: int) -> list[Window]:
    """Return, for each score map in turn, the window with the largest mean that meets no earlier window.

    The same maps always give the same windows. Candidates lie an eighth of a window apart.

    Parameters
    ----------
    scores : sequence of ndarray, (H, W)
        What makes a place worth a look.
    size : int
        Side of the windows in pixels; reduced to the image's size if that is smaller.

    Returns
    -------
    list of Window
        One per map; fewer when the image has no room left.
    """
    height, width = scores[0].shape
    size = min(size, height, width)
    step = max(1, size // 8)
    chosen: list[Window] = []
    for score in scores:
        total = np.zeros((height + 1, width + 1))  # summed-area table
        total[1:, 1:] = score.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
        sums = total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]
        sums = sums[::step, ::step]
        for index in np.argsort(-sums, axis=None, kind="stable"):
            row, column = divmod(int(index), sums.shape[1])
            window = Window(row * step, column * step, size)
            if not any(window.overlaps(other) for other in chosen):
                chosen.append(window)
                break
    return chosen


def comparison_sheet(
    candidates: Sequence[Candidate],
    reference: Candidate,
    *,
    exposure: float | None = None,
    panel_width: int = 640,
    title: str = "",
) -> Image.Image:
    """Compare images with their reference: whole images, magnified crops, error maps.

    The three crops show where the first candidate errs most, where the reference has the most detail, and
    where the last candidate, usually one's own method, errs most.

    Parameters
    ----------
    candidates : sequence of Candidate
        From the starting point, such as the noisy image, to the result.
    reference : Candidate
        The truth, shown last.
    exposure : float, optional
        Stops, for all images alike; `auto_exposure` of the reference when omitted.
    panel_width : int
        Least width of a panel in pixels: smaller images are magnified by a whole number.
    title : str
        Headline.

    Returns
    -------
    PIL.Image.Image
    """
    if exposure is None:
        exposure = auto_exposure(reference.image)
    truth = tone_map(reference.image, exposure)
    pictures = [tone_map(candidate.image, exposure) for candidate in candidates]
    height, width = truth.shape[:2]
    scale = max(1, math.ceil(panel_width / width))
    cell = (width * scale - (len(FRAMES) - 1) * _GAP) // len(FRAMES)
    zoom = min(max(scale + 1, round(cell / (width / 8))), cell)
    windows = choose_windows(
        [_display_error(pictures[0], truth), _detail(truth), _display_error(pictures[-1], truth)],
        cell // zoom,
    )

    shown = [*zip(candidates, pictures, strict=True), (reference, truth)]
    whole = [Panel(_framed(picture, windows, scale), c.title, c.note) for c, picture in shown]
    crops = [Panel(_crop_strip(picture, windows, zoom, width * scale)) for _, picture in shown]
    errors = [Panel(_magnified(error_picture(picture, truth), scale)) for picture in pictures]
    legend = Panel(_error_legend(width * scale, height * scale))
    return sheet([whole, crops, [*errors, legend]], title=title)


def sheet(rows: Sequence[Sequence[Panel]], *, title: str = "") -> Image.Image:
    """Set rows of panels in columns, with captions above the pictures.

    Parameters
    ----------
    rows : sequence of sequence of Panel
        Pictures of one column may differ in size; they are set flush left.
    title : str
        Headline over all of it.

    Returns
    -------
    PIL.Image.Image
    """
    columns = max(len(row) for row in rows)
    widths = [
        max((row[i].picture.shape[1] for row in rows if i < len(row)), default=0) for i in range(columns)
    ]
    page_width = sum(widths) + (columns - 1) * _COLUMN_GAP + 2 * _MARGIN
    text = max(15, round(page_width / 68))
    head = _MARGIN + (round(2.2 * text) if title else 0)
    captions = [_caption_height(row, text) for row in rows]
    heights = [max(panel.picture.shape[0] for panel in row) for row in rows]
    page_height = head + sum(captions) + sum(heights) + (len(rows) - 1) * _GAP + _MARGIN

    page = Image.new("RGB", (page_width, page_height), BACKGROUND)
    draw = ImageDraw.Draw(page)
    if title:
        _write(draw, (_MARGIN, _MARGIN), title, 1.25 * text, INK, page_width - 2 * _MARGIN)
    y = head
    for row, caption, height in zip(rows, captions, heights, strict=True):
        x = _MARGIN
        for panel, width in zip(row, widths, strict=False):
            _write(draw, (x, y), panel.title, text, INK, width)
            _write(draw, (x, y + round(1.35 * text)), panel.note, 0.82 * text, MUTED, width)
            page.paste(Image.fromarray(panel.picture), (x, y + caption))
            x += width + _COLUMN_GAP
        y += caption + height + _GAP
    return page


def save_picture(path: Path, picture: Image.Image | npt.NDArray[Any]) -> None:
    """Write a picture as PNG, whole or not at all.

    Parameters
    ----------
    path : path
        Where to; an existing file is replaced.
    picture : PIL.Image.Image or ndarray, (H, W, 3)
        sRGB, as uint8 or as floats whose white is 1; it is not encoded again.
    """
    if isinstance(picture, np.ndarray):
        picture = Image.fromarray(picture if picture.dtype == np.uint8 else _quantized(picture))
    with replace_files(path) as (partial,):
        picture.save(partial, format="PNG", optimize=True)


def _quantized(encoded: npt.NDArray[np.floating]) -> Picture:
    picture: Picture = np.round(np.clip(encoded, 0, 1) * 255).astype(np.uint8)
    return picture


def _display_error(picture: Picture, reference: Picture) -> npt.NDArray[np.float64]:
    difference = (picture.astype(np.float64) - reference) / 255
    error: npt.NDArray[np.float64] = np.sqrt(np.square(difference).mean(axis=-1))
    return error


def _detail(picture: Picture) -> npt.NDArray[np.float64]:
    """Gradient magnitude of a picture's luma."""
    luma = picture @ _LUMINANCE
    down = np.diff(luma, axis=0, append=luma[-1:])
    right = np.diff(luma, axis=1, append=luma[:, -1:])
    magnitude: npt.NDArray[np.float64] = np.hypot(down, right)
    return magnitude


def _heat(values: npt.NDArray[np.floating]) -> Picture:
    """Colours of values in [0, 1], with luminance that rises steadily."""
    stops = np.linspace(0, 1, len(_HEAT))
    channels = [np.interp(values, stops, channel) for channel in np.transpose(_HEAT)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


def _magnified(picture: Picture, factor: int) -> Picture:
    """Each pixel as a block, so that no filter hides what the pixels are."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def _framed(picture: Picture, windows: Sequence[Window], scale: int) -> Picture:
    image = Image.fromarray(_magnified(picture, scale))
    draw = ImageDraw.Draw(image)
    for window, color in zip(windows, FRAMES, strict=False):
        x, y, side = window.column * scale, window.row * scale, window.size * scale
        draw.rectangle((x, y, x + side - 1, y + side - 1), outline=color, width=_FRAME)
    return np.asarray(image)


def _crop_strip(picture: Picture, windows: Sequence[Window], zoom: int, width: int) -> Picture:
    """Set the windows side by side, spread over a panel's width."""
    side = windows[0].size * zoom
    strip = Image.new("RGB", (width, side), BACKGROUND)
    draw = ImageDraw.Draw(strip)
    for i, (window, color) in enumerate(zip(windows, FRAMES, strict=False)):
        x = round(i * (width - side) / (len(FRAMES) - 1))
        strip.paste(Image.fromarray(_magnified(window.of(picture), zoom)), (x, 0))
        draw.rectangle((x, 0, x + side - 1, side - 1), outline=color, width=_FRAME)
    return np.asarray(strip)


def _error_legend(width: int, height: int) -> Picture:
    """Explain the colours of the error maps and of the frames."""
    legend = Image.new("RGB", (width, height), BACKGROUND)
    draw = ImageDraw.Draw(legend)
    text = max(15, round(width / 27))
    y = text // 2
    _write(draw, (0, y), "error, as a share of white (RMS of sRGB)", text, MUTED, width)
    y += 2 * text
    ramp = _heat(np.broadcast_to(np.linspace(0, 1, width), (text, width)))
    legend.paste(Image.fromarray(ramp), (0, y))
    y += round(1.4 * text)
    _write(draw, (0, y), "0", text, MUTED, width)
    end = f"{ERROR_RANGE:.0%} or more"
    _write(draw, (width - round(_font(text).getlength(end)), y), end, text, MUTED, width)
    y += 3 * text
    for color, meaning in zip(FRAMES, _FRAME_MEANINGS, strict=True):
        draw.rectangle((0, y, text, y + text), outline=color, width=_FRAME)
        _write(draw, (2 * text, y), meaning, text, MUTED, width - 2 * text)
        y += round(1.8 * text)
    return np.asarray(legend)


def _caption_height(row: Sequence[Panel], text: int) -> int:
    if any(panel.note for panel in row):
        return round(2.75 * text)
    return round(1.6 * text) if any(panel.title for panel in row) else 0


def _write(
    draw: ImageDraw.ImageDraw,
    place: tuple[int, int],
    text: str,
    size: float,
    color: tuple[int, int, int],
    width: int,
) -> None:
    """Write one line, smaller where it would be wider than `width`."""
    needed = _font(size).getlength(text)
    if needed > width:
        size *= width / needed
    draw.text(place, text, fill=color, font=_font(size))


def _font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
