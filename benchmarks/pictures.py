"""Pictures of the pages: comparison sheets, the README's before and after, lights, and line charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from fewrays.display import Candidate, Panel, auto_exposure, comparison_sheet, sheet, tone_map
from fewrays.method import Image
from lights import Measured

__all__ = ["Curve", "hero", "light_sheet", "line_chart", "scene_sheet"]

Curve = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""Abscissae and ordinates, ``(N,)`` each."""

SHEET_WIDTH, HERO_WIDTH = 1600, 1280  # pixels

_LEAN = 0.12  # how far the split leans to the right towards the top, as a share of the height
_LINE = 2.0  # pixels
_SMOOTH = 4  # the split is drawn this much larger and then reduced, for smooth edges
_LABEL = 22  # pixels

_LIGHT_CROP, _LIGHT_ZOOM = 56, 4  # pixels
_CHART = (1200, 300)  # width and height of a chart's frame in pixels
_AXES = (90, 50)  # room for labels on its left and below
_COLORS = ((150, 152, 158), (24, 110, 190), (214, 96, 12), (40, 140, 70))
_PAPER, _INK, _GRID = (255, 255, 255), (32, 34, 40), (228, 228, 224)


def scene_sheet(candidates: list[Candidate], reference: Candidate) -> Pillow.Image:
    """Return `fewrays.display.comparison_sheet` at `SHEET_WIDTH`, small enough for a web page."""
    sheet = comparison_sheet(candidates, reference)
    height = round(sheet.height * SHEET_WIDTH / sheet.width)
    return sheet.resize((SHEET_WIDTH, height), Pillow.Resampling.LANCZOS)


def hero(before: Candidate, after: Candidate, reference: Image) -> Pillow.Image:
    """Return one view, on the left as it was before, on the right as it is after.

    Parameters
    ----------
    before, after : Candidate
        Images (H, W, 3) of linear radiance; the titles are written on them.
    reference : ndarray, (H, W, 3)
        Only sets the exposure.

    Returns
    -------
    PIL.Image.Image
        `HERO_WIDTH` pixels wide.
    """
    exposure = auto_exposure(reference)
    left, right = (_enlarged(Pillow.fromarray(tone_map(c.image, exposure))) for c in (before, after))
    picture = Pillow.composite(left, right, _band(left.size, -left.width, 0))
    picture.paste((255, 255, 255), mask=_band(left.size, -_LINE / 2, _LINE / 2))
    _label(picture, before.title, right_side=False)
    _label(picture, after.title, right_side=True)
    return picture


def light_sheet(measured: Sequence[Measured]) -> Pillow.Image:
    """Return every light's truth and images in a row: exposed for the scene, and for the light's peak."""
    rows = []
    for one in measured:
        images = {"truth": one.truth, **one.images}
        to_peak = math.log2(0.8 / float(one.truth.max()))
        rows.append([Panel(_middle(image, -1.0), name, _note(name, one)) for name, image in images.items()])
        rows.append([Panel(_middle(image, to_peak)) for image in images.values()])
    return sheet(rows)


def _note(name: str, one: Measured) -> str:
    return one.case.name if name == "truth" else ""


def _middle(image: Image, exposure: float) -> npt.NDArray[np.uint8]:
    """Return the middle of an image, where the light is, magnified."""
    row, column = ((side - _LIGHT_CROP) // 2 for side in image.shape[:2])
    picture = tone_map(image[row : row + _LIGHT_CROP, column : column + _LIGHT_CROP], exposure)
    return picture.repeat(_LIGHT_ZOOM, axis=0).repeat(_LIGHT_ZOOM, axis=1)


def line_chart(charts: Mapping[str, Mapping[str, Curve]], abscissa: str, ordinate: str) -> Pillow.Image:
    """Return charts of curves by name, one below the other, each under its title.

    Parameters
    ----------
    charts : mapping
        ``charts[title][name]`` is a `Curve`; at most four of them in a chart.
    abscissa, ordinate : str
        Labels of the axes, the same for all charts.

    Returns
    -------
    PIL.Image.Image
    """
    height = _CHART[1] + 2 * _AXES[1]
    page = Pillow.new("RGB", (_CHART[0] + _AXES[0] + 30, height * len(charts)), _PAPER)
    for number, (title, curves) in enumerate(charts.items()):
        _draw_chart(ImageDraw.Draw(page), (_AXES[0], number * height + _AXES[1]), title, curves)
        draw, font = ImageDraw.Draw(page), ImageFont.load_default(16)
        base = number * height + _AXES[1] + _CHART[1]
        draw.text((_AXES[0] + _CHART[0], base + 26), abscissa, fill=_INK, font=font, anchor="ra")
        draw.text((_AXES[0] + _CHART[0], base - _CHART[1] - 8), ordinate, fill=_INK, font=font, anchor="rs")
    return page


def _draw_chart(
    draw: ImageDraw.ImageDraw, corner: tuple[int, int], title: str, curves: Mapping[str, Curve]
) -> None:
    """Draw grid, curves and legend into a frame whose left upper corner is given."""
    left, top = corner
    width, height = _CHART
    x_min = min(float(x.min()) for x, _ in curves.values())
    x_max = max(float(x.max()) for x, _ in curves.values())
    y_max = 1.05 * max(float(y.max()) for _, y in curves.values())
    small = ImageFont.load_default(14)

    def place(x: float, y: float) -> tuple[float, float]:
        return left + (x - x_min) / (x_max - x_min) * width, top + height - y / y_max * height

    for tick in _ticks(x_min, x_max):
        draw.line([place(tick, 0), place(tick, y_max)], _GRID)
        draw.text((place(tick, 0)[0], top + height + 6), f"{tick:g}", fill=_INK, font=small, anchor="ma")
    for tick in _ticks(0, y_max):
        draw.line([place(x_min, tick), place(x_max, tick)], _GRID)
        draw.text((left - 8, place(x_min, tick)[1]), f"{tick:g}", fill=_INK, font=small, anchor="rm")
    font = ImageFont.load_default(18)
    draw.text((left, top - 10), title, fill=_INK, font=font, anchor="ls")
    legend = left + font.getlength(title) + 40
    for (name, (x, y)), color in zip(curves.items(), _COLORS, strict=False):
        draw.line([place(*point) for point in zip(x.tolist(), y.tolist(), strict=True)], color, 2)
        draw.text((legend, top - 10), name, fill=color, font=font, anchor="ls")
        legend += font.getlength(name) + 24


def _ticks(start: float, end: float) -> list[float]:
    """Round numbers, some six of them, between two values."""
    rough = (end - start) / 6
    unit = 10 ** math.floor(math.log10(rough))
    step = next(unit * m for m in (1, 2, 5, 10) if unit * m >= rough)
    return [step * i for i in range(math.ceil(start / step), math.floor(end / step) + 1)]


def _enlarged(picture: Pillow.Image) -> Pillow.Image:
    height = round(picture.height * HERO_WIDTH / picture.width)
    return picture.resize((HERO_WIDTH, height), Pillow.Resampling.BICUBIC)


def _band(size: tuple[int, int], start: float, end: float) -> Pillow.Image:
    """Mask of what lies between `start` and `end` pixels to the right of the split."""
    width, height = (side * _SMOOTH for side in size)
    top, bottom = (width + _LEAN * height) / 2, (width - _LEAN * height) / 2
    start, end = start * _SMOOTH, end * _SMOOTH
    mask = Pillow.new("L", (width, height))
    corners = [(top + start, 0), (top + end, 0), (bottom + end, height), (bottom + start, height)]
    ImageDraw.Draw(mask).polygon(corners, fill=255)
    return mask.resize(size, Pillow.Resampling.BOX)


def _label(picture: Pillow.Image, text: str, *, right_side: bool) -> None:
    """Write white text on a dark, translucent ground into a lower corner."""
    font = ImageFont.load_default(_LABEL)
    margin, pad = _LABEL, _LABEL // 2
    width, height = round(font.getlength(text)) + 2 * pad, _LABEL + 2 * pad
    x = picture.width - margin - width if right_side else margin
    y = picture.height - margin - height
    ground = Pillow.new("L", (width, height))
    ImageDraw.Draw(ground).rounded_rectangle((0, 0, width - 1, height - 1), pad, fill=165)
    picture.paste((12, 13, 16), (x, y), ground)
    middle = (x + width / 2, y + height / 2)
    ImageDraw.Draw(picture).text(middle, text, fill=(255, 255, 255), font=font, anchor="mm")
