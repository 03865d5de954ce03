"""The exact image of a plane of waves that fills the whole image.

The lens and the pixel filter only attenuate each wave, and motion averages over where it has been.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fewrays.lens import Lens
from fewrays.method import Image
from fewrays.sources.analytic_options import PixelFilter, check_filter, check_shutter, check_size
from fewrays.sources.analytic_paint import Waves
from fewrays.sources.analytic_planes import Motion, Plane

__all__ = ["exact_waves"]

Floats = npt.NDArray[np.float64]


def exact_waves(
    texture: Waves,
    depth: float,
    lens: Lens,
    height: int,
    width: int,
    *,
    motion: Motion = (0.0, 0.0, 0.0),
    shutter: tuple[float, float] = (0.0, 1.0),
    pixel_filter: PixelFilter = "gaussian",
    sigma_pix: float = 0.5,
) -> Image:
    """Exact image of an unmasked plane of waves.

    Integrating over a point-symmetric aperture and pixel filter leaves each wave's frequency and phase alone
    and multiplies its amplitude by the Fourier transforms of the two, the aperture's being taken at
    ``C(depth)`` times the frequency. At any moment a moving plane still shows waves, shifted and, where its
    depth changes, magnified; their mean over the shutter is a Gauss-Legendre quadrature, exact to rounding.

    Parameters
    ----------
    texture : Waves
        What the plane is painted with.
    depth : float
        Of the plane, at t = 0.
    lens, height, width, shutter, pixel_filter, sigma_pix
        As in `reference`.
    motion : (float, float, float)
        As in `Plane`.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32, without noise.

    Raises
    ------
    SampleError
        For a size that is not positive, an unknown pixel filter, a depth or a motion that `Plane` rejects
        and a shutter outside ``[0, 1]``.
    """
    check_size(height=height, width=width)
    check_filter(pixel_filter, sigma_pix)
    check_shutter(shutter)
    plane = Plane(depth, texture, motion=motion)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    image = np.zeros((height, width, 3))
    for time, weight in zip(*_shutter_nodes(plane, texture, lens, (height, width), shutter), strict=True):
        seen = _snapshot(texture, plane, time)
        if pixel_filter == "gaussian":
            pixel = np.exp(-2 * (np.pi * sigma_pix) ** 2 * np.square(seen.frequency).sum(axis=-1))
        else:
            pixel = np.sinc(seen.frequency).prod(axis=-1)
        aperture = _aperture_transform(lens, float(lens.slope(plane.depth_at(time))) * seen.frequency)
        blurred = replace(seen, amplitude=(pixel * aperture)[:, None] * seen.amplitude)
        image += weight * blurred(np.stack([x, y], axis=-1))
    return image.astype(np.float32)


def _snapshot(texture: Waves, plane: Plane, time: float) -> Waves:
    """Waves that the lens centre sees at a time where `texture` is what it saw at t = 0."""
    along = np.asarray(plane.motion[:2])
    phase = texture.phase - 2 * np.pi * time / plane.depth * (texture.frequency @ along)
    magnified = texture.frequency * (plane.depth_at(time) / plane.depth)
    return replace(texture, frequency=magnified, phase=phase)


def _shutter_nodes(
    plane: Plane, texture: Waves, lens: Lens, size: tuple[int, int], shutter: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Choose times and weights of a quadrature over the shutter that resolves what passes by any pixel.

    A pixel's radiance is a sum of waves over time. Their frequencies are bounded by how fast the texture
    passes the pixel's centre, and, because the blur circle scaled back to t = 0 is linear in time, by how
    fast the rim of the lens and the pixel's edges sweep over the texture.
    """
    opens, closes = shutter
    if not plane.moves or opens == closes:
        return np.array([opens]), np.ones(1)
    height, width = size
    corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
    passing = np.abs((corners * plane.motion[2] - plane.motion[:2]) @ texture.frequency.T).max(initial=0)
    spread = (abs(lens.c1) + 1) * abs(plane.motion[2]) * np.hypot(*texture.frequency.T).max(initial=0)
    cycles = (closes - opens) * (passing + math.sqrt(2) * spread) / plane.depth
    nodes, weights = np.polynomial.legendre.leggauss(24 + 4 * math.ceil(cycles))
    return opens + (closes - opens) * (nodes + 1) / 2, weights / 2


def _aperture_transform(lens: Lens, frequency: Floats) -> Floats:
    """Fourier transform of the aperture density at frequencies ``(N, 2)`` in cycles per unit of u.

    Both are quadratures, exact to rounding: a disc's transform (a jinc) is that of its marginal along the
    frequency, a semicircle, which is the weight function of Gauss-Chebyshev quadrature of the second kind; a
    Gaussian cut off at the square is a product of integrals over ``[-1, 1]``.
    """
    radius = np.hypot(frequency[:, 0], frequency[:, 1])
    nodes = 64 + 4 * math.ceil(radius.max(initial=0))
    if lens.aperture == "disc":
        angle = np.pi * np.arange(1, nodes + 1) / (nodes + 1)
        semicircle: Floats = 2 / (nodes + 1) * np.square(np.sin(angle))
        transform: Floats = np.cos(2 * np.pi * radius[:, None] * np.cos(angle)) @ semicircle
        return transform
    u, weights = np.polynomial.legendre.leggauss(nodes)
    u = u * min(1.0, 8 * lens.sigma)  # nothing of a Gaussian is left beyond 8σ
    weights = weights * np.exp(-np.square(u) / (2 * lens.sigma**2))
    per_axis = np.cos(2 * np.pi * frequency[..., None] * u) @ (weights / weights.sum())
    product: Floats = per_axis.prod(axis=-1)
    return product
