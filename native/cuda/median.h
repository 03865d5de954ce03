// The median of many numbers that are not negative, found by their bits, which are in the same order: first by the
// upper half of them, then by the lower. Numbers are counted, so that no order of threads matters.
#pragma once

#include <bit>
#include <cstdint>

#include "../simd.h"
#include "atomics.h"
#include "block.h"

namespace fewrays {

constexpr int half_values = 1 << 16;  // of 16 bits
constexpr int pick_threads = 256;

// The two numbers in the middle, or twice the one.
struct Middle {
    std::uint32_t rank[2];  // among those that have the upper bits
    std::uint32_t upper[2], lower[2];
    std::uint32_t any;  // whether there are numbers

    FEWRAYS_INLINE float value(int which) const { return std::bit_cast<float>(upper[which] << 16 | lower[which]); }
    FEWRAYS_INLINE float median() const { return any ? 0.5f * (value(0) + value(1)) : 0.0f; }
};

// Counts a number by its upper bits in (half_values).
FEWRAYS_INLINE void count_upper(std::uint32_t* counts, float number) {
    atomic_increase(&counts[std::bit_cast<std::uint32_t>(number) >> 16], std::uint32_t{1});
}

// Counts it by its lower bits in (2, half_values), where the upper ones are those of a middle number.
FEWRAYS_INLINE void count_lower(std::uint32_t* counts, const Middle& middle, float number) {
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(number);
    for (int which = 0; which < 2; ++which)
        if (bits >> 16 == middle.upper[which])
            atomic_increase(&counts[which * half_values + (bits & 0xffff)], std::uint32_t{1});
}

// Counts before each thread's part of them, and after all.
struct PartSums {
    std::uint32_t before[pick_threads + 1];
};

// Adds up the counts of every thread's part.
inline void sum_parts(const std::uint32_t* counts, const Block& block, PartSums& sums) {
    constexpr int part = half_values / pick_threads;
    block.each([&](int thread) {
        std::uint32_t sum = 0;
        for (int k = 0; k < part; ++k) sum += counts[thread * part + k];
        sums.before[thread + 1] = sum;
    });
    block.each([&](int thread) {
        if (thread > 0) return;
        sums.before[0] = 0;
        for (int k = 0; k < pick_threads; ++k) sums.before[k + 1] += sums.before[k];
    });
}

// Calls found(value, rank) for the value of 16 bits that the thing of this rank has, and its rank among those.
template <typename Found>
inline void pick_rank(const std::uint32_t* counts, std::uint32_t rank, const Block& block, const PartSums& sums,
                      Found&& found) {
    constexpr int part = half_values / pick_threads;
    block.each([&](int thread) {
        if (rank < sums.before[thread] || rank >= sums.before[thread + 1]) return;
        std::uint32_t left = rank - sums.before[thread];
        int value = thread * part;
        while (left >= counts[value]) left -= counts[value++];
        found(static_cast<std::uint32_t>(value), left);
    });
}

}  // namespace fewrays
