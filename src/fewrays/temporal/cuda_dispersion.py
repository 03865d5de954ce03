"""How large the holes between samples on a GPU are: ``native/cuda/temporal_dispersion.cu``, launched.

The twin of `fewrays.temporal.dispersion`. The host gets one number for each plane, and waits for them: how
wide cells are, and so how many, it has to know before it can launch what sorts samples into them.
"""

from __future__ import annotations

import math

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.cuda.samples import DeviceSamples
from fewrays.temporal.dispersion import REACH, SIDE, believable, middle_of, published_radius, random_planes

__all__ = ["KERNELS", "dispersion_on_card"]

_MOST_PLANES = 16

_HOLES = Kernel(
    "temporal_dispersion",
    "temporal_holes",
    64,
    {
        **dict.fromkeys(("xy", "uv", "time"), "*f4"),
        "holes": "*u8",
        **dict.fromkeys(("slopes", "speeds_x", "speeds_y"), f"{_MOST_PLANES}f8"),
        "reach": "f8",
        **dict.fromkeys(("first_row", "first_column", "side", "width", "spp"), "i4"),
    },
)
KERNELS = (_HOLES,)
"""All kernels of it."""


def dispersion_on_card(machine: Machine, samples: DeviceSamples, *, timed: bool) -> float:
    """Measure how large the empty circles between reprojected samples get, and wait for it.

    Parameters
    ----------
    machine : Machine
    samples : DeviceSamples
    timed : bool
        Whether anything moves, so that times spread samples as lens points do.

    Returns
    -------
    float
        Radius in pixels, as `fewrays.temporal.dispersion.dispersion` has it.
    """
    middle = middle_of(samples.height, samples.width)
    if middle is None:
        return published_radius(samples.spp)
    row, column, side = middle
    planes = random_planes(timed=timed)
    holes = machine.xp.zeros(len(planes), np.uint64)
    machine.launch(
        _HOLES,
        (SIDE * SIDE, len(planes), 1),
        xy=samples.xy,
        uv=samples.uv if samples.lens.c0 else None,
        time=samples.time if timed else None,
        holes=holes,
        slopes=planes[:, 0],
        speeds_x=planes[:, 1],
        speeds_y=planes[:, 2],
        reach=math.ceil(REACH),
        first_row=row,
        first_column=column,
        side=side,
        width=samples.width,
        spp=samples.spp,
    )
    squares = machine.fetch(holes)().view(np.float64)
    return believable(float(np.sqrt(squares).mean()), samples.spp)
