"""Which engine makes planes and images: the processor's, or that of a GPU, where its planes stay."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fewrays.cuda.device import pick_device, require_machine
from fewrays.cuda.samples import DeviceSamples
from fewrays.lens import Lens
from fewrays.multiplane.build import BuildOptions, build_maps
from fewrays.multiplane.cuda.build import build_planes
from fewrays.multiplane.cuda.planes import DevicePlanes
from fewrays.multiplane.cuda.render import render_planes
from fewrays.multiplane.maps import Maps
from fewrays.multiplane.render import RenderOptions, render_maps
from fewrays.parallel import Execution
from fewrays.pinhole import needs_order, with_order
from fewrays.samples import SampleBuffer

__all__ = ["AnyPlanes", "build", "on_card", "on_host", "render"]

AnyPlanes = Maps | DevicePlanes
"""Planes in the host's memory, or in a card's."""

_DEVICES = ("cpu", "cuda")
_ORDER = 16.0  # pixels of blur far away, for planes that are to be told apart by depth alone


def build(samples: SampleBuffer | DeviceSamples, options: BuildOptions, execution: Execution) -> AnyPlanes:
    """Make planes of samples, where the execution says, or where the samples are."""
    if needs_order(samples):
        return _build_in_order(samples, options, execution)
    if isinstance(samples, SampleBuffer):
        if pick_device(_DEVICES, execution.device) == "cpu":
            return build_maps(samples, options, execution)
        samples = DeviceSamples.of_buffer(require_machine(), samples)
    return build_planes(require_machine(), samples, options)


def _build_in_order(
    samples: SampleBuffer | DeviceSamples, options: BuildOptions, execution: Execution
) -> AnyPlanes:
    """Make planes of what a pinhole sees: sorted as through a lens, at whose centre all lens points are."""
    centered = samples.with_lens(replace(samples.lens, c0=0.0, c1=0.0))
    ordered = with_order(replace(centered, uv=0 * centered.uv), _ORDER)
    planes = build(ordered, replace(options, fine_to=math.inf), execution)

    def through_pinhole(maps: Maps) -> Maps:
        slope = np.full_like(maps.shear.slope, samples.lens.c1)
        return replace(maps, lens=samples.lens, shear=replace(maps.shear, slope=slope))

    if isinstance(planes, Maps):
        return through_pinhole(planes)
    return replace(planes, outline=through_pinhole(planes.outline))


def render(
    planes: AnyPlanes, lens: Lens | None, options: RenderOptions, execution: Execution
) -> npt.NDArray[np.float32]:
    """Make an image (H, W, 3) of planes, where the execution says; ``"auto"`` is where they are."""
    device = execution.device
    if device == "auto":
        device = "cuda" if isinstance(planes, DevicePlanes) else "cpu"
    if pick_device(_DEVICES, device) == "cpu":
        return np.ascontiguousarray(render_maps(on_host(planes), lens, options, execution)[..., :3])
    machine = require_machine()
    image = render_planes(machine, on_card(planes), lens, options)[..., :3]
    delivered: npt.NDArray[np.float32] = execution.deliver(machine, machine.xp.ascontiguousarray(image))
    return delivered


def on_host(planes: AnyPlanes) -> Maps:
    """Return planes in the host's memory, copied if need be."""
    return planes if isinstance(planes, Maps) else planes.to_maps(require_machine())


def on_card(planes: AnyPlanes) -> DevicePlanes:
    """Return planes in the current card's memory, copied if need be."""
    return planes if isinstance(planes, DevicePlanes) else DevicePlanes.of_maps(require_machine(), planes)
