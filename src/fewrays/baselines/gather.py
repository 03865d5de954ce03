"""Image-space blur by the circle of confusion, the baseline of *dynamic* (Yu, Wang and Yu 2010, Figure 8).

Each pixel becomes the mean of the image over a disc whose radius is the circle of confusion at the pixel's
own depth (Potmesil and Chakravarty's gather, as in [1]_). Nothing is known of what lies in front of what, so
that light leaks across depth edges: a blurred background takes colour from the focused foreground beside it,
and a blurred foreground ends in a hard edge where the background is in focus.

A disc is summed as horizontal chords. With the running sum P of a row, interpolated linearly, the chord of
half length h around x adds ``P(x + h) - P(x - h)``, so that every radius has smooth ends and one below half a
pixel leaves the image as it is. Time is proportional to the largest radius.

References
----------
.. [1] P. Rokita. "Fast generation of depth of field effects in computer graphics". Computers & Graphics
   17 (5), 1993. DOI:10.1016/0097-8493(93)90011-Y
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.lens import Lens
from fewrays.method import Image

__all__ = ["gather_blur"]

Float64 = npt.NDArray[np.float64]


def gather_blur(color: npt.ArrayLike, depth: npt.ArrayLike, lens: Lens) -> Image:
    """Blur every pixel by its own circle of confusion.

    Parameters
    ----------
    color : array_like, (H, W, 3)
        Linear radiance of a pinhole image.
    depth : array_like, (H, W)
        Planar depth, > 0, in the lens's units; ``inf`` for a background without distance.
    lens : Lens
        Its aperture counts as a disc.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32. Discs that reach beyond the image are cut off there.

    Raises
    ------
    SampleError
        As `fewrays.dynamic.DepthLayer`.
    """
    picture = DepthLayer(color, depth)  # type: ignore[arg-type]  # it takes and checks what is like an array
    height, width = picture.height, picture.width
    with np.errstate(over="ignore"):
        radius = np.minimum(np.abs(lens.slope(picture.depth.astype(np.float64))), height + width)
    running = _running_sums(picture.color)
    total = np.zeros((height, width, 4))
    reach = min(math.floor(radius.max()), height - 1)
    for down in range(-reach, reach + 1):
        rows = slice(max(0, -down), height - max(0, down))
        chord = np.sqrt(np.maximum(radius[rows] ** 2 - down**2, 0))
        total[rows] += _chord_sums(running[rows.start + down : rows.stop + down], chord)
    # A radius of 0 has a disc without area: the pixel itself.
    sharp = total[..., 3] <= 0
    total[sharp] = 1
    image = total[..., :3] / total[..., 3:]
    image[sharp] = picture.color[sharp]
    return image.astype(np.float32)


def _running_sums(color: npt.NDArray[np.float32]) -> Float64:
    """Return sums (H, W + 1, 4) of colours, and of ones, left of each pixel border."""
    height, width = color.shape[:2]
    running = np.zeros((height, width + 1, 4))
    np.cumsum(color, axis=1, dtype=np.float64, out=running[:, 1:, :3])
    running[..., 3] = np.arange(width + 1)
    return running


def _chord_sums(running: Float64, half: Float64) -> Float64:
    """Return sums (R, W, 4) over chords of half length (R, W) around the pixels of rows."""
    centre = np.arange(half.shape[1]) + 0.5
    return _at(running, centre + half) - _at(running, centre - half)


def _at(running: Float64, x: Float64) -> Float64:
    """Interpolate running sums (R, W + 1, 4) at positions (R, W) in pixels, constant beyond the ends."""
    last = running.shape[1] - 1
    x = np.clip(x, 0, last)
    left = np.minimum(x.astype(np.intp), last - 1)
    share = (x - left)[..., None]
    low = np.take_along_axis(running, left[..., None], axis=1)
    high = np.take_along_axis(running, left[..., None] + 1, axis=1)
    value: Float64 = low + share * (high - low)
    return value
