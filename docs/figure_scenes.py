"""Scenes of planes that several pages show, their samples and their true images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays import Lens, SampleBuffer
from fewrays.lens import LensAperture, Sampling
from fewrays.method import Image
from fewrays.sources.analytic import (
    Mask,
    Plane,
    Texture,
    Waves,
    checker,
    constant,
    disc,
    half_plane,
    reference,
    sample,
    smooth_noise,
    stripes,
)

SPP, TRUTH_SPP = 8, 256

Floats = npt.NDArray[np.float64]


def make_lens(
    aperture: LensAperture = "gaussian", sampling: Sampling = "square", sigma: float = 1 / 3
) -> Lens:
    """Return a lens for which every slope between -400 and 100 pixels has a depth."""
    return Lens(-500.0, 100.0, aperture, sampling, sigma)


LENS = make_lens()


def at_slope(slope: float) -> float:
    """Return the depth at which `make_lens` has this slope."""
    return LENS.depth(slope)


def scattered_discs(cell: float, radius: float, seed: int) -> Mask:
    """One disc at a random place in every square cell of a grid, in pixels."""
    offsets = np.random.default_rng(seed).uniform(radius, cell - radius, (32, 32, 2))

    def mask(xy: Floats) -> npt.NDArray[np.bool_]:
        index = np.floor(xy / cell).astype(np.int64)
        center = index * cell + offsets[index[..., 0] % 32, index[..., 1] % 32]
        return np.asarray(np.square(xy - center).sum(axis=-1) < radius**2)

    return mask


def leaves() -> list[Plane]:
    """Blurred leaves before bars in focus before a bright blurred background: much partial occlusion."""

    def within(mask: Mask, left: float, right: float) -> Mask:
        return lambda xy: mask(xy) & (xy[..., 0] >= left) & (xy[..., 0] < right)

    near, middle = scattered_discs(44, 12, 1), scattered_discs(34, 8, 2)
    close, far = scattered_discs(30, 6, 3), scattered_discs(26, 8, 4)
    return [
        Plane(at_slope(-16), checker(9, (0.02, 0.1, 0.02), (0.1, 0.35, 0.05)), within(near, -90, 66)),
        Plane(at_slope(-9), checker(7, (0.05, 0.15, 0.02), (0.3, 0.5, 0.1)), within(middle, -90, 110)),
        Plane(at_slope(-4), checker(5, (0.1, 0.2, 0.05), (0.35, 0.6, 0.15)), within(close, 20, 150)),
        Plane(at_slope(0), checker(6, (0.25, 0.1, 0.05), (0.8, 0.5, 0.3)), stripes(48, fill=0.4)),
        Plane(at_slope(5), checker(5, (0.2, 0.3, 0.5), (0.5, 0.6, 0.7)), within(far, 40, 120)),
        Plane(at_slope(14), checker(20, (0.5, 0.65, 0.9), (1.0, 0.95, 0.8))),
    ]


def floor() -> list[Plane]:
    """Terraces of slopes from 20 at the top to -12 px at the bottom: a slanted surface without gaps."""
    slopes = np.linspace(20, -12, 33)
    texture = smooth_noise(7, waves=6, seed=5)
    far = [Plane(at_slope(slopes[0]), texture)]
    return far + [
        Plane(at_slope(c), texture, half_plane((0, 3.0 * i), (0, 1))) for i, c in enumerate(slopes) if i
    ]


@cache
def leaves_truth() -> Image:
    """Return the true image of `leaves`."""
    return reference(leaves(), LENS, 128, 192, spp=TRUTH_SPP)


@cache
def leaves_samples() -> SampleBuffer:
    """Return samples of `leaves`."""
    return sample(leaves(), LENS, 128, 192, SPP)


@cache
def wide_leaves() -> SampleBuffer:
    """Return samples of the leaves, repeated over an image that is large enough to measure times."""
    planes = leaves()
    for i, plane in enumerate(planes):
        planes[i] = replace(plane, color=repeated(plane.color), mask=plane.mask and repeated(plane.mask))
    return sample(planes, LENS, 384, 576, SPP)


def repeated(function: Callable[[Floats], Any]) -> Callable[[Floats], Any]:
    """Return a texture or mask repeated every 160 pixels along both axes."""
    return lambda xy: function(np.mod(xy, 160))


@cache
def floor_truth() -> Image:
    """Return the true image of `floor`."""
    return reference(floor(), LENS, 96, 96, spp=TRUTH_SPP)


@cache
def floor_samples() -> SampleBuffer:
    """Return samples of `floor`."""
    return sample(floor(), LENS, 96, 96, SPP)


def two_discs_planes(slope: float, front_radius: float) -> list[Plane]:
    """Return a red disc before a green one, both out of focus, before black (the paper's Figure 6)."""
    return [
        Plane(at_slope(-slope), constant(1.0, 0.0, 0.0), disc((48, 48), front_radius)),
        Plane(at_slope(slope), constant(0.0, 1.0, 0.0), disc((48, 48), 14)),
        Plane(at_slope(30), constant(0.0)),
    ]


def two_discs_samples(slope: float, front_radius: float, spp: int = 16) -> SampleBuffer:
    """Return samples of the two discs."""
    return sample(two_discs_planes(slope, front_radius), LENS, 96, 96, spp)


@cache
def two_discs(slope: float, front_radius: float) -> dict[str, Image]:
    """Return the true image of the two discs, and the one that Eq. 37 predicts from each disc's own image."""
    planes = two_discs_planes(slope, front_radius)
    red, green = (reference([plane, planes[2]], LENS, 96, 96, spp=2 * TRUTH_SPP) for plane in planes[:2])
    return {
        "truth": reference(planes, LENS, 96, 96, spp=2 * TRUTH_SPP),
        "predicted": red + (1 - red[..., :1]) * green,
    }


def green_lost(truth: Image, image: Image) -> tuple[float, float, float]:
    """Return the largest loss, mean absolute error and lost light of the green disc, in percent."""
    loss = 100 * (truth - image)[..., 1]
    return float(loss.max()), float(np.abs(loss).mean()), float(loss.sum() / truth[..., 1].sum())


def moved(plane: Plane, by: float) -> Plane:
    """Return a plane moved right and down by some pixels."""
    color, mask = plane.color, plane.mask
    shifted: Texture = lambda xy: color(xy - by)  # noqa: E731
    return Plane(plane.depth, shifted, None if mask is None else lambda xy: mask(xy - by))


def square_wave(period: float, harmonics: int = 15) -> Waves:
    """Return soft-edged bars as a sum of waves, whose blurred image is exact."""
    order = 2 * np.arange(harmonics) + 1
    weight = 4 / np.pi * np.sinc(order / (2 * harmonics)) / order
    frequency = np.stack([order / period, np.zeros(harmonics)], axis=-1)
    amplitude = 0.4 * weight[:, None] * np.ones(3)
    return Waves(np.full(3, 0.5), amplitude, frequency, np.full(harmonics, -np.pi / 2))
