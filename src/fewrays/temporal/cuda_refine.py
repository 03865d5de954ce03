"""What the mean of locations gains, on a GPU: ``native/cuda/temporal_refine.cu``, launched.

The twin of `fewrays.temporal.refine`, which says what is done and why. Nothing of it waits for the card: even
the median of the noise, of which pixels must have some share to be trusted less, stays there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.temporal.cuda_mean import DeviceMean
from fewrays.temporal.refine import (
    BEARABLE,
    LEAST_LEFT,
    LEAST_NOISE,
    NEAR,
    NOISE,
    OWN_SHARE,
    POOL,
    gaussian_taps,
    smoothing_of_bands,
)

__all__ = ["KERNELS", "blur", "correct", "smooth_bands"]

_MOST_TAPS = 97  # on one side of a blur, with the middle: of POOL times the widest correction
_HALF_VALUES = 2**16  # that the upper or the lower half of a number's bits can have
_MIDDLE = 7  # words of ``Middle`` in ``native/cuda/median.h``

_SIZE = dict.fromkeys(("height", "width"), "i4")


def _kernels(names: str, arguments: dict[str, str]) -> tuple[Kernel, ...]:
    return tuple(Kernel("temporal_refine", f"temporal_{name}", 256, arguments) for name in names.split())


_BLUR, *_ = _kernels(
    "blur",
    {
        **dict.fromkeys(("image", "blurred"), "*f4"),
        **_SIZE,
        **dict.fromkeys(("channels", "first", "step", "along", "reach"), "i4"),
        "taps": f"{_MOST_TAPS}f4",
    },
)
_JOIN, *_ = _kernels(
    "join",
    {
        **dict.fromkeys(("bands", "smooth", "image"), "*f4"),
        **_SIZE,
        **dict.fromkeys(("band_count", "first_smooth"), "i4"),
    },
)
_SQUARES, _NOISE = _kernels(
    "squares noise",
    {
        **dict.fromkeys(("mean", "near", "squares", "around", "variance"), "*f4"),
        "several": "*u1",
        "noise": "*f4",
        **_SIZE,
        "own_share": "f4",
    },
)
_POOL, _UPPER, _COUNT, _LOWER, _TRUST = _kernels(
    "pool upper count lower trust",
    {
        **dict.fromkeys(("noise", "pooled", "trust"), "*f4"),
        **dict.fromkeys(("counts", "middle", "largest"), "*u4"),
        **_SIZE,
        "least_noise": "f4",
    },
)
_DIFFERENCE, _ENERGIES, _CORRECT = _kernels(
    "difference energies correct",
    {
        **dict.fromkeys(("image", "mean", "noise", "trust"), "*f4"),
        "largest": "*u4",
        **dict.fromkeys(("weighed", "weighed_noise", "around", "around_noise"), "*f4"),
        **dict.fromkeys(("difference", "energies", "pooled", "corrected"), "*f4"),
        **_SIZE,
        **dict.fromkeys(("noise_share", "bearable", "least_left"), "f4"),
    },
)
KERNELS = (
    *(_BLUR, _JOIN, _SQUARES, _NOISE, _POOL, _UPPER, _COUNT, _LOWER, _TRUST),
    *(_DIFFERENCE, _ENERGIES, _CORRECT),
)
"""All kernels of it."""


def smooth_bands(machine: Machine, bands: Any, starts: tuple[float, ...], along_lens: float) -> Any:
    """Join bands of blur to an image, each smoothed by what it can bear.

    Parameters
    ----------
    machine : Machine
    bands : array of float32, (H, W, bands, 4)
        Sums of radiance and of weights.
    starts : tuple of float
        Least |C| of each band, in pixels, ascending.
    along_lens : float
        δ, in lens units; 0 for no smoothing.

    Returns
    -------
    array of float32, (H, W, 3)
        Radiance; 0 where no location found anything.
    """
    xp, (height, width, count, _) = machine.xp, bands.shape
    widths = smoothing_of_bands(starts, along_lens)
    first = next((band for band, sigma in enumerate(widths) if sigma), count)
    smooth = xp.empty((count - first, height, width, 4), np.float32)
    for band in range(first, count):
        blur(machine, bands, widths[band], channels=(4 * band, 4), out=smooth[band - first])
    image = xp.empty((height, width, 3), np.float32)
    machine.launch(
        _JOIN,
        _pixels(image),
        bands=bands,
        smooth=smooth,
        image=image,
        height=height,
        width=width,
        band_count=count,
        first_smooth=first,
    )
    return image


def correct(machine: Machine, image: Any, samples: DeviceMean, sigma: float) -> Any:
    """Add what the samples' own mean differs by, smoothed, as far as its noise does not explain that.

    Parameters
    ----------
    machine : Machine
    image : array of float32, (H, W, 3)
        Radiance.
    samples : DeviceMean
    sigma : float
        Standard deviation of the Gaussian that smooths the difference, in pixels.

    Returns
    -------
    array of float32, (H, W, 3)
        Not negative where `image` is not.
    """
    noise = _noise(machine, samples)
    trust, largest = _trust(machine, noise, sigma)
    names = {"weighed": 4, "weighed_noise": 1, "difference": 3, "energies": 3, "corrected": 3}
    planes = {name: _planes(machine, image, channels) for name, channels in names.items()}
    given = {"image": image, "mean": samples.mean, "noise": noise, "trust": trust, "largest": largest}
    given |= {**planes, **dict.fromkeys(("around", "around_noise", "pooled"))}
    given |= {"height": image.shape[0], "width": image.shape[1]}
    given |= {"noise_share": NOISE, "bearable": BEARABLE, "least_left": LEAST_LEFT}
    machine.launch(_DIFFERENCE, _pixels(image), **given)
    given["around"] = blur(machine, planes["weighed"], sigma)
    given["around_noise"] = blur(machine, planes["weighed_noise"], sigma, squared=True)
    machine.launch(_ENERGIES, _pixels(image), **given)
    given["pooled"] = blur(machine, planes["energies"], POOL * sigma)
    machine.launch(_CORRECT, _pixels(image), **given)
    return planes["corrected"]


def _noise(machine: Machine, samples: DeviceMean) -> Any:
    """Return the variance where there are samples, and 1 there: (H, W, 2)."""
    mean = samples.mean
    squares, noise = (_planes(machine, mean, 2) for _ in range(2))
    given = {
        "mean": mean,
        "near": blur(machine, mean, NEAR),
        "squares": squares,
        "around": None,
        "variance": samples.variance,
        "several": samples.several,
        "noise": noise,
        "height": mean.shape[0],
        "width": mean.shape[1],
        "own_share": OWN_SHARE,
    }
    machine.launch(_SQUARES, _pixels(mean), **given)
    given["around"] = blur(machine, squares, 2 * NEAR)
    machine.launch(_NOISE, _pixels(mean), **given)
    return noise


def _trust(machine: Machine, noise: Any, sigma: float) -> tuple[Any, Any]:
    """Weigh pixels by how little noise there is around them: (H, W), and the bits of the largest weight."""
    xp, trust = machine.xp, _planes(machine, noise, 1)
    counts, largest = xp.zeros((2, _HALF_VALUES), np.uint32), xp.zeros(1, np.uint32)
    given = {
        "noise": noise,
        "pooled": blur(machine, noise, sigma),
        "trust": trust,
        "counts": counts,
        "middle": xp.zeros(_MIDDLE, np.uint32),
        "largest": largest,
        "height": noise.shape[0],
        "width": noise.shape[1],
        "least_noise": LEAST_NOISE,
    }
    machine.launch(_POOL, _pixels(noise), **given)
    machine.launch(_UPPER, (1, 1, 1), **given)
    counts.fill(0)
    machine.launch(_COUNT, _pixels(noise), **given)
    machine.launch(_LOWER, (1, 1, 1), **given)
    machine.launch(_TRUST, _pixels(noise), **given)
    return trust, largest


def blur(
    machine: Machine,
    image: Any,
    sigma: float,
    *,
    squared: bool = False,
    channels: tuple[int, int] | None = None,
    out: Any = None,
) -> Any:
    """Blur an image with a Gaussian, taking nothing to be beyond its borders.

    Parameters
    ----------
    machine : Machine
    image : array of float32, (H, W, …)
    sigma : float
        Standard deviation in pixels, at most 32.
    squared : bool
        Use the squares of the taps, as for the variance of a blurred image of independent pixels.
    channels : (int, int), optional
        Number of the first channel and how many to blur; all when omitted.
    out : array of float32, (H, W, channels), optional
        Receives the blurred image.

    Returns
    -------
    array of float32, (H, W, channels)
        `out`, or a new one.
    """
    height, width = image.shape[:2]
    step = image.size // (height * width)
    first, count = channels or (0, step)
    taps = gaussian_taps(sigma, squared=squared)
    reach = len(taps) // 2
    side = np.zeros(_MOST_TAPS, np.float32)
    side[: reach + 1] = taps[reach:]
    out = _planes(machine, image, count) if out is None else out
    between = _planes(machine, image, count)
    for along, (source, to) in enumerate(((image, between), (between, out))):
        machine.launch(
            _BLUR,
            (blocks_for(height * width * count, _BLUR), 1, 1),
            image=source,
            blurred=to,
            height=height,
            width=width,
            channels=count,
            first=0 if along else first,
            step=count if along else step,
            along=along,
            reach=reach,
            taps=side,
        )
    return out


def _planes(machine: Machine, image: Any, channels: int) -> Any:
    return machine.xp.empty((*image.shape[:2], channels), np.float32)


def _pixels(image: Any) -> tuple[int, int, int]:
    """Return the blocks that give each pixel of an image a thread."""
    return blocks_for(image.shape[0] * image.shape[1], _JOIN), 1, 1
