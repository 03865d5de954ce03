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
    for (int row = first; row < last; ++row)
        for (int column = 0; column < coarse.width; ++column) halve_texel(fine, coarse, row, column);
}

FEWRAYS_CLONES void dynamic_mipmap(const MipLevel* levels, int level_count, float view_radius, int first, int last) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < levels[0].width; ++column)
            mipmap_texel(levels, level_count, view_radius, row, column);
}

FEWRAYS_CLONES void dynamic_blur_along(const MipLevel& level, const MipLevel& passed, const BlurRule& rule, int first,
                                       int last) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < level.width; ++column) blur_along(level, passed, rule, row, column);
}

FEWRAYS_CLONES void dynamic_blur_down(const MipLevel& passed, const MipLevel& level, const MipLevel& sheet,
                                      const BlurRule& rule, int first, int last) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < level.width; ++column) blur_down(passed, level, sheet, rule, row, column);
}

void dynamic_background(const FrontImage& image, float tolerance, float agreement, int reach, int first, int last,
                        BackgroundPixel* background) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < image.width; ++column)
            background[std::ptrdiff_t{row} * image.width + column] =
                background_of(image, row, column, tolerance, agreement, reach);
}

}  // namespace fewrays
