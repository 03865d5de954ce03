"""Rays gathered along edges against edges that are known, and what must not come of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import Lens, Multiplane, SampleBuffer, reconstruct
from fewrays.multiplane.maps import Maps
from fewrays.sources.analytic import Mask, Plane, constant, disc, half_plane, sample, smooth_noise, stripes
from plane_layers import whole_layer

LENS = Lens(-100.0, 20.0)
SIDE = 32
BORDER = 6  # beyond what samples outside the image would have shown of it
SEEDS = range(8)
BRIGHT, DARK = np.array([0.9, 0.6, 0.3]), np.array([0.1, 0.1, 0.2])

Float64 = npt.NDArray[np.float64]


def towards(degrees: float) -> Float64:
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])


def place(seed: int) -> Float64:
    """Return a position close to the image's centre: where pixels and cells begin is not to matter."""
    return np.random.default_rng(seed).uniform(SIDE / 2 - 1, SIDE / 2 + 1, 2)


def covered_by_half_plane(point: Float64, normal: Float64) -> Float64:
    """Return the share of each pixel on the normal's side of a line, exactly, (H, W).

    A pixel's shadow on the normal is a trapezoid: the share is a second integral of the four places where its
    slope changes.
    """
    across, along = np.maximum(np.abs(normal), 1e-6)
    center = np.arange(SIDE) + 0.5
    distance = np.stack(np.meshgrid(center, center), axis=-1) @ normal - point @ normal
    half_sum, half_difference = (across + along) / 2, (across - along) / 2
    twice = [
        np.square(np.maximum(distance + change, 0.0))
        for change in (half_sum, half_difference, -half_difference, -half_sum)
    ]
    share: Float64 = (twice[0] - twice[1] - twice[2] + twice[3]) / (2 * across * along)
    return share


def covered(mask: Mask, fineness: int = 32) -> Float64:
    """Return about which share of each pixel a mask covers, (H, W)."""
    fine = (np.arange(SIDE * fineness) + 0.5) / fineness
    inside = mask(np.stack(np.meshgrid(fine, fine), axis=-1)).reshape(SIDE, fineness, SIDE, fineness)
    return np.asarray(inside.mean(axis=(1, 3), dtype=np.float64))


def in_front(mask: Mask) -> list[Plane]:
    """A shape in focus in front of a background that is not."""
    return [Plane(LENS.depth(0.0), constant(*BRIGHT), mask), Plane(LENS.depth(5.0), constant(*DARK))]


def painted(mask: Mask) -> list[Plane]:
    """The same on one plane: an edge of radiance alone."""
    return [Plane(LENS.depth(0.0), lambda xy: np.where(mask(xy)[..., None], BRIGHT, DARK))]


def errors(planes: list[Plane], share: Float64, seed: int) -> Float64:
    """Errors of images of 4 samples per pixel, without and with rays along edges, (2, H, W, 3)."""
    truth = share[..., None] * BRIGHT + (1 - share[..., None]) * DARK
    samples = sample(planes, LENS, SIDE, SIDE, 4, seed=seed)
    without = reconstruct(samples, "multiplane", threads=1, views=32, along_edges=0.0)
    with_rays = reconstruct(samples, "multiplane", threads=1, views=32)
    error: Float64 = np.stack([without, with_rays]) - truth
    return error[:, BORDER:-BORDER, BORDER:-BORDER]


def root_mean_square(error: Float64) -> tuple[float, float]:
    """Of errors (N, 2, …), without and with rays along edges."""
    without, with_rays = np.sqrt(np.square(np.moveaxis(error, 1, 0)).reshape(2, -1).mean(axis=1))
    return float(without), float(with_rays)


class TestStraightEdges:
    @pytest.mark.parametrize("angle", [0, 20, 45, 70, 90, 155])
    @pytest.mark.parametrize("paint", [in_front, painted])
    def test_have_less_error_and_stay_where_they_are(
        self, paint: Callable[[Mask], list[Plane]], angle: float
    ) -> None:
        normal = towards(angle)
        error = np.array(
            [
                errors(
                    paint(half_plane(tuple(place(seed)), tuple(normal))),
                    covered_by_half_plane(place(seed), normal),
                    seed,
                )
                for seed in SEEDS
            ]
        )
        without, with_rays = root_mean_square(error)
        assert with_rays < 0.8 * without
        # An edge that is a pixel off adds its length, in pixels, times its contrast to the image.
        side = SIDE - 2 * BORDER
        length = side / np.abs(normal).max()
        off = error[..., 0].sum(axis=(2, 3)) / (length * (BRIGHT - DARK)[0])
        assert abs(off[:, 1].mean()) < 0.03
        assert abs((off[:, 1] - off[:, 0]).mean()) < 0.015


class TestOtherShapes:
    """What is no straight edge gets no worse."""

    @pytest.mark.parametrize("angle", [0, 20, 45])
    @pytest.mark.parametrize("opening", [90, 45])
    def test_corners(self, opening: float, angle: float) -> None:
        def corner(seed: int) -> Mask:
            one = half_plane(tuple(place(seed)), tuple(towards(angle)))
            other = half_plane(tuple(place(seed)), tuple(towards(angle + 180 - opening)))
            return lambda xy: one(xy) & other(xy)

        error = np.array([errors(in_front(corner(seed)), covered(corner(seed)), seed) for seed in SEEDS])
        tip = slice(SIDE // 2 - BORDER - 4, SIDE // 2 - BORDER + 4)
        without, with_rays = root_mean_square(error[:, :, tip, tip])
        assert with_rays < without

    @pytest.mark.parametrize("angle", [0, 20, 45])
    @pytest.mark.parametrize("width", [0.3, 0.6])
    def test_lines_thinner_than_a_pixel(self, width: float, angle: float) -> None:
        def line(seed: int) -> Mask:
            return lambda xy: np.abs((xy - place(seed)) @ towards(angle)) < width / 2

        error = np.array([errors(in_front(line(seed)), covered(line(seed)), seed) for seed in SEEDS])
        without, with_rays = root_mean_square(error)
        assert with_rays < 1.03 * without
        # And none of their light goes astray.
        light = width * (SIDE - 2 * BORDER) * (BRIGHT - DARK)[0]
        lost = error[..., 0].sum(axis=(2, 3)).mean(axis=0) / light
        assert abs(lost[1] - lost[0]) < 0.05

    def test_discs(self) -> None:
        error = np.array(
            [
                errors(in_front(disc(tuple(place(seed)), 2.0)), covered(disc(tuple(place(seed)), 2.0)), seed)
                for seed in SEEDS
            ]
        )
        without, with_rays = root_mean_square(error)
        assert with_rays < without


@pytest.mark.parametrize("radiance", [(0.0, 0.0, 0.0), (0.75, 0.5, 2.0)])
def test_a_constant_image_stays_constant(radiance: tuple[float, float, float]) -> None:
    """Exactly; close to the image's borders, where opacity falls off, to half precision."""
    samples = sample([Plane(LENS.depth(0.0), constant(*radiance))], LENS, SIDE, SIDE, 4)
    image = reconstruct(samples, "multiplane", threads=1, views=16, along_edges=50.0)
    expected = np.broadcast_to(np.array(radiance, np.float32), image.shape)
    middle = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    np.testing.assert_allclose(image, expected, rtol=5e-4)
    np.testing.assert_allclose(image[middle], expected[middle], rtol=1e-6)


@pytest.mark.parametrize("factor", [1000.0, 1e-3])
def test_radiance_of_another_scale(factor: float) -> None:
    planes = in_front(half_plane((15.3, 15.8), tuple(towards(35))))
    samples = sample(planes, LENS, SIDE, SIDE, 4)
    image = reconstruct(samples, "multiplane", threads=1, views=16)
    other = replace(samples, color=np.float32(factor) * samples.color)
    # Half precision has 11 bits, and rounds elsewhere.
    np.testing.assert_allclose(
        reconstruct(other, "multiplane", threads=1, views=16), factor * image, rtol=1e-3
    )


def image_part(maps: Maps, plane: int) -> Float64:
    """What the cells of a plane hold that lie on the image."""
    left, top = -maps.grid.corner[plane] * maps.grid.cells[plane]
    height, width = np.array([maps.height, maps.width]) * maps.grid.cells[plane]
    return whole_layer(maps, plane)[top : top + height, left : left + width]


@pytest.mark.parametrize("radiance", [1e-2, 1.0, 1e3])
@pytest.mark.parametrize(("contrast", "seen"), [(0.01, False), (1.0, True)])
def test_what_is_hardly_seen_shows_no_way(radiance: float, contrast: float, seen: bool) -> None:
    """An edge counts by how its radiance compares with what is around it, however bright that is."""
    mask = half_plane((15.3, 15.8), tuple(towards(35)))
    one, other = radiance * np.ones(3), radiance * (1 + contrast) * np.ones(3)
    plane = Plane(LENS.depth(0.0), lambda xy: np.where(mask(xy)[..., None], other, one))
    samples = sample([plane], LENS, SIDE, SIDE, 4)
    maps, without = (
        Multiplane.build(samples, threads=1, **options).maps for options in ({}, {"along_edges": 0.0})
    )
    inside = 3 * BORDER  # cells
    same = np.equal(image_part(maps, 0), image_part(without, 0))[inside:-inside, inside:-inside]
    assert same.all() != seen


MIRRORS: dict[str, Callable[[npt.NDArray[Any]], npt.NDArray[Any]]] = {
    "left and right": lambda array: array[:, ::-1],
    "above and below": lambda array: array[::-1],
    "rows and columns": lambda array: np.swapaxes(array, 0, 1),
}


def mirrored(samples: SampleBuffer, how: str) -> SampleBuffer:
    """Mirror samples of a square image."""
    turn = MIRRORS[how]
    xy, uv = turn(samples.xy), turn(samples.uv)
    if how == "rows and columns":
        xy, uv = xy[..., ::-1], uv[..., ::-1]
    else:
        axis = int(how == "above and below")
        sign = np.where(np.arange(2) == axis, -1.0, 1.0)
        xy, uv = np.where(sign < 0, samples.height, 0) + sign * xy, sign * uv
    return replace(samples, xy=xy, uv=uv, depth=turn(samples.depth), color=turn(samples.color))


@pytest.mark.parametrize("how", MIRRORS)
def test_mirrored_samples_have_mirrored_planes(how: str) -> None:
    """Slopes are such that planes begin 32 pixels beyond the image, and neighbourhoods mirror as well.

    Stripes leave no block of the plane in front without samples: blocks are wider than high.
    """
    lens, side = Lens(-100.0, 40.0), 64
    planes = [
        Plane(lens.depth(-26.0), constant(*BRIGHT), stripes(11.0, direction=(3.0, 2.0))),
        Plane(lens.depth(26.0), smooth_noise(5)),
    ]
    samples = sample(planes, lens, side, side, 4)
    turned = mirrored(samples, how)
    options: dict[str, Any] = {"threads": 1, "fine_to": 30.0}
    one, other = (Multiplane.build(each, **options).maps for each in (samples, turned))
    plain = Multiplane.build(samples, **options, along_edges=0.0).maps
    assert one.plane_count == other.plane_count == len(planes)
    for plane in range(len(planes)):
        expected, actual = MIRRORS[how](image_part(one, plane)), image_part(other, plane)
        agrees = np.isclose(actual, expected, rtol=2e-3, atol=2e-4)
        assert agrees.mean() > 0.999
    differs = ~np.isclose(image_part(plain, 0), image_part(one, 0), rtol=2e-3, atol=2e-4)
    assert differs.mean() > 0.02


def test_planes_far_out_of_focus_are_untouched() -> None:
    """Bit by bit, beyond three times the blur up to which planes count as in focus."""
    slopes = [-9.0, -5.0, -1.5, 0.0, 2.5, 5.5, 6.5, 12.0]
    rng = np.random.default_rng(3)
    stripes = [half_plane(tuple(rng.uniform(8, 56, 2)), tuple(towards(40 * k))) for k in range(len(slopes))]
    masks = [*stripes[:-1], None]
    planes = [
        Plane(LENS.depth(c), smooth_noise(6, seed=k), mask)
        for k, (c, mask) in enumerate(zip(slopes, masks, strict=True))
    ]
    samples = sample(planes, LENS, 64, 64, 4)
    maps, without = (
        Multiplane.build(samples, threads=1, **options).maps for options in ({}, {"along_edges": 0.0})
    )
    touched = [
        not np.array_equal(whole_layer(maps, plane), whole_layer(without, plane))
        for plane in range(maps.plane_count)
    ]
    np.testing.assert_array_equal(touched, np.abs(maps.shear.slope) <= 6.0)
