"""`DeviceLayer`: an image with depth in a card's memory, such as that of a renderer that runs there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fewrays.cuda.device import require_machine
from fewrays.cuda.machine import Machine
from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.errors import SampleError, require_option

__all__ = ["DeviceLayer"]


@dataclass(frozen=True, eq=False)
class DeviceLayer:
    """What `DepthLayer` is on the host. Make one with `of_arrays` or `of_layer`.

    Its values are looked at when sheets are made of it, so that the card is waited for once.

    Parameters
    ----------
    color : array of float32, (H, W, 3)
    depth : array of float32, (H, W)
    alpha : array of float32, (H, W), optional
    mend : bool
        Take depths that are NaN, zero or negative for background.
    """

    color: Any
    depth: Any
    alpha: Any = None
    mend: bool = False

    @classmethod
    def of_layer(cls, machine: Machine, layer: DepthLayer) -> DeviceLayer:
        """Copy a layer to the card."""
        alpha = None if layer.alpha is None else machine.on_device(layer.alpha, np.float32)
        color, depth = (machine.on_device(each, np.float32) for each in (layer.color, layer.depth))
        return cls(color, depth, alpha)

    @classmethod
    def of_arrays(
        cls,
        color: Any,
        depth: Any,
        alpha: Any = None,
        *,
        invalid_depth: str = "error",
        machine: Machine | None = None,
    ) -> DeviceLayer:
        """Take arrays that are on the card already; those that are float32 and contiguous are not copied.

        Parameters
        ----------
        color, depth, alpha
            As for `DepthLayer`; of CuPy, PyTorch, Mitsuba's CUDA variants or whatever else has
            ``__cuda_array_interface__`` or ``__dlpack__``, or of the host.
        invalid_depth : {"error", "background"}
            What NaN, zero and negative depths are.
        machine : Machine, optional
            The current GPU when omitted.

        Raises
        ------
        SampleError
            For shapes that do not go together, and without a GPU.
        """
        choices = ("error", "background")
        require_option("invalid_depth", invalid_depth, invalid_depth in choices, "out of error, background")
        machine = machine or require_machine()
        given = {"color": color, "depth": depth} | ({} if alpha is None else {"alpha": alpha})
        arrays = {name: machine.on_device(array, np.float32) for name, array in given.items()}
        shape = arrays["color"].shape
        if len(shape) != 3 or shape[2] != 3 or min(shape) < 1:
            raise SampleError(f"expected shape (H, W, 3), not empty; got {shape}", field="color")
        for name in arrays.keys() - {"color"}:
            if arrays[name].shape != shape[:2]:
                raise SampleError(
                    f"expected shape {shape[:2]}, as the colour's; got {arrays[name].shape}", field=name
                )
        return cls(**arrays, mend=invalid_depth == "background")

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.depth.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.depth.shape[1])
