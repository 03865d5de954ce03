// Which way an edge runs, and how far along it to look for more rays.
#pragma once

#include <cmath>

#include "../simd.h"

namespace fewrays {

// Means around a place, in cells: squares of the gradient of opacity (x, y, and their product), the same of the square
// root of the radiance seen, its own square, and rays.
enum EdgeMoment { opacity_xx, opacity_xy, opacity_yy, light_xx, light_xy, light_yy, light_square, rays, edge_moments };

// A way through cells, one for each step: `slope` cells to the side. The k-th counts (1 - k k fade)^2.
struct EdgeWay {
    float slope, fade;
    int steps;   // to each side; 0 where no edge shows
    bool steep;  // steps go from row to row instead of from column to column
};

constexpr float unseen_edge = 1e-3f;     // squares of gradients that count as no edge
constexpr float farthest_along = 12.0f;  // cells

// `at(m)` gives moment m. Where all gradients point in one direction, the way is so long that its cells should have
// `along` rays to each side; it is shorter where they do not.
template <typename Moments>
FEWRAYS_INLINE EdgeWay edge_way(const Moments& at, float along) {
    constexpr float darkest = 1e-20f;
    const float count = at(rays);
    if (!(count > 0.0f)) return {0.0f, 0.0f, 0, false};
    const float contrast = 1.0f / (at(light_square) + darkest);
    const float xx = at(opacity_xx) + contrast * at(light_xx), yy = at(opacity_yy) + contrast * at(light_yy);
    const float xy = at(opacity_xy) + contrast * at(light_xy);
    const float difference = xx - yy;
    const float oriented = std::sqrt(difference * difference + 4.0f * xy * xy);
    const float clear = oriented / (xx + yy + unseen_edge);
    const float reach = std::fmin(along / count, farthest_along) * clear * clear;
    if (!(reach >= 1.0f)) return {0.0f, 0.0f, 0, false};
    const float slope = -2.0f * xy / (std::fabs(difference) + oriented);
    const float fade = (1.0f + slope * slope) / (reach * reach);
    return {slope, fade, static_cast<int>(1.0f / std::sqrt(fade)), difference > 0.0f};
}

// Cells aside at a step.
FEWRAYS_INLINE int aside(const EdgeWay& way, int step) {
    return static_cast<int>(std::floor(static_cast<float>(step) * way.slope + 0.5f));
}

FEWRAYS_INLINE float weight(const EdgeWay& way, int step) {
    const float rest = 1.0f - static_cast<float>(step * step) * way.fade;
    return rest * rest;
}

}  // namespace fewrays
