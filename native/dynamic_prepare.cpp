// What comes before the views: the blur between them, and what is behind edges. Twins of
// src/fewrays/dynamic/prefilter.py and fill.py.
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dynamic.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int mixed_width = 3;  // pixels of an edge
constexpr int blurred = 5;      // values of a texel: light and coverage

// Means of texels.
struct Mean {
    float total = 0, sum[blurred] = {};

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

FEWRAYS_INLINE void halve_rows(const MipLevel& fine, const MipLevel& coarse, int first, int last) {
    constexpr float taps[] = {0.25f, 0.5f, 0.25f};
    for (int i = first; i < last; ++i)
        for (int j = 0; j < coarse.width; ++j) {
            Mean mean;
            for (int down = -1; down <= 1; ++down)
                for (int along = -1; along <= 1; ++along) {
                    const int row = 2 * i + down, column = 2 * j + along;
                    if (row < 0 || row >= fine.height || column < 0 || column >= fine.width) continue;
                    mean.add(fine.texels[std::ptrdiff_t{row} * fine.width + column], taps[down + 1] * taps[along + 1]);
                }
            mean.store(coarse.texels[std::ptrdiff_t{i} * coarse.width + j]);
        }
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

// What the search in one direction found.
struct Find {
    std::ptrdiff_t pixel;
    float slope, distance2;
    int steps;
    bool pure;  // no edge
};

// The first surface behind a pixel in a direction, from where the rim of the lens can uncover it.
FEWRAYS_INLINE bool find_behind(const FrontImage& image, int row, int column, int down, int along, float tolerance,
                                int reach, Find& find) {
    const float front = image.front[std::ptrdiff_t{row} * image.width + column];
    const float length = down != 0 && along != 0 ? 1.41421356f : 1.0f;
    const auto inside = [&](int i, int j) { return i >= 0 && i < image.height && j >= 0 && j < image.width; };
    for (int step = 1; step <= reach; ++step) {
        const int i = row + step * down, j = column + step * along;
        const float distance = length * static_cast<float>(step);
        if (!inside(i, j) || distance > image.most - front + 1) return false;
        const float gap = image.slope[std::ptrdiff_t{i} * image.width + j] - front;
        if (!(gap > tolerance && distance <= gap + 1)) continue;
        // The first from here on that is no edge, or else this one.
        for (int further = step; further < step + mixed_width; ++further) {
            const int to_row = row + further * down, to_column = column + further * along;
            if (!inside(to_row, to_column)) break;
            const std::ptrdiff_t pixel = std::ptrdiff_t{to_row} * image.width + to_column;
            if (!(image.slope[pixel] - front > tolerance)) break;
            const float away = length * static_cast<float>(further);
            const bool pure = !image.edge[pixel];
            if (pure || further == step) find = {pixel, image.slope[pixel], away * away, further, pure};
            if (pure) break;
        }
        return true;
    }
    return false;
}

// The slope in the middle of all, or of two such the greater.
FEWRAYS_INLINE float upper_median(const Find* finds, int count) {
    for (int candidate = 0; candidate < count; ++candidate) {
        int less = 0, equal = 0;
        for (int k = 0; k < count; ++k) {
            less += finds[k].slope < finds[candidate].slope;
            equal += finds[k].slope == finds[candidate].slope;
        }
        if (less <= count / 2 && count / 2 < less + equal) return finds[candidate].slope;
    }
    return finds[0].slope;
}

FEWRAYS_INLINE BackgroundPixel background_of(const FrontImage& image, int row, int column, float tolerance,
                                             float agreement, int reach) {
    BackgroundPixel result{};
    if (!image.needed[std::ptrdiff_t{row} * image.width + column]) return result;
    Find finds[8];
    int count = 0;
    for (int down = -1; down <= 1; ++down)
        for (int along = -1; along <= 1; ++along)
            if ((down != 0 || along != 0) &&
                find_behind(image, row, column, down, along, tolerance, reach, finds[count]))
                ++count;
    if (count == 0) return result;
    // A mixture counts for nothing where what is none is hardly farther away.
    int nearest = finds[0].steps;
    for (int k = 1; k < count; ++k) nearest = std::min(nearest, finds[k].steps);
    const auto near_and_pure = [&](const Find& find) { return find.pure && find.steps <= nearest + mixed_width; };
    if (std::any_of(finds, finds + count, near_and_pure)) {
        Find* const mixed = std::partition(finds, finds + count, [](const Find& find) { return find.pure; });
        count = static_cast<int>(mixed - finds);
    }
    const float anchor = upper_median(finds, count);
    float total = 0;
    for (int k = 0; k < count; ++k) {
        if (std::fabs(finds[k].slope - anchor) > agreement) continue;
        const float weight = 1 / finds[k].distance2;
        total += weight;
        for (int channel = 0; channel < 4; ++channel)
            result.light[channel] += weight * image.light[4 * finds[k].pixel + channel];
        result.slope += weight * finds[k].slope;
    }
    for (float& channel : result.light) channel /= total;
    result.slope /= total;
    result.known = 1;
    return result;
}

}  // namespace

FEWRAYS_CLONES void dynamic_halve(const MipLevel& fine, const MipLevel& coarse, int first, int last) {
    halve_rows(fine, coarse, first, last);
}

FEWRAYS_CLONES void dynamic_mipmap(const MipLevel* levels, int level_count, float view_radius, int first, int last) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < levels[0].width; ++column)
            mipmap_texel(levels, level_count, view_radius, row, column);
}

FEWRAYS_CLONES void dynamic_blur_along(const MipLevel& level, const MipLevel& passed, const BlurRule& rule, int first,
                                       int last) {
    const int step = step_of(rule.level);
    for (int row = first; row < last; ++row)
        for (int column = 0; column < level.width; ++column) {
            const std::ptrdiff_t pixel = std::ptrdiff_t{row} * level.width + column;
            passed.texels[pixel] = level.texels[pixel];
            if (needs_level(level.texels[pixel].slope, rule))
                smooth(level.texels + pixel, step, column >= step, column + step < level.width, rule)
                    .store(passed.texels[pixel]);
        }
}

FEWRAYS_CLONES void dynamic_blur_down(const MipLevel& passed, const MipLevel& level, const MipLevel& sheet,
                                      const BlurRule& rule, int first, int last) {
    const int step = step_of(rule.level);
    const float narrow = variance_of(rule.level), wide = variance_of(rule.level + 1);
    for (int row = first; row < last; ++row)
        for (int column = 0; column < level.width; ++column) {
            const std::ptrdiff_t pixel = std::ptrdiff_t{row} * level.width + column;
            Texel& texel = level.texels[pixel];
            if (!needs_level(texel.slope, rule)) continue;
            const Texel before = texel;
            smooth(passed.texels + pixel, std::ptrdiff_t{step} * level.width, row >= step, row + step < level.height,
                   rule)
                .store(texel);
            const float wanted = wanted_variance(texel.slope, rule);
            if (wanted <= narrow) continue;
            const float share = std::min((wanted - narrow) / (wide - narrow), 1.0f);
            Mean both;
            both.add(before, 1 - share);
            both.add(texel, share);
            put_light(both.sum, both.sum[4], sheet.texels[pixel]);
        }
}

void dynamic_background(const FrontImage& image, float tolerance, float agreement, int reach, int first, int last,
                        BackgroundPixel* background) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < image.width; ++column)
            background[std::ptrdiff_t{row} * image.width + column] =
                background_of(image, row, column, tolerance, agreement, reach);
}

}  // namespace fewrays
