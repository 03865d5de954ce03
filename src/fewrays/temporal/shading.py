"""Camera samples shaded one by one, from the light samples of all: beyond temporal, section 5.

The paper reconstructs light at the points that its locations see. The same reconstruction at the points of
the *camera samples* themselves gives a `SampleBuffer` whose radiance has no shadow noise left, and every
method can take that: those that know nothing of lights as well, and those that look at the samples' own mean.
The points need no reconstruction then, and cost the same: the samples of a pixel share the light points that
its locations would have had.

Where nothing moves, each sample gets a run of the light points, and the samples of a pixel get all between
them. Where something moves, light points have times, and a sample gets those of about its own time:
its point is followed to each of them, so that light and point are never of different times.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.cuda.device import pick_device, require_machine
from fewrays.cuda.machine import Machine
from fewrays.errors import SampleError, require_option
from fewrays.lighting import Lighting
from fewrays.native_view import view_light_field
from fewrays.parallel import Execution, map_ranges
from fewrays.samples import SampleBuffer
from fewrays.temporal.kernel import native_lights
from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.settle import settle
from fewrays.temporal.shading_cuda import Shading
from fewrays.temporal.shading_reference import shade_samples
from fewrays.tiling import Tiling

__all__ = ["shade", "shading_on"]

Device = Literal["auto", "cpu", "reference", "cuda"]
Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]

_DEVICES = ("cpu", "reference", "cuda")
_TILE = 32
_WINDOWS = 4  # in a shutter: the part of it from which a moving sample's light points are taken


def shade(
    samples: SampleBuffer,
    *,
    light_points: int = 128,
    radius_scale: float = 1.4,
    correction: float = 0.5,
    device: Device = "auto",
    threads: int | None = None,
    progress: bool = False,
) -> SampleBuffer:
    """Replace the direct light of area lights, one noisy light sample each, by what all light samples tell.

    Parameters
    ----------
    samples : SampleBuffer
        With `SampleBuffer.lighting`.
    light_points : int
        Light points for each pixel and light: time grows with them, noise shrinks.
    radius_scale : float
        Radius within which light samples are gathered, in units of the largest hole that their pattern
        leaves.
    correction : float
        Scale in pixels on which light is corrected towards what the samples' own light samples brought; 0 for
        none.
    device : {"auto", "cpu", "reference", "cuda"}
        ``"cuda"`` is an NVIDIA GPU, which ``"auto"`` means where there is one; ``"reference"`` runs the plain
        NumPy definition, slowly.
    threads : int, optional
        Threads to use; all usable cores when omitted. The result does not depend on it.
    progress : bool
        Show a progress bar on stderr for work that takes over two seconds.

    Returns
    -------
    SampleBuffer
        The same samples with other colours and without lighting, for any method.

    Raises
    ------
    SampleError
        For samples without lighting, options that are out of range, and ``device="cuda"`` without a GPU.
    """
    require_option("light_points", light_points, 1 <= light_points <= 65536, "from 1 to 65536")
    require_option("radius_scale", radius_scale, 0.25 <= radius_scale <= 8, "from 0.25 to 8")
    settles = correction == 0 or 0.5 <= correction <= 4
    require_option("correction", correction, settles, "0 or from 0.5 to 4 px")
    require_option("device", device, device in get_args(Device), f"of {', '.join(get_args(Device))}")
    chosen = pick_device(_DEVICES, device)
    lighting = samples.lighting
    if lighting is None:
        raise SampleError("these samples come without area lights: take them as they are", field="lighting")
    execution = Execution(chosen, threads, progress)
    if chosen == "cuda":
        machine = require_machine()
        color = machine.on_host(
            shading_on(machine, samples, light_points=light_points, radius_scale=radius_scale).run()
        )
    else:
        rule, times, views = _plan(samples, light_points, radius_scale)
        shade_all = _shade_by_definition if chosen == "reference" else _shade_tiles
        color = shade_all(samples, lighting, rule, times, views, execution)
    if correction:
        color = settle(samples, color, correction, execution)
    return replace(samples, color=color, lighting=None)


def shading_on(
    machine: Machine, samples: SampleBuffer, *, light_points: int = 128, radius_scale: float = 1.4
) -> Shading:
    """Prepare what a card makes of samples with lighting, but for the correction; options as for `shade`."""
    assert samples.lighting is not None
    rule, times, views = _plan(samples, light_points, radius_scale)
    return Shading(machine, samples, samples.lighting, rule, times, views)


def _plan(
    samples: SampleBuffer, light_points: int, radius_scale: float
) -> tuple[SurfaceRule, Float32, tuple[Int32, int]]:
    """Return the camera samples' rule, the views' times, each sample's first view, and how many it gets."""
    share = max(1, light_points // samples.spp)
    times, first_view = _views(samples, share)
    rule = SurfaceRule.for_samples(samples, light_points, radius_scale=radius_scale, tent_scale=1)
    return rule, times, (first_view, share)


def _shade_by_definition(
    samples: SampleBuffer,
    lighting: Lighting,
    rule: SurfaceRule,
    times: Float32,
    views: tuple[Int32, int],
    execution: Execution,
) -> Float32:
    first_view, share = views
    return shade_samples(samples, lighting, rule, times, first_view[:, None] + np.arange(share), execution)


def _shade_tiles(
    samples: SampleBuffer,
    lighting: Lighting,
    rule: SurfaceRule,
    times: Float32,
    views: tuple[Int32, int],
    execution: Execution,
) -> Float32:
    """Return what `shade_samples` does, from native code; `times` and `views` are what `_plan` says."""
    field = view_light_field(samples)
    lights = native_lights(samples, lighting, rule, len(times))
    first_view, share = views
    color = np.zeros_like(samples.color)
    tiling = Tiling(height=samples.height, width=samples.width, tile=_TILE)

    def tiles(first: int, last: int) -> None:
        _native.shade_tiles(field, lights, _TILE, share, times, first_view, first, last, color)

    map_ranges(tiles, tiling.tile_count, execution, label="light", chunk=1)
    return color


def _views(samples: SampleBuffer, share: int) -> tuple[Float32, Int32]:
    """Return the views' times, and the first of its `share` views for each sample; the others follow.

    The samples of a pixel are told apart by where they are, so that their order means nothing.
    """
    lighting = samples.lighting
    moving = lighting is not None and lighting.moves
    if samples.time is not None and (moving or (samples.motion is not None and bool(samples.motion.any()))):
        count = share * _WINDOWS
        times = ((np.arange(count) + 0.5) / count).astype(np.float32)
        first = np.clip(np.searchsorted(times, samples.time) - share // 2, 0, count - share)
        return times, first.reshape(-1).astype(np.int32)
    rank = samples.xy[..., 0].argsort(axis=-1, kind="stable").argsort(axis=-1, kind="stable")
    rows, columns = np.ogrid[: samples.height, : samples.width]
    first = share * ((rank + (columns + 2 * rows)[..., None]) % samples.spp)
    return np.zeros(share * samples.spp, np.float32), first.reshape(-1).astype(np.int32)
