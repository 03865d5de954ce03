// How samples of coarse layers are spread over bins: twin of _share_hits and _scramble in layered/reference.py.
#pragma once

#include <cstdint>

#include "host_device.h"

namespace fewrays {

// Least share of a hit that a bin gets along an axis: none is so small that rounding could make it vanish.
constexpr float least_share = 1.0f / 512.0f;

// The share of the second of two bins, between whose centres a hit lies at this fraction of the way. It grows without
// steps, so that what rounding does to a fraction stays as small.
FEWRAYS_HD inline float share_of(float fraction) { return least_share + (1.0f - 2.0f * least_share) * fraction; }

// A number from -1/2 to 1/2 that looks random, but is the sample's own: the first 16 bits behind the point of a
// multiple of its lens position. They are cut out as whole numbers: a difference might be fused with the product before
// it on one processor and not on another, and what is left of 719 lens units would then be another number.
FEWRAYS_HD inline float scramble(float u) {
    const float many = (u + 1.0f) * 719.37f;
    const auto bits = static_cast<std::int32_t>(many * 65536.0f);
    return static_cast<float>(bits & 0xffff) * (1.0f / 65536.0f) - 0.5f;
}

}  // namespace fewrays
