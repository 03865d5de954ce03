"""A layer as it is warped: light, coverage and slope of every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Sheet"]

Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Sheet:
    """A layer of the scene as the lens centre sees it.

    Parameters
    ----------
    light : ndarray of float32, (H, W, 4)
        Radiance and opacity, both multiplied by `coverage`. The opacity is what ends up in the image's alpha
        channel: a pixel that is known to be empty covers what is behind it and has none.
    coverage : ndarray of float32, (H, W)
        Share of the pixel that the sheet covers, 0 to 1.
    slope : ndarray of float32, (H, W)
        In pixels per unit of lens coordinate.
    shown : ndarray of bool, (H, W)
        Pixels that are warped. The others only complete the surfaces that these belong to, where a place
        between pixels is looked up.
    behind : float
        Pixels of slope by which the sheet stands back where visibility is resolved: what was made up must
        not hide what was seen.
    """

    light: Float32
    coverage: Float32
    slope: Float32
    shown: npt.NDArray[np.bool_]
    behind: float = 0.0
