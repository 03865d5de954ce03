"""A sample buffer of any size, whose depth complexity is known, without a renderer."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from PIL import ImageDraw

import fewrays
from fewrays.sources.analytic import Mask, Plane, sample, smooth_noise

__all__ = ["leaf_planes"]

_CELL = 128  # pixels; each leafy plane has one leaf in some of these
_LENS = fewrays.Lens(-40.0, 10.0, aperture="gaussian", sampling="square")


def leaf_planes(
    height: int, width: int, spp: int, *, planes: int = 20, share: float = 0.27, seed: int = 0
) -> fewrays.SampleBuffer:
    """Sample planes of scattered leaves in front of and behind the focal plane, and a wall behind them.

    Parameters
    ----------
    height, width : int
        In pixels.
    spp : int
        Samples per pixel; their lens positions are uniform over the square, for a Gaussian lens.
    planes : int
        Leafy planes, at slopes from -16 to 7 px.
    share : float
        Of the cells of 128 x 128 pixels, those that hold a leaf, in each plane.
    seed : int
        The same seed gives the same samples.

    Returns
    -------
    SampleBuffer
    """
    rng = np.random.default_rng(seed)
    stack = [Plane(_LENS.depth(8.0), smooth_noise(12.0, mean=rng.uniform(0.3, 0.9, 3).tolist(), seed=seed))]
    for number, slope in enumerate(np.linspace(-16, 7, planes)):
        color = smooth_noise(6.0, mean=rng.uniform(0.2, 0.8, 3).tolist(), waves=8, seed=seed + 1 + number)
        stack.append(Plane(_LENS.depth(float(slope)), color, _leaves(height, width, share, rng)))
    return sample(stack, _LENS, height, width, spp, seed=seed)


def _leaves(height: int, width: int, share: float, rng: np.random.Generator) -> Mask:
    """Return a mask of slender polygons, one in each of the chosen cells."""
    picture = Pillow.new("1", (width, height))
    draw = ImageDraw.Draw(picture)
    for top in range(0, height, _CELL):
        for left in range(0, width, _CELL):
            if rng.random() >= share:
                continue
            center = np.array([left, top]) + rng.uniform(0, _CELL, 2)
            draw.polygon([tuple(corner) for corner in _leaf(center, rng)], fill=1)
    inside = np.asarray(picture)

    def mask(xy: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        # Positions beyond the image see its other side: the lens must not look past the leaves' end.
        column, row = np.floor(xy).astype(np.int64).T
        result: npt.NDArray[np.bool_] = inside[row % height, column % width]
        return result

    return mask


def _leaf(center: npt.NDArray[np.float64], rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Corners (16, 2) of an ellipse of random size and direction."""
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    length = rng.uniform(0.15, 0.4) * _CELL
    along, across = length * np.cos(around), 0.4 * length * np.sin(around)
    turn = rng.uniform(0, np.pi)
    corners = [along * np.cos(turn) - across * np.sin(turn), along * np.sin(turn) + across * np.cos(turn)]
    return np.asarray(center + np.stack(corners, axis=-1))
