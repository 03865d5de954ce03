// Optical vignetting: how much light of a lens point passes the front rim of the lens on its way to a pixel. The twin
// of src/fewrays/vignetting.py, which derives it.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

// The middle of the image in pixels; the rim's displacement per pixel of distance from there, its radius, and the
// width over which it fades, which is above 0, in lens units.
struct FrontRim {
    float center_x, center_y;
    float per_pixel, radius, softness;
};

// From 0 to 1, for the lens point (u, v) and the image position (x, y) in pixels. A caller that shall not darken the
// image divides by the mean of all lens points' weights; where that is 0, each of them counts as 1.
FEWRAYS_HD inline float cats_eye_weight(float u, float v, float x, float y, const FrontRim& rim) {
    const float du = rim.per_pixel * (x - rim.center_x), dv = rim.per_pixel * (y - rim.center_y);
    const float beyond = std::sqrt((u + du) * (u + du) + (v + dv) * (v + dv)) - rim.radius;
    const float inner = -0.5f * std::fmin(std::sqrt(du * du + dv * dv), rim.softness);
    return std::fmin(std::fmax(1.0f - (beyond - inner) / rim.softness, 0.0f), 1.0f);
}

}  // namespace fewrays
