"""How large the holes between samples can get: the radius R of temporal, section 3.3.

The dispersion of a set of points is the radius of the largest circle that holds none of them. Samples that
are well distributed in (x, y, u, v, t) are less so on the screen once they are reprojected to another lens
point and time, and how much less depends on how fast they move across it. So the dispersion is measured from
the samples' own pattern, as that of a plane parallel to the image which covers everything, for several slopes
and speeds. Nothing of the scene enters: neither depths nor colours.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
import numpy.typing as npt

from fewrays.samples import SampleBuffer

__all__ = [
    "BORDER",
    "PLACES",
    "REACH",
    "SIDE",
    "believable",
    "dispersion",
    "middle_of",
    "published_radius",
    "random_planes",
]

Float64 = npt.NDArray[np.float64]

SIDE = 12
"""Pixels along each side of the square whose holes are measured."""

BORDER = 2
"""Pixels around it, whose samples may be the nearest."""

REACH = 8.0
"""Largest slope and speed of the planes, in pixels."""

PLACES = 8
"""Places in a pixel along each axis where holes are measured."""

_PLANES = 16
_LIMITS = (0.1, 4.0)  # of what counts as a pattern's dispersion, times the published radius
_CACHED = 64

_known: dict[bytes, float] = {}


def published_radius(spp: int) -> float:
    """Return the paper's rule of thumb in pixels, ``2 / √spp`` (section 3.3)."""
    return 2 / math.sqrt(spp)


def middle_of(height: int, width: int) -> tuple[int, int, int] | None:
    """Return where the pattern of an image's samples is looked at.

    Returns
    -------
    (int, int, int) or None
        First row and column, and side in pixels, of a square that reprojection fills the middle of; None if
        the image is too small.
    """
    half = SIDE // 2 + BORDER + math.ceil(REACH)
    row, column = height // 2, width // 2
    return None if min(row, column) < half else (row - half, column - half, 2 * half)


def random_planes(*, timed: bool) -> Float64:
    """Return the planes' slopes and, if there are times, speeds along x and y: ``(planes, 3)`` in pixels."""
    rng = np.random.default_rng(0)
    planes = np.zeros((_PLANES, 3))
    for plane in planes:
        plane[0] = rng.uniform(-REACH, REACH)
        if timed:
            plane[1:] = rng.uniform(-REACH, REACH, 2) / math.sqrt(2)
    return planes


def believable(radius: float, spp: int) -> float:
    """Return a measured radius in pixels, or the published one if the measured one is that of no pattern."""
    published = published_radius(spp)
    low, high = (limit * published for limit in _LIMITS)
    return radius if low <= radius <= high else published


def dispersion(samples: SampleBuffer, lens_points: npt.NDArray[np.float32] | None = None) -> float:
    """Measure how large the empty circles between reprojected samples get.

    Measured in the middle of the image, as the mean over random planes of each plane's largest circle, and
    remembered for the pattern. Patterns with gaps, such as those of dropped samples, and images too small to
    measure give `published_radius`.

    Parameters
    ----------
    samples : SampleBuffer
    lens_points : ndarray of float32, (H, W, S, 2), optional
        Where on the lens they were drawn, in lens units, unless that is what they say: of a pinhole, all at
        its centre.

    Returns
    -------
    float
        Radius in pixels.
    """
    middle = middle_of(samples.height, samples.width)
    if middle is None:
        return published_radius(samples.spp)
    row, column, side = middle
    window = np.s_[row : row + side, column : column + side]
    xy = (samples.xy[window] - np.array((column, row), np.float32)).reshape(-1, 2)
    if lens_points is None:
        lens_points = samples.uv if samples.lens.c0 else np.zeros_like(samples.uv)
    uv = lens_points[window].reshape(-1, 2)
    time = None if samples.time is None or samples.motion is None else samples.time[window].reshape(-1, 1)
    key = _digest(xy, uv, time)
    if key not in _known:
        while len(_known) >= _CACHED:
            _known.pop(next(iter(_known)), None)
        _known[key] = _measure(xy, uv, time)
    return believable(_known[key], samples.spp)


def _digest(*arrays: npt.NDArray[np.float32] | None) -> bytes:
    pattern = hashlib.blake2b(digest_size=16)
    for array in arrays:
        pattern.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    return pattern.digest()


def _measure(
    xy: npt.NDArray[np.float32], uv: npt.NDArray[np.float32], time: npt.NDArray[np.float32] | None
) -> float:
    """Mean over planes of the largest hole in the middle of a window of samples."""
    largest = []
    for slope, *speed in random_planes(timed=time is not None):
        seen = xy - slope * uv.astype(np.float64)
        if time is not None:
            seen = seen - np.array(speed) * (time - 0.5)
        largest.append(_largest_hole(seen - math.ceil(REACH)))
    return float(np.mean(largest))


def _largest_hole(points: Float64) -> float:
    """Largest distance to the nearest point, of places in a square with a border of pixels around it."""
    side = SIDE + 2 * BORDER
    table = _sort_into_pixels(points, side)
    fine = (np.arange(PLACES) + 0.5) / PLACES
    within = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    corners = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1) + BORDER
    places = corners[:, :, None] + within  # (side, side, places in a pixel, 2)
    nearest2 = np.full(places.shape[:-1], np.inf)
    around = range(2 * BORDER + 1)
    for down in around:
        for right in around:
            pixels = table[down : down + SIDE, right : right + SIDE]
            for k in range(table.shape[2]):
                np.minimum(nearest2, np.square(places - pixels[:, :, None, k]).sum(axis=-1), out=nearest2)
    return float(np.sqrt(nearest2.max()))


def _sort_into_pixels(points: Float64, side: int) -> Float64:
    """Table (side, side, most points of a pixel, 2) of the points of every pixel, filled up with far ones."""
    pixel = np.floor(points)
    inside = ((pixel >= 0) & (pixel < side)).all(axis=-1)
    points, pixel = points[inside], pixel[inside].astype(np.intp)
    number = pixel[:, 1] * side + pixel[:, 0]
    order = np.argsort(number, kind="stable")
    counts = np.bincount(number, minlength=side * side)
    table = np.full((side * side, max(int(counts.max()), 1), 2), 1e6)
    place = np.arange(len(order)) - (np.cumsum(counts) - counts)[number[order]]
    table[number[order], place] = points[order]
    return table.reshape(side, side, -1, 2)
