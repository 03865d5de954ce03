// Bounds of the hierarchy that finds samples: section 4 and Appendix A of Lehtinen et al. 2011.
#pragma once

#include <cstdint>

#include "host_device.h"

namespace fewrays {

// A lens point and a time.
struct View {
    float u, v, time;
};

struct Box {
    float left, right, top, bottom;
};

// The function lens * a + time * b + c.
struct Plane {
    float a, b, c;

    FEWRAYS_HD float at(float lens, float time) const { return a * lens + b * time + c; }
};

// A group of samples, between planes wherever on the lens they are seen from and whenever (Eq. 6).
struct alignas(8) TreeNode {
    Plane left, right, top, bottom;
    float nearest, farthest;     // slopes
    float opens, closes;         // the times at which any of the samples can be seen
    std::int32_t first, second;  // children; of a leaf the first sample as ~first, and the end

    FEWRAYS_HD bool leaf() const { return first < 0; }
    FEWRAYS_HD bool meets(const Box& box, const View& view) const {
        return left.at(view.u, view.time) <= box.right && right.at(view.u, view.time) >= box.left &&
               top.at(view.v, view.time) <= box.bottom && bottom.at(view.v, view.time) >= box.top &&
               opens <= view.time && view.time <= closes;
    }
};

}  // namespace fewrays
