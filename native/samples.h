// How native code sees a SampleBuffer, and where in the image its blocks of pixels have their samples.
#pragma once

#include <cstddef>

namespace fewrays {

struct Samples {
    const float* xy;     // (H, W, S, 2)
    const float* uv;     // (H, W, S, 2)
    const float* depth;  // (H, W, S)
    const float* color;  // (H, W, S, 3)
    int height, width, spp;
    float c0, c1;
};

// The image positions of a block's samples, as a box; empty where x_min > x_max.
struct Extent {
    float x_min, x_max, y_min, y_max;
};

// Extents of blocks of `block` x `block` pixels, for rows of blocks [first, last). Samples farther than `margin`
// pixels outside the image are left out: no tile gathers them.
void block_extents(const Samples& samples, int block, float margin, int first, int last, Extent* extents);

}  // namespace fewrays
