#include "full_light.h"

#include <algorithm>
#include <cmath>

#include "math/clear_view.h"

namespace fewrays {

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
    const ClearView view(lamp_.frame, point, normal, field.spacing[sample], radius_, farthest_, first_time, last_time);
    if (!view.decides()) return false;
    const auto may_matter = [&](const TreeNode& node) { return view.may_matter(node); };
    const auto may_block = [&](std::int32_t other) {
        return view.may_block(field.path(other), field.far_slope(), field.spacing[other]);
    };
    return !tree.any(may_matter, [&](const std::int32_t* samples, std::int32_t count) {
        return std::any_of(samples, samples + count, may_block);
    });
}

}  // namespace fewrays
