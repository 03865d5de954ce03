// Wide instructions without a build per machine.
#pragma once

#include <cstdint>
#include <cstring>

// A function marked FEWRAYS_CLONES is compiled for three instruction sets; the loader picks the widest that the
// processor has. Helpers that its loops call are FEWRAYS_INLINE, so that they are compiled along with each clone.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && !defined(FEWRAYS_NO_CLONES)
#define FEWRAYS_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FEWRAYS_CLONES
#endif

#if defined(__CUDACC__)
#define FEWRAYS_INLINE __forceinline__
#define FEWRAYS_RESTRICT __restrict__
#define FEWRAYS_PREFETCH(address) static_cast<void>(address)
#define FEWRAYS_UNROLL _Pragma("unroll")
#elif defined(_MSC_VER)
#define FEWRAYS_INLINE __forceinline
#define FEWRAYS_RESTRICT __restrict
#define FEWRAYS_PREFETCH(address) static_cast<void>(address)
#define FEWRAYS_UNROLL
#else
#define FEWRAYS_INLINE inline __attribute__((always_inline))
#define FEWRAYS_RESTRICT __restrict__
#define FEWRAYS_PREFETCH(address) __builtin_prefetch(address)
#define FEWRAYS_UNROLL
#endif

namespace fewrays {

// exp(x) for x <= 0, to about 2e-7 relative, from arithmetic that compilers vectorise. Below -87, where
// float32 would become subnormal, the result stays at exp(-87).
FEWRAYS_INLINE float exp_negative(float x) {
    x = x < -87.0f ? -87.0f : x;
    const float scaled = x * 1.44269504f;
    const auto whole = static_cast<std::int32_t>(scaled - 0.5f);  // truncation rounds to nearest for x <= 0
    const float n = static_cast<float>(whole);
    // ln 2 in two parts keeps the remainder exact.
    const float r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    float p = 1.9875691500e-4f;
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.0f;
    const std::int32_t bits = (whole + 127) << 23;
    float power;
    std::memcpy(&power, &bits, sizeof power);
    return p * power;
}

// floor(x) as an integer, without the SSE4.1 instruction that the baseline lacks.
FEWRAYS_INLINE std::int32_t floor_to_int(float x) {
    const auto truncated = static_cast<std::int32_t>(x);
    return truncated - (static_cast<float>(truncated) > x);
}

}  // namespace fewrays
