// Points, planes and a flat light in camera space: section 5 of Lehtinen et al. 2011, the twin of
// src/fewrays/temporal/shadows.py.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

struct Vector {
    float x, y, z;
};

FEWRAYS_HD inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
FEWRAYS_HD inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
FEWRAYS_HD inline Vector operator*(float s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
FEWRAYS_HD inline float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FEWRAYS_HD inline float length(Vector a) { return std::sqrt(dot(a, a)); }

// What the lens centre sees: pixel = center + focal * (X, Y) / Z, for points in camera space.
struct Projection {
    float focal_x, focal_y, center_x, center_y;

    FEWRAYS_HD Vector point(float x, float y, float depth) const {
        return {(x - center_x) / focal_x * depth, (y - center_y) / focal_y * depth, depth};
    }
};

// The points along which a lens point sees a place of the image: from + depth * towards.
struct CameraRay {
    Vector from, towards;
};

// With the slope c0 / depth + c1, in pixels per lens unit.
FEWRAYS_HD inline CameraRay ray_of(const Projection& camera, float x, float y, float u, float v, float c0, float c1) {
    return {{-u * c0 / camera.focal_x, -v * c0 / camera.focal_y, 0.0f}, camera.point(x - u * c1, y - v * c1, 1.0f)};
}

// The depth at which a ray meets the plane through a point; the point's own where it runs along the plane.
FEWRAYS_HD inline float depth_on_plane(const CameraRay& ray, Vector point, Vector normal) {
    const float along = dot(normal, ray.towards);
    const float depth = dot(normal, point - ray.from) / along;
    return std::fabs(along) > 1e-6f * length(ray.towards) ? depth : point.z;
}

// A flat light. In light space, points are relative to its centre, along its edges and, the last, its normal.
struct LightFrame {
    Vector center, u, v, normal;  // camera space; unit axes
    float half_u, half_v;         // from the centre to the middles of the edges
    float distance;               // of the second plane

    FEWRAYS_HD Vector turn(Vector direction) const {
        return {dot(u, direction), dot(v, direction), dot(normal, direction)};
    }
    FEWRAYS_HD Vector enter(Vector point) const { return turn(point - center); }
    FEWRAYS_HD Vector leave(Vector point) const { return center + (point.x * u + (point.y * v + point.z * normal)); }
    // The unit of light points: all of the light lies within one unit of its centre along both axes.
    FEWRAYS_HD float unit() const { return half_u > half_v ? half_u : half_v; }
};

struct PlanePosition {
    float x, y;
};

// Where the line from a light point to a point in light space meets the second plane.
FEWRAYS_HD inline PlanePosition on_second_plane(const LightFrame& light, Vector light_point, Vector point) {
    const float share = light.distance / point.z;
    return {light_point.x + (point.x - light_point.x) * share, light_point.y + (point.y - light_point.y) * share};
}

// A receiver's tangent plane as a light point sees it.
struct TangentPlane {
    float unit;         // of the slopes
    float start, step;  // heights over the plane: of the light point, and what the way to the second plane adds
    float across_x, across_y;
    float precision, roughness;  // heights that mean nothing: of themselves, and per distance on the second plane

    // The depth of what has a slope, in the second plane's distance.
    FEWRAYS_HD float share(float slope) const { return unit / (unit - slope); }
    // How far in front of the plane it is, seen (dx, dy) from the receiver on the second plane.
    FEWRAYS_HD float height(float share_of_way, float dx, float dy) const {
        return start + share_of_way * (step + across_x * dx + across_y * dy);
    }
};

}  // namespace fewrays
