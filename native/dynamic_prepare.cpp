// What comes before the views: the blur between them, and what is behind edges. Twins of
// src/fewrays/dynamic/prefilter.py and fill.py.
#include <cstddef>

#include "dynamic.h"
#include "simd.h"

namespace fewrays {
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

void dynamic_background(const FrontImage& image, const BehindRule& rule, int first, int last,
                        BackgroundPixel* background) {
    for (int row = first; row < last; ++row)
        for (int column = 0; column < image.width; ++column) {
            const std::ptrdiff_t pixel = std::ptrdiff_t{row} * image.width + column;
            background[pixel] = image.needed[pixel] ? background_of(image, row, column, rule) : BackgroundPixel{};
        }
}

}  // namespace fewrays
