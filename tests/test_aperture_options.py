"""The aperture among the options: every way to ask for one, images from files, and what is refused."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import Lens, SampleError, load_image, save_image
from fewrays.aperture import Aperture, ApertureImage
from fewrays.aperture_options import ApertureOptions, load_aperture_image
from fewrays.temporal import TemporalOptions

DISC = Lens(-3.0, 1.0)
GAUSSIAN = Lens(-3.0, 1.0, aperture="gaussian", sampling="gaussian", sigma=0.4)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "aperture.exr"
    save_image(path, np.array([[0.0, 1.0], [0.5, 0.25]]))
    return path


def test_by_default_it_is_the_lens_s_own() -> None:
    for lens in (DISC, GAUSSIAN):
        assert ApertureOptions().aperture_of(lens) == Aperture.of_lens(lens)
        squeezed = ApertureOptions(squeeze=2.0).aperture_of(lens)
        assert squeezed == Aperture(lens.aperture, sigma=lens.sigma, squeeze=2.0)


def test_blades_make_a_polygon() -> None:
    options = ApertureOptions(blades=5, rotation=12.0, roundness=0.3, squeeze=1.5)
    expected = Aperture("polygon", GAUSSIAN.sigma, 5, 12.0, 0.3, 1.5)
    assert options.aperture_of(GAUSSIAN) == expected


@pytest.mark.parametrize("options_class", [ApertureOptions, TemporalOptions])
def test_an_image_is_loaded_once(picture: Path, options_class: type[ApertureOptions]) -> None:
    with patch("fewrays.aperture_options.load_image", wraps=load_image) as load:
        options = options_class(aperture_image=picture, squeeze=2.0)
        apertures = [options.aperture_of(lens) for lens in (DISC, GAUSSIAN, DISC)]
    assert load.call_count == 1
    image = ApertureImage([[0.0, 1.0], [0.5, 0.25]])
    assert apertures == [Aperture("image", image=image, squeeze=2.0)] * 3
    assert asdict(options)["aperture_image"] == picture  # and not its pixels: it is what a header says


def test_colours_count_by_luminance_after_decoding(tmp_path: Path) -> None:
    path = tmp_path / "colours.png"
    save_image(path, np.array([[(1, 0, 0), (0, 1, 0)], [(0, 0, 1), (0.5, 0.5, 0.5)]], np.float32))
    pixels = load_aperture_image(path).pixels
    assert pixels == pytest.approx(np.array([[0.2126, 0.7152], [0.0722, 0.5]]), abs=0.003)


@pytest.mark.parametrize(
    ("pixels", "problem"),
    [(np.zeros((3, 3)), "black"), (np.array([[1.0, -2.0]]), "got -2 at row 0, column 1")],
)
def test_bad_pictures_are_named(tmp_path: Path, pixels: np.ndarray, problem: str) -> None:
    path = tmp_path / "bad.exr"
    save_image(path, pixels)
    with pytest.raises(SampleError, match=problem) as error:
        ApertureOptions(aperture_image=path)
    assert error.value.file == str(path)
    assert error.value.field == "aperture_image"


def test_a_missing_or_unknown_file_is_named_when_the_options_are_made(tmp_path: Path) -> None:
    for name in ("missing.png", "aperture.jpg"):
        with pytest.raises(SampleError, match=re.escape(name)):
            TemporalOptions(aperture_image=tmp_path / name)


def test_blades_and_an_image_exclude_each_other(picture: Path) -> None:
    with pytest.raises(SampleError, match="5 blades") as error:
        ApertureOptions(blades=5, aperture_image=picture)
    assert error.value.field == "aperture_image"


@given(
    blades=st.integers(-5, 100),
    rotation=st.floats(),
    roundness=st.floats(),
    squeeze=st.floats(),
    locations=st.integers(1, 40),
)
def test_any_options_make_an_aperture_or_name_what_is_wrong(
    blades: int, rotation: float, roundness: float, squeeze: float, locations: int
) -> None:
    try:
        options = ApertureOptions(blades=blades, rotation=rotation, roundness=roundness, squeeze=squeeze)
    except SampleError as error:
        assert error.field in {"blades", "rotation", "roundness", "squeeze"}
        return
    aperture = options.aperture_of(DISC)
    assert aperture.contains(aperture.points(locations)).all()
    assert 0 < aperture.area <= np.pi + 1e-9


@pytest.mark.parametrize("squeeze", [0.1, 9.0, float("nan"), -2.0, 0.0])
def test_a_bad_squeeze_is_named(squeeze: float) -> None:
    with pytest.raises(SampleError, match=re.escape("from 0.125 to 8")) as error:
        TemporalOptions(squeeze=squeeze)
    assert error.value.field == "squeeze"
