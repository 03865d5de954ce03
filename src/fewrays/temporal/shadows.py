"""Light and shadow of area lights at the points that locations see: temporal, section 5.

For each location the camera's samples tell which point is seen. From there on it is as with defocus: the
light is a lens, and whether a light point shines on the point is read off the light samples that pass nearby,
once they are seen from that light point at the location's time. One light point for each location will do,
as the locations of a pixel are many: all dimensions are integrated at once, as in path tracing.

1. `Lights.receiver`: the point on the tangent plane of the nearest camera sample.
2. `Lights.gain`: what light it would reflect to the camera if nothing were in between, from its samples' own
   reflectances and normals.
3. `Lights.radiance_from`: whether light samples that end in front of the point cover it as the light point
   sees it, as surfaces do (`surfaces`); if not, the mean radiance of those that pass or end there.

**What is in front** (`Lights.blocks`). Depths are not compared by a bias. A light sample stops light if it
ends in front of the receiver's tangent plane, *and* the receiver lies behind the tangent plane of what it
hit. On a flat surface neither holds; on a convex one its neighbours lie behind its tangent plane; in a
hollow, and at the foot of a wall, they lie in front of it, but it lies in front of theirs. On rough ground
planes tell less: what juts out by less than it lies to the side of the ray is not in its way. What remains is
rounding, of which there is some hundred units in the last place of the distances involved. The tangent plane
of a blocker that no camera sample has seen is not known: there, the other conditions decide.

**How far to look.** Radii count in units of the density of light samples (`view_light`): of those that were
aimed at the receiver's surroundings, or each sample's own if it is denser. A blocker is met by fewer, if the
camera does not see all of what lies in its shadow, and its samples leave holes: what cannot be told within R
is told by looking `WIDE` times as far, where holes may be `SECOND_LOOK` times as large. Where all samples
within that are blocked, but on one side only, the search goes on until there is light or blockers all around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fewrays.lighting import Lighting
from fewrays.samples import SampleBuffer
from fewrays.temporal.lamps import Lamp, facing_normals, make_lamps
from fewrays.temporal.plan import SurfaceRule
from fewrays.temporal.reprojection import Sights
from fewrays.temporal.surfaces import Surface, any_covers, obviously_covers, surrounds
from fewrays.temporal.view import View, ViewedField

__all__ = ["GRAZING", "ROUGHNESS", "ROUNDING", "SECOND_LOOK", "Lights"]

Float64 = npt.NDArray[np.float64]

ROUNDING = 2e-5
"""By how much points may be off, in shares of their distances from the camera and from the light."""

GRAZING = 1e-3
"""Cosine at the light below which rays carry no light worth looking for."""

ROUGHNESS = 1.0
"""How far a hit must jut out over a receiver's tangent plane to block, per distance from its ray."""

SECOND_LOOK = 1.5
"""How many times as long lengths are where R does not tell light from shadow."""

WIDE = 2.0
"""Radius within which surfaces are told apart then, in R."""

MOST_BLOCKERS = 32
"""Blocking samples around a receiver that are looked at closely: of more, the nearest."""

_WIDEST = 12.0  # radius up to which light is looked for, in R
_LEAST_WEIGHT = 1e-6  # of a sample under the tent: where there are no others it counts


@dataclass(frozen=True)
class Around:
    """The light samples around a receiver, as its light point sees them.

    Parameters
    ----------
    blockers : Sights
        Those that stop its light.
    blocked_near : bool
        Whether any of them is within R.
    lit : bool
        Whether there are others.
    radiance : ndarray, (3,)
        Mean of the others within R, or of those farther off, or else of the blockers.
    """

    blockers: Sights
    blocked_near: bool
    lit: bool
    radiance: Float64


@dataclass(frozen=True)
class Receiver:
    """A point that the camera sees, with the shares of the camera samples that it was made from.

    Parameters
    ----------
    point : ndarray, (3,)
        In camera space.
    facing : ndarray, (3,)
        Normal of its tangent plane.
    sample : ndarray of int, (n,)
        Camera samples.
    share : ndarray, (n,)
    """

    point: Float64
    facing: Float64
    sample: npt.NDArray[np.intp]
    share: Float64


class Lights:
    """The area lights of a buffer, seen by one location after the other.

    Parameters
    ----------
    samples : SampleBuffer
    lighting : Lighting
        That of the samples.
    rule : SurfaceRule
        That of the camera samples; `SurfaceRule.for_light` makes that of the light samples of it.
    times : ndarray, (N,)
        Of the views, in [0, 1] over the shutter. Each gets a light point of every light.
    """

    def __init__(
        self, samples: SampleBuffer, lighting: Lighting, rule: SurfaceRule, times: npt.NDArray[np.float32]
    ) -> None:
        self.lens = samples.lens
        self.projection = lighting.projection
        self.rule = rule.for_light(samples, lighting)
        self.times = times
        self.unlit = lighting.unlit.reshape(-1, 3).astype(np.float64)
        self.normal = lighting.normal.reshape(-1, 3).astype(np.float64)
        self.facing = facing_normals(samples, lighting).astype(np.float64)
        self.lamps = make_lamps(samples, lighting)
        self.fields = [ViewedField(lamp.field) for lamp in self.lamps]
        self.points = [lamp.points(len(times)) for lamp in self.lamps]
        self.camera_paths = ViewedField(samples).paths

    def shine(self, number: int) -> None:
        """See all light samples from the light points of a view, at its time."""
        time = float(self.times[number])
        self.views = [
            field.view(points[number], time) for field, points in zip(self.fields, self.points, strict=True)
        ]

    def radiance(self, camera: View, surface: Surface, x: float, y: float) -> Float64:
        """Return the radiance ``(3,)`` of the surface that a location shows, lit by all lights."""
        return self.reflected_by(self.receiver(camera, surface, x, y))

    def reflected_by(self, receiver: Receiver) -> Float64:
        """Return the radiance ``(3,)`` of a point that is lit by all lights."""
        total: Float64 = receiver.share @ self.unlit[receiver.sample]
        for lamp, view in zip(self.lamps, self.views, strict=True):
            gain = self.gain(lamp, view, receiver)
            if gain.any():
                total = total + gain * self.radiance_from(lamp, view, receiver)
        return total

    def receiver(self, camera: View, surface: Surface, x: float, y: float) -> Receiver:
        """Find the point that a location sees, on its ray from the lens point.

        It lies on the tangent plane of the nearest of the surface's samples, but neither in front of all of
        the samples nor behind.
        """
        sample, share = surface.sights.sample, camera.shares(surface)
        used = share > 0
        sample, share = sample[used], share[used]
        away2 = np.square(surface.sights.xy[used]).sum(axis=-1)
        nearest = sample[np.lexsort([sample, away2])[0]]
        paths = self.camera_paths
        seen = paths.start[sample] + camera.time * paths.change[sample]
        own = paths.start[nearest] + camera.time * paths.change[nearest]
        point = self.projection.points(own[:2] / own[2], own[2])
        # Points of the ray are origin + depth * direction: x at the lens centre is x - u (c0 / depth + c1).
        focal = np.array(self.projection.focal)
        origin = np.append(-camera.uv * self.lens.c0 / focal, 0.0)
        direction = self.projection.points(np.array([x, y]) - camera.uv * self.lens.c1, 1.0)
        facing = self.facing[nearest]
        along = facing @ direction
        depth = own[2]
        if abs(along) > 1e-6 * np.linalg.norm(direction):
            depth = facing @ (point - origin) / along
        depth = np.clip(depth, seen[:, 2].min(), seen[:, 2].max())
        return Receiver(origin + depth * direction, facing, sample, share)

    def own_point(self, sample: int, time: float) -> Receiver:
        """Return a camera sample's own point, as it is at a time."""
        paths = self.camera_paths
        x, y, depth = paths.start[sample] + time * paths.change[sample]
        point = self.projection.points(np.array([x, y]) / depth, depth)
        return Receiver(point, self.facing[sample], np.array([sample]), np.ones(1))

    def gain(self, lamp: Lamp, view: View, receiver: Receiver) -> Float64:
        """Return the radiance ``(3,)`` that a receiver would send to the camera per unit of the light's."""
        to_light = self._light_point(lamp, view) - receiver.point
        distance = float(np.linalg.norm(to_light))
        cosine = float(-to_light @ lamp.light.normal) / distance
        if not cosine > GRAZING:
            return np.zeros(3)
        there = lamp.density[receiver.sample] > 0
        falling = np.maximum(self.normal[receiver.sample] @ to_light, 0) / distance
        reflected = (receiver.share * falling * there) @ lamp.reflectance[receiver.sample].astype(np.float64)
        return np.asarray(reflected * lamp.light.area * cosine / distance**2)

    def radiance_from(self, lamp: Lamp, view: View, receiver: Receiver) -> Float64:
        """Reconstruct the radiance ``(3,)`` that comes from the view's light point to a receiver."""
        density = lamp.density[receiver.sample].astype(np.float64)
        weight = receiver.share * (density > 0)
        spacing = float(weight @ density / weight.sum())
        rule = self.rule.scaled(spacing)
        around = self._around(lamp, view, receiver, spacing, 1.0)
        if around.lit and not around.blockers.count:
            return around.radiance
        if obviously_covers(around.blockers, rule):
            return np.zeros(3)
        wide_rule = self.rule.scaled(SECOND_LOOK * spacing)
        spread = WIDE
        around = self._around(lamp, view, receiver, spacing, spread)
        while not around.lit and spread < _WIDEST and not surrounds(around.blockers.xy, wide_rule):
            spread = min(2 * spread, _WIDEST)
            around = self._around(lamp, view, receiver, spacing, spread)
        if around.lit and not around.blocked_near and spread == WIDE:
            return around.radiance
        dark = not around.lit or any_covers(_nearest(around.blockers), wide_rule)
        return np.zeros(3) if dark else around.radiance

    def _around(self, lamp: Lamp, view: View, receiver: Receiver, spacing: float, spread: float) -> Around:
        """Sort out the light samples within `spread` R of a receiver."""
        uv = view.uv * lamp.lens_unit / lamp.light.half_size
        (x, y), _ = lamp.light.project(receiver.point, uv, view.time)
        sights = view.look(x, y, spread * self.rule.radius * spacing)
        distance = np.hypot(*sights.xy.T)
        reach = self.rule.radius * np.minimum(lamp.density[sights.sample], spacing)
        used = distance <= spread * reach
        sights, distance, reach = sights.take(used), distance[used], reach[used]
        blocked = self.blocks(lamp, view, sights, receiver, (x, y))
        within = distance <= reach
        tent = reach * np.where(within, self.rule.tent, spread)
        weight = np.maximum(1 - distance / tent, _LEAST_WEIGHT)
        radiance = np.zeros(3)
        for which in (~blocked & within, ~blocked, blocked):
            if which.any():
                weights = weight[which]
                radiance = weights @ view.color[sights.sample[which]] / weights.sum()
                break
        return Around(sights.take(blocked), bool((blocked & within).any()), not blocked.all(), radiance)

    def blocks(
        self, lamp: Lamp, view: View, sights: Sights, receiver: Receiver, at: tuple[float, float]
    ) -> npt.NDArray[np.bool_]:
        """Tell which light samples ``(n,)`` end in front of a receiver.

        Parameters
        ----------
        lamp : Lamp
        view : View
            Of the light samples.
        sights : Sights
            Some of them, at positions relative to the receiver's.
        receiver : Receiver
        at : tuple of float
            Where the receiver is seen, on Π in world units.
        """
        light = lamp.light
        start = self._light_point(lamp, view)
        uv = view.uv * lamp.lens_unit / light.half_size
        # The slope is a (1 - d / w) along the longer half size a.
        depth = light.plane_distance / (1 - sights.slope / lamp.lens_unit)
        hits = light.hits(sights.xy + np.array(at), uv, depth, view.time)
        precision = ROUNDING * (
            np.linalg.norm(start - receiver.point)
            + np.linalg.norm(receiver.point)
            + np.linalg.norm(light.centers(view.time))
        )
        facing = receiver.facing * np.copysign(1.0, receiver.facing @ (start - receiver.point))
        receiver_depth = light.to_light_space(receiver.point, view.time)[2]
        beside = np.hypot(*sights.xy.T) * receiver_depth / light.plane_distance
        in_front = (hits - receiver.point) @ facing > precision + ROUGHNESS * beside
        planes = self.facing[sights.sample]
        planes = planes * np.copysign(1.0, (planes * (start - hits)).sum(axis=-1))[:, None]
        behind = (planes * (receiver.point - hits)).sum(axis=-1) < -precision
        return np.asarray(in_front & (behind | ~lamp.arrives[sights.sample]))

    def _light_point(self, lamp: Lamp, view: View) -> Float64:
        """Return the light point of a view in camera space, ``(3,)``."""
        return lamp.light.points(view.uv * lamp.lens_unit / lamp.light.half_size, view.time)


def _nearest(sights: Sights) -> Sights:
    """Return the nearest samples of a crowd."""
    x, y = sights.xy.T
    return sights.take(np.lexsort([y, x, x**2 + y**2])[:MOST_BLOCKERS])
