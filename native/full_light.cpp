#include "full_light.h"

#include <algorithm>

#include "math/clear_view.h"

namespace fewrays {

bool gets_full_light(const Lamp& lamp, float radius, std::ptrdiff_t sample, Vector point, float first_time,
                     float last_time) {
    const SampleTree& tree = *lamp.tree;
    const LightField& field = tree.field();
    if (!lamp.radiance || !lamp.arrives[sample] || lamp.motion.x != 0 || lamp.motion.y != 0 || lamp.motion.z != 0)
        return false;
    if (!still(field.path(static_cast<std::int32_t>(sample)))) return false;
    const ClearView view(lamp.frame, point, lamp.facing_at(sample), field.spacing[sample], radius, lamp.farthest,
                         first_time, last_time);
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
