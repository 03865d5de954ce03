"""Where samples are seen from another lens point at another time (temporal, section 3.1, Eq. 2 to 4).

A sample is a point on a surface, hit by one ray. Taking away what its own lens point did to its image
position leaves the *path* on which the lens centre sees the point: a straight line in space, and so in
homogeneous screen coordinates ``(x w, y w, w)``, where w is the depth. A *view* is a lens point and a time;
every path has one *sight* there. ``native/math/reprojection.h`` is the native twin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.samples import SampleBuffer

__all__ = ["NEAREST_SHARE", "Paths", "Sights"]

Float64 = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

NEAREST_SHARE = 1e-3
"""Share of its own depth below which a point that comes towards the camera is not seen any more."""


@dataclass(frozen=True)
class Sights:
    """Points as seen from one lens point at one time.

    Parameters
    ----------
    sample : ndarray of int, (N,)
        Which sample each one is: its index into the flattened buffer.
    xy : ndarray, (N, 2)
        Where it is seen, in pixels.
    slope : ndarray, (N,)
        How fast it moves over the screen along with the lens point, in pixels per lens unit: front to back.
    speed : ndarray, (N, 2)
        How fast it moves over the screen while the shutter is open, in pixels per shutter interval.
    """

    sample: Indices
    xy: Float64
    slope: Float64
    speed: Float64

    @property
    def count(self) -> int:
        """Number of points, N."""
        return len(self.sample)

    def take(self, which: npt.NDArray[np.bool_] | Indices | slice) -> Sights:
        """Return some of them."""
        return Sights(self.sample[which], self.xy[which], self.slope[which], self.speed[which])

    def relative_to(self, x: float, y: float) -> Sights:
        """Return them with positions relative to a place in the image, in pixels."""
        return Sights(self.sample, self.xy - np.array([x, y]), self.slope, self.speed)

    @classmethod
    def join(cls, parts: Sequence[Sights]) -> Sights:
        """Put several together."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            sample=np.concatenate([part.sample for part in parts]),
            xy=np.concatenate([part.xy for part in parts]),
            slope=np.concatenate([part.slope for part in parts]),
            speed=np.concatenate([part.speed for part in parts]),
        )


@dataclass(frozen=True)
class Paths:
    """How samples move over the screen of the lens centre while the shutter is open.

    Parameters
    ----------
    start : ndarray, (N, 3)
        Homogeneous screen positions ``(x w, y w, w)`` as the shutter opens, in pixels times depth units and,
        the last, depth units.
    change : ndarray, (N, 3)
        Their change until it closes.
    nearest : ndarray, (N,)
        Depth below which a point is not seen.
    c0, c1 : float
        The lens: ``slope = c0 / depth + c1`` (Eq. 4).
    """

    start: Float64
    change: Float64
    nearest: Float64
    c0: float
    c1: float

    @classmethod
    def of_samples(cls, samples: SampleBuffer) -> Paths:
        """Follow each sample back to the lens centre and to the opening of the shutter.

        These are the bracket in Eq. 3, ``(x - u C(z)) z``, for both axes and Eq. 2, at the time 0.

        Parameters
        ----------
        samples : SampleBuffer
            Without a motion everything stands still, whatever the times.

        Returns
        -------
        Paths
            N = H · W · S.
        """
        xy, uv = (values.reshape(-1, 2).astype(np.float64) for values in (samples.xy, samples.uv))
        depth = samples.depth.astype(np.float64).reshape(-1, 1)
        c0, c1 = samples.lens.c0, samples.lens.c1
        own = np.concatenate([(xy - uv * (c0 / depth + c1)) * depth, depth], axis=1)
        change = np.zeros_like(own)
        time = np.zeros_like(depth)
        if samples.motion is not None and samples.time is not None:
            change = samples.motion.reshape(-1, 3).astype(np.float64)
            time = samples.time.reshape(-1, 1).astype(np.float64)
        return cls(own - time * change, change, NEAREST_SHARE * depth[:, 0], c0, c1)

    def seen_from(self, u: float, v: float, time: float) -> Sights:
        """See the samples from a lens point at a time (Eq. 2 and 3).

        Parameters
        ----------
        u, v : float
            Lens point, in lens units.
        time : float
            In [0, 1] over the shutter.

        Returns
        -------
        Sights
            Of the samples that are in front of the camera then.
        """
        depth = self.start[:, 2] + time * self.change[:, 2]
        sample = np.flatnonzero(depth >= self.nearest)
        change, depth = self.change[sample], depth[sample]
        at_centre = (self.start[sample, :2] + time * change[:, :2]) / depth[:, None]
        slope = self.c0 / depth + self.c1
        # Derivatives by time of the two: the slope, too, changes with the depth.
        speed_at_centre = (change[:, :2] - change[:, 2:] * at_centre) / depth[:, None]
        slope_change = -self.c0 * change[:, 2] / depth**2
        lens_point = np.array([u, v])
        return Sights(
            sample=sample,
            xy=at_centre + slope[:, None] * lens_point,
            slope=slope,
            speed=speed_at_centre + slope_change[:, None] * lens_point,
        )
