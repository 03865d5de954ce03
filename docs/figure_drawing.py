"""How figures are drawn: colours, plots, magnified pictures, and where they are written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from fewrays.display import Panel, save_picture, sheet
from fewrays.method import Image

IMAGES = Path(__file__).parent / "images"

Picture = npt.NDArray[np.uint8]
Color = tuple[int, int, int]

PAPER: Color = (250, 250, 247)
INK: Color = (32, 34, 40)
GREY: Color = (150, 152, 158)
ORANGE: Color = (214, 96, 12)
BLUE: Color = (24, 110, 190)
GREEN: Color = (40, 140, 70)


class Plot:
    """A picture with axes, drawn at twice its size so that lines come out smooth."""

    def __init__(
        self,
        width: int,
        height: int,
        x: tuple[float, float],
        y: tuple[float, float],
        background: Color = PAPER,
    ) -> None:
        self.size, self.x, self.y = (2 * width, 2 * height), x, y
        self.image = Pillow.new("RGB", self.size, background)
        self.draw = ImageDraw.Draw(self.image)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return where a point lies in the picture."""
        across = (x - self.x[0]) / (self.x[1] - self.x[0]) * self.size[0]
        return across, (self.y[1] - y) / (self.y[1] - self.y[0]) * self.size[1]

    def line(self, points: Sequence[tuple[float, float]], color: Color, width: int = 2) -> None:
        """Draw a polyline."""
        self.draw.line([self.at(*p) for p in points], color, 2 * width, joint="curve")

    def dot(self, x: float, y: float, color: Color, radius: float = 2.5) -> None:
        """Draw a dot."""
        cx, cy = self.at(x, y)
        r = 2 * radius
        self.draw.ellipse((cx - r, cy - r, cx + r, cy + r), color)

    def text(self, x: float, y: float, text: str, color: Color = INK, size: int = 15) -> None:
        """Write on a light ground, left end at a point."""
        place, font = self.at(x, y), ImageFont.load_default(2 * size)
        left, top, right, bottom = self.draw.textbbox(place, text, font=font, anchor="lm")
        self.draw.rectangle((left - 8, top - 6, right + 8, bottom + 6), PAPER)
        self.draw.text(place, text, color, font=font, anchor="lm")

    def picture(self) -> Picture:
        """Return the picture at its size."""
        half = (self.size[0] // 2, self.size[1] // 2)
        return np.asarray(self.image.resize(half, Pillow.Resampling.LANCZOS))


def enlarge(picture: Picture, factor: int) -> Picture:
    """Magnify by a whole number, each pixel a block."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def write(name: str, rows: Sequence[Sequence[Panel]]) -> None:
    """Write a sheet of panels to ``images/<name>.png``."""
    IMAGES.mkdir(exist_ok=True)
    path = IMAGES / f"{name}.png"
    page = sheet(rows)
    save_picture(path, page)
    print(f"\n{path.name}: {page.width} x {page.height}, {path.stat().st_size / 1000:.0f} kB")


def difference(image: Image, truth: Image, factor: float) -> Picture:
    """Return the difference of two images, magnified, around grey."""
    return np.asarray(255 * np.clip(0.5 + factor * (image - truth), 0, 1), np.uint8)


def layer_colors(shares: npt.NDArray[np.floating]) -> Image:
    """Mix one colour per layer by the layers' shares of each pixel, (H, W, L)."""
    place = np.linspace(0, 1, shares.shape[2])[:, None]
    palette = np.hstack(
        [np.clip(1 - 2 * place, 0, 1), 1 - np.abs(2 * place - 1), np.clip(2 * place - 1, 0, 1)]
    )
    return np.asarray(shares @ palette, np.float32)


def visible_opacity(opacity: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Return what each layer shows of itself, from opacities front to back."""
    behind = np.cumprod(1 - opacity, axis=2)
    result: npt.NDArray[np.floating] = opacity * np.concatenate(
        [np.ones_like(behind[..., :1]), behind[..., :-1]], axis=2
    )
    return result
