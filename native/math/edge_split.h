// A pixel that mixes two surfaces, taken apart: the twin of src/fewrays/dynamic/edges.py, a pixel at a time, and in
// double precision as there.
#pragma once

#include <algorithm>
#include <cstddef>

#include "../simd.h"
#include "sheet_lookup.h"

namespace fewrays {

constexpr double split_contrast = 0.03;  // of F and B relative to their size; with less, a mixture is like either
constexpr double split_residual = 0.4;   // of the contrast, that a mixture may be off the line between F and B
constexpr float opaque_from = 0.99f;     // opacity from which a background is one
constexpr double whole_within = 0.06;    // coverages so close to 0 or 1 are that

// Mean light of the surface in front of a pixel, as far as it is known.
struct FrontLight {
    double light[4] = {};
    bool known = false;
};

// From the pixels within 2 pixels that are no edge, is_edge(pixel), and whose slopes are at most `farthest`.
template <typename IsEdge>
FEWRAYS_INLINE FrontLight front_light(const Texel* image, int height, int width, int row, int column, float farthest,
                                      const IsEdge& is_edge) {
    FrontLight front;
    double total = 0;
    for (int down = -2; down <= 2; ++down)
        for (int along = -2; along <= 2; ++along) {
            const int i = row + down, j = column + along;
            if (i < 0 || i >= height || j < 0 || j >= width) continue;
            const std::ptrdiff_t pixel = std::ptrdiff_t{i} * width + j;
            if (is_edge(pixel) || !(image[pixel].slope <= farthest)) continue;
            const double weight = 1.0 / (1 + down * down + along * along);
            total += weight;
            for (int k = 0; k < 4; ++k) front.light[k] += weight * static_cast<double>(image[pixel].light[k]);
        }
    front.known = total > 0;
    for (double& channel : front.light) channel /= front.known ? total : 1;
    return front;
}

// Two surfaces that a pixel may mix.
struct Mixture {
    FrontLight front;
    float front_slope;
    const float* behind;  // its light
    float behind_slope;
};

// How much of the pixel its depth says that the front covers.
FEWRAYS_INLINE double coverage_by_depth(const Texel& texel, const Mixture& of, float tolerance) {
    if (texel.slope <= of.front_slope + tolerance) return 1;
    if (texel.slope >= of.behind_slope - tolerance) return 0;
    const float share = (of.behind_slope - texel.slope) / (of.behind_slope - of.front_slope);
    return static_cast<double>(std::clamp(share, 0.0f, 1.0f));
}

// How much its colour says, or its depth where the colour tells nothing.
FEWRAYS_INLINE double coverage_by_color(const Texel& texel, const Mixture& of, double by_depth) {
    double size = 0, sum = 0, along = 0, off_line = 0;
    for (int k = 0; k < 4; ++k) {
        const double front = of.front.light[k], behind = of.behind[k], contrast = front - behind;
        size += contrast * contrast;
        sum += front * front + behind * behind;
        along += (static_cast<double>(texel.light[k]) - behind) * contrast;
    }
    if (!of.front.known || !(size > split_contrast * split_contrast * sum)) return by_depth;
    const double share = along / size;
    for (int k = 0; k < 4; ++k) {
        const double behind = of.behind[k], contrast = of.front.light[k] - behind;
        const double off = static_cast<double>(texel.light[k]) - behind - share * contrast;
        off_line += off * off;
    }
    return off_line <= split_residual * split_residual * size ? std::clamp(share, 0.0, 1.0) : by_depth;
}

// Leaves of a pixel what is the front's; what shows none of it becomes the back's.
FEWRAYS_INLINE void split_texel(const Mixture& of, float tolerance, Texel& texel) {
    const double by_depth = coverage_by_depth(texel, of, tolerance);
    double coverage = coverage_by_color(texel, of, by_depth);
    if (coverage < whole_within) coverage = 0;
    if (coverage > 1 - whole_within) coverage = 1;
    if (!(coverage > 0)) {
        if (by_depth > 0) texel.slope = of.behind_slope;
        return;
    }
    for (int k = 0; k < 4; ++k) {
        const double own = texel.light[k], behind = of.behind[k];
        double kept = std::max(own - (1 - coverage) * behind, 0.0);
        if (k == 3) kept = std::min(kept, coverage);
        texel.light[k] = static_cast<float>(kept);
    }
    texel.coverage = static_cast<float>(coverage);
    if (!(texel.slope <= of.front_slope + tolerance)) texel.slope = of.front_slope;
}

}  // namespace fewrays
