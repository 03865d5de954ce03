// Half-precision planes on a GPU: the four channels of a cell lie beside each other, so that one load brings them.
#pragma once

#include <cstdint>
#include <cstring>

#include "../half.h"

namespace fewrays {

// Opacity, and radiance times opacity, of one cell.
struct alignas(8) HalfTexel {
    Half channels[4];
};

struct Values {
    float opacity, red, green, blue;
};

#ifdef __CUDACC__

inline float wide(Half half) {
    float value;
    asm("cvt.f32.f16 %0, %1;" : "=f"(value) : "h"(half));
    return value;
}

inline HalfTexel load(const HalfTexel* from) {
    const uint2 bits = __ldg(reinterpret_cast<const uint2*>(from));
    HalfTexel texel;
    std::memcpy(&texel, &bits, sizeof texel);
    return texel;
}

#else

inline float wide(Half half) { return from_half(half); }
inline HalfTexel load(const HalfTexel* from) { return *from; }

#endif

FEWRAYS_INLINE void add(Values& sum, float weight, const HalfTexel& texel) {
    sum.opacity += weight * wide(texel.channels[0]);
    sum.red += weight * wide(texel.channels[1]);
    sum.green += weight * wide(texel.channels[2]);
    sum.blue += weight * wide(texel.channels[3]);
}

}  // namespace fewrays
