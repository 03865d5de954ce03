// Warping pixels to a view and ordering them by depth: Eq. 4 of Yu et al. 2010, the twin of
// src/fewrays/dynamic/warp.py.
#pragma once

#include <bit>
#include <cstdint>

#include "host_device.h"

namespace fewrays {

// The pixels of a view from `first` to before `end` that what is seen at `position` covers along one axis: those whose
// centres are within `half` of it. Of the two borders one belongs to it, so that half = 1/2 covers one pixel.
struct Covered {
    std::int32_t first, end;
};

FEWRAYS_HD inline std::int32_t ceil_to_int(float x) {
    const auto truncated = static_cast<std::int32_t>(x);
    return truncated + (static_cast<float>(truncated) < x);
}

FEWRAYS_HD inline Covered covered_pixels(float position, float half) {
    return {ceil_to_int(position - half), ceil_to_int(position + half)};
}

// The pixel, of `size` along an axis, that stands for one beyond the border: its mirror image about the outermost
// pixel, or the far border where that is beyond as well.
FEWRAYS_HD inline std::int32_t mirrored(std::int32_t pixel, std::int32_t size) {
    const std::int32_t inward = pixel < 0 ? -pixel : pixel >= size ? 2 * (size - 1) - pixel : pixel;
    return inward < 0 ? 0 : inward >= size ? size - 1 : inward;
}

// The bits of a number, such that they ascend with it.
FEWRAYS_HD inline std::uint32_t ascending_bits(float value) {
    const auto bits = std::bit_cast<std::uint32_t>(value + 0.0f);  // no negative zero
    return bits ^ ((bits >> 31) != 0 ? 0xffffffffu : 0x80000000u);
}

// A whole number that is the smaller, the nearer a slope, given by its ascending bits, is; of equal ones, the smaller
// the pixel's number. The least of all that fall on a pixel is what it shows: an atomic minimum on hardware that
// writes in parallel.
FEWRAYS_HD inline std::uint64_t visibility_key(std::uint32_t order, std::uint32_t number) {
    return (static_cast<std::uint64_t>(order) << 32) | number;
}

constexpr std::uint64_t nothing_visible = ~std::uint64_t{0};

}  // namespace fewrays
