"""Transfer functions between linear radiance and display values: sRGB (IEC 61966-2-1), and a plain gamma.

sRGB is for pictures: linear below 0.0031308 and a power of 1/2.4 above, so that the eye sees equal steps. The
gamma is for error figures, as in the papers.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["gamma_encode", "srgb_decode", "srgb_encode"]

_LINEAR_END = 0.0031308  # where the two pieces meet, in linear light
_DISPLAY_END = 12.92 * _LINEAR_END


def srgb_encode(linear: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Turn linear light into sRGB display values.

    Parameters
    ----------
    linear : array_like
        Linear light, 1 = display white, any shape. Values outside ``[0, 1]`` are clipped: a display shows no
        more.

    Returns
    -------
    ndarray
        float32 in ``[0, 1]``, the shape of `linear`.
    """
    light = np.clip(np.asarray(linear, np.float32), 0, 1)
    encoded = np.where(light <= _LINEAR_END, 12.92 * light, 1.055 * light ** np.float32(1 / 2.4) - 0.055)
    return encoded.astype(np.float32, copy=False)


def srgb_decode(display: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Turn sRGB display values into linear light; the inverse of `srgb_encode`.

    Parameters
    ----------
    display : array_like
        Display values in ``[0, 1]``, any shape; values outside are clipped.

    Returns
    -------
    ndarray
        float32 in ``[0, 1]``, the shape of `display`.
    """
    value = np.clip(np.asarray(display, np.float32), 0, 1)
    light = np.where(value <= _DISPLAY_END, value / 12.92, ((value + 0.055) / 1.055) ** np.float32(2.4))
    return light.astype(np.float32, copy=False)


def gamma_encode(linear: npt.ArrayLike, gamma: float = 2.2) -> npt.NDArray[np.float64]:
    """Clip linear light to ``[0, 1]`` and raise it to ``1 / gamma``.

    Parameters
    ----------
    linear : array_like
        Linear light, 1 = display white, any shape.
    gamma : float
        2.2 for the project's error figures.

    Returns
    -------
    ndarray
        float64 in ``[0, 1]``, the shape of `linear`.
    """
    encoded: npt.NDArray[np.float64] = np.clip(linear, 0, 1) ** (1 / gamma)
    return encoded
