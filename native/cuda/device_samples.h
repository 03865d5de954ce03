// Samples in a card's memory, and sums over them that are whole numbers.
#pragma once

#include <cstdint>

#include "../math/reprojection.h"
#include "../simd.h"
#include "block.h"

namespace fewrays {

constexpr int sample_threads = 256;
constexpr float off_image = -524288.0f;  // samples left of it were dropped

// Samples, one after the other.
struct DeviceSamples {
    const float *xy, *uv, *depth, *color;
    const float *time, *motion;  // null where there are none; motion where nothing moves
    const float* bandwidth;      // null where all are matte
    std::int64_t count;
    float c0, c1;
};

FEWRAYS_INLINE bool is_dropped(const DeviceSamples& samples, std::int64_t i) { return samples.xy[2 * i] <= off_image; }

FEWRAYS_INLINE Path path_of_sample(const DeviceSamples& s, std::int64_t i) {
    return path_of(s.xy[2 * i], s.xy[2 * i + 1], s.uv[2 * i], s.uv[2 * i + 1], s.depth[i], s.time ? s.time[i] : 0.0f,
                   s.motion ? s.motion + 3 * i : nullptr, s.c0, s.c1);
}

// Calls work(i) for a thread's sample, if there is one.
template <typename Work>
inline void each_sample(const Block& block, const DeviceSamples& samples, Work&& work) {
    block.each([&](int thread) {
        const std::int64_t i = static_cast<std::int64_t>(block.x()) * sample_threads + thread;
        if (i < samples.count) work(i);
    });
}

// A number as a multiple of 1 / unit, and back. Negative ones wrap around, as sums of them do.
FEWRAYS_INLINE std::uint64_t in_units(float value, float unit) {
    const float scaled = value * unit;
    return static_cast<std::uint64_t>(static_cast<std::int64_t>(scaled < 0.0f ? scaled - 0.5f : scaled + 0.5f));
}

FEWRAYS_INLINE float of_units(std::uint64_t sum, float unit) {
    return static_cast<float>(static_cast<std::int64_t>(sum)) / unit;
}

}  // namespace fewrays
