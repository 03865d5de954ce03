// Points that an area light may shine on, and what of the light samples around them stops its light: section 5 of
// Lehtinen et al. 2011, the twin of src/fewrays/temporal/shadows.py.
#pragma once

#include <cmath>

#include "host_device.h"
#include "light.h"

namespace fewrays {

constexpr float rounding = 2e-5f;      // of the distances that a point's place is made of
constexpr float grazing = 1e-3f;       // cosine at the lamp below which its light does not matter
constexpr float roughness = 1;         // of a surface: what juts out less than it lies to the side does not block
constexpr float second_look = 1.5f;    // times R: the radius that decides between light and shadow
constexpr float wide = 2;              // times R: the radius within which surfaces are told apart
constexpr float widest = 12;           // times R: how far samples are looked for where there are none nearer
constexpr int most_blockers = 32;      // around a receiver that are looked at closely: of more, the nearest
constexpr float least_weight = 1e-6f;  // of a sample under the tent: where there are no others it counts

// A point that may be lit, in light space.
struct Receiver {
    Vector point, facing;  // facing is the normal of its tangent plane towards the light
    PlanePosition at;      // on the second plane
    float spacing;         // of light samples around it
    float precision;       // distance that rounding may move points by
};

// A point in camera space as it is seen from a light point.
struct Incidence {
    Vector to_light, local;  // local is the point in light space
    float distance, cosine;  // cosine at the light

    FEWRAYS_HD bool matters() const { return cosine > grazing; }
    // How much irradiance a light of this area and unit radiance brings, but for the cosine at the point.
    FEWRAYS_HD float factor(float area) const { return area * cosine / (distance * distance); }
};

FEWRAYS_HD inline Incidence incidence_of(const LightFrame& frame, Vector light_point, Vector point) {
    const Vector to_light = frame.leave(light_point) - point, local = frame.enter(point);
    const float distance = length(to_light);
    return {to_light, local, distance, local.z / distance};
}

// A point in camera space, with the normal of its tangent plane, as a receiver.
FEWRAYS_HD inline Receiver receiver_of(const LightFrame& frame, Vector light_point, Vector point, Vector normal,
                                       const Incidence& seen, float spacing) {
    const Vector facing = frame.turn(dot(normal, seen.to_light) >= 0 ? normal : -1.0f * normal);
    const float precision = rounding * (seen.distance + length(point) + length(frame.center));
    return {seen.local, facing, on_second_plane(frame, light_point, seen.local), spacing, precision};
}

// Of a receiver, as a light point in light space sees it.
FEWRAYS_HD inline TangentPlane tangent_plane(const LightFrame& frame, Vector light_point, const Receiver& to) {
    TangentPlane plane{};
    plane.unit = frame.unit();
    plane.start = dot(to.facing, light_point - to.point);
    plane.step = dot(to.facing, Vector{to.at.x, to.at.y, frame.distance} - light_point);
    plane.across_x = to.facing.x;
    plane.across_y = to.facing.y;
    plane.precision = to.precision;
    plane.roughness = roughness * to.point.z / frame.distance;
    return plane;
}

// Whether a receiver lies behind the tangent plane of what a light sample has hit, whose normal in light space is
// given; in front of it, as in a hollow, its light is not stopped. The hit is a share of the way from the light point
// to the second plane off, and seen (dx, dy) from the receiver there.
FEWRAYS_HD inline bool lies_behind(const LightFrame& frame, Vector light_point, const Receiver& to, Vector normal,
                                   float share, float dx, float dy) {
    const Vector towards = Vector{to.at.x + dx, to.at.y + dy, frame.distance} - light_point;
    const Vector hit = light_point + share * towards;
    const float side = dot(normal, light_point - hit) >= 0 ? 1.0f : -1.0f;
    return side * dot(normal, to.point - hit) < -to.precision;
}

}  // namespace fewrays
