"""Shading of camera samples on a GPU: ``native/cuda/shadows.cu``, launched lamp after lamp.

One kernel finds the samples that all of the lamp shines on for certain
(``native/math/clear_view.h``) and lights them. The others are listed, for which the host waits, and the next
kernel looks their light points up one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.kernel import Kernel
from fewrays.cuda.machine import Machine, blocks_for
from fewrays.cuda.samples import SAMPLE_FIELDS, DeviceSamples
from fewrays.lighting import Lighting
from fewrays.samples import SampleBuffer
from fewrays.temporal.lamps import Lamp, facing_normals, make_lamps
from fewrays.temporal.lamps_cuda import LAMP_FIELDS, PLACE, LampOnCard, rule_numbers
from fewrays.temporal.plan import SurfaceRule

__all__ = ["KERNELS", "Shading"]

_SHADE_FIELDS = {
    **SAMPLE_FIELDS,
    "normal": "*f4",
    "first_view": "*i4",
    "listed": "*i4",
    "open": "*u1",
    "radiance": "*f4",
    "reflectance": "*f4",
    "spacing": "*f4",
    "projection": "4f4",
    "count": "i4",
    "share": "i4",
    **LAMP_FIELDS,
}
_CLEAR = Kernel("shadows", "shadows_clear", 128, _SHADE_FIELDS)
_LIGHT = Kernel("shadows", "shadows_light", 128, _SHADE_FIELDS)
KERNELS = (PLACE, _CLEAR, _LIGHT)
"""All kernels of shading."""


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
            "rule": rule_numbers(light_rule),
        }
        self._lamps = [
            LampOnCard.copy(machine, lamp, rule, len(times)) for lamp in make_lamps(samples, lighting)
        ]
        self._whole = [machine.on_device(_may_get_all(each.lamp), np.int32) for each in self._lamps]

    def run(self) -> Any:
        """Light every camera sample, waiting for the card once for each lamp.

        Returns
        -------
        array of float32, (H, W, S, 3)
            Linear radiance, on the card.
        """
        radiance = self._unlit.copy()
        for lamp, whole in zip(self._lamps, self._whole, strict=True):
            self._add(lamp, whole, radiance)
        return radiance

    def _add(self, lamp: LampOnCard, whole: Any, radiance: Any) -> None:
        """Add a lamp's light; `whole` are the numbers of the samples that may get all of it."""
        machine, xp = self._machine, self._machine.xp
        left = (lamp.density > 0).astype(np.uint8)
        given = {**self._arguments, **lamp.arguments, "placed": lamp.place(machine)}
        given |= {"reflectance": lamp.reflectance, "spacing": lamp.density, "open": left}
        given |= {"radiance": radiance}
        count = len(whole)
        machine.launch(_CLEAR, (blocks_for(count, _CLEAR), 1, 1), listed=whole, count=count, **given)
        listed = xp.flatnonzero(left).astype(np.int32)
        machine.launch(
            _LIGHT, (blocks_for(len(listed), _LIGHT), 1, 1), listed=listed, count=len(listed), **given
        )


def _may_get_all(lamp: Lamp) -> npt.NDArray[np.intp]:
    """Return the samples that all of a lamp may shine on, as far as the host knows."""
    may = (lamp.density > 0) & lamp.arrives
    if lamp.uniform_radiance is None or any(lamp.light.motion):
        may[:] = False
    if lamp.field.motion is not None:
        may &= ~lamp.field.motion.any(axis=-1).reshape(-1)
    return np.flatnonzero(may)
