// What lies behind the edges of an image: the twin of src/fewrays/dynamic/fill.py, a pixel at a time.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../simd.h"

namespace fewrays {

// What is believed to be behind a pixel's surface.
struct BackgroundPixel {
    float light[4];
    float slope;
    float known;  // 1 or 0
};

// An image, (H, W), whose surfaces are carried on behind those in front.
struct FrontImage {
    const float *light, *slope;  // (H, W, 4), (H, W)
    const float* front;          // slope of the surface that covers each pixel
    const std::uint8_t* edge;    // pixels that may show a mixture
    const std::uint8_t* needed;  // pixels to look behind
    int height, width;
    float most;  // no slope is greater
};

// How far surfaces are looked for, and which belong together.
struct BehindRule {
    float tolerance;  // pixels of slope by which what is behind is so at least
    float agreement;  // pixels of slope by which finds may differ and be averaged
    int reach;        // pixels
};

constexpr int mixed_width = 3;  // pixels of an edge

// What the search in one direction found.
struct Find {
    std::ptrdiff_t pixel;
    float slope, distance2;
    int steps;
    bool pure;  // no edge
};

// The first surface behind a pixel in a direction, from where the rim of the lens can uncover it.
FEWRAYS_INLINE bool find_behind(const FrontImage& image, int row, int column, int down, int along,
                                const BehindRule& rule, Find& find) {
    const float front = image.front[std::ptrdiff_t{row} * image.width + column];
    const float length = down != 0 && along != 0 ? 1.41421356f : 1.0f;
    const auto inside = [&](int i, int j) { return i >= 0 && i < image.height && j >= 0 && j < image.width; };
    for (int step = 1; step <= rule.reach; ++step) {
        const int i = row + step * down, j = column + step * along;
        const float distance = length * static_cast<float>(step);
        if (!inside(i, j) || distance > image.most - front + 1) return false;
        const float gap = image.slope[std::ptrdiff_t{i} * image.width + j] - front;
        if (!(gap > rule.tolerance && distance <= gap + 1)) continue;
        // The first from here on that is no edge, or else this one.
        for (int further = step; further < step + mixed_width; ++further) {
            const int to_row = row + further * down, to_column = column + further * along;
            if (!inside(to_row, to_column)) break;
            const std::ptrdiff_t pixel = std::ptrdiff_t{to_row} * image.width + to_column;
            if (!(image.slope[pixel] - front > rule.tolerance)) break;
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

// Keeps those finds that count; a mixture counts for nothing where what is none is hardly farther away.
FEWRAYS_INLINE int purest(Find* finds, int count) {
    int nearest = finds[0].steps, kept = 0;
    for (int k = 1; k < count; ++k) nearest = std::min(nearest, finds[k].steps);
    bool any_pure = false;
    for (int k = 0; k < count; ++k) any_pure |= finds[k].pure && finds[k].steps <= nearest + mixed_width;
    if (!any_pure) return count;
    for (int k = 0; k < count; ++k)
        if (finds[k].pure) finds[kept++] = finds[k];
    return kept;
}

// What is behind a pixel: the mean of what the eight directions find of one surface.
FEWRAYS_INLINE BackgroundPixel background_of(const FrontImage& image, int row, int column, const BehindRule& rule) {
    BackgroundPixel result{};
    Find finds[8];
    int count = 0;
    for (int down = -1; down <= 1; ++down)
        for (int along = -1; along <= 1; ++along)
            if ((down != 0 || along != 0) && find_behind(image, row, column, down, along, rule, finds[count])) ++count;
    if (count == 0) return result;
    count = purest(finds, count);
    const float anchor = upper_median(finds, count);
    float total = 0;
    for (int k = 0; k < count; ++k) {
        if (std::fabs(finds[k].slope - anchor) > rule.agreement) continue;
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

}  // namespace fewrays
