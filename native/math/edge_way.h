// Which way an edge runs, and how far along it to look for more rays.
#pragma once

#include <cmath>

#include "../simd.h"

namespace fewrays {

// Means around a place, in cells: squares of the gradient of opacity (x, y, and their product), the same of the square
// root of the radiance seen, its own square, and rays.
enum EdgeMoment { opacity_xx, opacity_xy, opacity_yy, light_xx, light_xy, light_yy, light_square, rays, edge_moments };

struct Gradient {
    float x, y;
};

// Of a map at one of its cells, by those around it: Sobel's operator.
FEWRAYS_INLINE Gradient gradient_between(float above_left, float above, float above_right, float left, float right,
                                         float below_left, float below, float below_right) {
    const float fall = below_right - above_left, rise = above_right - below_left;
    return {0.125f * (fall + rise + 2.0f * (right - left)), 0.125f * (fall - rise + 2.0f * (below - above))};
}

// A mean with binomial weights: of a cell, and of the sums of those one, two and three cells to both sides.
constexpr int moment_reach = 3;  // cells
FEWRAYS_INLINE float binomial_mean(float own, float one, float two, float three) {
    return 0.015625f * three + 0.09375f * two + 0.234375f * one + 0.3125f * own;
}

// What is seen of a cell: the square root of its radiance, so that it counts about as an eye sees it.
FEWRAYS_INLINE float light_seen(float opacity, float red, float green, float blue) {
    const float sum = red + green + blue;
    return opacity * std::copysign(std::sqrt(std::fabs(sum)), sum);
}

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
