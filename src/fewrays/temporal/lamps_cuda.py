"""Lamps in a card's memory: ``DeviceLamp`` in ``native/cuda/lamp_reading.h``.

The hierarchy of a lamp's light samples is made on the host and copied to the card in depth-first order, which
threads walk without a stack.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.lamps import Lamp
from fewrays.temporal.plan import SurfaceRule

__all__ = ["LAMP_FIELDS", "PLACE", "LampOnCard", "frame_numbers", "rule_numbers"]

_PLACED_NUMBERS = 8  # of a light sample, where the hierarchy has it
_NODE_WORDS = 18

LAMP_FIELDS = {
    "facing": "*f4",
    "light": "*f4",
    "arrives": "*u1",
    "points": "*f4",
    "times": "*f4",
    "nodes": "*i4",
    "placed": "*f4",
    "order": "*i4",
    "frame": "15f4",
    "shift": "3f4",
    "area": "f4",
    "farthest": "f4",
    "far_slope": "f4",
    "even_radiance": "3f4",
    "even": "i4",
    "rule": "6f4",
    "node_count": "i4",
}
"""A lamp, as `fewrays.cuda.kernel.Kernel` describes it."""

PLACE = Kernel(
    "shadows",
    "shadows_place",
    256,
    {**SAMPLE_FIELDS, "spacing": "*f4", "order": "*i4", "placed": "*f4"},
)
"""The kernel that puts light samples where the hierarchy has them."""


@dataclass(frozen=True, eq=False)
class LampOnCard:
    """A lamp in a card's memory. Make one with `copy`.

    Parameters
    ----------
    lamp : Lamp
        As the host has it.
    arguments : dict
        What kernels take of it by `LAMP_FIELDS`, but for what is the same for all lamps and ``placed``.
    field : DeviceSamples
        Its light samples.
    reflectance : array of float32, (N, 3)
        Of the camera samples' points.
    density : array of float32, (N,)
        As `Lamp.density`.
    """

    lamp: Lamp
    arguments: dict[str, Any]
    field: DeviceSamples
    reflectance: Any
    density: Any

    @classmethod
    def copy(cls, machine: Machine, lamp: Lamp, rule: SurfaceRule, views: int) -> LampOnCard:
        """Copy a lamp to the card, with a light point for each view; `rule` is the camera samples'."""
        light, points, radiance = lamp.light, lamp.points(views), lamp.uniform_radiance
        tree = Hierarchy(lamp.field, rule, lamp.density).native
        nodes = np.empty((tree.node_count, _NODE_WORDS), np.int32)
        order = np.empty(lamp.density.size, np.int32)
        tree.write_depth_first(nodes, order)
        field = DeviceSamples.of_buffer(machine, lamp.field)
        arguments = {
            "light": field.color,
            "arrives": machine.on_device(lamp.arrives, np.uint8),
            "points": machine.on_device(points, np.float32),
            "nodes": machine.on_device(nodes, np.int32),
            "order": machine.on_device(order, np.int32),
            "node_count": len(nodes),
            "frame": frame_numbers(lamp),
            "shift": light.motion,
            "area": light.area,
            "farthest": float(np.hypot(*points.T).max()),
            "far_slope": lamp.field.lens.c1,
            "even_radiance": np.zeros(3) if radiance is None else radiance,
            "even": radiance is not None,
        }
        return cls(
            lamp=lamp,
            arguments=arguments,
            field=field,
            reflectance=machine.on_device(lamp.reflectance, np.float32),
            density=machine.on_device(lamp.density, np.float32),
        )

    def place(self, machine: Machine) -> Any:
        """Put its light samples where the hierarchy has them, ``(N, 8)``."""
        placed = machine.xp.empty((self.field.count, _PLACED_NUMBERS), np.float32)
        machine.launch(
            PLACE,
            (blocks_for(self.field.count, PLACE), 1, 1),
            spacing=self.density,
            order=self.arguments["order"],
            placed=placed,
            **self.field.arguments(),
        )
        return placed


def frame_numbers(lamp: Lamp) -> tuple[float, ...]:
    """Return ``LightFrame`` in ``native/math/light.h``, as the shutter opens."""
    light = lamp.light
    return (*light.center, *light.axes.reshape(-1), *light.half_size, light.plane_distance)


def rule_numbers(rule: SurfaceRule) -> tuple[float, ...]:
    """Return ``DeviceRule`` in ``native/cuda/surfaces.h``."""
    return (rule.radius, rule.along_lens, rule.along_time, rule.tolerance, rule.tent, rule.overhang)
