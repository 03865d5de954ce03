from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from fewrays.color import srgb_decode
from fewrays.display import (
    BACKGROUND,
    ERROR_RANGE,
    FRAMES,
    Candidate,
    Panel,
    Window,
    auto_exposure,
    choose_windows,
    comparison_sheet,
    error_picture,
    save_picture,
    sheet,
    tone_map,
)


def solid(value: float, height: int = 8, width: int = 10) -> npt.NDArray[np.float32]:
    return np.full((height, width, 3), value, np.float32)


def panel_of(color: tuple[int, int, int], height: int = 40, width: int = 60) -> Panel:
    return Panel(np.broadcast_to(np.array(color, np.uint8), (height, width, 3)))


def count(image: Image.Image, color: tuple[int, int, int]) -> int:
    return int((np.asarray(image) == color).all(axis=-1).sum())


def test_tone_map_is_srgb() -> None:
    assert tone_map(solid(0.0)).max() == 0
    assert tone_map(solid(1.0)).min() == 255
    assert (tone_map(solid(0.21586)) == 128).all()  # ((128 / 255 + 0.055) / 1.055) ** 2.4
    assert tone_map(solid(7.0)).min() == 255
    assert tone_map(solid(-1.0)).max() == 0


@given(st.floats(0.001, 0.24), st.integers(-3, 2))
def test_one_stop_doubles_the_light(value: float, stops: int) -> None:
    picture = tone_map(solid(value), exposure=stops)
    shown = float(srgb_decode(picture[0, 0, 0] / np.float32(255)))
    assert shown == pytest.approx(
        min(value * 2.0**stops, 1), abs=0.5 / 255 * 2.3
    )  # half a code, steepest slope


def test_auto_exposure_undoes_a_scale() -> None:
    image = np.random.default_rng(0).gamma(1, 1, (20, 30, 3)).astype(np.float32)
    assert auto_exposure(image * 8) == pytest.approx(auto_exposure(image) - 3, abs=1e-4)
    assert auto_exposure(solid(0.8)) == pytest.approx(0, abs=1e-4)
    assert auto_exposure(solid(0.0)) == 0


def test_error_picture_ends_at_its_range() -> None:
    black = np.zeros((4, 5, 3), np.uint8)
    assert (error_picture(black, black) == 0).all()
    at_range = np.full_like(black, np.ceil(255 * ERROR_RANGE))
    assert (error_picture(at_range, black) == error_picture(at_range * 2, black)).all()
    luma = [
        float(error_picture(np.full_like(black, code), black).mean(axis=-1)[0, 0])
        for code in range(0, int(255 * ERROR_RANGE), 4)
    ]
    assert all(a < b for a, b in pairwise(luma))  # brighter always means worse


def test_windows_find_what_stands_out() -> None:
    score = np.zeros((60, 80))
    score[16:24, 48:56] = 1
    (window,) = choose_windows([score], 8)
    assert window == Window(16, 48, 8)


@given(st.integers(4, 60), st.integers(4, 60), st.integers(2, 30), st.integers(0, 9))
def test_windows_lie_inside_and_apart(height: int, width: int, size: int, seed: int) -> None:
    scores = list(np.random.default_rng(seed).random((3, height, width)))
    windows = choose_windows(scores, size)
    assert windows == choose_windows(scores, size)
    assert 1 <= len(windows) <= 3
    covered = np.zeros((height, width), int)
    for window in windows:
        part = covered[window.row : window.row + window.size, window.column : window.column + window.size]
        assert part.shape == (window.size, window.size)
        part += 1
    assert covered.max() == 1


def test_window_has_the_largest_mean() -> None:
    score = np.random.default_rng(3).random((24, 31))
    (window,) = choose_windows([score], 7)  # below eight pixels every place is a candidate
    means = np.lib.stride_tricks.sliding_window_view(score, (7, 7)).mean(axis=(2, 3))
    assert means[window.row, window.column] == pytest.approx(means.max(), rel=1e-12)


def test_sheet_shows_every_pixel_of_every_panel() -> None:
    red, green, blue = (200, 10, 10), (10, 200, 10), (10, 10, 200)
    page = sheet([[panel_of(red), panel_of(green, width=90)], [panel_of(blue, height=25)]])
    assert count(page, red) == 40 * 60
    assert count(page, green) == 40 * 90
    assert count(page, blue) == 25 * 60
    assert page.getpixel((0, 0)) == BACKGROUND


def test_captions_do_not_touch_the_pictures() -> None:
    white = (255, 255, 255)
    plain = panel_of(white, width=400)
    for title in ("short", "a title that is far too long for the width of its panel " * 3):
        captioned = Panel(plain.picture, title, "a note")
        page = sheet([[captioned]], title="headline")
        assert count(page, white) >= 40 * 400
        pixels = np.asarray(page)
        assert (pixels[:, -20:] == BACKGROUND).all()  # the text ends where the panel ends
        top = int(np.argmax((pixels == 255).all(axis=-1).sum(axis=1) >= 400))
        assert (pixels[top - 2 : top] == BACKGROUND).all()
        assert (pixels[:top] != BACKGROUND).any()  # there is text above


def test_comparison_sheet_marks_the_windows() -> None:
    rng = np.random.default_rng(0)
    reference = rng.random((90, 160, 3)).astype(np.float32)
    noisy = reference + rng.normal(0, 0.2, reference.shape).astype(np.float32)
    page = comparison_sheet(
        [Candidate(noisy, "noisy", "10 dB"), Candidate(reference, "exact", "inf dB")],
        Candidate(reference, "reference"),
        title="comparison",
    )
    assert page.size[0] > 3 * 640
    for color in FRAMES:
        assert count(page, color) > 6 * 4 * 100  # six frames each, at least a hundred pixels a side


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (7, 300), (300, 7)])
def test_comparison_sheet_of_odd_shapes(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).random((*shape, 3)).astype(np.float32)
    candidate = Candidate(image, "image")
    assert min(comparison_sheet([candidate], candidate, panel_width=64).size) > 64


def test_save_picture_takes_codes_floats_and_images(tmp_path: Path) -> None:
    codes = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    for picture in (codes, codes / np.float32(255), Image.fromarray(codes)):
        save_picture(tmp_path / "p.png", picture)
        with Image.open(tmp_path / "p.png") as read:
            assert (np.asarray(read) == codes).all()
    assert [file.name for file in tmp_path.iterdir()] == ["p.png"]
