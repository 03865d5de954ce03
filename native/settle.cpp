#include "settle.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "simd.h"

namespace fewrays {
namespace {

constexpr float least_cosine = 0.9f;  // between normals of one surface
constexpr float reach = 2.0f;         // standard deviations
constexpr double least_others = 0.1;  // of what is averaged, without which a sample cannot tell noise from error

// Sums over the samples around one, with weights w: of w d, w l, (w d)^2, w d w l, (w l)^2 for difference d and light
// l.
struct Sums {
    float difference, light, differences, mixed, lights;
};

// How far sample j lies off sample i's tangent plane, in shares of i's depth.
FEWRAYS_INLINE float off_plane(const SettlePlan& plan, std::ptrdiff_t i, std::ptrdiff_t j, float x, float y) {
    const float* gradient = plan.inverse_gradient + 2 * i;
    return std::fabs(plan.inverse_depth[i] + gradient[0] * x + gradient[1] * y - plan.inverse_depth[j]);
}

// Whether two samples lie on one surface, as a weight: how far the nearer to the other's plane is off it, in pixels,
// or in distances between the two where that is more.
FEWRAYS_INLINE float on_one_surface(const SettlePlan& plan, std::ptrdiff_t i, std::ptrdiff_t j) {
    const float* a = plan.normal + 3 * i;
    const float* b = plan.normal + 3 * j;
    if (!(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > least_cosine)) return 0.0f;
    const float x = plan.at_center[2 * j] - plan.at_center[2 * i];
    const float y = plan.at_center[2 * j + 1] - plan.at_center[2 * i + 1];
    const float distance = std::max(1.0f, x * x + y * y);  // squared
    const float off = std::min(off_plane(plan, i, j, x, y), off_plane(plan, j, i, -x, -y));
    const float pixels = off / (plan.pixel * plan.inverse_depth[i]);
    return exp_negative(-0.5f * pixels * pixels / distance);
}

FEWRAYS_INLINE void add(const SettlePlan& plan, std::ptrdiff_t i, std::ptrdiff_t j, Sums& sums) {
    const float x = plan.xy[2 * j] - plan.xy[2 * i], y = plan.xy[2 * j + 1] - plan.xy[2 * i + 1];
    const float near = exp_negative(-0.5f * (x * x + y * y) / (plan.sigma * plan.sigma));
    const float weight = near * on_one_surface(plan, i, j);
    const float difference = weight * plan.difference[j], light = weight * plan.light[j];
    sums.difference += difference;
    sums.light += light;
    sums.differences += difference * difference;
    sums.mixed += difference * light;
    sums.lights += light * light;
}

}  // namespace

FEWRAYS_CLONES
void settle_rows(const SettlePlan& plan, int first, int last, float* share, float* variance) {
    const int radius = static_cast<int>(std::ceil(reach * plan.sigma));
    for (int row = first; row < last; ++row)
        for (int column = 0; column < plan.width; ++column) {
            const int top = std::max(row - radius, 0), bottom = std::min(row + radius, plan.height - 1);
            const int left = std::max(column - radius, 0), right = std::min(column + radius, plan.width - 1);
            const std::ptrdiff_t own = (std::ptrdiff_t{row} * plan.width + column) * plan.spp;
            for (std::ptrdiff_t i = own; i < own + plan.spp; ++i) {
                Sums sums{};
                for (int y = top; y <= bottom; ++y) {
                    const std::ptrdiff_t begin = (std::ptrdiff_t{y} * plan.width + left) * plan.spp;
                    const std::ptrdiff_t end = begin + std::ptrdiff_t{right - left + 1} * plan.spp;
                    for (std::ptrdiff_t j = begin; j < end; ++j) add(plan, i, j, sums);
                }
                share[i] = variance[i] = 0.0f;
                if (!(plan.light[i] > 0.0f)) continue;  // nothing to correct
                const double light = sums.light, square = light * light, mean = sums.difference / light;
                const double others = 1.0 - sums.lights / square;  // 1 - 1 / n for n samples of equal weight
                const double squares = sums.differences - 2.0 * mean * sums.mixed + mean * mean * sums.lights;
                const bool known = others > least_others;
                share[i] = static_cast<float>(mean);
                variance[i] = static_cast<float>(known ? std::max(squares, 0.0) / (square * others) : mean * mean);
            }
        }
}

}  // namespace fewrays
