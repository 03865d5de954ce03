"""When the shutter is open, and how much light it lets pass."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays.errors import require_option

__all__ = ["Shutter", "ShutterResponse"]

ShutterResponse = Literal["box", "trapezoid", "triangle", "gaussian"]
Float64 = npt.NDArray[np.float64]

_RAMPS = {"box": 0.0, "trapezoid": 0.25, "triangle": 0.5}
_SIGMAS = 3.0  # standard deviations of the Gaussian response from its middle to its ends


@dataclass(frozen=True)
class Shutter:
    """A shutter interval and its response.

    Parameters
    ----------
    opens, closes : float
        Times in [0, 1] over the shutter interval of the samples; the same for an instant.
    response : {"box", "trapezoid", "triangle", "gaussian"}
        How open the shutter is in between: fully; fully over the middle half, opening and closing at a steady
        rate before and after; opening up to the middle and closing from there; or a Gaussian cut off at 3
        standard deviations.

    Raises
    ------
    SampleError
        For times that are not in order within [0, 1] or an unknown response.
    """

    opens: float = 0.0
    closes: float = 1.0
    response: ShutterResponse = "box"

    def __post_init__(self) -> None:
        ordered = 0 <= self.opens <= self.closes <= 1
        interval = (self.opens, self.closes)
        require_option("shutter", interval, ordered, "with 0 <= opening <= closing <= 1")
        responses = get_args(ShutterResponse)
        require_option(
            "shutter_response", self.response, self.response in responses, f"out of {', '.join(responses)}"
        )

    def times(self, shares: npt.ArrayLike) -> Float64:
        """Return the times before which these shares of the light, each in [0, 1], have passed."""
        share = np.asarray(shares, np.float64)
        return self.opens + (self.closes - self.opens) * self._within(share)

    def density(self, times: npt.ArrayLike) -> Float64:
        """Return the light per time, whose integral is 1; 0 for an instant, which no sample hits."""
        length = self.closes - self.opens
        if length == 0:
            return np.zeros(np.shape(times))
        within = (np.asarray(times, np.float64) - self.opens) / length
        inside = (within >= 0) & (within <= 1)
        peak, ramp, bell = self.light
        light = np.full_like(within, peak)
        if bell:
            light *= np.exp(-bell * np.square(within - 0.5))
        elif ramp:
            light *= np.minimum(np.minimum(within, 1 - within) / ramp, 1.0)
        density: Float64 = np.where(inside, light / length, 0.0)
        return density

    @property
    def light(self) -> tuple[float, float, float]:
        """What the response is over the time that the shutter is open, as if that were 1.

        The light per time where it is widest open; the share of the time that opening takes, and closing, 0
        for none; and ``1 / (2 σ²)`` of a Gaussian, 0 for other responses.
        """
        if self.response == "gaussian":
            normal = NormalDist(0.5, 1 / (2 * _SIGMAS))
            return normal.pdf(0.5) / (normal.cdf(1) - normal.cdf(0)), 0.0, 0.5 * (2 * _SIGMAS) ** 2
        ramp = _RAMPS[self.response]
        return 1 / (1 - ramp), ramp, 0.0

    def _within(self, share: Float64) -> Float64:
        """Invert the distribution of light over the time that the shutter is open, [0, 1]."""
        if self.response == "gaussian":
            normal = NormalDist()
            below = normal.cdf(-_SIGMAS)
            deviations = [normal.inv_cdf(below + (1 - 2 * below) * q) for q in share]
            return 0.5 + np.array(deviations) / (2 * _SIGMAS)
        # A trapezoid of height 1 with ramps of length r holds 1 - r of light, r / 2 on each ramp: the time
        # with light L before it is √(2 r L) on the first ramp and L + r / 2 between them.
        ramp = _RAMPS[self.response]
        light = np.minimum(share, 1 - share) * (1 - ramp)
        time = np.where(light < ramp / 2, np.sqrt(2 * ramp * light), light + ramp / 2)
        return np.where(share < 0.5, time, 1 - time)
