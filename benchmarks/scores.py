"""PSNR of an image, with and without the noise of the reference that it is compared with."""

from __future__ import annotations

import math
from dataclasses import dataclass

from example_renders import Reference
from fewrays.method import Image
from fewrays.metrics import psnr_display

__all__ = ["Score", "decibels", "score", "without_noise"]


@dataclass(frozen=True)
class Score:
    """PSNR in dB after clip to [0, 1] and gamma 2.2: as measured, and without the reference's noise."""

    measured: float
    corrected: float

    def __str__(self) -> str:
        return f"{self.measured:.2f} ({decibels(self.corrected)})"

    @property
    def error(self) -> float:
        """Mean squared error behind the corrected PSNR."""
        return float(10 ** (-self.corrected / 10))


def score(image: Image, reference: Reference) -> Score:
    """Compare an image with the reference of its pixel filter."""
    measured = psnr_display(image, reference.image)
    return Score(measured, without_noise(measured, reference.noise_psnr))


def without_noise(psnr: float, noise_psnr: float) -> float:
    """Return the PSNR in dB against the limit of a reference, given that against the noisy reference.

    The reference's noise is independent of the image's error, so their mean squares add up. The result is
    infinite where noise explains all of the error.
    """
    error = float(10 ** (-psnr / 10) - 10 ** (-noise_psnr / 10))
    return -10 * math.log10(error) if error > 0 else math.inf


def decibels(value: float) -> str:
    """Return a corrected PSNR as text."""
    return "noise only" if math.isinf(value) else f"{value:.2f}"
