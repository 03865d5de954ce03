// The point that a location sees, put together from camera samples near it, and what it sends on of a lamp's light:
// section 5 of Lehtinen et al. 2011, the twin of src/fewrays/temporal/shadows.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "host_device.h"
#include "light.h"
#include "receiver.h"
#include "reprojection.h"

namespace fewrays {

// Where the point of a camera sample of that depth is at a time, in camera space.
FEWRAYS_HD inline Vector point_at(const Projection& camera, const Path& path, float depth, float time) {
    const float w = depth_at(path, time);
    return camera.point((path.x + time * path.dx) / w, (path.y + time * path.dy) / w, w * depth);
}

// How deep it is after so much of the shutter.
FEWRAYS_HD inline float depth_after(float depth, const float* motion, float time) {
    return motion ? depth + time * motion[2] : depth;
}

// Gets the camera samples that a location sees, in any order.
class SeenSurface {
public:
    FEWRAYS_HD void include(std::int64_t number, float depth, float distance2) {
        least_ = std::min(least_, depth);
        most_ = std::max(most_, depth);
        if (distance2 > nearest2_ || (distance2 == nearest2_ && number > nearest_)) return;
        nearest2_ = distance2;
        nearest_ = number;
    }

    // The sample that is nearest to the location.
    FEWRAYS_HD std::int64_t nearest() const { return nearest_; }

    // The point that is seen: on that sample's tangent plane, but neither in front of all samples nor behind.
    FEWRAYS_HD Vector point(const CameraRay& ray, Vector nearest_point, Vector normal) const {
        return ray.from + std::clamp(depth_on_plane(ray, nearest_point, normal), least_, most_) * ray.towards;
    }

private:
    float nearest2_ = INFINITY, least_ = INFINITY, most_ = 0.0f;
    std::int64_t nearest_ = 0;
};

// What a point sends to the camera per unit of a light point's radiance, from the samples that it was made of.
class LampGain {
public:
    FEWRAYS_HD explicit LampGain(const Incidence& seen) : seen_(seen) {}

    // A sample's share, shading normal, reflectance (3), and how far its light sample is from others; 0 for none.
    FEWRAYS_HD void include(float share, Vector normal, const float* reflectance, float spacing) {
        if (!(spacing > 0.0f)) return;
        spacing_ += share * spacing;
        shares_ += share;
        const float own = share * std::max(dot(normal, seen_.to_light), 0.0f) / seen_.distance;
        for (int channel = 0; channel < 3; ++channel) sums_[channel] += own * reflectance[channel];
    }

    // Whether there is any; then writes it, where a location counts so many times per share.
    FEWRAYS_HD bool finish(float weight, float area, float* gain) const {
        const float factor = weight * seen_.factor(area);
        for (int channel = 0; channel < 3; ++channel) gain[channel] = factor * sums_[channel];
        return gain[0] != 0.0f || gain[1] != 0.0f || gain[2] != 0.0f;
    }

    // Of light samples around the point; there is one wherever there is a gain.
    FEWRAYS_HD float spacing() const { return spacing_ / shares_; }

private:
    const Incidence& seen_;
    float spacing_ = 0.0f, shares_ = 0.0f, sums_[3] = {};
};

}  // namespace fewrays
