"""Metrics by hand-computed values and invariants."""

import importlib
import math
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays.errors import SampleError
from fewrays.metrics import (
    compare,
    error_heatmap,
    flip,
    flip_map,
    psnr,
    psnr_display,
    relmse,
    ssim,
)

METRICS = [psnr, psnr_display, relmse, ssim, flip, flip_map, error_heatmap, compare]


def _flat(value: float) -> np.ndarray:
    return np.full((16, 20, 3), value)


def _noisy(spread: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:32, :40] / 6
    clean = 0.5 + 0.3 * np.sin(x)[..., None] * np.cos(y)[..., None] * [1, 0.5, 0.8]
    return clean + spread * rng.normal(size=clean.shape), clean


def test_psnr_by_hand() -> None:
    assert psnr(_flat(0.6), _flat(0.5)) == pytest.approx(20.0)
    assert psnr(_flat(6.0), _flat(5.0), peak=10.0) == pytest.approx(20.0)
    half = _flat(0.5)
    half[:8] += 0.1  # the error's mean square halves: 10 log10(2) dB more
    assert psnr(half, _flat(0.5)) == pytest.approx(20 + 10 * math.log10(2))


def test_psnr_display_by_hand() -> None:
    level = 0.6**2.2
    assert psnr_display(_flat(level), _flat(0.5**2.2)) == pytest.approx(20.0)
    assert psnr_display(_flat(7.0), _flat(1.0)) == math.inf  # both are white on a display
    assert psnr_display(_flat(-0.5), _flat(0.0)) == math.inf


def test_relmse_by_hand() -> None:
    assert relmse(_flat(1.1), _flat(1.0)) == pytest.approx(0.01 / 1.01)
    assert relmse(_flat(0.1), _flat(0.0)) == pytest.approx(1.0)
    # One channel of three.
    image = _flat(2.0)
    image[..., 1] += 1
    assert relmse(image, _flat(2.0)) == pytest.approx(1 / 4.01 / 3)


@given(scale=st.floats(0.01, 100))
def test_linear_psnr_with_its_peak_ignores_units(scale: float) -> None:
    image, clean = _noisy(0.05)
    assert psnr(scale * image, scale * clean, peak=scale) == pytest.approx(psnr(image, clean), abs=1e-9)


def test_equal_images() -> None:
    _, clean = _noisy(0)
    result = compare(clean, clean)
    assert (result.psnr, result.psnr_display, result.relmse, result.flip) == (math.inf, math.inf, 0, 0)
    assert result.ssim == pytest.approx(1)


def test_more_noise_is_worse_by_every_metric() -> None:
    slight, strong = (compare(*_noisy(spread)) for spread in (0.01, 0.1))
    assert slight.psnr > strong.psnr + 15
    assert slight.psnr_display > strong.psnr_display + 15
    assert slight.relmse < strong.relmse
    assert slight.ssim is not None
    assert strong.ssim is not None
    assert slight.ssim > strong.ssim + 0.1
    assert slight.flip is not None
    assert strong.flip is not None
    assert slight.flip < strong.flip - 0.05


def test_flip_map_shows_where_the_difference_is() -> None:
    image, clean = _noisy(0)
    image[10:14, 20:24] += 0.4
    errors = flip_map(image, clean)
    assert errors.shape == (32, 40)
    assert errors.dtype == np.float32
    row, column = np.unravel_index(errors.argmax(), errors.shape)
    assert 10 <= row < 14
    assert 20 <= column < 24
    assert errors[:, :5].max() == 0
    assert flip(image, clean) == pytest.approx(errors.mean(), rel=1e-5)


def test_heatmap_is_black_to_pale_yellow() -> None:
    same = error_heatmap(_flat(0.3), _flat(0.3))
    assert same.shape == (16, 20, 3)
    assert same.dtype == np.float32
    assert same.max() < 0.02
    opposite = error_heatmap(_flat(0.0), _flat(1.0))[8, 10]
    assert opposite[0] > 0.95
    assert opposite[0] > opposite[1] > opposite[2] > 0.5
    assert opposite.max() <= 1


def test_a_table_is_printed() -> None:
    table = str(compare(*_noisy(0.05)))
    assert len(table.splitlines()) == 5
    assert "PSNR (clip, gamma 2.2)" in table
    assert "FLIP" in table
    assert len({len(line) for line in table.splitlines()}) == 1


def test_without_the_extra_the_rest_is_still_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("flip_evaluator", "skimage", "skimage.metrics"):
        monkeypatch.setitem(sys.modules, module, None)  # importing it now raises ImportError
    result = compare(*_noisy(0.05))
    assert result.psnr > 20
    assert (result.ssim, result.flip) == (None, None)
    assert str(result).count("not available") == 2
    for metric in (ssim, flip, error_heatmap):
        with pytest.raises(ImportError, match=r'pip install "fewrays\[metrics\]"'):
            metric(*_noisy(0.05))


def test_importing_the_module_needs_no_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("flip_evaluator", "skimage", "skimage.metrics"):
        monkeypatch.setitem(sys.modules, module, None)
    importlib.reload(sys.modules["fewrays.metrics"])


def test_images_smaller_than_the_ssim_window() -> None:
    small = np.full((10, 30, 3), 0.5)
    assert compare(small, small).ssim is None
    with pytest.raises(SampleError, match="11 x 11"):
        ssim(small, small)


@pytest.mark.parametrize("metric", METRICS)
def test_bad_images(metric: Callable[..., object]) -> None:
    with pytest.raises(SampleError, match=r"^image: shape \(16, 20, 3\) differs"):
        metric(_flat(1.0), np.ones((16, 21, 3)))
    with pytest.raises(SampleError, match=r"^reference: expected real numbers of shape"):
        metric(_flat(1.0), np.ones((16, 20)))
    bad = _flat(1.0)
    bad[3, 4, 1] = np.nan
    bad[9, 9, 2] = np.inf
    with pytest.raises(SampleError, match=r"^image: 2 of 960 .* \[3, 4, 1\]: nan"):
        metric(bad, _flat(1.0))


@pytest.mark.parametrize("peak", [0.0, -1.0, math.nan, math.inf])
def test_bad_peaks(peak: float) -> None:
    with pytest.raises(SampleError, match=r"^peak: "):
        psnr(_flat(1.0), _flat(0.5), peak=peak)
