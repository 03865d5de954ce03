#include "layer_visibility.h"

#include <algorithm>

#include "separable_blur.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr float min_covered = 1e-3f;
constexpr float min_weight = 1e-12f;

struct Interpolated {
    float value, step_x, step_y;
};

// At the corners of a cell: p and q = p + 1, and the same in the row below.
FEWRAYS_INLINE Interpolated interpolate(float p, float q, float p_below, float q_below, float fx, float fy) {
    const float upper = q - p, lower = q_below - p_below;
    const float top = p + fx * upper, bottom = p_below + fx * lower;
    return {top + fy * (bottom - top), upper + fy * (lower - upper), bottom - top};
}

// One row of composite().
FEWRAYS_INLINE void composite_row(const float* FEWRAYS_RESTRICT seen, const float* FEWRAYS_RESTRICT covers,
                                  const float* FEWRAYS_RESTRICT r, const float* FEWRAYS_RESTRICT g,
                                  const float* FEWRAYS_RESTRICT b, std::ptrdiff_t stride, float fx, float fy,
                                  float shear, int columns, float weight, float* FEWRAYS_RESTRICT mean,
                                  float* FEWRAYS_RESTRICT along_u, float* FEWRAYS_RESTRICT along_v,
                                  float* FEWRAYS_RESTRICT sum_opacity, float* FEWRAYS_RESTRICT sum_red,
                                  float* FEWRAYS_RESTRICT sum_green, float* FEWRAYS_RESTRICT sum_blue) {
    for (int i = 0; i < columns; ++i) {
        const float t = mean[i], u = along_u[i], v = along_v[i];
        const Interpolated a =
            interpolate(covers[i], covers[i + 1], covers[i + stride], covers[i + stride + 1], fx, fy);
        const float covered = std::max(1.0f - t, min_covered), cover = std::max(a.value, min_weight);
        const float reciprocal = 1.0f / (covered * cover);  // of both at the price of one
        const float spare = (seen[i] - t) * cover * reciprocal;
        // A map's very edge has a slope but nothing to see.
        const float counts = a.value > min_weight ? shear * std::min(std::max(spare, 0.0f), 1.0f) : 0.0f;
        const float with_u = counts * u, with_v = counts * v;

        const float unclamped = t * a.value + with_u * a.step_x + with_v * a.step_y;
        const float visible = std::min(std::max(unclamped, std::max(t + a.value - 1.0f, 0.0f)), std::min(t, a.value));
        // What the clamp adds or takes away has the layer's mean radiance.
        const float alone = t + (visible - unclamped) * covered * reciprocal;
        sum_opacity[i] += weight * visible;
        const Interpolated er = interpolate(r[i], r[i + 1], r[i + stride], r[i + stride + 1], fx, fy);
        sum_red[i] += weight * std::max(alone * er.value + with_u * er.step_x + with_v * er.step_y, 0.0f);
        const Interpolated eg = interpolate(g[i], g[i + 1], g[i + stride], g[i + stride + 1], fx, fy);
        sum_green[i] += weight * std::max(alone * eg.value + with_u * eg.step_x + with_v * eg.step_y, 0.0f);
        const Interpolated eb = interpolate(b[i], b[i + 1], b[i + stride], b[i + stride + 1], fx, fy);
        sum_blue[i] += weight * std::max(alone * eb.value + with_u * eb.step_x + with_v * eb.step_y, 0.0f);

        const float clear = 1.0f - a.value, moved = t * shear;
        along_u[i] = u * clear - moved * a.step_x;
        along_v[i] = v * clear - moved * a.step_y;
        mean[i] = std::max(t - visible, 0.0f);
    }
}

FEWRAYS_INLINE void composite_near_row(const float* FEWRAYS_RESTRICT covers, const float* FEWRAYS_RESTRICT r,
                                       const float* FEWRAYS_RESTRICT g, const float* FEWRAYS_RESTRICT b, int columns,
                                       float weight, float* FEWRAYS_RESTRICT mean, float* FEWRAYS_RESTRICT along_u,
                                       float* FEWRAYS_RESTRICT along_v, float* FEWRAYS_RESTRICT sum_opacity,
                                       float* FEWRAYS_RESTRICT sum_red, float* FEWRAYS_RESTRICT sum_green,
                                       float* FEWRAYS_RESTRICT sum_blue) {
    for (int i = 0; i < columns; ++i) {
        const float t = weight * mean[i], clear = 1.0f - covers[i];
        sum_opacity[i] += t * covers[i];
        sum_red[i] += t * r[i];
        sum_green[i] += t * g[i];
        sum_blue[i] += t * b[i];
        mean[i] *= clear;
        along_u[i] *= clear;
        along_v[i] *= clear;
    }
}

}  // namespace

FEWRAYS_CLONES void composite(const LayerView& view, const Shown& shown) {
    for (int row = 0; row < shown.rows; ++row) {
        const std::ptrdiff_t in = row * view.stride, behind = std::ptrdiff_t{row} * patch_columns,
                             out = std::ptrdiff_t{row} * shown.stride;
        composite_row(view.channels[known] + in, view.channels[opacity] + in, view.channels[red] + in,
                      view.channels[green] + in, view.channels[blue] + in, view.stride, view.fraction_x,
                      view.fraction_y, view.shear, shown.columns, shown.weight, shown.mean + behind,
                      shown.along_u + behind, shown.along_v + behind, shown.opacity + out, shown.red + out,
                      shown.green + out, shown.blue + out);
    }
}

FEWRAYS_CLONES void composite_near(const LayerView& view, const Shown& shown) {
    for (int row = 0; row < shown.rows; ++row) {
        const std::ptrdiff_t in = row * view.stride, behind = std::ptrdiff_t{row} * patch_columns,
                             out = std::ptrdiff_t{row} * shown.stride;
        composite_near_row(view.channels[opacity] + in, view.channels[red] + in, view.channels[green] + in,
                           view.channels[blue] + in, shown.columns, shown.weight, shown.mean + behind,
                           shown.along_u + behind, shown.along_v + behind, shown.opacity + out, shown.red + out,
                           shown.green + out, shown.blue + out);
    }
}

FEWRAYS_CLONES float largest(const float* values, std::ptrdiff_t n) {
    float best[columns_at_once] = {};
    for (std::ptrdiff_t i = 0; i < n; i += columns_at_once)
        for (int k = 0; k < columns_at_once; ++k) best[k] = std::max(best[k], values[i + k]);
    return *std::max_element(best, best + columns_at_once);
}

FEWRAYS_CLONES Span occupied(const float* row, int columns) {
    int first = 0, end = columns;
    const auto empty = [&](int from) {
        float largest_here = 0;
        for (int i = 0; i < columns_at_once; ++i) largest_here = std::max(largest_here, row[from + i]);
        return largest_here <= 0.0f;
    };
    while (first < end && empty(first)) first += columns_at_once;
    while (first < end && empty((end - 1) / columns_at_once * columns_at_once))
        end = (end - 1) / columns_at_once * columns_at_once;
    return {first, std::max(first, end)};
}

}  // namespace fewrays
