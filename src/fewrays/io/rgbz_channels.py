"""Which channels of a renderer's EXR are its picture and its depth.

Renderers agree on ``R``, ``G``, ``B``, ``A`` and ``Z``, and then put layer names in front. What they write by
default, found by the tables below:

| renderer | colour | depth |
|---|---|---|
| single-layer EXR of most (Blender, Arnold, V-Ray, Redshift, Karma) | ``R`` … | ``Z`` |
| Blender multilayer, one part or many | ``ViewLayer.Combined.R`` | ``ViewLayer.Depth.Z``, ``….Depth.V`` |
| Mitsuba 3 (``aov`` integrator) | ``R`` … | ``NAME.T``, a ray's length |
| pbrt-v4 (``gbuffer`` film) | ``R`` … | ``P.Z`` in camera space |
| Unreal (Movie Render Queue) | ``FinalImage…_Beauty.R`` or ``R`` | ``FinalImage…_WorldDepth.R`` |
| Nuke, Houdini | ``R``, ``rgba.red``, ``C.r`` | ``depth.Z``, ``Pz`` |

Names are compared without regard to case. Where several layers fit equally well the caller has to choose.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from fewrays.errors import SampleError

__all__ = ["ColorChannels", "DepthChannel", "DepthKind", "find_color", "find_depth"]

DepthKind = Literal["planar", "distance", "inverse"]

_COMPONENTS = tuple({long, long[0]} for long in ("red", "green", "blue", "alpha"))
_PICTURES: tuple[str, ...] = (
    r"",
    r".*\b(combined|beauty)|.*_beauty",
    r"rgba?|.*\.rgba?",
    r"c|ci|main|image|final_?image|colou?r|default",
)
"""Layers that hold the picture, most telling first; matched against the whole layer name, lower case."""

_DEPTHS: tuple[tuple[str, DepthKind], ...] = (
    (r"z", "planar"),
    (r"(.*\.)?(depth[-_ ]?z?|z[-_ ]?depth|vrayzdepth)(\.[zvryxt])?|z\.[zvryx]", "planar"),
    (r"(.*[._ ])?(scene|world|linear|image|pw)[a-z]*depth(\.[zvryx])?|finalimage\w*depth\.[zvryx]", "planar"),
    (r"(.*\.)?(p\.z|pz|hitpz)", "planar"),
    (r".+\.t", "distance"),
    (r"(.*\.)?distance(\.[zvryx])?", "distance"),
)
"""Channels that hold depth, most telling first, and what it is measured along."""


@dataclass(frozen=True)
class ColorChannels:
    """The channels of a picture: red, green, blue, three times the same for a grey one; alpha if any."""

    rgb: tuple[str, str, str]
    alpha: str | None


@dataclass(frozen=True)
class DepthChannel:
    """A channel of depth, and the kind that its writer is known for."""

    name: str
    kind: DepthKind


def find_color(names: Sequence[str], layer: str | None = None, beside: str | None = None) -> ColorChannels:
    """Return the channels of the picture.

    Parameters
    ----------
    names : sequence of str
        Every channel of the file, with its layer.
    layer : str, optional
        The layer to take, such as ``ViewLayer.Combined``; found by its name unless given.
    beside : str, optional
        The depth channel: of several pictures the one in the same view layer is meant.

    Raises
    ------
    SampleError
        When there is no such layer, no picture, or more than one that fits as well.
    """
    layers = _color_layers(names)
    if layer is not None:
        for name, channels in layers.items():
            if name.lower() == layer.lower():
                return channels
        raise SampleError(f"has no red, green and blue; {_list(names)}", field=f"layer {layer!r}")
    for pattern in _PICTURES:
        fitting = [name for name in layers if re.fullmatch(pattern, name.lower())]
        if len(fitting) > 1 and beside is not None:
            fitting = [name for name in fitting if _parent(name) == _parent(_layer(beside))] or fitting
        if fitting:
            return layers[_only(fitting, "layers", "color_layer")]
    grey = [name for name in names if name.lower() in ("y", "l")]
    if not layers and len(grey) == 1:
        return ColorChannels((grey[0],) * 3, next((name for name in names if name.lower() == "a"), None))
    if len(layers) == 1:
        return next(iter(layers.values()))
    raise SampleError(
        f"no layer has a name known for the picture; give one as color_layer. {_list(names)}",
        field="channels",
    )


def find_depth(names: Sequence[str], channel: str | None = None) -> DepthChannel:
    """Return the channel of depth.

    Parameters
    ----------
    names : sequence of str
        Every channel of the file, with its layer.
    channel : str, optional
        The channel to take, such as ``ViewLayer.Depth.Z``; found by its name unless given.

    Raises
    ------
    SampleError
        When there is no such channel, none that is known for depth, or more than one that fits as well.
    """
    if channel is not None:
        for name in names:
            if name.lower() == channel.lower():
                return DepthChannel(name, _kind_of(name))
        raise SampleError(f"is not there; {_list(names)}", field=f"channel {channel!r}")
    for pattern, kind in _DEPTHS:
        fitting = [
            name
            for name in names
            if re.fullmatch(pattern, name.lower()) and not re.search(r"denois", name.lower())
        ]
        # A depth written as three equal components is one depth.
        layers: dict[str, str] = {}
        for name in sorted(fitting, key=_component_order):
            layers.setdefault(_layer(name), name)
        if layers:
            return DepthChannel(layers[_only(list(layers), "channels", "depth_channel", layers)], kind)
    raise SampleError(
        f"no channel has a name known for depth; give one as depth_channel. {_list(names)}", field="channels"
    )


def _component_order(name: str) -> int:
    return "zvr".find(name[-1].lower()) % 4


def _kind_of(name: str) -> DepthKind:
    return next((kind for pattern, kind in _DEPTHS if re.fullmatch(pattern, name.lower())), "planar")


def _color_layers(names: Sequence[str]) -> dict[str, ColorChannels]:
    """Return the layers that have red, green and blue, in the order of the file."""
    found: dict[str, ColorChannels] = {}
    for layer in dict.fromkeys(_layer(name) for name in names):
        own = [name for name in names if _layer(name) == layer]
        components = [
            next((name for name in own if name.rpartition(".")[2].lower() in spellings), None)
            for spellings in _COMPONENTS
        ]
        red, green, blue, alpha = components
        if red is not None and green is not None and blue is not None:
            found[layer] = ColorChannels((red, green, blue), alpha)
    return found


def _layer(name: str) -> str:
    return name.rpartition(".")[0]


def _parent(layer: str) -> str:
    return layer.rpartition(".")[0]


def _only(fitting: Sequence[str], what: str, parameter: str, shown: dict[str, str] | None = None) -> str:
    if len(fitting) > 1:
        listed = ", ".join(name if shown is None else shown[name] for name in fitting)
        raise SampleError(f"several {what} fit: {listed}; choose one by {parameter}", field="channels")
    return fitting[0]


def _list(names: Sequence[str]) -> str:
    return f"the file has {', '.join(names)}"
