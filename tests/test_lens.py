"""The lens against similar triangles, hand-computed cameras and moments."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fewrays.errors import SampleError
from fewrays.lens import Lens, LensAperture, Sampling


def _grid(cells: int) -> np.ndarray:
    """Midpoints of a fine grid over the square that bounds the lens."""
    axis = (np.arange(cells) + 0.5) / cells * 2 - 1
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def test_f_number_and_focal_length() -> None:
    # 50 mm on 36 mm at 720 px: K = 1000 px. f/2: R = 12.5 mm. Focus at 2 m.
    lens = Lens.thin_lens(720, focus_distance=2.0, focal_length=50.0, f_number=2.0)
    assert lens.c0 == pytest.approx(-12.5)
    assert lens.c1 == pytest.approx(6.25)
    assert float(lens.slope(4.0)) == pytest.approx(3.125)
    assert float(lens.slope(1.0)) == pytest.approx(-6.25)


def test_units_per_metre_scales_the_lens_radius_only() -> None:
    lens = Lens.thin_lens(720, focus_distance=200.0, focal_length=50.0, f_number=2.0, units_per_metre=100.0)
    assert lens.c0 == pytest.approx(-1250.0)
    assert lens.c1 == pytest.approx(6.25)


def test_sensor_width() -> None:
    lens = Lens.thin_lens(1000, focus_distance=1.0, focal_length=24.0, sensor_width=24.0, lens_radius=0.01)
    assert lens.c0 == pytest.approx(-10.0)


def test_field_of_view_and_lens_radius() -> None:
    # 90 degrees across 640 px: K = 320 px.
    lens = Lens.thin_lens(640, focus_distance=5.0, fov=90.0, lens_radius=0.1)
    assert lens.c0 == pytest.approx(-32.0)
    assert lens.c1 == pytest.approx(6.4)
    assert lens.focus_distance == pytest.approx(5.0)


@given(
    point=st.floats(-3, 3),
    depth=st.floats(0.2, 50),
    focus=st.floats(0.2, 50),
    radius=st.floats(0, 0.5),
    u=st.floats(-1, 1),
)
def test_slope_is_what_similar_triangles_give(
    point: float, depth: float, focus: float, radius: float, u: float
) -> None:
    lens = Lens.thin_lens(640, focus_distance=focus, fov=90.0, lens_radius=radius)
    # The ray from the lens point through the scene point meets the focal plane here; the lens centre sees
    # the focal plane sharp, so that is where the sensor records the ray.
    on_focal_plane = radius * u + (point - radius * u) * focus / depth
    recorded = 320 * on_focal_plane / focus
    predicted = 320 * point / depth + float(lens.slope(depth)) * u
    assert predicted == pytest.approx(recorded, abs=1e-6 * (1 + abs(recorded)))


@given(near=st.floats(0.01, 1e4), far=st.floats(0.01, 1e4), focus=st.floats(0.01, 1e4))
def test_slope_grows_with_depth_and_changes_sign_in_focus(near: float, far: float, focus: float) -> None:
    assume(near < 0.999 * far)
    lens = Lens.thin_lens(640, focus_distance=focus, fov=60.0, lens_radius=0.05)
    assert lens.slope(near) < lens.slope(far)
    assert abs(float(lens.slope(focus))) <= 1e-12 * abs(lens.c1)
    assert lens.slope(focus * 0.9) < 0 < lens.slope(focus * 1.1)


def test_slope_keeps_float32() -> None:
    lens = Lens(-3.0, 1.0)
    assert lens.slope(np.ones(2, np.float32)).dtype == np.float32
    assert lens.slope([1, 2]).dtype == np.float64
    assert lens.weights(np.zeros((2, 2), np.float32)).dtype == np.float32


@given(focus=st.floats(0.1, 1e3), scale=st.floats(0, 8), depth=st.floats(0.1, 1e3))
def test_refocus(focus: float, scale: float, depth: float) -> None:
    lens = Lens.thin_lens(640, focus_distance=2.0, fov=40.0, lens_radius=0.05, aperture="gaussian", sigma=0.3)
    moved = lens.refocus(focus, scale)
    direct = Lens.thin_lens(640, focus_distance=focus, fov=40.0, lens_radius=0.05 * scale)
    assert float(moved.slope(depth)) == pytest.approx(float(direct.slope(depth)), rel=1e-9, abs=1e-9)
    assert (moved.aperture, moved.sigma) == ("gaussian", 0.3)


def test_refocus_to_infinity_and_to_a_pinhole() -> None:
    lens = Lens(-10.0, 2.0)
    assert lens.refocus(math.inf).c1 == 0
    assert lens.refocus(math.inf).focus_distance == math.inf
    pinhole = lens.refocus(aperture_scale=0)
    assert not pinhole.slope([0.1, 5.0, 1e6]).any()
    assert math.isnan(pinhole.focus_distance)


def test_weights_by_hand() -> None:
    disc = Lens(-1.0, 1.0, aperture="disc", sampling="square")
    np.testing.assert_allclose(disc.weights([[0.0, 0.0], [0.6, 0.6], [0.9, 0.9]]), [4 / np.pi, 4 / np.pi, 0])

    gaussian = Lens(-1.0, 1.0, aperture="gaussian", sampling="square", sigma=1 / 3)
    centre = 4 / (2 * np.pi / 9 * math.erf(3 / math.sqrt(2)) ** 2)
    np.testing.assert_allclose(
        gaussian.weights([[0.0, 0.0], [1 / 3, 0.0], [1.0, 1.0]]), centre * np.exp([0, -0.5, -9]), rtol=1e-12
    )

    importance = Lens(-1.0, 1.0, aperture="gaussian", sampling="gaussian")
    np.testing.assert_array_equal(importance.weights([[0.0, 0.0], [0.9, -0.9]]), [1, 1])


@pytest.mark.parametrize("aperture", ["disc", "gaussian"])
@pytest.mark.parametrize("sampling", ["disc", "square", "gaussian"])
@pytest.mark.parametrize("sigma", [0.2, 1 / 3, 0.7])
def test_weights_turn_the_sampling_density_into_the_aperture(
    aperture: LensAperture, sampling: Sampling, sigma: float
) -> None:
    lens = Lens(-1.0, 1.0, aperture=aperture, sampling=sampling, sigma=sigma)
    uv = _grid(600)
    cell = (2 / 600) ** 2
    if sampling == "disc":
        uv = uv[np.square(uv).sum(axis=-1) <= 1]
    density = lens.sampling_density(uv) * cell
    assert density.sum() == pytest.approx(1, abs=2e-3)

    lost = 0.0  # of a Gaussian aperture, the part in the corners that disc sampling never sees
    if aperture == "gaussian" and sampling == "disc":
        inside = math.erf(1 / (sigma * math.sqrt(2)))
        lost = 1 - (1 - math.exp(-0.5 / sigma**2)) / inside**2
    assert (lens.weights(uv) * density).sum() == pytest.approx(1 - lost, abs=2e-3)


@pytest.mark.parametrize(("aperture", "sampling"), [("disc", "square"), ("gaussian", "square")])
def test_second_moment_is_that_of_gaussian_sigma(aperture: LensAperture, sampling: Sampling) -> None:
    lens = Lens(-1.0, 1.0, aperture=aperture, sampling=sampling, sigma=0.2)
    uv = _grid(800)
    weights = lens.weights(uv)
    moment = (weights * np.square(uv[..., 0])).sum() / weights.sum()
    assert math.sqrt(moment) == pytest.approx(lens.gaussian_sigma, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"c0": 1.0}, "lens.c0"),
        ({"c0": math.nan}, "lens.c0"),
        ({"c1": math.inf}, "lens.c1"),
        ({"c1": "wide"}, "lens.c1"),
        ({"sigma": 0.0}, "lens.sigma"),
        ({"sigma": None}, "lens.sigma"),
        ({"aperture": "square"}, "lens.aperture"),
        ({"sampling": "hexagon"}, "lens.sampling"),
    ],
)
def test_bad_lenses_name_the_field(arguments: dict[str, object], field: str) -> None:
    with pytest.raises(SampleError) as error:
        Lens(**{"c0": -1.0, "c1": 1.0, **arguments})  # type: ignore[arg-type]
    assert error.value.field == field


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"fov": 40.0}, "lens_radius"),
        ({"fov": 40.0, "f_number": 2.0}, "f_number"),
        ({"lens_radius": 0.1}, "fov"),
        ({"fov": 40.0, "focal_length": 50.0, "lens_radius": 0.1}, "fov"),
        ({"fov": 180.0, "lens_radius": 0.1}, "fov"),
        ({"fov": 40.0, "lens_radius": -0.1}, "lens_radius"),
        ({"fov": 40.0, "lens_radius": 0.1, "f_number": 2.0}, "lens_radius"),
        ({"fov": 40.0, "lens_radius": 0.1, "focus_distance": 0.0}, "focus_distance"),
        ({"focal_length": 50.0, "f_number": -2.0}, "f_number"),
    ],
)
def test_cameras_that_determine_no_lens(arguments: dict[str, float], field: str) -> None:
    with pytest.raises(SampleError) as error:
        Lens.thin_lens(640, **{"focus_distance": 2.0, **arguments})  # type: ignore[arg-type]
    assert error.value.field == field


@pytest.mark.parametrize("scale", [-1.0, math.nan, math.inf])
def test_bad_aperture_scales(scale: float) -> None:
    with pytest.raises(SampleError, match="aperture_scale"):
        Lens(-1.0, 1.0).refocus(aperture_scale=scale)


@pytest.mark.parametrize("focus", [0.0, -2.0, math.nan])
def test_bad_focus_distances(focus: float) -> None:
    with pytest.raises(SampleError, match="focus_distance"):
        Lens(-1.0, 1.0).refocus(focus)


def test_depth_is_the_inverse_of_slope() -> None:
    lens = Lens(-40.0, 8.0)
    for slope in (-30.0, 0.0, 7.5):
        assert float(lens.slope(lens.depth(slope))) == pytest.approx(slope, abs=1e-12)


@pytest.mark.parametrize(
    ("lens", "slope"), [(Lens(-40.0, 8.0), 8.0), (Lens(-40.0, 8.0), np.nan), (Lens(0, 0), 0.0)]
)
def test_slopes_that_no_depth_has_are_rejected(lens: Lens, slope: float) -> None:
    with pytest.raises(SampleError) as caught:
        lens.depth(slope)
    assert caught.value.field == "slope"
