"""The samples' own mean on a GPU: ``native/cuda/temporal_mean.cu``, launched.

The twin of `fewrays.temporal.refine.sample_mean`. Samples are weighed and sorted into pixels by counting, so
that every pixel can add up those around it in the order of their numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from fewrays.aperture import Aperture
from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.lens import Lens
from fewrays.pixel_filter import PixelFilter, PixelFilterShape
from fewrays.temporal.shutter import Shutter

__all__ = ["KERNELS", "DeviceMean", "sample_mean_on_card"]

_MEAN = {
    **SAMPLE_FIELDS,
    "pixels": "*f8",
    **dict.fromkeys(("scale_u", "scale_v", "area", "falloff", "first_corner", "rim_arc", "rim_top"), "f8"),
    **dict.fromkeys(("sectors", "rows", "columns"), "i4"),
    **dict.fromkeys(("sampling_peak", "sampling_falloff"), "f8"),
    **dict.fromkeys(("opens", "length", "shutter_peak", "ramp", "bell"), "f8"),
    **dict.fromkeys(("filter_radius", "filter_sigma"), "f8"),
    **dict.fromkeys(("filter_shape", "reach"), "i4"),
    "weights": "*f8",
    "cells": "*i4",
    **dict.fromkeys(("counts", "starts"), "*u4"),
    "order": "*i4",
    **dict.fromkeys(("mean", "variance"), "*f4"),
    "several": "*u1",
    **dict.fromkeys(("height", "width"), "i4"),
}
_WEIGH, _FILL, _SORT, _ADD = (
    Kernel("temporal_mean", name, 256, _MEAN)
    for name in ("temporal_weigh", "temporal_mean_fill", "temporal_mean_sort", "temporal_mean")
)
KERNELS = (_WEIGH, _FILL, _SORT, _ADD)
"""All kernels of it."""


@dataclass(frozen=True, eq=False)
class DeviceMean:
    """The mean of the samples under the pixel filter, the aperture and the shutter, on the card.

    Parameters
    ----------
    mean : array of float32, (H, W, 4)
        Radiance, and 1 where there are samples, else 0.
    variance : array of float32, (H, W)
        Of the mean, summed over the channels.
    several : array of uint8, (H, W)
        Where there are enough samples for the variance to say anything.
    """

    mean: Any
    variance: Any
    several: Any


def sample_mean_on_card(
    machine: Machine, samples: DeviceSamples, aperture: Aperture, pixel_filter: PixelFilter, shutter: Shutter
) -> DeviceMean:
    """Average the samples near every pixel, weighted by filter, aperture and shutter.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    aperture : Aperture
        What the image integrates over.
    pixel_filter : PixelFilter
    shutter : Shutter

    Returns
    -------
    DeviceMean
        Nothing waits for it.
    """
    xp, height, width, reach = machine.xp, samples.height, samples.width, pixel_filter.reach
    cells = (height + 2 * reach) * (width + 2 * reach)
    counts, starts = xp.zeros(cells, np.uint32), xp.zeros(cells + 1, np.uint32)
    result = DeviceMean(
        xp.empty((height, width, 4), np.float32),
        xp.empty((height, width), np.float32),
        xp.empty((height, width), np.uint8),
    )
    arguments = {
        **samples.arguments(),
        **_aperture_numbers(machine, aperture),
        **_sampling_numbers(samples.lens),
        **_shutter_numbers(shutter),
        "filter_radius": pixel_filter.radius,
        "filter_sigma": pixel_filter.sigma_pix,
        "filter_shape": get_args(PixelFilterShape).index(pixel_filter.shape),
        "reach": reach,
        "weights": xp.empty(samples.count, np.float64),
        "cells": xp.empty(samples.count, np.int32),
        "counts": counts,
        "starts": starts,
        "order": xp.empty(samples.count, np.int32),
        "mean": result.mean,
        "variance": result.variance,
        "several": result.several,
        "height": height,
        "width": width,
    }
    machine.launch(_WEIGH, (blocks_for(samples.count, _WEIGH), 1, 1), **arguments)
    xp.cumsum(counts, dtype=np.uint32, out=starts[1:])
    counts.fill(0)
    machine.launch(_FILL, (blocks_for(samples.count, _FILL), 1, 1), **arguments)
    machine.launch(_SORT, (blocks_for(cells, _SORT), 1, 1), **arguments)
    machine.launch(_ADD, (blocks_for(height * width, _ADD), 1, 1), **arguments)
    return result


def _aperture_numbers(machine: Machine, aperture: Aperture) -> dict[str, Any]:
    """Return ``ApertureLight`` in ``native/math/aperture_light.h``."""
    scale_u, scale_v = aperture.scale
    numbers: dict[str, Any] = {"scale_u": scale_u, "scale_v": scale_v, "area": aperture.area, "falloff": 0.0}
    if aperture.image is not None:
        pixels = aperture.image.pixels
        rows, columns = pixels.shape
        numbers |= {"pixels": machine.on_device(pixels, np.float64), "rows": rows, "columns": columns}
        return numbers | {"first_corner": 0.0, "rim_arc": 0.0, "rim_top": 0.0, "sectors": 0}
    arc, top = aperture.rim_arc
    if aperture.shape == "gaussian":
        numbers["falloff"] = 0.5 / aperture.sigma**2
    numbers |= {"pixels": None, "rows": 0, "columns": 0, "rim_arc": arc, "rim_top": top}
    return numbers | {"first_corner": aperture.first_corner, "sectors": aperture.sectors}


def _sampling_numbers(lens: Lens) -> dict[str, float]:
    falloff = 0.5 / lens.sigma**2 if lens.sampling == "gaussian" else 0.0
    return {"sampling_peak": float(lens.sampling_density((0.0, 0.0))), "sampling_falloff": falloff}


def _shutter_numbers(shutter: Shutter) -> dict[str, float]:
    """Return ``ShutterLight`` in ``native/math/shutter_light.h``."""
    length = shutter.closes - shutter.opens
    peak, ramp, bell = shutter.light
    peak = peak / length if length else 0.0
    return {"opens": shutter.opens, "length": length, "shutter_peak": peak, "ramp": ramp, "bell": bell}
