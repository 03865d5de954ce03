"""Light at what locations see, on a GPU: ``native/cuda/relighting.cu``, launched view after view.

For each view one kernel finds the points that the pixels' locations see, and another, lamp after lamp, what
of its light gets there. Nothing waits for the card. Where there are many lamps, an image is lit in parts, so
that what is noted of its points takes little memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.lighting import Lighting
from fewrays.samples import SampleBuffer
from fewrays.temporal.cuda_view import MOST_BANDS, VIEW_FIELDS, DeviceView
from fewrays.temporal.lamps import facing_normals, make_lamps
from fewrays.temporal.lamps_cuda import LAMP_FIELDS, LampOnCard, frame_numbers, rule_numbers
from fewrays.temporal.plan import Plan

__all__ = ["KERNELS", "Relighting"]

_MOST_SHARES = 2**24  # of a lamp's light, by pixels that are noted at once: of 16 bytes each
_PLACE_NUMBERS, _SHARE_NUMBERS = 7, 4

_SEE = Kernel(
    "relighting",
    "relighting_see",
    128,
    {
        **SAMPLE_FIELDS,
        "unlit": "*f4",
        "normal": "*f4",
        "facing": "*f4",
        "lamps": "*f4",
        "points": "*f4",
        "reflectance": "*f4",
        "spacing": "*f4",
        "seen": "*i4",
        "shares": "*f4",
        "bands": "*f4",
        "first": "i8",
        "projection": "4f4",
        "time_of_view": "f4",
        "offset_x": "f4",
        "offset_y": "f4",
        "weight": "f4",
        "band_starts": f"{MOST_BANDS}f4",
        "band_count": "i4",
        "lamp_count": "i4",
        "number": "i4",
        "views": "i4",
        "count": "i4",
        "width": "i4",
        **VIEW_FIELDS,
    },
)
_LIGHT = Kernel(
    "relighting",
    "relighting_light",
    128,
    {
        "seen": "*i4",
        "shares": "*f4",
        "bands": "*f4",
        "first": "i8",
        "band_count": "i4",
        "number": "i4",
        "count": "i4",
        **LAMP_FIELDS,
    },
)
KERNELS = (_SEE, _LIGHT)
"""All kernels of light at locations."""


class Relighting:
    """The lamps of camera samples in a card's memory, for all views of a plan.

    Parameters
    ----------
    machine : Machine
    samples : SampleBuffer
    on_card : DeviceSamples
        The same samples.
    plan : Plan
    lighting : Lighting
        The samples'.
    """

    def __init__(
        self, machine: Machine, samples: SampleBuffer, on_card: DeviceSamples, plan: Plan, lighting: Lighting
    ) -> None:
        def copy(array: Any) -> Any:
            return machine.on_device(array, np.float32)

        self._machine = machine
        self._plan = plan
        views, projection = plan.locations.count, lighting.projection
        lamps = make_lamps(samples, lighting)
        facing = copy(facing_normals(samples, lighting))
        copies = [LampOnCard.copy(machine, lamp, plan.rule, views) for lamp in lamps]
        poses = [(*frame_numbers(lamp), *lamp.light.motion, lamp.light.area) for lamp in lamps]
        self._camera = {
            **on_card.arguments(),
            "unlit": copy(lighting.unlit),
            "normal": copy(lighting.normal),
            "facing": facing,
            "lamps": copy(np.array(poses)),
            "points": self._row([each.arguments["points"] for each in copies]),
            "reflectance": self._row([each.reflectance for each in copies]),
            "spacing": self._row([each.density for each in copies]),
            "projection": (*projection.focal, *projection.center),
            "lamp_count": len(lamps),
            "views": views,
            "width": plan.width,
        }
        same = {
            "facing": facing,
            "times": copy(plan.locations.t),
            "rule": rule_numbers(plan.rule.for_light(samples, lighting)),
        }
        self._lamps = [{**each.arguments, **same, "placed": each.place(machine)} for each in copies]
        self._pixels = plan.height * plan.width
        self._part = min(self._pixels, max(_MOST_SHARES // max(len(lamps), 1), _SEE.threads))
        self._seen = machine.xp.empty((self._part, _PLACE_NUMBERS), np.int32)
        self._shares = machine.xp.empty((len(lamps), self._part, _SHARE_NUMBERS), np.float32)

    def _row(self, arrays: list[Any]) -> Any:
        """Return arrays of all lamps one behind the other."""
        xp = self._machine.xp
        return xp.concatenate([xp.empty(0, np.float32), *(array.reshape(-1) for array in arrays)])

    def add_view(self, number: int, view: DeviceView, bands: Any) -> None:
        """Add what all pixels see in a view, lit, to `bands`: see `reconstruct_bands`.

        Parameters
        ----------
        number : int
            Of the view.
        view : DeviceView
        bands : array of float32, (H, W, bands, 4)
        """
        where = self._plan.locations
        x, y = where.offset[number]
        band_count = len(self._plan.band_starts)
        for first in range(0, self._pixels, self._part):
            count = min(self._part, self._pixels - first)
            grid = (blocks_for(count, _SEE), 1, 1)
            shares = self._shares.reshape(-1)[: len(self._lamps) * count * _SHARE_NUMBERS]
            shares = shares.reshape(len(self._lamps), count, _SHARE_NUMBERS)
            part = {"seen": self._seen, "bands": bands, "first": first, "count": count}
            part |= {"band_count": band_count, "number": number}
            self._machine.launch(
                _SEE,
                grid,
                **self._camera,
                **part,
                **view.arguments,
                shares=shares,
                time_of_view=where.t[number],
                offset_x=x,
                offset_y=y,
                weight=where.weight[number],
                band_starts=view.band_starts,
            )
            for lamp, own in zip(self._lamps, shares, strict=True):
                self._machine.launch(_LIGHT, grid, **part, **lamp, shares=own)
