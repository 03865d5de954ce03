"""Cat's eye: lens shapes of known area and direction, nothing in the middle, no steps, no darkening."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fewrays import SampleError
from fewrays.aperture import Aperture
from fewrays.vignetting import CatsEye, FrontRim

Float64 = npt.NDArray[np.float64]

HEADERS = Path(__file__).parents[1] / "native" / "math"
SIZE = (24, 36)  # pixels, down and across


def overlap(distance: Float64) -> Float64:
    """Area of the overlap of two unit discs, from the integral of its width, in shares of a disc."""
    y = np.linspace(0, 1, 20001)
    width = 2 * (np.sqrt(1 - y**2) - np.asarray(distance)[..., None] / 2).clip(0)
    area: Float64 = 2 * ((width[..., 1:] + width[..., :-1]) / 2).sum(axis=-1) * (y[1] - y[0]) / math.pi
    return area


def displacements(strength: float, height: int, width: int) -> Float64:
    """Where the rim's centre appears from each pixel, (H, W, 2)."""
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    towards: Float64 = -strength * np.stack([x, y], axis=-1) / (math.hypot(width, height) / 2)
    return towards


@pytest.mark.parametrize("strength", [0.4, 1.0])
def test_light_that_is_left_is_the_overlap_of_two_discs(strength: float) -> None:
    weights = CatsEye(strength, darken=True).weights(Aperture().points(4096), *SIZE)
    exact = overlap(np.hypot(*np.moveaxis(displacements(strength, *SIZE), -1, 0)))
    assert weights.mean(axis=0) == pytest.approx(exact, abs=0.006)


def test_the_corner_of_full_strength_keeps_the_overlap_of_discs_a_radius_apart() -> None:
    rim = CatsEye(1.0).front_rim(Aperture().points(10000), 100, 100)
    share = rim.passes(Aperture().points(10000), (0.0, 0.0)).mean()
    assert share == pytest.approx((2 * math.acos(0.5) - math.sqrt(3) / 2) / math.pi, abs=2e-3)


def test_lights_lose_the_side_that_faces_outwards() -> None:
    """The centre of the light left lies halfway to the rim's, which is displaced towards the middle."""
    uv = Aperture().points(4096)
    weights = CatsEye(1.0).weights(uv, *SIZE)
    centre = np.einsum("nij,nk->ijk", weights, uv) / len(uv)
    assert centre == pytest.approx(displacements(1.0, *SIZE) / 2, abs=0.02)


def test_the_long_axis_is_tangential() -> None:
    uv = Aperture().points(4096)
    rim = CatsEye(1.0).front_rim(uv, 100, 100)
    for angle in (0.0, 0.7, 2.0, 4.5):
        outward = np.array((math.cos(angle), math.sin(angle)))
        left = uv[rim.passes(uv, 50 + 49 * outward) > 0.5]
        along, across = np.ptp(left @ outward), np.ptp(left @ [-outward[1], outward[0]])
        distance = 49 / math.hypot(50, 50)
        assert along == pytest.approx(2 - distance, abs=0.05)
        assert across == pytest.approx(math.sqrt(4 - distance**2), abs=0.05)


@pytest.mark.parametrize("aperture", [Aperture(), Aperture("gaussian"), Aperture("polygon", squeeze=2.0)])
@pytest.mark.parametrize("count", [1, 16, 128])
def test_nothing_is_cut_without_strength_or_in_the_middle(aperture: Aperture, count: int) -> None:
    uv = aperture.points(count)
    for darken in (False, True):
        assert (CatsEye(0.0, darken).weights(uv, *SIZE) == 1).all()
        assert (CatsEye(1.0, darken).weights(uv, 5, 7)[:, 2, 3] == 1).all()


@pytest.mark.parametrize("count", [16, 64, 128, 512])
def test_points_fade_instead_of_dropping_out(count: int) -> None:
    """Along an image of 1000 px no point changes by more than the rim moves over its softness."""
    uv = Aperture().points(count)
    soft = CatsEye(1.0, darken=True).weights(uv, 1, 1000)[:, 0]
    moves = 1 / 500  # lens radii from pixel to pixel; the soft zone itself moves half as much at most
    assert np.abs(np.diff(soft)).max() <= 1.5 * moves / math.sqrt(math.pi / count) + 1e-12
    displacement = (np.arange(1000) - 499.5) / 500
    hard = np.hypot(uv[:, :1] + displacement, uv[:, 1:]) <= 1
    exact = overlap(np.abs(displacement))
    soft_step, hard_step, exact_step = (
        np.abs(np.diff(light)).max() for light in (soft.mean(axis=0), hard.mean(axis=0), exact)
    )
    assert soft_step < 2.5 * exact_step
    if count < 512:  # with half as many points as pixels along the way, the steps of a hard rim are small too
        assert soft_step < hard_step / 2


@given(
    strength=st.floats(0, 1),
    count=st.integers(1, 40),
    height=st.integers(1, 9),
    width=st.integers(1, 9),
    squeeze=st.floats(0.125, 8),
)
def test_every_pixel_keeps_its_light(
    strength: float, count: int, height: int, width: int, squeeze: float
) -> None:
    uv = Aperture(squeeze=squeeze).points(count)
    weights = CatsEye(strength).weights(uv, height, width)
    assert weights.shape == (count, height, width)
    assert (weights >= 0).all()
    assert weights.sum(axis=0) == pytest.approx(np.full((height, width), count))
    dark = CatsEye(strength, darken=True).weights(uv, height, width)
    assert (dark >= 0).all()
    assert (dark <= 1).all()


def test_an_aperture_beside_the_rim_is_not_lost() -> None:
    """Points so far off the centre that a corner's rim passes none of them count in full there."""
    uv = np.tile([[0.7, 0.7]], (400, 1))
    weights = CatsEye(1.0).weights(uv, 64, 64)
    assert (CatsEye(1.0, darken=True).weights(uv, 64, 64)[:, -1, -1] == 0).all()
    assert (weights.sum(axis=0) == pytest.approx(400)) and np.isfinite(weights).all()


def test_bad_input_is_named() -> None:
    for strength in (-0.1, 1.1, math.nan, math.inf):
        with pytest.raises(SampleError, match="from 0 to 1") as error:
            CatsEye(strength)
        assert error.value.field == "cats_eye"
    for uv in (np.zeros((0, 2)), np.zeros(2), np.zeros((3, 3))):
        with pytest.raises(SampleError, match="shape") as error:
            CatsEye(0.5).weights(uv, 4, 4)
        assert error.value.field == "uv"


_COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")


@pytest.mark.skipif(_COMPILER is None, reason="needs a C++ compiler")
def test_the_native_function_is_its_twin(tmp_path: Path) -> None:
    assert _COMPILER is not None
    source, library = tmp_path / "twin.cpp", tmp_path / "twin.so"
    source.write_text(
        '#include "cats_eye.h"\n'
        'extern "C" float twin(float u, float v, float x, float y, const fewrays::FrontRim* rim) {\n'
        "    return fewrays::cats_eye_weight(u, v, x, y, *rim);\n}\n"
    )
    command = [
        _COMPILER,
        "-std=c++20",
        "-shared",
        "-fPIC",
        "-I",
        str(HEADERS),
        str(source),
        "-o",
        str(library),
    ]
    subprocess.run(command, check=True, timeout=60)
    twin = ctypes.CDLL(str(library)).twin
    twin.restype = ctypes.c_float
    uv = Aperture("gaussian", sigma=0.6).points(50)
    for strength in (0.0, 0.3, 1.0):
        rim = CatsEye(strength).front_rim(uv, 5, 8)
        names = ("centre_x", "centre_y", "per_pixel", "radius", "softness")
        native = (ctypes.c_float * 5)(*(getattr(rim, name) for name in names))
        for x, y in ((0.5, 0.5), (4.0, 2.5), (7.5, 0.5), (3.5, 4.5)):
            found = [twin(*(ctypes.c_float(n) for n in (u, v, x, y)), native) for u, v in uv]
            assert found == pytest.approx(rim.passes(uv, (x, y)), abs=3e-6)


def test_the_rim_holds_for_any_shape_of_arguments() -> None:
    rim = FrontRim(4.0, 3.0, 0.2, 1.0, 0.1)
    assert rim.passes((0.0, 0.0), (4.0, 3.0)) == 1
    assert rim.passes(np.zeros((5, 1, 2)), np.zeros((7, 2))).shape == (5, 7)
