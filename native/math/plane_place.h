// Where the evidence of a sample lies on planes of the multiplane method.
#pragma once

#include <algorithm>
#include <cmath>

#include "../simd.h"
#include "reprojection.h"

namespace fewrays {

// Image position in pixels.
struct Place {
    float x, y;
};

// Where the lens centre sees a sample's surface at half time. Its slope is `own`, of which at most `most_blur` counts;
// (u, v) is its lens point, and `far_slope` the slope of what is infinitely far away.
FEWRAYS_INLINE Place place_on_plane(const Path& path, float own, float u, float v, float most_blur, bool moving,
                                    float far_slope) {
    const float beyond = own - std::clamp(own, -most_blur, most_blur);
    const float right = beyond * u, down = beyond * v;
    if (!moving || depth_at(path, 0.5f) < nearest_depth) return {path.x + right, path.y + down};
    const Sight sight = sight_of(path, 0.0f, 0.0f, 0.5f, far_slope);
    return {sight.x + right, sight.y + down};
}

}  // namespace fewrays
