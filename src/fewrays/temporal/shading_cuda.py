"""Shading of camera samples on a GPU: ``native/cuda/shadows.cu``, launched lamp after lamp.

The hierarchy of a lamp's light samples is made on the host and copied to the card in depth-first order, which
threads walk without a stack. One kernel finds the samples that all of the lamp shines on for certain
(``native/math/clear_view.h``) and lights them. The others are listed, for which the host waits, and the next
kernel looks their light points up one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.lighting import Lighting
from fewrays.samples import SampleBuffer
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.lamps import Lamp, facing_normals, make_lamps
from fewrays.temporal.plan import SurfaceRule

__all__ = ["KERNELS", "Shading"]

_PLACED_NUMBERS = 8  # of a light sample, where the hierarchy has it
_NODE_WORDS = 18

_PLACE = Kernel(
    "shadows",
    "shadows_place",
    256,
    {**SAMPLE_FIELDS, "spacing": "*f4", "order": "*i4", "placed": "*f4"},
)
_SHADE_FIELDS = {
    **SAMPLE_FIELDS,
    "normal": "*f4",
    "facing": "*f4",
    "first_view": "*i4",
    "times": "*f4",
    "listed": "*i4",
    "open": "*u1",
    "radiance": "*f4",
    "reflectance": "*f4",
    "light": "*f4",
    "spacing": "*f4",
    "arrives": "*u1",
    "points": "*f4",
    "nodes": "*i4",
    "placed": "*f4",
    "order": "*i4",
    "projection": "4f4",
    "frame": "15f4",
    "shift": "3f4",
    "area": "f4",
    "farthest": "f4",
    "far_slope": "f4",
    "even_radiance": "3f4",
    "even": "i4",
    "rule": "6f4",
    "count": "i4",
    "node_count": "i4",
    "share": "i4",
}
_CLEAR = Kernel("shadows", "shadows_clear", 128, _SHADE_FIELDS)
_LIGHT = Kernel("shadows", "shadows_light", 128, _SHADE_FIELDS)
KERNELS = (_PLACE, _CLEAR, _LIGHT)
"""All kernels of shading."""


@dataclass(frozen=True, eq=False)
class _DeviceLamp:
    """A lamp in a card's memory, and who may get all of its light.

    Parameters
    ----------
    arguments : dict
        What kernels take of it, but for its hierarchy.
    field : DeviceSamples
        Its light samples.
    nodes, order : array of int32, (nodes, 18) and (N,)
        Its hierarchy, as ``SampleTree.write_depth_first`` has it.
    there : array of bool, (N,)
        Which camera samples have a light sample.
    whole : array of int32
        Those that may get all of its light, as far as the host knows.
    """

    arguments: dict[str, Any]
    field: DeviceSamples
    nodes: Any
    order: Any
    there: Any
    whole: Any


class Shading:
    """Camera samples and their lamps in a card's memory, to be shaded any number of times.

    Parameters
    ----------
    machine : Machine
    samples : SampleBuffer
    lighting : Lighting
        That of the samples.
    rule : SurfaceRule
        That of the camera samples.
    times : ndarray of float32, (V,)
        Of the views, in [0, 1] over the shutter.
    views : (ndarray of int32, (N,), int)
        The first of each sample's views, and how many it gets, one after the other.
    """

    def __init__(
        self,
        machine: Machine,
        samples: SampleBuffer,
        lighting: Lighting,
        rule: SurfaceRule,
        times: npt.NDArray[np.float32],
        views: tuple[npt.NDArray[np.int32], int],
    ) -> None:
        self._machine = machine
        first_view, share = views
        light_rule, projection = rule.for_light(samples, lighting), lighting.projection
        floats = {
            "normal": lighting.normal,
            "facing": facing_normals(samples, lighting),
            "times": times,
        }
        self._unlit = machine.on_device(lighting.unlit, np.float32)
        self._arguments = {
            **DeviceSamples.of_buffer(machine, samples).arguments(),
            **{name: machine.on_device(array, np.float32) for name, array in floats.items()},
            "first_view": machine.on_device(first_view, np.int32),
            "share": share,
            "projection": (*projection.focal, *projection.center),
            "rule": (
                light_rule.radius,
                light_rule.along_lens,
                light_rule.along_time,
                light_rule.tolerance,
                light_rule.tent,
                light_rule.overhang,
            ),
        }
        self._lamps = [_on_device(machine, lamp, rule, len(times)) for lamp in make_lamps(samples, lighting)]

    def run(self) -> Any:
        """Light every camera sample, waiting for the card once for each lamp.

        Returns
        -------
        array of float32, (H, W, S, 3)
            Linear radiance, on the card.
        """
        radiance = self._unlit.copy()
        for lamp in self._lamps:
            self._add(lamp, radiance)
        return radiance

    def _add(self, lamp: _DeviceLamp, radiance: Any) -> None:
        machine, xp = self._machine, self._machine.xp
        placed = xp.empty((lamp.field.count, _PLACED_NUMBERS), np.float32)
        hierarchy = {"placed": placed, "order": lamp.order}
        machine.launch(
            _PLACE,
            (blocks_for(lamp.field.count, _PLACE), 1, 1),
            spacing=lamp.arguments["spacing"],
            **hierarchy,
            **lamp.field.arguments(),
        )
        left = lamp.there.astype(np.uint8)
        given = {**self._arguments, **lamp.arguments, **hierarchy, "open": left, "radiance": radiance}
        given |= {"nodes": lamp.nodes, "node_count": len(lamp.nodes)}
        count = len(lamp.whole)
        machine.launch(_CLEAR, (blocks_for(count, _CLEAR), 1, 1), listed=lamp.whole, count=count, **given)
        listed = xp.flatnonzero(left).astype(np.int32)
        machine.launch(
            _LIGHT, (blocks_for(len(listed), _LIGHT), 1, 1), listed=listed, count=len(listed), **given
        )


def _on_device(machine: Machine, lamp: Lamp, rule: SurfaceRule, views: int) -> _DeviceLamp:
    light, points, radiance = lamp.light, lamp.points(views), lamp.uniform_radiance
    tree = Hierarchy(lamp.field, rule, lamp.density).native
    nodes = np.empty((tree.node_count, _NODE_WORDS), np.int32)
    order = np.empty(lamp.density.size, np.int32)
    tree.write_depth_first(nodes, order)
    there = lamp.density > 0
    whole = there & lamp.arrives
    if radiance is None or any(light.motion):
        whole[:] = False
    if lamp.field.motion is not None:
        whole &= ~lamp.field.motion.any(axis=-1).reshape(-1)
    floats = {
        "reflectance": lamp.reflectance,
        "spacing": lamp.density,
        "points": points,
    }
    field = DeviceSamples.of_buffer(machine, lamp.field)
    arguments = {
        **{name: machine.on_device(array, np.float32) for name, array in floats.items()},
        "light": field.color,
        "arrives": machine.on_device(lamp.arrives, np.uint8),
        "frame": (*light.center, *light.axes.reshape(-1), *light.half_size, light.plane_distance),
        "shift": light.motion,
        "area": light.area,
        "farthest": float(np.hypot(*points.T).max()),
        "far_slope": lamp.field.lens.c1,
        "even_radiance": np.zeros(3) if radiance is None else radiance,
        "even": radiance is not None,
    }
    return _DeviceLamp(
        arguments=arguments,
        field=field,
        nodes=machine.on_device(nodes, np.int32),
        order=machine.on_device(order, np.int32),
        there=machine.on_device(there, np.bool_),
        whole=machine.on_device(np.flatnonzero(whole), np.int32),
    )
