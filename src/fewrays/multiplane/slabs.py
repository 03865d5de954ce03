"""Which plane a sample belongs to: slabs of the circle of confusion, and of motion where samples move.

Slab k holds the slopes ``C`` with ``k - 1/2 <= s(C) < k + 1/2``, for

    s(C) = sign(C) |C| / w                                          where |C| <= L,
    s(C) = sign(C) (L / w) (1 + ln(|C| / L))                        where |C| <= 4 L,
    s(C) = sign(C) (L / w) (1 + ln 4 + 2 - 2 (|C| / (4 L))^-1/2)    beyond,

with slabs w pixels thick as long as blur is below L pixels. Beyond, thickness grows with the blur that hides
it, and in the end faster, with the power 3/2: there are never more than ``2 (L / w) (3 + ln 4)`` slabs. One
slab has the focal plane in its middle.

What moves while the shutter is open is told apart further, by its motion over the screen in cells of a few
pixels. A plane stands for one slab and one such cell, and is seen from lens point (u, v) at time t shifted by

    C (u, v) + M (t - 1/2),

C and M being the means of its samples': time is to motion what the lens is to slope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fewrays.samples import OFF_IMAGE, SampleBuffer
from fewrays.temporal.reprojection import Paths

__all__ = ["FARTHEST", "MOST_PLANES", "Assignment", "SlabRule", "assign_planes"]

Float64 = npt.NDArray[np.float64]

_CHUNK = 2**20  # samples that are assigned at a time
_MOST_KEYS = 2**23  # that are looked up in a table, instead of sorted
_WIDE = 4.0  # times the blur up to which slabs are even; thickness then grows faster than blur
_WIDE_AT = 1 + math.log(_WIDE)  # s(C) of that, in units of L / w

MOST_PLANES = 2**15 - 1
"""Planes that numbers of samples' planes can tell apart."""

FARTHEST = 512.0
"""Pixels of motion beyond which cells are not told apart."""


@dataclass(frozen=True)
class SlabRule:
    """How slopes and motion are cut into slabs.

    Parameters
    ----------
    thickness : float
        Of slabs near focus, in pixels of blur radius: w.
    linear_to : float
        Blur radius in pixels beyond which slabs grow thicker: L.
    motion_cell : float
        Side of the cells that tell motion apart, in pixels per shutter interval.
    most_blur : float
        Blur radius in pixels above which slopes count as of this one: blur as wide as several images.
    """

    thickness: float = 0.35
    linear_to: float = 8.0
    motion_cell: float = 1.5
    most_blur: float = 2.0**16

    def coordinate(self, slope: npt.ArrayLike) -> Float64:
        """Return s(C) for slopes in pixels, of any shape."""
        slope = np.clip(np.asarray(slope, np.float64), -self.most_blur, self.most_blur)
        size = np.abs(slope)
        times = size / self.linear_to
        beyond = 1 + np.log(np.clip(times, 1, _WIDE)) + 2 - 2 / np.sqrt(np.maximum(times / _WIDE, 1))
        distance: Float64 = np.where(times <= 1, times, beyond) * (self.linear_to / self.thickness)
        signed: Float64 = np.copysign(distance, slope)
        return signed

    def slope(self, coordinate: npt.ArrayLike) -> Float64:
        """Return the slope in pixels at coordinates s, of any shape: the inverse of `coordinate`."""
        coordinate = np.asarray(coordinate, np.float64)
        distance = np.abs(coordinate) * (self.thickness / self.linear_to)
        rest = np.maximum(1 - (distance - _WIDE_AT) / 2, 1e-6)  # 0 where blur is infinite
        beyond = np.where(distance <= _WIDE_AT, np.exp(np.clip(distance, 1, _WIDE_AT) - 1), _WIDE / rest**2)
        size = self.linear_to * np.where(distance <= 1, distance, beyond)
        signed: Float64 = np.copysign(np.minimum(size, self.most_blur), coordinate)
        return signed

    def index(self, slope: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Return the slab that slopes in pixels fall into, of any shape."""
        slabs: npt.NDArray[np.int64] = np.floor(self.coordinate(slope) + 0.5).astype(np.int64)
        return slabs


@dataclass(frozen=True, eq=False)
class Assignment:
    """Planes, and which of them each sample belongs to.

    A plane stands where its samples are on average, which is exact for a surface that faces the camera.

    Parameters
    ----------
    plane_of : ndarray of int16, (N,)
        For samples in the order of the flattened buffer; -1 for those dropped.
    slope : ndarray, (K,)
        Of each plane, in pixels: they rise from front to back.
    motion : ndarray, (K, 2)
        Over the shutter interval, in pixels.
    kept : int
        How many samples belong to a plane.
    """

    plane_of: npt.NDArray[np.int16]
    slope: Float64
    motion: Float64
    kept: int


def assign_planes(samples: SampleBuffer, rule: SlabRule) -> Assignment:
    """Sort samples into planes.

    Cells of motion become larger, twice by twice, when there would be more planes than numbers for them.
    """
    count = samples.depth.size
    if samples.motion is not None and bool(samples.motion.any()):
        slope, motion = _seen_at_half_time(samples, rule)
        key = np.column_stack([rule.index(slope), np.floor(motion / rule.motion_cell + 0.5)]).astype(np.int32)
    else:
        slope, motion = None, None
        key = np.empty((count, 1), np.int32)
        for part in _chunks(count):
            key[part, 0] = rule.index(_slope_of(samples, rule, part))
    planes, number = _number_rows(key)
    if len(planes) > MOST_PLANES:
        return assign_planes(samples, replace(rule, motion_cell=2 * rule.motion_cell))
    sums = np.zeros((len(planes), 4))
    for part in _chunks(count):
        of_part = _slope_of(samples, rule, part) if slope is None else slope[part]
        columns = [np.ones_like(of_part), of_part]
        columns += [] if motion is None else list(motion[part].T)
        for column, values in enumerate(columns):
            sums[:, column] += np.bincount(number[part], values, len(planes))
    means = sums[:, 1:] / sums[:, :1]
    order = np.argsort(means[:, 0], kind="stable")
    plane_of = np.argsort(order).astype(np.int16)[number]
    plane_of[samples.xy.reshape(-1, 2)[:, 0] <= OFF_IMAGE / 2] = -1
    return Assignment(plane_of, means[order, 0], means[order, 1:], int(np.count_nonzero(plane_of >= 0)))


def _chunks(count: int) -> Iterator[slice]:
    for first in range(0, count, _CHUNK):
        yield slice(first, min(first + _CHUNK, count))


def _slope_of(samples: SampleBuffer, rule: SlabRule, part: slice) -> Float64:
    slope = samples.lens.slope(samples.depth.reshape(-1)[part]).astype(np.float64)
    return np.clip(slope, -rule.most_blur, rule.most_blur)


def _seen_at_half_time(samples: SampleBuffer, rule: SlabRule) -> tuple[Float64, Float64]:
    """Return the slope at half time (N,) and the motion (N, 2) of what samples hit, for the lens centre."""
    count = samples.depth.size
    slope, motion = _slope_of(samples, rule, slice(count)), np.zeros((count, 2))
    paths = Paths.of_samples(samples)
    half, opening, closing = (paths.seen_from(0.0, 0.0, time) for time in (0.5, 0.0, 1.0))
    slope[half.sample] = np.clip(half.slope, -rule.most_blur, rule.most_blur)
    both, at_open, at_close = np.intersect1d(
        opening.sample, closing.sample, assume_unique=True, return_indices=True
    )
    motion[both] = np.clip(closing.xy[at_close] - opening.xy[at_open], -FARTHEST, FARTHEST)
    return slope, motion


def _number_rows(key: npt.NDArray[np.int32]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
    """Return the distinct rows in lexical order, and the number of each row among them."""
    low = key.min(axis=0)
    spans = key.max(axis=0).astype(np.int64) - low + 1
    flat = np.zeros(len(key), np.int64)
    for column, span in zip(range(key.shape[1]), spans, strict=True):
        flat = flat * span + (key[:, column] - low[column])
    if spans.prod() <= _MOST_KEYS:
        occurs = np.bincount(flat, minlength=1) > 0
        present, number = np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[flat]
    else:
        present, number = np.unique(flat, return_inverse=True)
    rows = np.stack(np.unravel_index(present, tuple(spans)), axis=-1).astype(np.int32) + low
    return rows, number
