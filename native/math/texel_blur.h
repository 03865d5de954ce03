// What blurs a sheet's light for what lies between the views: the twin of src/fewrays/dynamic/prefilter.py and
// mipmap.py, a texel at a time.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "../simd.h"
#include "sheet_lookup.h"

namespace fewrays {

// One level of a mip pyramid, (H, W); level 0 is a sheet.
struct MipLevel {
    Texel* texels;
    int height, width;
};

// How surfaces are blurred: by a cascade of kernels, up to a deviation of `radius` times the slope.
struct BlurRule {
    float radius;
    float tolerance, relative;  // slopes that differ by so many pixels, or by that share, are one surface
    int level;                  // number of the kernel
};

constexpr int blurred_values = 5;  // of a texel: light and coverage

// Means of texels.
struct Mean {
    float total = 0, sum[blurred_values] = {};

    FEWRAYS_INLINE void add(const Texel& texel, float weight) {
        total += weight;
        for (int k = 0; k < 4; ++k) sum[k] += weight * texel.light[k];
        sum[4] += weight * texel.coverage;
    }

    FEWRAYS_INLINE void store(Texel& texel) const {
        const float scale = 1 / total;
        for (int k = 0; k < 4; ++k) texel.light[k] = scale * sum[k];
        texel.coverage = scale * sum[4];
    }
};

// Puts blurred light into a texel, whose own coverage stays as sharp as it is.
FEWRAYS_INLINE void put_light(const float* light, float coverage, Texel& texel) {
    const float scale = coverage > 0 ? texel.coverage / coverage : 0.0f;
    for (int k = 0; k < 4; ++k) texel.light[k] = scale * light[k];
}

// One texel of the next coarser level.
FEWRAYS_INLINE void halve_texel(const MipLevel& fine, const MipLevel& coarse, int row, int column) {
    constexpr float taps[] = {0.25f, 0.5f, 0.25f};
    Mean mean;
    for (int down = -1; down <= 1; ++down)
        for (int along = -1; along <= 1; ++along) {
            const int i = 2 * row + down, j = 2 * column + along;
            if (i < 0 || i >= fine.height || j < 0 || j >= fine.width) continue;
            mean.add(fine.texels[std::ptrdiff_t{i} * fine.width + j], taps[down + 1] * taps[along + 1]);
        }
    mean.store(coarse.texels[std::ptrdiff_t{row} * coarse.width + column]);
}

// A level at a pixel of level 0, bilinear.
FEWRAYS_INLINE Mean interpolate(const MipLevel& level, int number, int row, int column) {
    const float scale = 1 / static_cast<float>(1 << number);
    const int left = column >> number, top = row >> number;
    const float along = scale * static_cast<float>(column) - static_cast<float>(left);
    const float down = scale * static_cast<float>(row) - static_cast<float>(top);
    Mean mean;
    for (int tap = 0; tap < 4; ++tap) {
        const int i = top + tap / 2, j = left + tap % 2;
        if (i >= level.height || j >= level.width) continue;
        const float area = (tap / 2 ? down : 1 - down) * (tap % 2 ? along : 1 - along);
        mean.add(level.texels[std::ptrdiff_t{i} * level.width + j], area);
    }
    return mean;
}

// Looks a texel of level 0 up between the levels that its slope asks for.
FEWRAYS_INLINE void mipmap_texel(const MipLevel* levels, int level_count, float view_radius, int row, int column) {
    Texel& texel = levels[0].texels[std::ptrdiff_t{row} * levels[0].width + column];
    const float footprint = 2 * view_radius * std::fabs(texel.slope);
    if (!(footprint > 1)) return;
    const float wanted = std::min(std::log2(footprint), static_cast<float>(level_count - 1));
    const int coarse = std::max(static_cast<int>(std::ceil(wanted)), 1);
    const float share = wanted - static_cast<float>(coarse - 1);
    Texel fine = texel, blurry = texel;
    if (coarse > 1) interpolate(levels[coarse - 1], coarse - 1, row, column).store(fine);
    interpolate(levels[coarse], coarse, row, column).store(blurry);
    Mean both;
    both.add(fine, 1 - share);
    both.add(blurry, share);
    put_light(both.sum, both.sum[4], texel);
}

// Pixels from tap to tap of a level's kernel: two kernels of one width follow each other.
FEWRAYS_INLINE int step_of(int level) { return 1 << (level / 2); }

// Variance in pixels² that the kernels of the first levels add up to.
FEWRAYS_INLINE float variance_of(int level) {
    const auto power = static_cast<float>(1 << (level / 2 * 2));
    return (power - 1) / 3 + (level % 2 ? 0.5f * power : 0.0f);
}

// Variance that a slope asks for.
FEWRAYS_INLINE float wanted_variance(float slope, const BlurRule& rule) {
    const float deviation = rule.radius * slope;
    return deviation * deviation;
}

// Whether a pixel, or one of its surface beside it, needs the next level.
FEWRAYS_INLINE bool needs_level(float slope, const BlurRule& rule) {
    return wanted_variance(slope, rule) > 0.5f * variance_of(rule.level);
}

// A level's kernel at a pixel, over those of its surface; `stride` is the number of texels from tap to tap, and the
// image has a tap before and after or not.
FEWRAYS_INLINE Mean smooth(const Texel* texel, std::ptrdiff_t stride, bool before, bool after, const BlurRule& rule) {
    const float slanted =
        std::min(rule.tolerance * static_cast<float>(step_of(rule.level)), std::fabs(texel->slope) * rule.relative);
    const float allowed = std::max(slanted, rule.tolerance);
    const auto weight = [&](const Texel& other) {
        return std::fabs(other.slope - texel->slope) <= allowed ? 0.25f : 0.0f;
    };
    Mean mean;
    mean.add(*texel, 0.5f);
    if (before) mean.add(texel[-stride], weight(texel[-stride]));
    if (after) mean.add(texel[stride], weight(texel[stride]));
    return mean;
}

// One pass of a level's kernel at a pixel, along x: from `level` into `passed`.
FEWRAYS_INLINE void blur_along(const MipLevel& level, const MipLevel& passed, const BlurRule& rule, int row,
                               int column) {
    const int step = step_of(rule.level);
    const std::ptrdiff_t pixel = std::ptrdiff_t{row} * level.width + column;
    passed.texels[pixel] = level.texels[pixel];
    if (needs_level(level.texels[pixel].slope, rule))
        smooth(level.texels + pixel, step, column >= step, column + step < level.width, rule)
            .store(passed.texels[pixel]);
}

// The other pass, along y, from `passed` into `level`; pixels that are to be blurred no wider go to the sheet.
FEWRAYS_INLINE void blur_down(const MipLevel& passed, const MipLevel& level, const MipLevel& sheet,
                              const BlurRule& rule, int row, int column) {
    const int step = step_of(rule.level);
    const float narrow = variance_of(rule.level), wide = variance_of(rule.level + 1);
    const std::ptrdiff_t pixel = std::ptrdiff_t{row} * level.width + column;
    Texel& texel = level.texels[pixel];
    if (!needs_level(texel.slope, rule)) return;
    const Texel before = texel;
    smooth(passed.texels + pixel, std::ptrdiff_t{step} * level.width, row >= step, row + step < level.height, rule)
        .store(texel);
    const float wanted = wanted_variance(texel.slope, rule);
    if (wanted <= narrow) return;
    const float share = std::min((wanted - narrow) / (wide - narrow), 1.0f);
    Mean both;
    both.add(before, 1 - share);
    both.add(texel, share);
    put_light(both.sum, both.sum[4], sheet.texels[pixel]);
}

}  // namespace fewrays
