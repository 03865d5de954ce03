// Half-precision numbers as bits, converted by integer arithmetic that compilers vectorise.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

#include "simd.h"

namespace fewrays {

using Half = std::uint16_t;

constexpr float largest_half = 65504.0f;

// The factor that half_bits leaves out: 2 to the difference of the exponents' biases.
constexpr float half_bias = 0x1p112f;

// A half's exponent and mantissa in a float's place: the number divided by half_bias. Multiply weights by half_bias
// instead of every number.
FEWRAYS_INLINE float half_bits(Half half) {
    const auto wide = static_cast<std::uint32_t>(static_cast<std::int32_t>(static_cast<std::int16_t>(half)) << 13);
    return std::bit_cast<float>(wide & 0x8fffe000u);
}

FEWRAYS_INLINE float from_half(Half half) { return half_bits(half) * half_bias; }

// To the nearest; at most largest_half in size. What is below 2^-14 becomes 0, so that half_bits is never subnormal.
FEWRAYS_INLINE Half to_half(float value) {
    const float full = std::fabs(value), size = full < largest_half ? full : largest_half;
    const std::uint32_t rounded = std::bit_cast<std::uint32_t>(size) + 0x1000u;
    const std::uint32_t bits = size < 0x1p-14f ? 0u : (rounded >> 13) - (112u << 10);
    return static_cast<Half>((bits < 0x7c00u ? bits : 0x7bffu) | (value < 0.0f ? 0x8000u : 0u));
}

}  // namespace fewrays
