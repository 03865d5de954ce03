"""A whole image's pattern, made in blocks of rows because its intermediates are many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.area_light import AreaLight
from fewrays.lens import Lens, Sampling
from fewrays.sources.patterns import check_size, sample_lights, sample_pattern, sample_times

__all__ = ["ImagePattern"]

_BLOCK = 2**20  # samples that are made at once

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class ImagePattern:
    """Where samples of an image of `height` x `width` pixels lie: on it, on the lens, in time and on lights.

    Raises
    ------
    SampleError
        For a size that `fewrays.sources.patterns` refuses.
    """

    height: int
    width: int
    spp: int
    seed: int

    def __post_init__(self) -> None:
        check_size(*self._size)

    @property
    def _size(self) -> tuple[int, int, int]:
        return self.height, self.width, self.spp

    def positions(self, lens: Lens) -> tuple[Float32, Float32]:
        """Return positions on the image and on the lens, both (H, W, S, 2)."""
        xy, uv = np.empty((*self._size, 2), np.float32), np.empty((*self._size, 2), np.float32)
        for rows in self._row_blocks():
            xy[slice(*rows)], uv[slice(*rows)] = sample_pattern(
                *self._size, seed=self.seed, sampling=lens.sampling, sigma=lens.sigma, rows=rows
            )
        return xy, uv

    def slice_times(self, slices: int) -> Float32:
        """Return times (N,), each moved to the middle of its slice of the shutter interval."""
        times = np.empty(self._size, np.float32)
        for rows in self._row_blocks():
            continuous = sample_times(*self._size, seed=self.seed, rows=rows)
            times[slice(*rows)] = (np.floor(continuous * slices) + 0.5) / slices
        return times.reshape(-1)

    def on_lights(self, lights: Sequence[AreaLight]) -> Float32:
        """Return points on every light, (N, L, 2), in [-1, 1]² or the unit disc."""
        points = np.empty((*self._size, len(lights), 2), np.float32)
        for number, light in enumerate(lights):
            shape: Sampling = "disc" if light.shape == "disc" else "square"
            for rows in self._row_blocks():
                points[slice(*rows), :, :, number] = sample_lights(
                    *self._size, seed=self.seed, light=number, sampling=shape, rows=rows
                )
        return points.reshape(-1, len(lights), 2)

    def _row_blocks(self) -> Iterator[tuple[int, int]]:
        step = max(1, _BLOCK // (self.width * self.spp))
        for first in range(0, self.height, step):
            yield first, min(first + step, self.height)
