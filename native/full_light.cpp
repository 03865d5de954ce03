#include "full_light.h"

#include <algorithm>
#include <cmath>

namespace fewrays {
namespace {

// The places on the second plane from which a hit could be in a receiver's way: as the lamp's point moves by u lens
// units, from `at` by u times the slope, and around that.
struct Swath {
    float at, slope, radius;
};

// Whether a node may have samples in a swath, seen from any point of the lens, along one axis.
bool meets(const Plane& low, const Plane& high, const Swath& swath, float farthest, float first_time, float last_time) {
    float from = -farthest, to = farthest;
    const auto keep_negative = [&](float rise, float start) {  // where start + u * rise <= 0
        if (rise > 0) to = std::min(to, -start / rise);
        if (rise < 0) from = std::max(from, -start / rise);
        if (rise == 0 && start > 0) to = from - 1;
    };
    const float lowest = low.c + std::min(low.b * first_time, low.b * last_time);
    const float highest = high.c + std::max(high.b * first_time, high.b * last_time);
    keep_negative(low.a - swath.slope, lowest - swath.at - swath.radius);
    keep_negative(swath.slope - high.a, swath.at - swath.radius - highest);
    return from <= to;
}

}  // namespace

FullLight::FullLight(const Lamp& lamp, const SurfaceRule& rule, int point_count) : lamp_(lamp), radius_(rule.radius) {
    for (int i = 0; i < point_count; ++i)
        farthest_ = std::max(farthest_, std::hypot(lamp.points[2 * i], lamp.points[2 * i + 1]));
}

bool FullLight::shines_on(std::ptrdiff_t sample, Vector point, Vector normal, float first_time, float last_time) const {
    const SampleTree& tree = *lamp_.tree;
    const LightField& field = tree.field();
    if (!lamp_.radiance || !lamp_.arrives[sample] || lamp_.motion.x != 0 || lamp_.motion.y != 0 || lamp_.motion.z != 0)
        return false;
    if (!still(field.path(static_cast<std::int32_t>(sample)))) return false;
    const LightFrame& frame = lamp_.frame;
    const Vector local = frame.enter(point);
    Vector facing = frame.turn(normal);
    const float above = -dot(facing, local), sideways = farthest_ * frame.unit() * std::hypot(facing.x, facing.y);
    if (!(std::fabs(above) > sideways)) return false;  // the lamp's points are on both sides of the tangent plane
    facing = above > 0 ? facing : -1.0f * facing;

    const float spacing = field.spacing[sample], reach = radius_ * spacing;
    const float nearest = std::max(length(local) - farthest_ * frame.unit(), 0.0f);
    const float precision = rounding * (nearest + length(point) + length(frame.center));
    const PlanePosition at = on_second_plane(frame, {}, local);
    const float slope = frame.unit() * (1.0f - frame.distance / local.z);
    const TangentPlane plane = tangent_plane(frame, {}, {local, facing, at, spacing, precision});
    const Swath across{at.x, slope, reach}, down{at.y, slope, reach};

    const auto may_matter = [&](const TreeNode& node) {
        if (!meets(node.left, node.right, across, farthest_, first_time, last_time) ||
            !meets(node.top, node.bottom, down, farthest_, first_time, last_time))
            return false;
        // The height over the tangent plane is a multiple of a linear function of the place, for every depth.
        const auto most = [&](float factor, const Plane& low, const Plane& high, float middle) {
            const float first = low.c + std::min(low.b * first_time, low.b * last_time) - middle;
            const float last = high.c + std::max(high.b * first_time, high.b * last_time) - middle;
            return std::max(factor * first, factor * last);
        };
        const float step = plane.step + most(plane.across_x, node.left, node.right, at.x) +
                           most(plane.across_y, node.top, node.bottom, at.y);
        const float height =
            plane.start + std::max(plane.share(node.nearest) * step, plane.share(node.farthest) * step);
        return height > precision;
    };
    const auto may_block = [&](std::int32_t other) {
        const Path path = field.path(other);
        if (!still(path)) return true;
        const Sight sight = sight_of(path, 0, 0, 0, field.far_slope());
        const float dx = sight.x - at.x, dy = sight.y - at.y;
        const float away = std::max(std::sqrt(dx * dx + dy * dy) - farthest_ * std::fabs(sight.slope - slope), 0.0f);
        return away <= radius_ * std::min(field.spacing[other], spacing) &&
               plane.height(plane.share(sight.slope), dx, dy) > precision + plane.roughness * away;
    };
    return !tree.any(may_matter, [&](const std::int32_t* samples, std::int32_t count) {
        return std::any_of(samples, samples + count, may_block);
    });
}

}  // namespace fewrays
