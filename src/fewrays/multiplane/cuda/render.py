"""From planes to images on a GPU: ``native/cuda/multiplane_render.cu``, launched."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine
from fewrays.lens import Lens
from fewrays.multiplane.copies import Copies
from fewrays.multiplane.cuda.planes import DevicePlanes
from fewrays.multiplane.cuda.smoothing import copy_records, smooth_planes
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.render import RenderOptions, shrink_of
from fewrays.temporal.locations import Locations

__all__ = ["KERNELS", "render_planes"]

Float64 = npt.NDArray[np.float64]

_TILE = 32
_RENDER = Kernel(
    "multiplane_render",
    "multiplane_render",
    256,
    {
        "planes": "*i4",
        "shrink": "*f4",
        "reach": "*f4",
        "is_smoothed": "*u1",
        "slots": "*i4",
        "built": "*u2",
        "smoothed": "*u2",
        "views": "*f4",
        "image": "*f4",
        "rim": "5f4",
        "count": "i4",
        "view_count": "i4",
        "height": "i4",
        "width": "i4",
        "front_end": "i4",
        "back_begin": "i4",
        "vignetted": "i4",
        "darken": "i4",
    },
)
KERNELS = (_RENDER,)
"""All kernels of the step."""


def render_planes(machine: Machine, planes: DevicePlanes, lens: Lens | None, options: RenderOptions) -> Any:
    """Make an image, without waiting for it.

    Parameters
    ----------
    machine : Machine
    planes : DevicePlanes
    lens : Lens, optional
        As for `fewrays.Multiplane.render`.
    options : RenderOptions

    Returns
    -------
    array of float32, (H, W, 4)
        On the card: radiance, and the share of the light whose origin the planes know.
    """
    seen = planes.outline.through(lens or planes.outline.lens)
    where = options.locations(seen.lens)
    rim = options.vignetting().front_rim(where.uv, seen.height, seen.width)
    smoothing = options.smoothing_of(seen.shear.slope, seen.grid.cells, seen.lens, where)
    shrink = shrink_of(seen.shear.slope, smoothing.variance, where)
    copies = Copies.of_maps(seen, smoothing)
    smoothed = smooth_planes(machine, planes, copies)
    image = machine.xp.empty((seen.height, seen.width, 4), np.float32)
    machine.launch(
        _RENDER,
        (-(-seen.width // _TILE), -(-seen.height // _TILE), 1),
        planes=machine.on_device(copy_records(copies), np.int32),
        shrink=machine.on_device(shrink, np.float32),
        reach=machine.on_device(_reach(seen, shrink, where), np.float32),
        is_smoothed=machine.on_device(smoothing.sigma > 0, np.uint8),
        slots=smoothed.slots,
        built=planes.texels,
        smoothed=smoothed.texels,
        views=machine.on_device(np.column_stack([where.uv, where.t, where.offset, where.weight]), np.float32),
        image=image,
        rim=astuple(rim),
        count=seen.plane_count,
        view_count=where.count,
        height=seen.height,
        width=seen.width,
        front_end=copies.front_end,
        back_begin=copies.back_begin,
        vignetted=options.cats_eye > 0,
        darken=options.darken,
    )
    return image


def _reach(maps: Maps, shrink: Float64, where: Locations) -> Float64:
    """Return pixels (K,) that no view shifts a plane beyond."""
    offset, lens = (np.abs(values).max(axis=0) for values in (where.offset, where.uv))
    since = np.abs(where.t - 0.5).max()
    shift = shrink[:, None] * (offset + np.abs(maps.shear.slope)[:, None] * lens)
    farthest: Float64 = (shift + np.abs(maps.shear.motion) * since).max(axis=1)
    return farthest
