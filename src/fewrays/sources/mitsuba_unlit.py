"""Radiance of Mitsuba scenes without the direct light of those lights that are sampled apart.

`Unlit` walks the first step of each light path by itself and leaves the rest to a path tracer:

- what the first surface emits, or the surroundings behind everything;
- the direct light of all *other* emitters, by next-event estimation;
- a direction sampled from the BSDF, and what the path tracer finds along it, less what the first thing there
  emits where that was direct light: all of it for the lights that are sampled apart, the share that multiple
  importance sampling leaves to the other way for the other emitters.

Light samples (`fewrays.sources.mitsuba_lights`) bring what a surface *scatters* on the side that the light
stands on. So mirrors and clear glass keep the lights that show in them, and thin leaves the light that shines
through them.

In the mean this and the light samples add up to what Mitsuba's ``path`` integrator finds.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from fewrays.errors import SampleError

__all__ = ["Unlit"]

_NO_LIMIT = 2**32 - 1  # how Mitsuba writes a depth of -1


class Unlit:
    """Everything but the direct light of some emitters.

    Parameters
    ----------
    mi : module
        Mitsuba, with the variant active that the scene was loaded under.
    scene : mitsuba.Scene
        Without media.
    integrator : mitsuba.Integrator
        ``path`` or ``direct``: how long light paths are.
    apart : sequence of mitsuba.Emitter
        Those whose direct light is left out.

    Raises
    ------
    SampleError
        For other integrators, those without direct light, those that hide emitters, and scenes with media.
    """

    def __init__(self, mi: ModuleType, scene: Any, integrator: Any, apart: Sequence[Any]) -> None:
        surrounded = any(sensor.get_medium() is not None for sensor in scene.sensors())
        if surrounded or any(shape.is_medium_transition() for shape in scene.shapes()):
            raise SampleError(
                "direct light cannot be told apart in scenes with participating media; leave lighting out",
                field="lighting",
            )
        self._mi, self._scene = mi, scene
        depth, roulette = _lengths(integrator)
        self._beyond = mi.load_dict(
            {"type": "path", "max_depth": depth if depth < 0 else depth - 1, "rr_depth": max(1, roulette - 1)}
        )
        self._apart = [mi.EmitterPtr(emitter) for emitter in apart]
        others = [emitter for emitter in scene.emitters() if all(emitter.ptr != one.ptr for one in apart)]
        self._others, self._all = len(others), len(others) + len(apart)
        self._emitters = mi.EmitterPtr([*others, *apart])

    def sample(self, sampler: Any, hit: Any, paths: Any) -> Any:
        """Return the radiance along camera rays, one light path each.

        Parameters
        ----------
        sampler : mitsuba.Sampler
            Of M numbers at once.
        hit : mitsuba.PreliminaryIntersection3f
            Of the M camera rays.
        paths : mitsuba.Ray3f
            Those rays.

        Returns
        -------
        mitsuba.Color3f
            M radiances.
        """
        import drjit as dr

        mi = self._mi
        si = hit.compute_surface_interaction(paths, mi.RayFlags.All, hit.is_valid())
        emitted = si.emitter(self._scene).eval(si)
        bsdf = si.bsdf()
        # The lights sampled apart take part where they shine through a surface.
        through = mi.has_flag(bsdf.flags(), mi.BSDFFlags.DiffuseTransmission)
        through |= mi.has_flag(bsdf.flags(), mi.BSDFFlags.GlossyTransmission)
        count = dr.select(through, mi.UInt32(self._all), mi.UInt32(self._others))
        direct = self._other_emitters(sampler, si, bsdf, count)
        return emitted + direct + self._along_the_bsdf(sampler, si, bsdf, count, through)

    def _other_emitters(self, sampler: Any, si: Any, bsdf: Any, count: Any) -> Any:
        """Return the light of one of the first `count` emitters, chosen evenly."""
        import drjit as dr

        mi = self._mi
        choice, point = sampler.next_1d(), sampler.next_2d()
        active = si.is_valid() & (count > 0) & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        index = dr.minimum(mi.UInt32(choice * count), dr.maximum(count, 1) - 1)
        emitter = dr.gather(mi.EmitterPtr, self._emitters, index, active)
        there, light = emitter.sample_direction(si, point, active)
        active &= there.pdf > 0
        wo = si.to_local(there.d)
        active &= ~((index >= self._others) & _same_side(mi, si.wi, wo))
        active &= ~self._scene.ray_test(si.spawn_ray_to(there.p), active)
        value, chance = bsdf.eval_pdf(mi.BSDFContext(), si, wo, active)
        share = dr.select(there.delta, 1, _power_heuristic(there.pdf, chance * count))
        return dr.select(active, value * light * count * share, 0)

    def _along_the_bsdf(self, sampler: Any, si: Any, bsdf: Any, count: Any, through: Any) -> Any:
        """Return what arrives from a direction sampled from the BSDF, less the direct light in it."""
        import drjit as dr

        mi, scene = self._mi, self._scene
        drawn, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), si.is_valid())
        active = si.is_valid() & dr.any(weight != 0)
        ray = si.spawn_ray(si.to_world(drawn.wo))
        far = scene.ray_intersect(ray, active)
        emitter = far.emitter(scene)
        shown = emitter.eval(far, active)
        apart = mi.Bool(False)
        for one in self._apart:
            apart |= emitter == one
        there = mi.DirectionSample3f(scene, far, si)
        chance = emitter.pdf_direction(si, there, active & (emitter != mi.EmitterPtr(None)))
        chance = dr.select((~apart | through) & (count > 0), chance / dr.maximum(count, 1), 0)
        keep = dr.select(apart & _same_side(mi, si.wi, drawn.wo), 0, _power_heuristic(drawn.pdf, chance))
        keep = dr.select(mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta), 1, keep)
        found = self._beyond.sample(scene, sampler, mi.RayDifferential3f(ray), None, active)[0]
        rest = dr.maximum(mi.Color3f(found) - (1 - keep) * shown, 0)  # rounding may take it below
        return dr.select(active, weight * rest, 0)


def _lengths(integrator: Any) -> tuple[int, int]:
    """Return the longest light path, -1 without limit, and the one from which roulette ends some."""
    kind = integrator.class_name()
    if kind not in ("PathIntegrator", "DirectIntegrator"):
        raise SampleError(
            f"direct light cannot be told apart in {kind}; choose {{'type': 'path'}} or {{'type': 'direct'}}",
            field="integrator",
        )
    if integrator.hide_emitters:
        raise SampleError(
            "hide_emitters makes surfaces show that have no samples; leave it out", field="integrator"
        )
    if kind == "DirectIntegrator":
        return 2, 5
    # The integrator tells these numbers nowhere but in its description.
    limit, roulette = (int(_number(integrator, name)) for name in ("max_depth", "rr_depth"))
    if limit < 2:
        raise SampleError(
            f"paths of max_depth {limit} hold no direct light; choose at least 2", field="max_depth"
        )
    return -1 if limit == _NO_LIMIT else limit, roulette


def _number(integrator: Any, name: str) -> str:
    found = re.search(rf"\b{name} = (\d+)", str(integrator))
    if found is None:
        raise SampleError(f"this release of Mitsuba does not tell its {name}", field="integrator")
    return found[1]


def _same_side(mi: ModuleType, first: Any, second: Any) -> Any:
    """Tell whether two directions leave a surface on the same side."""
    return mi.Frame3f.cos_theta(first) * mi.Frame3f.cos_theta(second) > 0


def _power_heuristic(own: Any, other: Any) -> Any:
    """Return the weight of a sample that had the density `own` and might have come with `other`."""
    import drjit as dr

    share = dr.square(own) / (dr.square(own) + dr.square(other))
    return dr.select(dr.isfinite(share), share, 0)
