"""What planes are painted with: textures, and masks that say where a plane is, by position in pixels."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = [
    "Mask",
    "Texture",
    "Waves",
    "checker",
    "constant",
    "disc",
    "grating",
    "half_plane",
    "smooth_noise",
    "stripes",
]

Floats = npt.NDArray[np.float64]
Texture = Callable[[Floats], npt.ArrayLike]
"""From positions ``(..., 2)`` in pixels, as the lens centre sees them, to radiance ``(..., 3)``."""
Mask = Callable[[Floats], npt.NDArray[np.bool_]]
"""From positions ``(..., 2)`` in pixels to whether the plane is there, ``(...)``."""


# Textures.


@dataclass(frozen=True, eq=False)
class Waves:
    """A texture that is a sum of sinusoids, ``mean + sum_n amplitude_n cos(2π frequency_n · xy + phase_n)``.

    Parameters
    ----------
    mean : ndarray, (3,)
        Mean radiance.
    amplitude : ndarray, (N, 3)
        Of each wave.
    frequency : ndarray, (N, 2)
        In cycles per pixel.
    phase : ndarray, (N,)
        In radians.
    """

    mean: Floats
    amplitude: Floats
    frequency: Floats
    phase: Floats

    def __call__(self, xy: Floats) -> Floats:
        """Radiance ``(..., 3)`` at positions ``(..., 2)``."""
        result: Floats = self.mean + np.cos(2 * np.pi * (xy @ self.frequency.T) + self.phase) @ self.amplitude
        return result


def constant(red: float, green: float | None = None, blue: float | None = None) -> Texture:
    """One radiance everywhere; grey when only one number is given."""
    color = np.array([red, red if green is None else green, red if blue is None else blue], np.float64)
    return lambda xy: np.broadcast_to(color, (*xy.shape[:-1], 3))


def checker(
    size: float,
    dark: Sequence[float] = (0.1, 0.1, 0.1),
    light: Sequence[float] = (0.9, 0.9, 0.9),
) -> Texture:
    """Squares of `size` pixels in two colours, one corner at the origin."""
    colors = np.array([light, dark], np.float64)
    return lambda xy: colors[np.floor(xy / size).astype(np.int64).sum(axis=-1) % 2]


def grating(
    frequency: tuple[float, float],
    *,
    mean: Sequence[float] = (0.5, 0.5, 0.5),
    amplitude: Sequence[float] = (0.4, 0.4, 0.4),
    phase: float = 0.0,
) -> Waves:
    """One sinusoid of `frequency` cycles per pixel along x and y."""
    return Waves(
        np.asarray(mean, np.float64),
        np.asarray([amplitude], np.float64),
        np.asarray([frequency], np.float64),
        np.asarray([phase], np.float64),
    )


def smooth_noise(
    period: float,
    *,
    mean: Sequence[float] = (0.5, 0.5, 0.5),
    contrast: float = 0.15,
    waves: int = 24,
    seed: int = 0,
) -> Waves:
    """Band-limited coloured noise.

    Parameters
    ----------
    period : float
        Shortest period in pixels; the longest is 8 times that.
    mean : sequence of 3 floats
        Mean radiance.
    contrast : float
        Standard deviation of each channel.
    waves : int
        Number of sinusoids.
    seed : int
        The same seed gives the same texture.

    Returns
    -------
    Waves
    """
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, np.pi, waves)
    frequency = 8 ** -rng.random(waves) / period
    amplitude = rng.normal(size=(waves, 3))
    amplitude *= contrast * math.sqrt(2) / np.linalg.norm(amplitude, axis=0)
    return Waves(
        np.asarray(mean, np.float64),
        amplitude,
        frequency[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1),
        rng.uniform(0, 2 * np.pi, waves),
    )


# Masks.


def disc(center: tuple[float, float], radius: float) -> Mask:
    """Inside a circle, in pixels."""
    return lambda xy: np.square(xy - np.asarray(center)).sum(axis=-1) < radius**2


def half_plane(point: tuple[float, float], normal: tuple[float, float]) -> Mask:
    """On the side of the line through `point` that `normal` points to."""
    return lambda xy: (xy - np.asarray(point)) @ np.asarray(normal, np.float64) > 0


def stripes(period: float, *, fill: float = 0.5, direction: tuple[float, float] = (1.0, 0.0)) -> Mask:
    """Bars across `direction`, one every `period` pixels, that fill the share `fill` of it."""
    axis = np.asarray(direction, np.float64) / np.hypot(*direction)
    return lambda xy: np.mod(xy @ axis / period, 1) < fill
