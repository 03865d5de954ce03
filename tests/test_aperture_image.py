"""Aperture images: points against the image's own moments, never in the dark, as even as a disc's."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fewrays import SampleError
from fewrays.aperture import Aperture, ApertureImage

Float64 = npt.NDArray[np.float64]


def middles(height: int, width: int) -> tuple[Float64, Float64]:
    """Lens positions u and v of the middles of pixels, (h, w) each."""
    u, v = np.meshgrid((2 * np.arange(width) + 1) / width - 1, (2 * np.arange(height) + 1) / height - 1)
    return u, v


def painted(inside: Callable[[Float64, Float64], npt.NDArray[np.bool_]], size: int = 64) -> Float64:
    """Antialiased image of a shape."""
    fine = inside(*middles(4 * size, 4 * size)).astype(np.float64)
    image: Float64 = fine.reshape(size, 4, size, 4).mean(axis=(1, 3))
    return image


def disc(u: Float64, v: Float64) -> npt.NDArray[np.bool_]:
    return np.asarray(np.hypot(u, v) < 1)


def ring(u: Float64, v: Float64) -> npt.NDArray[np.bool_]:
    return disc(u, v) & (np.hypot(u, v) > 0.45)


def spots(u: Float64, v: Float64) -> npt.NDArray[np.bool_]:
    return np.asarray((np.hypot(u - 0.5, v) < 0.4) | (np.hypot(u + 0.5, v + 0.2) < 0.35))


def ramp(size: int = 48) -> Float64:
    """A disc that is lighter towards the lower right."""
    u, v = middles(size, size)
    image: Float64 = painted(disc, size) * (1 + 0.5 * u + 0.3 * v)
    return image


IMAGES = {
    "disc": painted(disc),
    "ring": painted(ring),
    "spots": painted(spots),
    "ramp": ramp(),
    "noise": np.random.default_rng(4).random((20, 33)) ** 3,
    "one pixel of many": np.pad([[1.0]], ((3, 60), (40, 23))),
    "wide": np.array([[0.0, 1.0, 2.0, 0.5]]),
}
images = pytest.mark.parametrize("pixels", IMAGES.values(), ids=IMAGES)


def of(pixels: npt.ArrayLike, squeeze: float = 1.0) -> Aperture:
    return Aperture("image", image=ApertureImage(pixels), squeeze=squeeze)


def moments(pixels: Float64) -> Float64:
    """Means of u, v, u², u v and v² over constant pixels."""
    height, width = pixels.shape
    u, v = middles(height, width)
    terms = (u, v, u**2 + 1 / (3 * width**2), u * v, v**2 + 1 / (3 * height**2))
    return np.array([(pixels * term).sum() / pixels.sum() for term in terms])


def means(uv: Float64) -> Float64:
    """Means of the same over points."""
    u, v = uv.T
    return np.array([term.mean() for term in (u, v, u**2, u * v, v**2)])


@images
@pytest.mark.parametrize("count", [64, 256, 4096])
def test_points_have_the_moments_of_the_image(pixels: Float64, count: int) -> None:
    spread = np.ptp(np.argwhere(pixels > 0) / pixels.shape, axis=0).max() + 1 / max(pixels.shape)
    assert means(of(pixels).points(count)) == pytest.approx(moments(pixels), abs=2 * spread / count + 1e-3)


@images
def test_points_share_out_the_light(pixels: Float64) -> None:
    """Every quarter and ninth of the image holds as many points as its light says, but for its border."""
    count = 4096
    uv = of(pixels).points(count)
    fine = np.kron(pixels, np.ones((6, 6)))  # that parts are whole pixels
    for parts in (2, 3):
        height, width = fine.shape[0] // parts, fine.shape[1] // parts
        light = fine[: height * parts, : width * parts].reshape(parts, height, parts, width).sum(axis=(1, 3))
        column, row = np.clip(((uv + 1) / 2 * parts).astype(int), 0, parts - 1).T
        found = np.bincount(row * parts + column, minlength=parts**2)
        assert found == pytest.approx(count * light.ravel() / light.sum(), abs=0.006 * count)


@images
@pytest.mark.parametrize("squeeze", [1.0, 2.0, 0.5])
def test_no_point_lies_in_the_dark(pixels: Float64, squeeze: float) -> None:
    aperture = of(pixels, squeeze)
    uv = aperture.points(5000)
    assert np.abs(uv).max() <= 1
    for points in (uv, uv.astype(np.float32)):  # a position on a border may be rounded across it
        assert aperture.contains(points).all()
        assert (aperture.density(points) > 0).all()


def errors_of_half_planes(uv: Float64, pixels: Float64) -> tuple[float, float]:
    """Root-mean-square error of shares of light on one side of lines, and that of random points."""
    rng = np.random.default_rng(1)
    mean = moments(pixels)
    spread = math.sqrt((mean[2] - mean[0] ** 2 + mean[4] - mean[1] ** 2) / 2)
    angle, shift = rng.uniform(0, 2 * math.pi, 400), rng.uniform(-1.5, 1.5, 400) * spread
    normals = np.stack([np.cos(angle), np.sin(angle)])
    fine = np.kron(pixels, np.ones((3, 3)))
    grid = np.stack(middles(*fine.shape), axis=-1)[fine > 0]
    exact = fine[fine > 0] / fine.sum() @ ((grid - mean[:2]) @ normals < shift)
    found = ((uv - mean[:2]) @ normals < shift).mean(axis=0)
    random = exact * (1 - exact) / len(uv)
    return math.sqrt(np.square(found - exact).mean()), math.sqrt(random.mean())


@pytest.mark.parametrize("count", [32, 128, 512])
def test_a_painted_disc_integrates_as_well_as_the_disc(count: int) -> None:
    pixels = painted(disc)
    (exact, _), (image, _) = (
        errors_of_half_planes(aperture.points(count), pixels) for aperture in (Aperture(), of(pixels))
    )
    assert image < 1.1 * exact + 2e-4


@pytest.mark.parametrize("name", ["disc", "ring", "spots", "ramp", "noise"])
@pytest.mark.parametrize(("count", "most"), [(32, 0.45), (128, 0.3), (512, 0.19)])
def test_points_are_much_more_even_than_random_ones(name: str, count: int, most: float) -> None:
    """The exact disc's own points have 0.40, 0.23 and 0.13 of the error of random ones."""
    found, random = errors_of_half_planes(of(IMAGES[name]).points(count), IMAGES[name])
    assert found < most * random


@pytest.mark.parametrize(("centre", "radius"), [((0.0, 0.0), 1.0), ((0.5, -0.25), 0.4)])
def test_points_of_a_fine_disc_are_the_spiral_itself(centre: tuple[float, float], radius: float) -> None:
    """Wherever it is: the spiral winds around the light, not around the middle of the image."""
    pixels = painted(lambda u, v: disc((u - centre[0]) / radius, (v - centre[1]) / radius), 256)
    expected = centre + radius * Aperture().points(200)
    assert np.abs(of(pixels).points(200) - expected).max() < 0.004


def test_rows_run_down_and_columns_to_the_right() -> None:
    aperture = of([[0.0, 0.0], [0.0, 1.0]])
    assert aperture.area == 1
    assert aperture.contains([[0.5, 0.5], [-0.5, 0.5], [0.5, -0.5]]).tolist() == [True, False, False]
    assert (aperture.points(50) >= 0).all()
    assert aperture.density([0.2, 0.9]) == 1


@images
def test_density_is_the_share_of_light_per_area(pixels: Float64) -> None:
    for squeeze in (1.0, 2.0, 0.25):
        aperture = of(pixels, squeeze)
        factor = min(squeeze, 1 / squeeze)
        assert aperture.area == pytest.approx(4 * pixels.mean() * factor)
        narrow = np.array((min(1, 1 / squeeze), min(1, squeeze)))
        density = aperture.density(np.stack(middles(*pixels.shape), axis=-1) * narrow)
        assert density == pytest.approx(pixels / pixels.mean() / (4 * factor))
    outside = [[1.001, 0.0], [0.0, -1.1], [3.0, 3.0]]
    assert (of(pixels).density(outside) == 0).all()


def test_large_images_keep_their_light() -> None:
    rng = np.random.default_rng(5)
    pixels = rng.random((700, 300)) * (rng.random((700, 300)) > 0.7)
    pixels[:350] = 0
    image = ApertureImage(pixels)
    assert image.pixels.shape == (256, 256)
    assert image.area == pytest.approx(4 * pixels.mean())
    assert moments(image.pixels)[:2] == pytest.approx(moments(pixels)[:2], abs=1e-4)
    assert (image.pixels[:128] == 0).all()  # what is dark stays dark
    assert not image.pixels.flags.writeable


def test_equal_images_are_equal_and_hash_alike() -> None:
    pixels = painted(ring, 16)
    one, two = of(pixels), of(pixels.copy())
    assert one == two
    assert hash(one) == hash(two)
    assert one != of(painted(disc, 16))
    assert one != of(pixels, squeeze=2.0)
    assert one != Aperture()
    assert (one.points(99) == two.points(99)).all()
    pixels[:] = 1  # the caller's array is not the image's
    assert one == two


@settings(max_examples=40, deadline=None)
@given(
    pixels=arrays.arrays(
        st.sampled_from((np.float64, np.float32, np.uint8, np.bool_)),
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=9),
    ),
    count=st.integers(1, 60),
    squeeze=st.floats(0.125, 8),
)
def test_any_image_works_or_is_refused(pixels: npt.NDArray[np.generic], count: int, squeeze: float) -> None:
    try:
        aperture = of(pixels, squeeze)
    except SampleError as error:
        assert error.field == "aperture_image"
        values = pixels.astype(np.float64)
        assert not ((values >= 0) & (values <= 1e30)).all() or values.max() < 1e-30
        return
    uv = aperture.points(count)
    assert np.abs(uv).max() <= 1
    assert aperture.contains(uv).all()
    assert aperture.area > 0


@pytest.mark.parametrize(
    ("pixels", "problem"),
    [
        (np.zeros((4, 4)), "black"),
        (np.full((4, 4), 1e-40), "black"),
        ([[1.0, -0.5]], "got -0.5 at row 0, column 1"),
        ([[1.0], [math.nan]], "got nan at row 1, column 0"),
        ([[math.inf]], "got inf"),
        (np.ones((4, 4, 3)), "shape"),
        (np.ones(4), "shape"),
        (np.ones((0, 4)), "shape"),
        ([["a"]], "real numbers"),
        ([[1j]], "real numbers"),
    ],
)
def test_bad_images_are_named(pixels: npt.ArrayLike, problem: str) -> None:
    with pytest.raises(SampleError, match=problem) as error:
        ApertureImage(pixels)
    assert error.value.field == "aperture_image"


@pytest.mark.parametrize(
    "options", [{"shape": "image"}, {"image": ApertureImage([[1]])}, {"shape": "image", "image": [[1.0]]}]
)
def test_an_image_belongs_to_its_shape(options: dict[str, object]) -> None:
    with pytest.raises(SampleError, match="ApertureImage") as error:
        Aperture(**options)  # type: ignore[arg-type]
    assert error.value.field == "image"
