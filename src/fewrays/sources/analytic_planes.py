"""Planes parallel to the image plane, still or moving, and what rays through a lens hit of a stack of them.

A plane is painted as the lens centre sees it. The ray through image position ``xy`` and lens position
``(u, v)`` meets the plane of depth ``z`` where the lens centre sees it at ``xy - C(z) * (u, v)``, so the
plane's texture and mask are functions of a position in pixels and no geometry is left to trace. The nearest
plane whose mask holds that position gives the sample.

A plane may move, without turning, while the shutter is open. Each of its points then changes its
homogeneous screen position ``(x w, y w, w)``, ``w`` = depth, by the same amount, so that a ray at any time
can be followed back to where the lens centre saw its point as the shutter opened; that is where the plane is
painted (temporal, section 3, Equations 2 and 3).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.errors import SampleError
from fewrays.lens import Lens
from fewrays.sources.analytic_paint import Mask, Texture

__all__ = ["Motion", "Plane", "hits_of", "motion_of", "trace"]

Floats = npt.NDArray[np.float64]
Motion = tuple[float, float, float]
"""Change over the whole shutter of ``(x w, y w, w)``, ``w`` = depth, in pixels times depth units."""


@dataclass(frozen=True)
class Plane:
    """A plane parallel to the image plane, still or moving in a straight line.

    Parameters
    ----------
    depth : float
        Planar depth in scene units, positive and finite.
        A moving plane has it at t = 0.
    color : callable
        Radiance ``(..., 3)`` of positions ``(..., 2)`` in pixels as the lens centre sees them at t = 0.
    mask : callable, optional
        Whether the plane is there, ``(...)`` of bool, for the same positions; everywhere when omitted.
    motion : (float, float, float)
        Change over the whole shutter, t = 0 to 1, of every point's homogeneous screen position
        ``(x w, y w, w)`` as the lens centre sees it, with ``w`` = depth and x, y in pixels from the image's
        left upper corner: what `SampleBuffer.motion` stores. `motion_of` makes it from screen velocities.

    Raises
    ------
    SampleError
        For a depth that is not positive and finite, or a motion that is not finite or leaves the depth not
        positive when the shutter closes.
    """

    depth: float
    color: Texture
    mask: Mask | None = None
    motion: Motion = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.depth) and self.depth > 0):
            raise SampleError(f"expected a positive, finite number, got {self.depth!r}", field="plane.depth")
        if len(self.motion) != 3 or not all(math.isfinite(change) for change in self.motion):
            raise SampleError(f"expected three finite numbers, got {self.motion!r}", field="plane.motion")
        last_depth = self.depth + self.motion[2]
        if last_depth <= 0:
            raise SampleError(
                f"the depth falls from {self.depth:g} to {last_depth:g} while the shutter is open; the plane "
                "must stay in front of the camera",
                field="plane.motion",
            )

    @property
    def moves(self) -> bool:
        """Whether any part of the motion is not zero."""
        return any(self.motion)

    def depth_at(self, times: npt.ArrayLike) -> Floats:
        """Depth at times ``(...)`` (temporal, Equation 2)."""
        result: Floats = self.depth + np.asarray(times, np.float64) * self.motion[2]
        return result

    def at_start(self, seen: Floats, times: Floats) -> Floats:
        """Follow points back to the opening of the shutter.

        Solves ``seen * w(t) = start * w(0) + t * motion``, Equation 3 of *temporal* for the lens centre, for
        the start, in a form that adds exactly nothing to what is still.

        Parameters
        ----------
        seen : ndarray, (..., 2)
            Where the lens centre sees points of the plane, in pixels.
        times : ndarray, (...)
            When it sees them there, in ``[0, 1]`` over the shutter.

        Returns
        -------
        ndarray, (..., 2)
            Where the lens centre saw the same points at t = 0.
        """
        if not self.moves:
            return seen
        *along, away = self.motion
        moved: Floats = (times / self.depth)[..., None] * (np.asarray(along) - seen * away)
        return seen - moved


def motion_of(
    depth: float,
    velocity: tuple[float, float] = (0.0, 0.0),
    *,
    depth_change: float = 0.0,
    principal_point: tuple[float, float] | None = None,
) -> Motion:
    """Put a straight motion in space into the form that `Plane` and `SampleBuffer` store.

    A point that only changes its depth moves on the image along the line through the principal point, where
    the optical axis meets the image: away from it as it comes closer.

    Parameters
    ----------
    depth : float
        Planar depth at t = 0, in scene units.
    velocity : (float, float)
        Movement parallel to the image over the whole shutter, as the pixels in x and y that it would cover
        at `depth`.
    depth_change : float
        Depth at t = 1 less `depth`, in scene units; negative towards the camera.
    principal_point : (float, float), optional
        In pixels, as a rule ``(width / 2, height / 2)``. Needed if the depth changes.

    Returns
    -------
    (float, float, float)
        Change of ``(x w, y w, w)`` over the shutter.

    Raises
    ------
    SampleError
        When the depth changes and no principal point is given.

    Examples
    --------
    >>> motion_of(2.0, (10, 0), depth_change=0.5, principal_point=(32, 24))
    (36.0, 12.0, 0.5)
    """
    if principal_point is None:
        if depth_change:
            raise SampleError(
                "a change of depth moves points to or from it: give it, as a rule the image's centre",
                field="principal_point",
            )
        principal_point = (0.0, 0.0)
    x, y = (
        speed * depth + axis * depth_change for speed, axis in zip(velocity, principal_point, strict=True)
    )
    return x, y, depth_change


def trace(
    planes: Sequence[Plane], lens: Lens, xy: npt.ArrayLike, uv: npt.ArrayLike, times: npt.ArrayLike = 0.0
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Find what rays hit.

    Parameters
    ----------
    planes, lens
        As in `sample`.
    xy, uv : array_like, (..., 2)
        Image positions in pixels and lens positions.
    times : array_like, (...) or one for all
        In ``[0, 1]`` over the shutter.

    Returns
    -------
    color : ndarray, (..., 3)
        Radiance, float32.
    depth : ndarray, (...)
        Planar depth at the ray's time, float32.

    Raises
    ------
    SampleError
        When no plane, or the farthest one masked, is given, and for times outside ``[0, 1]``.
    """
    color, depth, _ = hits_of(planes, lens, xy, uv, times)
    return color, depth


def hits_of(
    planes: Sequence[Plane], lens: Lens, xy: npt.ArrayLike, uv: npt.ArrayLike, times: npt.ArrayLike
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.intp]]:
    """Trace rays as `trace` does; say also which of the planes each has hit, as an index ``(...)``."""
    swaps, stacks = _front_to_back(planes)
    xy = np.asarray(xy, np.float64)
    uv = np.asarray(uv, np.float64)
    shape = xy.shape[:-1]
    xy, uv = xy.reshape(-1, 2), uv.reshape(-1, 2)
    times = np.broadcast_to(np.asarray(times, np.float64), shape).ravel()
    on_shutter = (times >= 0) & (times <= 1)
    if not on_shutter.all():
        raise SampleError(
            f"times lie in [0, 1] over the shutter, got {times[~on_shutter][0]:g}", field="times"
        )

    color = np.empty((len(xy), 3), np.float32)
    depth = np.empty(len(xy), np.float32)
    which = np.empty(len(xy), np.intp)
    period = np.searchsorted(swaps, times, side="right")
    for number, stack in enumerate(stacks):
        rays = np.flatnonzero(period == number)
        for index in stack:
            plane, now = planes[index], times[rays]
            distance = plane.depth_at(now)
            seen = plane.at_start(xy[rays] - lens.slope(distance)[:, None] * uv[rays], now)
            hit = np.ones(len(seen), bool) if plane.mask is None else np.asarray(plane.mask(seen), bool)
            color[rays[hit]] = plane.color(seen[hit])
            depth[rays[hit]] = distance[hit]
            which[rays[hit]] = index
            rays = rays[~hit]
    return color.reshape(*shape, 3), depth.reshape(shape), which.reshape(shape)


def _front_to_back(planes: Sequence[Plane]) -> tuple[Floats, list[list[int]]]:
    """Order planes by depth at all times.

    Depths change linearly, so the order only changes when two planes pass through each other.

    Parameters
    ----------
    planes : sequence of Plane
        In any order.

    Returns
    -------
    swaps : ndarray, (N,)
        Times within the shutter at which planes pass through each other, ascending.
    stacks : list of N + 1 lists
        Indices into `planes`, near to far, before, between and after those times.

    Raises
    ------
    SampleError
        When the farthest plane is masked at any time, or when there is no plane.
    """
    depth = np.array([plane.depth for plane in planes])
    change = np.array([plane.motion[2] for plane in planes])
    first, second = np.nonzero(change[:, None] > change)
    meeting = (depth[second] - depth[first]) / (change[first] - change[second])
    swaps: Floats = np.unique(meeting[(meeting > 0) & (meeting < 1)])
    ends = [0.0, *swaps, 1.0]
    stacks = []
    for start, end in itertools.pairwise(ends):
        stack = np.argsort(depth + (start + end) / 2 * change, kind="stable").tolist()
        if not stack or planes[stack[-1]].mask is not None:
            raise SampleError(
                "the farthest plane must cover everything, at all times: add one without a mask behind the "
                "others",
                field="planes",
            )
        stacks.append(stack)
    return swaps, stacks
