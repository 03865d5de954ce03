"""Depth of field from one image with depth, after Yu, Wang and Yu 2010.

The image is warped to many points of the lens: a light field, made as it is needed. Every view's ray is
queried where the view meets the focal plane, and all are blended.

`depth_layer` is what comes in. `prepare` makes of it the sheets that are warped: `edges` takes antialiased
edges apart, `fill` carries surfaces on behind others. `prefilter` blurs for what lies between the views.
`reference` makes the views one after the other in plain NumPy, by `warp` and `synthesis`; `kernel` does the
same in native code. `cuda_prepare` and `cuda` do all of it on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.cuda.device import is_on_card, pick_device, require_machine
from fewrays.cuda.machine import Machine
from fewrays.dynamic import cuda, fill, kernel, reference
from fewrays.dynamic.depth_layer import DepthLayer
from fewrays.dynamic.device_layer import DeviceLayer
from fewrays.dynamic.options import DefocusOptions
from fewrays.dynamic.plan import LightField, Sums, ViewRules
from fewrays.dynamic.prepare import Completion, GuessBackground, prepare_sheets
from fewrays.dynamic.sheet import Sheet
from fewrays.errors import SampleError, require_option
from fewrays.lens import Lens
from fewrays.method import Image, make_options
from fewrays.parallel import Execution

__all__ = ["DefocusOptions", "DepthLayer", "DeviceLayer", "defocus", "defocus_rgba", "make_light_field"]


@dataclass(frozen=True)
class Engine:
    """What the host does in two ways: guess what is behind an image, and add up all views."""

    guess_background: GuessBackground
    synthesize: Callable[[LightField, Sums, Execution, npt.NDArray[np.float32] | None], object]


ENGINES = {
    "cpu": Engine(kernel.guess_background, kernel.synthesize),
    "reference": Engine(fill.guess_background, reference.synthesize),
}
"""By device of the host."""

DEVICES = (*ENGINES, "cuda")
"""The one that ``"auto"`` means without a GPU first."""


def defocus(
    color: npt.ArrayLike,
    depth: npt.ArrayLike,
    lens: Lens,
    *,
    alpha: npt.ArrayLike | None = None,
    behind: Sequence[DepthLayer | DeviceLayer] = (),
    device: str = "auto",
    threads: int | None = None,
    progress: bool = False,
    output: str = "host",
    **options: Any,
) -> Image:
    """Give a pinhole image with depth the depth of field of a lens.

    Parameters
    ----------
    color : array_like, (H, W, 3)
        Linear radiance, multiplied by `alpha`. A GPU takes arrays that are in its memory as they are.
    depth : array_like, (H, W)
        Planar depth, > 0, in the lens's units; ``inf`` for a background without distance.
    lens : Lens
        As made for the image's width.
    alpha : array_like, (H, W), optional
        Opacity in [0, 1]; opaque when omitted.
    behind : sequence of DepthLayer or DeviceLayer
        What is behind, the nearest first: the further layers of a depth peel or of a deep image.
    device : {"auto", "cpu", "reference", "cuda"}
        ``"cuda"`` is an NVIDIA GPU, which ``"auto"`` means where there is one; ``"reference"`` runs the plain
        NumPy definition, slowly.
    threads : int, optional
        Threads to use; all usable cores when omitted. The result does not depend on it.
    progress : bool
        Show a progress bar on stderr for work over two seconds.
    output : {"host", "device"}
        Where an image that a GPU makes is returned: copied to the host, or as a CuPy array, without waiting.
    **options
        Fields of `DefocusOptions`.

    Returns
    -------
    ndarray, (H, W, 3)
        Linear radiance, float32, over black where there is nothing.

    Raises
    ------
    SampleError
        For images that do not fit together or hold impossible values, and for options out of range.

    Examples
    --------
    >>> lens = Lens.thin_lens(64, focus_distance=2.0, fov=40.0, lens_radius=0.1)
    >>> defocus(np.ones((48, 64, 3)), np.full((48, 64), 5.0), lens).shape
    (48, 64, 3)
    """
    rgba = defocus_rgba(
        color,
        depth,
        lens,
        alpha=alpha,
        behind=behind,
        device=device,
        threads=threads,
        progress=progress,
        output=output,
        **options,
    )
    return rgba[..., :3].copy()


def defocus_rgba(
    color: npt.ArrayLike,
    depth: npt.ArrayLike,
    lens: Lens,
    *,
    alpha: npt.ArrayLike | None = None,
    behind: Sequence[DepthLayer | DeviceLayer] = (),
    device: str = "auto",
    threads: int | None = None,
    progress: bool = False,
    output: str = "host",
    **options: Any,
) -> Image:
    """Do as `defocus`, for compositing: opacity is blurred along with the colours.

    Returns
    -------
    ndarray, (H, W, 4)
        Linear radiance multiplied by opacity, and opacity, float32.
    """
    chosen = make_options(DefocusOptions, options, "defocus")
    require_option("device", device, device in ("auto", *DEVICES), f"out of auto, {', '.join(DEVICES)}")
    execution = Execution(
        device=pick_device(DEVICES, device), threads=threads, progress=progress, output=output
    )
    if execution.device == "cuda":
        machine = require_machine()
        layers = _layers_on_card(machine, (color, depth, alpha), behind, chosen)
        rgba: Image = execution.deliver(machine, cuda.defocus_layers(machine, layers, lens, chosen))
        return rgba
    for name, array in (("color", color), ("depth", depth), ("alpha", alpha)):
        if is_on_card(array):
            raise SampleError("is on a GPU: use device='cuda', or copy it to the host", field=name)
    first = DepthLayer(color, _depth(depth, chosen), alpha)  # type: ignore[arg-type]
    field = make_light_field([first, *behind], lens, chosen, execution)  # type: ignore[list-item]
    sums = np.zeros((first.height, first.width, 5), np.float32)
    passed = np.zeros((first.height, first.width), np.float32) if chosen.darken else None
    ENGINES[execution.device].synthesize(field, sums, execution, passed)
    image = _mean(sums, field.sheets)
    if passed is not None:
        image[..., :3] *= passed[..., None] / np.float32(field.views.weight.sum())
    return image


def make_light_field(
    layers: Sequence[DepthLayer], lens: Lens, options: DefocusOptions, execution: Execution
) -> LightField:
    """Prepare everything that does not depend on the view, on the host.

    Parameters
    ----------
    layers : sequence of DepthLayer
        The nearest first.
    lens : Lens
    options : DefocusOptions
    execution : Execution
        On a device of the host.

    Returns
    -------
    LightField

    Raises
    ------
    SampleError
        For layers that differ in size, or that are no layers.
    """
    _require_alike(layers, DepthLayer)
    completion = Completion(
        ENGINES[execution.device].guess_background,
        execution,
        options.surface_tolerance,
        options.fill_reach,
        options.split_edges,
    )
    rules = ViewRules.of_options(options, lens, layers[0].height, layers[0].width)
    return LightField.of_sheets(prepare_sheets(layers, lens, completion), rules)


def _layers_on_card(
    machine: Machine,
    picture: tuple[Any, Any, Any],
    behind: Sequence[DepthLayer | DeviceLayer],
    options: DefocusOptions,
) -> list[DeviceLayer]:
    """Copy to the card what is not there yet; the picture is colour, depth and opacity or None."""
    if any(is_on_card(array) for array in picture):
        first = DeviceLayer.of_arrays(*picture, invalid_depth=options.invalid_depth, machine=machine)
        layers: list[DepthLayer | DeviceLayer] = [first, *behind]
    else:
        color, depth, alpha = picture
        layers = [DepthLayer(color, _depth(depth, options), alpha), *behind]  # type: ignore[arg-type]
    _require_alike(layers, DepthLayer, DeviceLayer)
    return [
        DeviceLayer.of_layer(machine, layer) if isinstance(layer, DepthLayer) else layer for layer in layers
    ]


def _require_alike(layers: Sequence[DepthLayer | DeviceLayer], *kinds: type) -> None:
    """Refuse what is no layer, and layers of another size than the first."""
    for number, layer in enumerate(layers):
        field = f"behind[{number - 1}]"
        if not isinstance(layer, kinds):
            names = " or a ".join(kind.__name__ for kind in kinds)
            raise SampleError(f"expected a {names}, got {type(layer).__name__}", field=field)
        if layer.depth.shape != layers[0].depth.shape:
            raise SampleError(
                f"expected {layers[0].depth.shape} pixels, as the first layer's; got {layer.depth.shape}",
                field=field,
            )


def _depth(depth: npt.ArrayLike, options: DefocusOptions) -> npt.ArrayLike:
    """Take invalid depths for background, if so asked."""
    if options.invalid_depth == "error":
        return depth
    values = np.asarray(depth)
    return np.where(values > 0, values, np.inf) if values.dtype.kind in "fiu" else depth


def _mean(sums: npt.NDArray[np.float32], sheets: Sequence[Sheet]) -> Image:
    """Divide by the weights of the valid rays; where there are none, show what the lens centre sees."""
    weight = sums[..., 4:]
    image: Image = np.divide(sums[..., :4], weight, out=np.zeros_like(sums[..., :4]), where=weight > 0)
    unseen = weight[..., 0] <= 0
    image[unseen] = sheets[0].light[unseen]
    return image
