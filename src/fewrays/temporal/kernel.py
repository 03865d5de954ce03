"""The temporal method's native kernels, mapped over tiles by a thread pool."""

from __future__ import annotations

import threading

import numpy as np
import numpy.typing as npt

from fewrays import _native
from fewrays.lighting import Lighting
from fewrays.parallel import Execution, map_ranges
from fewrays.samples import SampleBuffer
from fewrays.temporal.hierarchy import Hierarchy
from fewrays.temporal.lamps import facing_normals, make_lamps
from fewrays.temporal.plan import Plan, SurfaceRule
from fewrays.temporal.statistics import Statistics

__all__ = ["native_lights", "reconstruct_locations", "reconstruct_tiles"]


def reconstruct_tiles(
    samples: SampleBuffer, plan: Plan, bands: npt.NDArray[np.float32], execution: Execution
) -> Statistics:
    """Add up what all pixels see, view by view within each tile.

    Parameters
    ----------
    samples : SampleBuffer
    plan : Plan
    bands : ndarray, (H, W, bands, 4)
        Receives sums of radiance and of weights, by how blurred what is seen is.
    execution : Execution

    Returns
    -------
    Statistics
        How the locations were resolved.
    """
    hierarchy = Hierarchy(samples, plan.rule)
    where = plan.locations
    lights = None if plan.lighting is None else native_lights(samples, plan.lighting, plan.rule, where.count)
    views = np.column_stack([where.uv, where.t, where.offset, where.weight]).astype(np.float32)
    rule = native_rule(plan.rule)
    starts = np.array(plan.band_starts, np.float32)
    statistics = Statistics()
    lock = threading.Lock()

    def tiles(first: int, last: int) -> None:
        nonlocal statistics
        counts = _native.temporal_tiles(
            hierarchy.native, rule, views, plan.tile, starts, lights, first, last, bands
        )
        with lock:
            statistics += Statistics(*counts)

    map_ranges(tiles, plan.tile_count, execution, label="temporal", chunk=1)
    return statistics


def reconstruct_locations(
    hierarchy: Hierarchy, rule: SurfaceRule, locations: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_], Statistics]:
    """Reconstruct locations that have nothing in common, each by queries of the hierarchy.

    Parameters
    ----------
    hierarchy : Hierarchy
    rule : SurfaceRule
    locations : ndarray of float32, (N, 5)
        Image position x, y in pixels, lens point u, v and time.

    Returns
    -------
    color : ndarray of float32, (N, 3)
        Radiance; 0 where nothing was found.
    found : ndarray of bool, (N,)
        Whether any sample was near.
    statistics : Statistics
    """
    color = np.zeros((len(locations), 3), np.float32)
    found = np.zeros(len(locations), np.uint8)
    counts = _native.temporal_locations(
        hierarchy.native, native_rule(rule), np.ascontiguousarray(locations, np.float32), color, found
    )
    return color, found.astype(bool), Statistics(*counts)


def native_rule(rule: SurfaceRule) -> _native.SurfaceRule:
    """Return a rule as native code reads it."""
    return _native.SurfaceRule(
        radius=rule.radius,
        along_lens=rule.along_lens,
        along_time=rule.along_time,
        tolerance=rule.tolerance,
        tent=rule.tent,
        overhang=rule.overhang,
    )


def native_lights(samples: SampleBuffer, lighting: Lighting, rule: SurfaceRule, views: int) -> _native.Lights:
    """Show native code the area lights, with a hierarchy of light samples for each."""
    projection = lighting.projection
    lights = _native.Lights(
        projection=np.array([*projection.focal, *projection.center], np.float32),
        rule=native_rule(rule.for_light(samples, lighting)),
        unlit=lighting.unlit.reshape(-1, 3),
        normal=lighting.normal.reshape(-1, 3),
        facing=facing_normals(samples, lighting),
    )
    for lamp in make_lamps(samples, lighting):
        light = lamp.light
        lights.add(
            tree=Hierarchy(lamp.field, rule, lamp.density).native,
            reflectance=lamp.reflectance,
            arrives=lamp.arrives.astype(np.uint8),
            points=lamp.points(views).astype(np.float32),
            frame=np.concatenate([[light.center], light.axes]).astype(np.float32),
            half_size=light.half_size.astype(np.float32),
            distance=light.plane_distance,
            motion=np.array(light.motion, np.float32),
            radiance=lamp.uniform_radiance,
            area=light.area,
        )
    return lights
