// A sheet's pixels, and the light that a ray finds between them: the twin of src/fewrays/dynamic/synthesis.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../simd.h"
#include "disparity.h"
#include "host_device.h"

namespace fewrays {

// One pixel of a sheet for lookups.
struct FEWRAYS_WIDE Texel {
    float light[4];  // radiance and opacity, multiplied by coverage
    float coverage;
    float slope;      // far from any other where there is nothing
    float unused[2];  // one texel is one wide load
};

// One pixel of a sheet for warping, which reads much more of them.
struct WarpPixel {
    float slope;
    float spread;  // how much wider than a pixel it may look from the rim of the lens; negative where it is not warped
};

constexpr int texel_size = 8;
static_assert(sizeof(Texel) == texel_size * sizeof(float));

// What a ray carries: light and coverage, both times `total`.
struct Found {
    float values[texel_size] = {};
    float total = 0;

    FEWRAYS_INLINE void add(const Texel& texel, float slope, float tolerance, float area) {
        const float weight = std::fabs(texel.slope - slope) <= tolerance ? area : 0.0f;
        total += weight;
        // All of the texel, of which some is of no use: one wide instruction.
        const float* const from = reinterpret_cast<const float*>(&texel);
        for (int k = 0; k < texel_size; ++k) values[k] += weight * from[k];
    }
};

// Pixels of all sheets, (sheets, height, width), and by how many pixels the slopes of one surface may differ.
struct TexelImage {
    const Texel* texels;
    int height, width;
    float tolerance;
};

// Looks up a sheet between pixels, at (x, y), among those that belong to the surface of one of them.
FEWRAYS_INLINE Found look_up(const TexelImage& image, std::uint32_t number, float x, float y) {
    const Texel* const texels = image.texels;
    const int height = image.height, width = image.width;
    const float tolerance = image.tolerance;
    const Texel& own = texels[number];
    const std::uint32_t size = static_cast<std::uint32_t>(height) * static_cast<std::uint32_t>(width);
    const Texel* const sheet = texels + number / size * size;
    const std::int32_t left = floor_to_int(x), top = floor_to_int(y);
    const float along = x - static_cast<float>(left), down = y - static_cast<float>(top);
    const float areas[4] = {(1 - down) * (1 - along), (1 - down) * along, down * (1 - along), down * along};
    Found found;
    if (left >= 0 && top >= 0 && left + 1 < width && top + 1 < height) {
        const Texel* const corner = sheet + std::ptrdiff_t{top} * width + left;
        const Texel* const taps[4] = {corner, corner + 1, corner + width, corner + width + 1};
        for (int tap = 0; tap < 4; ++tap) found.add(*taps[tap], own.slope, tolerance, areas[tap]);
    } else {
        for (int tap = 0; tap < 4; ++tap) {
            const std::ptrdiff_t i = mirrored(top + tap / 2, height);
            found.add(sheet[i * width + mirrored(left + tap % 2, width)], own.slope, tolerance, areas[tap]);
        }
    }
    if (!(found.total > 0)) found.add(own, own.slope, tolerance, 1);
    return found;
}

// Where a ray meets the focal plane, in pixels, and the lens.
struct RayPlace {
    float x, y, u, v;
};

constexpr int ray_channels = 5;  // of what a ray carries and of the sums: light and coverage

// Adds to `sum` what a ray sees that counts `passing`: from front to back, the nearest of each sheet's pixels that do
// not cover their place wholly, key_of_veil(0 … veils - 1), in front of the nearest that does, `opaque`.
template <typename Count, typename KeyOfVeil>
FEWRAYS_INLINE void add_ray(const TexelImage& image, const RayPlace& ray, std::uint64_t opaque, Count veils,
                            const KeyOfVeil& key_of_veil, float passing, float* sum) {
    const auto see = [&](std::uint64_t key) {
        const auto number = static_cast<std::uint32_t>(key);
        const float slope = image.texels[number].slope;
        return look_up(image, number, ray.x - slope * ray.u, ray.y - slope * ray.v);
    };
    std::uint64_t behind = 0;  // what has been composited is no farther
    float remaining = 1;
    for (Count pass = 0; pass < veils; ++pass) {
        std::uint64_t next = nothing_visible;
        for (Count veil = 0; veil < veils; ++veil) {
            const std::uint64_t key = key_of_veil(veil);
            if (key > behind) next = std::min(next, key);
        }
        if (next >> 32 >= opaque >> 32) break;
        const Found found = see(next);
        const float scale = remaining / found.total;
        for (int k = 0; k < ray_channels; ++k) sum[k] += passing * scale * found.values[k];
        remaining *= 1 - found.values[4] / found.total;
        behind = next;
    }
    if (opaque == nothing_visible) return;
    const Found found = see(opaque);
    const float share = passing * remaining, scale = share / found.values[4];
    for (int k = 0; k < 4; ++k) sum[k] += scale * found.values[k];
    sum[4] += share;
}

}  // namespace fewrays
