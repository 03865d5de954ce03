"""Depth of field from one image against scenes whose image is known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fewrays import Lens
from fewrays.aperture import Aperture
from fewrays.dynamic import DepthLayer, defocus, defocus_rgba
from fewrays.metrics import psnr
from fewrays.sources.analytic import Plane, checker, half_plane, reference, trace
from fewrays.vignetting import CatsEye

Float32 = npt.NDArray[np.float32]

HEIGHT, WIDTH = 48, 72
EDGE = 36.4  # column where the foreground ends; its pixel shows both
BLUR = 12.0  # circle-of-confusion radius in pixels of what is not in focus

FRONT = Plane(1.0, checker(9, (0.9, 0.2, 0.1), (0.5, 0.1, 0.3)), half_plane((EDGE, 0), (-1, 0)))
BACK = Plane(4.0, checker(7, (0.1, 0.5, 0.9), (0.1, 0.2, 0.15)))

INSIDE = slice(14, -14)  # rows that nothing beyond the border is blurred into
ON_FRONT, ON_BACK = (INSIDE, slice(24, 37)), (INSIDE, slice(37, 49))

AS_PUBLISHED: dict[str, Any] = {
    "fill_reach": 0,
    "split_edges": False,
    "growth": 1,
    "prefilter": "mipmap",
    "lens_points": "halton",
}


def lens_focused_at(depth: float) -> Lens:
    """Return a lens that blurs one plane by `BLUR` where the other is in focus."""
    c0 = -BLUR / (1 / 1.0 - 1 / 4.0)
    return Lens(c0, -c0 / depth)


@dataclass(frozen=True)
class Figure:
    """One half of Figure 7: a pinhole image with depth, what is behind it, and the truth."""

    lens: Lens
    color: Float32
    depth: Float32
    behind: DepthLayer
    truth: Float32

    def error(self, region: tuple[slice, slice], **options: Any) -> float:
        """PSNR in dB over a region."""
        image = defocus(self.color, self.depth, self.lens, **options)
        return float(psnr(image[region], self.truth[region]))


@cache
def figure(focus: float) -> Figure:
    lens = lens_focused_at(focus)
    color, depth = pinhole([FRONT, BACK], lens)
    truth = reference([FRONT, BACK], lens, HEIGHT, WIDTH, spp=512, pixel_filter="box")
    return Figure(lens, color, depth, DepthLayer(*pinhole([BACK], lens)), truth)


def pinhole(planes: list[Plane], lens: Lens) -> tuple[Float32, Float32]:
    """Antialiased colours, and depths at the pixels' centres."""
    closed = lens.refocus(aperture_scale=0)
    color = reference(planes, closed, HEIGHT, WIDTH, spp=64, pixel_filter="box")
    centres = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1) + 0.5
    return color, trace(planes, closed, centres, np.zeros_like(centres))[1]


def test_a_sharp_background_beside_a_blurred_foreground_is_right() -> None:
    """Figure 7a."""
    assert figure(4.0).error(ON_BACK) > 40
    assert figure(4.0).error(ON_BACK, views=128) > 45


def test_b_a_blurred_foreground_shows_the_sharp_background_behind_it() -> None:
    """Figure 7b, where the paper fails: exact with a second layer, plausible without."""
    case = figure(4.0)
    left_out = case.error(ON_FRONT, fill_reach=0)
    assert case.error(ON_FRONT) > left_out + 3
    assert case.error(ON_FRONT) > case.error(ON_FRONT, **AS_PUBLISHED) + 1
    assert case.error(ON_FRONT, behind=[case.behind], views=128) > 40


def test_c_a_blurred_background_beside_a_sharp_foreground_is_close() -> None:
    """Figure 7c."""
    case = figure(1.0)
    assert case.error(ON_BACK) > 38
    assert case.error(ON_BACK) > case.error(ON_BACK, **AS_PUBLISHED) + 8
    assert case.error(ON_BACK, behind=[case.behind]) > 41


def test_d_a_sharp_foreground_is_right() -> None:
    """Figure 7d."""
    case = figure(1.0)
    assert case.error(ON_FRONT) > 36
    untouched = (INSIDE, slice(24, 35))  # but for the edge
    image = defocus(case.color, case.depth, case.lens)
    np.testing.assert_allclose(image[untouched], case.color[untouched], atol=1e-6)


def test_a_sharp_foreground_leaks_no_light() -> None:
    """What is blurred behind a bright sharp object keeps its own colour, up to the object's edge."""
    lens = lens_focused_at(1.0)
    color = np.full((HEIGHT, WIDTH, 3), 0.1, np.float32)
    color[:, :36] = 100.0
    color[:, 36] = 0.4 * 100.0 + 0.6 * 0.1  # antialiased, with the background's depth
    depth = np.where(np.arange(WIDTH) < 36, 1.0, 4.0) * np.ones((HEIGHT, 1))
    image = defocus(color, depth, lens)
    np.testing.assert_allclose(image[:, 37:], 0.1, rtol=1e-4)
    np.testing.assert_allclose(image[:, :36], 100.0, rtol=1e-4)
    np.testing.assert_allclose(image[:, 36], color[:, 36], rtol=1e-4)


@pytest.mark.parametrize("edge_depth", ["front", "back", "mean"])
def test_antialiased_edges_leave_no_sharp_rim(edge_depth: str) -> None:
    """Constant planes with a known mixture in one column: the blurred edge is the disc's own profile."""
    lens = lens_focused_at(4.0)
    front, back = np.array([1.0, 0.5, 0.1]), np.array([0.05, 0.1, 0.3])
    covered = np.clip(36.4 - np.arange(WIDTH), 0, 1)
    color = covered[:, None] * front + (1 - covered)[:, None] * back
    at_edge = {"front": 1.0, "back": 4.0, "mean": 1 / (0.4 / 1.0 + 0.6 / 4.0)}[edge_depth]
    depth = np.where(covered == 1, 1.0, np.where(covered == 0, 4.0, at_edge))
    rows = np.ones((HEIGHT, 1))
    image = defocus(color * rows[..., None], depth * rows, lens, views=256)
    share = disc_left_of(EDGE - (np.arange(WIDTH) + 0.5))
    truth = share[:, None] * front + (1 - share)[:, None] * back
    np.testing.assert_allclose(image[HEIGHT // 2], truth, atol=0.02)


def disc_left_of(distance: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Share of a disc of radius `BLUR` that lies left of a line at a signed distance from its centre."""
    x = np.clip(distance / BLUR, -1, 1)
    return np.asarray(0.5 + (np.arcsin(x) + x * np.sqrt(1 - x * x)) / np.pi)


def test_a_small_light_becomes_a_round_disc_of_its_own_energy() -> None:
    size = 81
    lens = lens_focused_at(1.0)
    color = np.zeros((size, size, 3), np.float32)
    color[40, 40] = [3000.0, 2000.0, 500.0]
    color[12, 57] = [100.0, 100.0, 100.0]
    image = defocus(color, np.full((size, size), 4.0), lens, views=256)
    np.testing.assert_allclose(image.sum(axis=(0, 1)), color.sum(axis=(0, 1)), rtol=2e-3)
    away = np.hypot(*(np.indices((size, size)) - 40))
    angle = (np.arctan2(*(np.indices((size, size)) - 40)) + 0.2) % (2 * np.pi) * 3 / np.pi
    expected = color[40, 40, 0] / (np.pi * BLUR**2)
    disc = image[away < BLUR - 2, 0] / expected
    assert disc.mean() == pytest.approx(1.0, abs=0.02)
    assert disc.std() < 0.15
    around = image[..., 0] * ((away > 2) & (away < BLUR + 4))
    sectors = [around[(angle >= k) & (angle < k + 1)].sum() for k in range(6)]
    np.testing.assert_allclose(sectors, np.mean(sectors), rtol=0.05)
    outside = (away > BLUR + 2) & (np.hypot(*(np.indices((size, size)) - [[[12]], [[57]]])) > BLUR + 2)
    assert image[outside].max() < 0.01 * expected


def test_a_thin_light_in_front_keeps_its_energy() -> None:
    lens = lens_focused_at(4.0)
    color = np.full((64, 64, 3), 0.01, np.float32)
    depth = np.full((64, 64), 4.0, np.float32)
    color[32, 20:44], depth[32, 20:44] = 500.0, 1.0
    image = defocus(color, depth, lens, views=128)
    np.testing.assert_allclose(image.sum(), color.sum(), rtol=0.03)


def test_glass_blurs_by_its_own_depth_and_shows_what_is_behind() -> None:
    """A transparent layer over a checker in focus: both are exact, as planes without edges are."""
    lens = lens_focused_at(4.0)
    glass = np.full((HEIGHT, WIDTH, 3), [0.06, 0.12, 0.3], np.float32)
    behind = DepthLayer(*pinhole([BACK], lens))
    rgba = defocus_rgba(
        glass, np.ones((HEIGHT, WIDTH)), lens, alpha=np.full((HEIGHT, WIDTH), 0.3), behind=[behind]
    )
    np.testing.assert_allclose(rgba[..., :3], glass + 0.7 * behind.color, atol=1e-5)
    np.testing.assert_allclose(rgba[..., 3], 1.0, atol=1e-6)


def test_alpha_is_blurred_with_the_colour() -> None:
    """An object before nothing: its premultiplied colour stays its colour times alpha."""
    lens = lens_focused_at(4.0)
    covered = np.clip(36.4 - np.arange(WIDTH), 0, 1) * np.ones((HEIGHT, 1))
    color = covered[..., None] * np.array([0.8, 0.4, 0.2])
    rgba = defocus_rgba(color, np.ones((HEIGHT, WIDTH)), lens, alpha=covered, views=256)
    np.testing.assert_allclose(rgba[..., :3], rgba[..., 3:] * np.array([0.8, 0.4, 0.2]), atol=2e-3)
    share = disc_left_of(EDGE - (np.arange(WIDTH) + 0.5))
    np.testing.assert_allclose(rgba[HEIGHT // 2, :, 3], share, atol=0.02)


def test_the_lens_falls_off_by_cosine_to_the_fourth() -> None:
    """A wide lens at f/0.5 (Eq. 6): the rim counts a quarter, so that a light's disc is darker there."""
    size = 65
    color = np.zeros((size, size, 3), np.float32)
    color[32, 32] = 1000.0
    image = defocus(color, np.full((size, size), 4.0), lens_focused_at(1.0), views=400, falloff_f_number=0.5)
    away = np.hypot(*(np.indices((size, size)) - 32)) / BLUR
    middle, rim = image[away < 0.3, 0].mean(), image[(away > 0.75) & (away < 0.85), 0].mean()
    assert rim / middle == pytest.approx((1 + 0.8**2) ** -2 / (1 + 0.2**2) ** -2, rel=0.1)


def test_lights_become_cats_eyes_towards_the_corners() -> None:
    """The rim's shape itself is tested with `fewrays.vignetting`; here, that it reaches the image."""
    height, width, blur = 90, 120, 10.0
    color = np.zeros((height, width, 3), np.float32)
    color[16, 20] = 100.0
    far = np.full((height, width), np.inf)
    choices: list[dict[str, Any]] = [{}, {"cats_eye": 0.9}, {"cats_eye": 0.9, "darken": True}]
    round_, eye, dark = (
        defocus(color, far, Lens(-blur, blur), views=300, **options)[..., 0] for options in choices
    )
    # Behind the focal plane lights lose their outer side, up and left of them here.
    rows, columns = np.indices(color.shape[:2])
    assert (round_ * rows).sum() / round_.sum() == pytest.approx(16, abs=0.1)
    assert (eye * rows).sum() / eye.sum() > 17
    assert (eye * columns).sum() / eye.sum() > 21
    passing = CatsEye(0.9).front_rim(Aperture().points(300), height, width).passes
    share = passing(Aperture().points(300)[:, None], np.array([[25.5, 20.5]])).mean()
    assert dark[20, 25] / eye[20, 25] == pytest.approx(share, rel=1e-3)
