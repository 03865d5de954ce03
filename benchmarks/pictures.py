"""Pictures of the quality page: a comparison sheet for each scene, and the README's before and after."""

from __future__ import annotations

from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from fewrays.display import Candidate, auto_exposure, comparison_sheet, tone_map
from fewrays.method import Image

__all__ = ["hero", "scene_sheet"]

SHEET_WIDTH, HERO_WIDTH = 1600, 1280  # pixels

_LEAN = 0.12  # how far the split leans to the right towards the top, as a share of the height
_LINE = 2.0  # pixels
_SMOOTH = 4  # the split is drawn this much larger and then reduced, for smooth edges
_LABEL = 22  # pixels


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
