"""The mean error of light on the surface around each sample, in plain NumPy: the definition of the kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.samples import SampleBuffer

__all__ = ["Around", "mean_error"]

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

_LEAST_COSINE = 0.9  # between normals of one surface
_REACH = 2.0  # standard deviations
_LEAST_OTHERS = 0.1  # of what is averaged, without which a sample cannot tell noise from error


@dataclass(frozen=True, eq=False)
class Around:
    """What tells which samples are neighbours on one surface.

    Parameters
    ----------
    xy : ndarray of float32, (H, W, S, 2)
        Image positions.
    at_center : ndarray of float32, (H, W, S, 2)
        Where the lens centre sees what samples hit.
    inverse_depth : ndarray of float32, (H, W, S)
    inverse_gradient : ndarray of float32, (H, W, S, 2)
        Derivatives of the inverse depth on the tangent plane, per pixel: the same all over a plane.
    normal : ndarray of float32, (H, W, S, 3)
    pixel : float
        The side of a pixel at depth 1.
    """

    xy: Float32
    at_center: Float32
    inverse_depth: Float32
    inverse_gradient: Float32
    normal: Float32
    pixel: float

    @classmethod
    def of_samples(cls, samples: SampleBuffer) -> Around:
        """Look at samples that have lighting."""
        lighting = samples.lighting
        assert lighting is not None
        depth = samples.depth.astype(np.float64)
        gradient = -lighting.depth_gradient / np.square(depth)[..., None]
        return cls(
            samples.xy,
            samples.at_center().astype(np.float32),
            (1 / depth).astype(np.float32),
            gradient.astype(np.float32),
            lighting.normal,
            pixel=1 / math.sqrt(math.prod(lighting.projection.focal)),
        )


def mean_error(around: Around, light: Float32, difference: Float32, sigma: float) -> tuple[Float32, Float32]:
    """Average the error of light over the samples around each that lie on its surface.

    Two samples lie on one surface as far as their normals agree, and one of them is near the other's tangent
    plane: within a pixel, or within the distance between the two.

    Parameters
    ----------
    around : Around
    light : ndarray, (H, W, S)
        What the lamps would bring if nothing were in between.
    difference : ndarray, (H, W, S)
        What the samples' own light samples brought, less what they were given.
    sigma : float
        Standard deviation in pixels of the Gaussian around a sample.

    Returns
    -------
    share, variance : ndarray, (H, W, S)
        The mean difference as a share of the mean light, and the variance of that; 0 where a sample gets no
        light. Where it has hardly any others on its surface, all may be noise.
    """
    height, width, spp = light.shape
    radius = math.ceil(_REACH * sigma)
    sums = np.zeros((5, height, width, spp))
    for down in range(-radius, radius + 1):
        for right in range(-radius, radius + 1):
            here = _inside(height, -down), _inside(width, -right)
            there = _inside(height, down), _inside(width, right)
            weight = _weights(around, here, there, sigma)
            off, own = (weight * array[there][..., None, :] for array in (difference, light))
            for total, term in zip(sums, (off, own, off * off, off * own, own * own), strict=True):
                total[here] += term.sum(axis=-1)
    lit = light > 0
    square = sums[1] ** 2
    # 1 - 1 / n for n samples of equal weight.
    others = 1 - np.divide(sums[4], square, out=np.ones_like(square), where=lit)
    share = np.divide(sums[0], sums[1], out=np.zeros_like(square), where=lit)
    squares = np.maximum(sums[2] - 2 * share * sums[3] + share**2 * sums[4], 0)
    known = others > _LEAST_OTHERS
    variance = np.divide(squares, square * others, out=share**2, where=known)
    return share.astype(np.float32), variance.astype(np.float32)


def _inside(count: int, shift: int) -> slice:
    """Return which of `count` rows or columns are still there when moved back by `shift`."""
    return slice(max(shift, 0), count + min(shift, 0))


def _weights(around: Around, here: tuple[slice, slice], there: tuple[slice, slice], sigma: float) -> Float64:
    """Return how much each sample there (last axis) counts for each sample here, (h, w, S, S)."""

    def pair(array: Float32) -> tuple[Float64, Float64]:
        wide = array.astype(np.float64)
        return wide[here][:, :, :, None], wide[there][:, :, None, :]

    own_xy, other_xy = pair(around.xy)
    near = np.exp(-0.5 * np.square(other_xy - own_xy).sum(axis=-1) / sigma**2)
    own_place, other_place = pair(around.at_center)
    step = other_place - own_place
    own_depth, other_depth = pair(around.inverse_depth)
    own_gradient, other_gradient = pair(around.inverse_gradient)
    off = np.minimum(
        np.abs(own_depth + (own_gradient * step).sum(axis=-1) - other_depth),
        np.abs(other_depth - (other_gradient * step).sum(axis=-1) - own_depth),
    )
    pixels = off / (around.pixel * own_depth)
    distance = np.maximum(1, np.square(step).sum(axis=-1))
    own_normal, other_normal = pair(around.normal)
    alike = (own_normal * other_normal).sum(axis=-1) > _LEAST_COSINE
    weights: Float64 = near * alike * np.exp(-0.5 * pixels**2 / distance)
    return weights
