// Where a sample is seen from a point of the lens at a time: Eq. 2 to 4 of Lehtinen et al. 2011, the twin of
// src/fewrays/temporal/reprojection.py.
#pragma once

#include <cmath>

#include "host_device.h"
#include "slope.h"

namespace fewrays {

// A point's path on the screen of the lens centre, in homogeneous coordinates (x w, y w, w) with the depth w in units
// of the point's own, when it was sampled: as the shutter opens, and the change until it closes. With c0, in pixels,
// the slope is c0 / w + c1.
struct Path {
    float x, y, w;
    float dx, dy, dw;
    float c0;
};

// A point as seen from a lens point at a time: where, its slope, and how fast it moves over the screen, in pixels per
// shutter interval.
struct Sight {
    float x, y, slope, speed_x, speed_y;
};

// Depth, in units of its own, below which a point that comes towards the camera is no longer seen.
constexpr float nearest_depth = 1e-3f;

// Beyond so many pixels nothing matters, and no product of such numbers overflows.
constexpr float farthest_pixel = 1e9f;

FEWRAYS_HD inline float within_reach(float pixels) {
    return pixels > -farthest_pixel ? (pixels < farthest_pixel ? pixels : farthest_pixel) : -farthest_pixel;
}

FEWRAYS_HD inline Path path_of(float x, float y, float u, float v, float depth, float time, const float* motion,
                               float c0, float c1) {
    const float c = slope(depth, c0, c1), own_c0 = within_reach(c0 / depth);
    const float center_x = within_reach(x - u * c), center_y = within_reach(y - v * c);
    if (!motion) return {center_x, center_y, 1.0f, 0.0f, 0.0f, 0.0f, own_c0};
    const float dx = within_reach(motion[0] / depth), dy = within_reach(motion[1] / depth);
    const float dw = within_reach(motion[2] / depth);
    return {center_x - time * dx, center_y - time * dy, 1.0f - time * dw, dx, dy, dw, own_c0};
}

FEWRAYS_HD inline bool still(const Path& path) { return path.dx == 0 && path.dy == 0 && path.dw == 0; }

FEWRAYS_HD inline float depth_at(const Path& path, float time) { return path.w + time * path.dw; }

// For a positive depth at that time.
FEWRAYS_HD inline Sight sight_of(const Path& path, float u, float v, float time, float c1) {
    const float reciprocal = 1.0f / depth_at(path, time), c = path.c0 * reciprocal + c1;
    const float x = (path.x + time * path.dx) * reciprocal, y = (path.y + time * path.dy) * reciprocal;
    // The slope changes with the depth as well.
    const float dc = -path.c0 * path.dw * reciprocal * reciprocal;
    return {x + u * c, y + v * c, c, (path.dx - path.dw * x) * reciprocal + u * dc,
            (path.dy - path.dw * y) * reciprocal + v * dc};
}

// By how much two points' order along one axis may be reversed while the lens point and the time vary by `along_lens`
// and `along_time`: at most 0 where they keep it (Eq. 5, with motion).
FEWRAYS_HD inline float crossing(float distance, float slopes, float speeds, float along_lens, float along_time) {
    return std::fabs(slopes) * along_lens + std::fabs(speeds) * along_time - std::fabs(distance);
}

}  // namespace fewrays
