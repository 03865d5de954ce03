// The samples around a strip of a patch, added to the bins of a pass's layers.
//
// Sums are whole numbers of 32 bits, so that they do not depend on the order of threads. Radiance is counted in units
// of a power of two, such that a bin has room for a number of hits as bright as the brightest sample around the tile:
// for 2^room hits, a sample is rounded by at most 2^(room - 30) of that. Room is taken for 16 times the samples that a
// bin should hold. Should a bin get more hits than there is room for, which the number of hits tells, the strip is done
// again with twice the room.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "../math/slope.h"
#include "atomics.h"
#include "block.h"
#include "layered_passes.h"

namespace fewrays {

constexpr int warp = 32;

// 2^exponent.
FEWRAYS_INLINE float power_of_two(int exponent) {
    return std::bit_cast<float>(static_cast<std::uint32_t>(std::clamp(exponent, -126, 126) + 127) << 23);
}

// The scale of radiance for which a bin has room.
FEWRAYS_INLINE float color_scale(const PassLayer& layer, float brightest) {
    const int above = static_cast<int>(std::bit_cast<std::uint32_t>(brightest) >> 23) - 126;  // 2^above is more
    return power_of_two(color_bits - layer.room - above);
}

// A number as a whole number of 32 bits. Negative ones wrap around, as sums of them do.
FEWRAYS_INLINE std::uint32_t as_whole(float value) {
    return static_cast<std::uint32_t>(static_cast<std::int32_t>(value < 0.0f ? value - 0.5f : value + 0.5f));
}

// Adds a share of a hit to a bin.
FEWRAYS_INLINE void add_hit(const PassLayer& layer, int row, int column, std::uint32_t share, const float* color,
                            float scale, SharedWord* words, TilesShared& shared, int k) {
    if (row < 0 || row >= layer.bin_rows || column < 0 || column >= layer.bin_columns) return;
    SharedWord* const bin = words + layer.offset + row * layer.stride + column;
    const int whole = layer.steps * layer.steps, plane = layer.plane();
    const std::uint32_t before = atomic_add(&bin[plane].whole, share);
    if (std::uint64_t{before} + share > std::uint64_t(whole) << layer.room)
        atomic_set(&shared.overflown, std::uint32_t{1} << k);
    const float part = static_cast<float>(share) / static_cast<float>(whole) * scale;
    for (int c = 0; c < 3; ++c) atomic_increase(&bin[(2 + c) * plane].whole, as_whole(part * color[c]));
}

// What is read of every sample.
struct Ray {
    std::int32_t layer;  // -1 for none
    float x, y, u, v;    // from the strip's corner, and on the lens
};

FEWRAYS_INLINE Ray load_ray(const TilesArguments& a, const Patch& strip, std::int64_t i) {
    return {a.layer_of[i], a.samples.xy[2 * i] - static_cast<float>(strip.left),
            a.samples.xy[2 * i + 1] - static_cast<float>(strip.top), a.samples.uv[2 * i], a.samples.uv[2 * i + 1]};
}

// Where a sample of some slope lies in a layer's bins, `shift` bins from its place.
FEWRAYS_INLINE bool find_bin(const PassLayer& layer, float x, float y, float shift, float& in_x, float& in_y) {
    in_x = x * layer.per_pixel + (static_cast<float>(layer.before) + shift);
    in_y = y * layer.per_pixel + (static_cast<float>(layer.above) + shift);
    return in_x >= -1.0f && in_y >= -1.0f && in_x < static_cast<float>(layer.bin_columns) &&
           in_y < static_cast<float>(layer.bin_rows);
}

FEWRAYS_INLINE void add_hole(const PassLayer& layer, const Ray& ray, SharedWord* words) {
    float x = ray.x - layer.slope * ray.u, y = ray.y - layer.slope * ray.v, in_x, in_y;
    if (layer.size > 1) {
        x += static_cast<float>(layer.size) * scramble(ray.u);
        y += static_cast<float>(layer.size) * scramble(ray.v);
    }
    if (!find_bin(layer, x, y, 0.0f, in_x, in_y) || in_x < 0.0f || in_y < 0.0f) return;
    const int bin = static_cast<int>(in_y) * layer.stride + static_cast<int>(in_x);
    atomic_increase(&words[layer.offset + bin].whole, std::uint32_t{1});
}

// Adds a hit to the bin that it lies in, or a share of it to each of the four whose centres are nearest.
FEWRAYS_INLINE void add_own(const TilesArguments& a, int tile, int k, const Ray& ray, std::int64_t i, SharedWord* words,
                            TilesShared& shared) {
    const PassLayer& layer = shared.layers[k];
    const bool shares = layer.size > 1;
    const float c = slope(a.samples.depth[i], a.samples.c0, a.samples.c1);
    float in_x, in_y;
    if (!find_bin(layer, ray.x - c * ray.u, ray.y - c * ray.v, shares ? -0.5f : 0.0f, in_x, in_y)) return;
    const float left = std::floor(in_x), top = std::floor(in_y);
    const auto steps = static_cast<float>(layer.steps);
    const auto right = shares ? static_cast<std::uint32_t>(share_of(in_x - left) * steps + 0.5f) : 0u;
    const auto down = shares ? static_cast<std::uint32_t>(share_of(in_y - top) * steps + 0.5f) : 0u;
    const float* const color = a.samples.color + 3 * i;
    const float scale = color_scale(layer, a.brightest[tile]);
    for (int corner = 0; corner < (shares ? 4 : 1); ++corner)
        add_hit(layer, static_cast<int>(top) + corner / 2, static_cast<int>(left) + corner % 2,
                (corner % 2 ? right : layer.steps - right) * (corner / 2 ? down : layer.steps - down), color, scale,
                words, shared, k);
}

// Adds the samples of all blocks of pixels in the list, a warp for each block: each to its own layer as a hit, and to
// those in front of it as a hole. Several are read before the first is added: a multiprocessor has too few warps here
// for others to hide how long memory takes.
FEWRAYS_INLINE void add_listed(const TilesArguments& a, const Patch& strip, int thread, SharedWord* words,
                               TilesShared& shared) {
    constexpr int at_once = 4;
    for (std::uint32_t k = thread / warp; k < shared.listed; k += tile_threads / warp) {
        const int block = static_cast<int>(shared.blocks[k] & block_mask), side = a.survey.side;
        const std::uint32_t layers = shared.blocks[k] >> block_bits;
        const int row = block / a.survey.columns * side, column = block % a.survey.columns * side;
        const int in_row = std::min(side, a.width - column) * a.spp, count = std::min(side, a.height - row) * in_row;
        const std::int64_t first = (static_cast<std::int64_t>(row) * a.width + column) * a.spp;
        const float rows_each = 1.0f / static_cast<float>(in_row);
        for (int from = thread % warp; from < count; from += at_once * warp) {
            Ray rays[at_once];
            std::int32_t numbers[at_once], own[at_once];
            FEWRAYS_UNROLL
            for (int j = 0; j < at_once; ++j) {
                const int i = std::min(from + j * warp, count - 1);
                // A division, exact for numbers below 2^20 and cheaper than one of whole numbers.
                const auto down = static_cast<int>((static_cast<float>(i) + 0.5f) * rows_each);
                numbers[j] = i + down * (a.width * a.spp - in_row);
                rays[j] = load_ray(a, strip, first + numbers[j]);
                if (from + j * warp >= count) rays[j].layer = -1;
                own[j] = -1;
            }
            for (int of = 0; of < shared.count; ++of) {
                if (!(layers >> of & 1)) continue;
                const PassLayer& layer = shared.layers[of];
                FEWRAYS_UNROLL
                for (int j = 0; j < at_once; ++j) {
                    if (rays[j].layer > layer.index) add_hole(layer, rays[j], words);
                    if (rays[j].layer == layer.index) own[j] = of;
                }
            }
            FEWRAYS_UNROLL
            for (int j = 0; j < at_once; ++j)
                if (own[j] >= 0) add_own(a, strip.tile, own[j], rays[j], first + numbers[j], words, shared);
        }
    }
}

// Which layers' bins the samples of a block may fall into, a bit for each.
FEWRAYS_INLINE std::uint32_t layers_of_block(const SampleBox& box, const TilesShared& shared) {
    std::uint32_t layers = 0;
    for (int k = 0; k < shared.count; ++k) {
        const PassLayer& layer = shared.layers[k];
        if (box.deepest >= layer.index && box.meets(layer.left, layer.right, layer.top, layer.bottom))
            layers |= std::uint32_t{1} << k;
    }
    return layers;
}

// Adds the samples around a strip to its bins.
inline void scatter_once(const TilesArguments& a, const Patch& strip, const Block& block, SharedWord* words,
                         TilesShared& shared) {
    block.each([&](int thread) {
        if (thread == 0) shared.listed = shared.overflown = 0;
        for (int i = thread; i < shared.words; i += tile_threads) words[i].whole = 0;
    });
    float left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY;
    for (int k = 0; k < shared.count; ++k) {
        const PassLayer& layer = shared.layers[k];
        left = std::min(left, layer.left);
        right = std::max(right, layer.right);
        top = std::min(top, layer.top);
        bottom = std::max(bottom, layer.bottom);
    }
    if (left > right) return;
    const BlockRange range = blocks_around(a.survey, left, right, top, bottom);
    for (int first = 0; first < range.count(); first += tile_threads) {
        block.each([&](int thread) {
            if (first + thread >= range.count()) return;
            const int at = range.block(a.survey, first + thread);
            const std::uint32_t layers = layers_of_block(a.survey.boxes[at], shared);
            if (layers)
                shared.blocks[atomic_take(&shared.listed)] = static_cast<std::uint32_t>(at) | layers << block_bits;
        });
        block.each([&](int thread) { add_listed(a, strip, thread, words, shared); });
        block.each([&](int thread) {
            if (thread == 0) shared.listed = 0;
        });
    }
}

// The same, with enough room.
inline void scatter(const TilesArguments& a, const Patch& strip, const Block& block, SharedWord* words,
                    TilesShared& shared) {
    for (;;) {
        scatter_once(a, strip, block, words, shared);
        if (shared.overflown == 0) break;
        block.each([&](int thread) {
            if (thread < shared.count && (shared.overflown >> thread & 1)) ++shared.layers[thread].room;
        });
    }
}

}  // namespace fewrays
