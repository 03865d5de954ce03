"""How far over the lens the radiance of glossy Mitsuba surfaces holds (temporal, section 6, Figure 14).

A point on a glossy surface looks different from different places on the lens. How fast it changes follows
from the roughness of its BSDF:

- A microfacet lobe of roughness alpha has facet slopes of variance alpha²/2 along each axis. Reflection
  doubles a tilt, so reflected directions spread with a standard deviation of √2 alpha radians.
- A step of du lens radii turns the direction from the point to the lens by du · lens_radius / depth. The
  surface's normal at the point stays, so its curvature does not matter.

Seen from the point, the lobe so has a standard deviation of √2 alpha · depth / lens_radius on the lens:
the radiance is the lighting blurred by that. Weighting samples by a Gaussian blurs it once more. With `SHARE`
of the lobe's own width, highlights get wider by √(1 + SHARE²), and enough samples still count.

Refraction into an index η turns by (1 - 1/η) times a facet's tilt, and by 1/η times the turn of the direction
to the lens. Its lobe on the lens is therefore (η - 1) / 2 as wide as that of the reflection: `REFRACTED`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from fewrays.sources.mitsuba_motion import registry_numbers

__all__ = ["LEAST_BANDWIDTH", "REFRACTED", "SHARE", "Gloss"]

SHARE = 0.5
"""Width of a sample's weight on the lens over the width of the lobe: 0.5 widens highlights by 12 %."""

LEAST_BANDWIDTH = 0.1
"""In lens radii: what mirrors get.

Samples that lie near each other in the image lie farther apart on the lens, so a smaller value would not tell
more of them apart, but send all weights to zero.
"""

REFRACTED = 0.25
"""Width of a refracted lobe over that of a reflected one, for glass of index 1.5."""

_ALPHAS = ("alpha", "alpha_u", "alpha_v")

Float32 = npt.NDArray[np.float32]


class Gloss:
    """The bandwidths of what rays hit in one scene.

    Parameters
    ----------
    mi : module
        Mitsuba, with the variant active that the scene was loaded under.
    lens_radius : float
        In scene units; through a pinhole, 0, every bandwidth is infinite.
    """

    def __init__(self, mi: ModuleType, lens_radius: float) -> None:
        self._mi = mi
        self._lens_radius = lens_radius
        self._alphas: dict[int, float] = {
            0: math.inf
        }  # by Dr.Jit's number of the BSDF; 0 where nothing is hit

    def bandwidth(self, hit: Any, ray: Any, depth: Float32) -> Float32:
        """Return the standard deviations on the lens over which radiance holds.

        Parameters
        ----------
        hit : mitsuba.PreliminaryIntersection3f
            Of N rays.
        ray : mitsuba.Ray3f
            Those rays.
        depth : ndarray, (N,)
            Planar depths of the hits, in scene units.

        Returns
        -------
        ndarray, (N,)
            In lens radii, at least `LEAST_BANDWIDTH`; infinite for matte surfaces and where nothing is hit.
        """
        if self._lens_radius == 0:
            return np.full_like(depth, np.inf)
        spread = SHARE * math.sqrt(2) * self._alpha(hit, ray)
        return np.maximum(spread * depth / self._lens_radius, LEAST_BANDWIDTH).astype(np.float32)

    def _alpha(self, hit: Any, ray: Any) -> npt.NDArray[np.float64]:
        """Return the roughness (N,) of what rays hit."""
        mi = self._mi
        # A preliminary hit of an instance does not name the shape inside, the full one does.
        bsdf = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit.is_valid()).bsdf()
        numbers, first, which = np.unique(registry_numbers(mi, bsdf), return_index=True, return_inverse=True)
        for number, index in zip(numbers.tolist(), first.tolist(), strict=True):
            if number not in self._alphas:
                self._alphas[number] = _least_alpha(mi, bsdf[index])
        return np.array([self._alphas[number] for number in numbers.tolist()])[which.reshape(-1)]


def _least_alpha(mi: ModuleType, bsdf: Any) -> float:
    """Return the roughness of a BSDF's sharpest lobe: 0 for mirrors and smooth glass, infinite if matte.

    Of BSDFs that refract, that of a reflection which is as sharp.

    Glossy BSDFs whose roughness has no name of `_ALPHAS` nor ``roughness`` (measured ones, say) count as
    mirrors: then nothing is assumed of them.
    """
    has = {name: mi.has_flag(bsdf.flags(), flag) for name, flag in mi.BSDFFlags.__members__.items()}
    if has["DeltaReflection"] or has["DeltaTransmission"]:
        return 0.0
    if not (has["GlossyReflection"] or has["GlossyTransmission"]):
        return math.inf
    values = _least_values(mi.traverse(bsdf))
    alphas = [value for (_, name), value in values.items() if name in _ALPHAS]
    for prefix, name in values:
        if name == "roughness":
            alphas += _principled_alphas(values, prefix)
    sharpest = max(min(alphas, default=0.0), 0.0)
    return REFRACTED * sharpest if has["GlossyTransmission"] else sharpest


def _least_values(parameters: Any) -> Mapping[tuple[str, str], float]:
    """Return each scalar's or texture's least value by (path of the BSDF that it belongs to, name)."""
    wanted = {*_ALPHAS, "roughness", "anisotropic", "clearcoat", "clearcoat_gloss"}
    least: dict[tuple[str, str], float] = {}
    for path, value in parameters:
        parts = path.split(".")
        name = next((part for part in parts if part in wanted), None)
        if name is None or parts[-1] == "to_uv":
            continue
        key = (".".join(parts[: parts.index(name)]), name)
        least[key] = min(least.get(key, math.inf), float(np.min(np.asarray(value))))
    return least


def _principled_alphas(values: Mapping[tuple[str, str], float], prefix: str) -> list[float]:
    """Return alphas of a principled BSDF's lobes: its roughness is their square root.

    Burley, "Physically Based Shading at Disney" (2012), section 5.4 and the addendum on anisotropy.
    """
    aspect = math.sqrt(1 - 0.9 * values.get((prefix, "anisotropic"), 0.0))
    alphas = [values[prefix, "roughness"] ** 2 * aspect]
    if values.get((prefix, "clearcoat"), 0.0) > 0:
        gloss = values.get((prefix, "clearcoat_gloss"), 0.0)
        alphas.append(0.1 + (0.001 - 0.1) * gloss)
    return alphas
