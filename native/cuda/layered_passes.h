// What a patch of a tile does in one go: which layers, and how their bins lie in the memory that a block of threads
// shares. Layer after layer, as many at once as there is room for. Where one layer's bins need more room than there is,
// the patch is done in strips of fewer rows.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "atomics.h"
#include "block.h"
#include "device_samples.h"
#include "layered.h"

namespace fewrays {

constexpr int tile_threads = 480;  // as many as leave each the registers that compositing needs
constexpr int most_together = 8;   // layers in a pass
constexpr int share_steps = 256;   // in which hits are shared between the centres of two bins, where they are few
constexpr int least_room = 6, color_bits = 30;
constexpr int own_shared_bytes = 12 << 10;  // that the host leaves to TilesShared
constexpr int far_off = 1 << 20;            // pixels, farther than any hit of a layer that a patch has room for
constexpr int block_bits = 24;  // of the number of a block of pixels, below bits for the layers that it matters to
constexpr std::uint32_t block_mask = (1u << block_bits) - 1;
static_assert(most_together <= 32 - block_bits);
constexpr int hit_planes = 5, bin_planes = 6;  // holes, hits and their radiance; and how well a bin is seen

// Where in the card's memory the map of a layer is that is not made patch by patch.
struct WholeMap {
    std::int64_t first;           // of its values, (map_channels, rows, columns)
    std::int32_t rows, columns;   // no rows: the layer is made patch by patch
    std::int32_t border, unused;  // pixels from its corner to the image's
};

struct TilesArguments {
    DeviceSamples samples;
    Survey survey;
    const std::int16_t* layer_of;  // (samples)
    const std::uint32_t* counts;   // (blocks, layers): samples
    const std::int32_t* levels;    // (layers)
    const float* reaches;          // (layers): largest |slope| of a sample
    const TileLayer* tile_layers;  // (tiles, layers)
    const float* brightest;        // (tiles)
    const WholeMap* whole;         // (layers)
    const float* maps;
    const float* parts;    // (part_count, 3): centre (u, v) and weight
    float* behind;         // (workers, 3 part_count + 4, patch, patch): what the parts see, between passes
    float* image;          // (height, width, 3)
    float* contributions;  // (height, width, layers, 4): radiance and opacity of each, zeros at first; or null
    std::int32_t layers, part_count, height, width, spp;
    std::int32_t tile, patch, workers, words, finest_by_place;
    float part_sigma, farthest_part;  // in lens units
    float full_weight, seen;          // shares of its samples from which on a bin weighs 1, and is certainly seen
};

// A layer of a pass, and its bins: `planes` planes of (bin_rows, stride), around what a strip may see of its hits.
struct PassLayer {
    std::int32_t index, size;  // of a cell, in pixels
    float slope, per_pixel;    // bins along a pixel
    std::int32_t bin_rows, bin_columns, stride, offset;
    std::int32_t above, before;             // bins from the first to the strip's first pixel, along columns and rows
    float left, right, top, bottom;         // where samples may lie that fall into the bins
    std::int32_t steps, room;               // of shares; and hits that its bins have room for, as a power of two
    std::int32_t level, bins, near, whole;  // bins along the side of a cell; whether its map is of the whole image
    std::int32_t around, margin;            // cells around the strip's pixels, bins around those
    std::int32_t rows, columns, planes;
    std::int32_t taps, first_tap;  // of the blur, and the first bin that those of the first cell read
    float taps_of[2 * most_taps];

    FEWRAYS_INLINE int plane() const { return bin_rows * stride; }
    FEWRAYS_INLINE float samples_each(int spp) const {
        const float side = static_cast<float>(size) / static_cast<float>(bins);
        return static_cast<float>(spp) * side * side;
    }
};

// A rectangle of pixels.
struct Patch {
    std::int32_t tile, top, left, rows, columns;
};

// How far to each side of the patch's corner the lens centre may see hits of a layer, in pixels. `far_off` is added, so
// that larger numbers are farther and none is below 1; all are 0 where there are no hits.
struct HitBox {
    std::uint32_t to_left, right, to_top, bottom;
};

struct TilesShared {
    float slopes[most_layers];
    std::int32_t radii[most_layers];  // of blurs; 0 where the layer does not matter to the tile
    float around[most_layers];        // pixels around the patch in which samples of the layer may matter to it
    HitBox hits[most_layers];
    std::uint32_t farthest_around;  // the largest, as a float's bits
    PassLayer layers[most_together];
    std::int32_t count, words;                              // of the pass: layers, and the words that bins take
    std::int32_t next, last;                                // the layer behind it, and whether there is none
    std::int32_t rows;                                      // of its strips
    std::uint32_t overflown, listed, blocks[tile_threads];  // a bit for each layer; blocks of pixels
};

static_assert(sizeof(TilesShared) <= own_shared_bytes);

FEWRAYS_INLINE PassLayer pass_layer(const TilesArguments& a, const TilesShared& shared, int index) {
    PassLayer layer{};
    const int level = a.levels[index], radius = shared.radii[index];
    layer.index = index;
    layer.level = level;
    layer.slope = shared.slopes[index];
    layer.near = level < 0;
    layer.size = level > 0 ? 1 << level : 1;
    layer.bins = level < 0 ? 1 << -level : 1;
    layer.whole = a.whole[index].rows > 0;
    // Pixels that some part of the aperture sees in the patch, and what splines read on all sides of them.
    const int border = layer.near ? 0 : static_cast<int>(std::ceil(a.farthest_part * std::fabs(layer.slope))) + 1;
    layer.around = (border + (layer.size > 1 ? 2 * layer.size - 1 : 0)) / layer.size;
    layer.taps = layer.near ? 2 * radius : 2 * radius - 1;
    layer.margin = std::max(radius - 1 - (layer.bins - 1) / 2, 0);
    layer.first_tap = layer.margin + (layer.bins - 1) / 2 - (radius - 1);
    layer.planes = layer.near ? hit_planes : bin_planes;
    layer.per_pixel = static_cast<float>(layer.bins) / static_cast<float>(layer.size);
    return layer;
}

// Pixels around a layer's cells in which samples may lie that fall into its bins. One cell more, for hits that are
// shared and holes that are scattered.
FEWRAYS_INLINE float catchment(const TilesArguments& a, const PassLayer& layer) {
    const float cells = 1.0f + static_cast<float>(layer.margin) / static_cast<float>(layer.bins);
    return cells * static_cast<float>(layer.size) + a.reaches[layer.index];
}

// Cells along one axis.
struct CellRange {
    int first, count;
};

// The cells around `pixels` pixels that hits from pixel `from` to pixel `to` are spread to.
FEWRAYS_INLINE CellRange cells_seen(const PassLayer& layer, int from, int to, int pixels) {
    const int all = (pixels + layer.size - 1) / layer.size + 2 * layer.around, before = layer.around * layer.size;
    const int radius = layer.margin / layer.bins + 2;
    const int beyond = (radius + (layer.size > 1 ? 4 : 2)) * layer.size;
    const int first = std::min(std::max(from - beyond + before, 0) / layer.size, all);
    const int end = std::min((std::max(to + beyond + before, 0) + layer.size - 1) / layer.size, all);
    return {first, std::max(end - first, 0)};
}

// Lays out a layer's bins around `rows` rows of a patch, from number `row` on.
FEWRAYS_INLINE void lay_out(const TilesArguments& a, const TilesShared& shared, const Patch& patch, int row, int rows,
                            PassLayer& layer) {
    const HitBox& hits = shared.hits[layer.index];
    const int left = far_off - static_cast<int>(hits.to_left), top = far_off - static_cast<int>(hits.to_top);
    const CellRange down = cells_seen(layer, top - row, static_cast<int>(hits.bottom) - far_off - row, rows);
    const CellRange along = cells_seen(layer, left, static_cast<int>(hits.right) - far_off, patch.columns);
    const bool none = layer.whole || down.count == 0 || along.count == 0;
    layer.rows = none ? 0 : down.count;
    layer.columns = none ? 0 : along.count;
    layer.bin_rows = none ? 0 : layer.rows * layer.bins + 2 * layer.margin;
    layer.bin_columns = none ? 0 : layer.columns * layer.bins + 2 * layer.margin;
    layer.stride = layer.bin_columns | 1;  // odd: rows begin in different banks
    layer.above = (layer.around - down.first) * layer.bins + layer.margin;
    layer.before = (layer.around - along.first) * layer.bins + layer.margin;
    const float beyond = catchment(a, layer);
    const auto pixel = [&](int corner, int cell) {
        return static_cast<float>(corner + (cell - layer.around) * layer.size);
    };
    layer.left = none ? INFINITY : pixel(patch.left, along.first) - beyond;
    layer.right = none ? -INFINITY : pixel(patch.left, along.first + along.count) + beyond;
    layer.top = none ? INFINITY : pixel(patch.top + row, down.first) - beyond;
    layer.bottom = none ? -INFINITY : pixel(patch.top + row, down.first + down.count) + beyond;
}

// Words that a layer's bins take around any strip of so many rows.
FEWRAYS_INLINE int words_for(const TilesArguments& a, const TilesShared& shared, const Patch& patch, int rows,
                             PassLayer& layer) {
    lay_out(a, shared, patch, 0, patch.rows, layer);
    const int of_strip = (rows + layer.size - 1) / layer.size + 2 * layer.around;
    const int bin_rows = std::min(of_strip, layer.rows) * layer.bins + 2 * layer.margin;
    return layer.rows > 0 ? layer.planes * bin_rows * layer.stride : 0;
}

// How many shares a hit is counted in: so few that no bin's sum of them outgrows 32 bits.
FEWRAYS_INLINE int steps_for(const PassLayer& layer, std::uint64_t count) {
    int steps = layer.size > 1 ? share_steps : 1;
    while (steps > 1 && count * steps * steps >> 32) steps /= 2;
    return steps;
}

FEWRAYS_INLINE int room_for(float samples) {
    int room = least_room;
    while (static_cast<float>(std::uint32_t{1} << room) < 16.0f * samples && room < color_bits) ++room;
    return room;
}

// Takes the layers of the next pass, front to back.
FEWRAYS_INLINE void plan_pass(const TilesArguments& a, const Patch& patch, TilesShared& shared) {
    int words = 0, index = shared.next;
    shared.count = 0;
    shared.rows = a.patch;
    for (; index < a.layers && shared.count < most_together; ++index) {
        if (shared.radii[index] == 0) continue;
        PassLayer layer = pass_layer(a, shared, index);
        int rows = a.patch, own = words_for(a, shared, patch, rows, layer);
        if (own == 0 && !layer.whole) continue;
        while (own > a.words) own = words_for(a, shared, patch, rows /= 2, layer);
        if (!layer.whole) {
            if (words > 0 && (rows != shared.rows || words + own > a.words)) break;
            const TileLayer& found = a.tile_layers[static_cast<std::int64_t>(patch.tile) * a.layers + index];
            layer.steps = steps_for(layer, found.count);
            layer.room = room_for(layer.samples_each(a.spp));
            layer.offset = words;
            words += own;
            shared.rows = rows;
        }
        shared.layers[shared.count++] = layer;
    }
    shared.words = words;
    shared.next = index;
    shared.last = index >= a.layers;
}

// Adds a block of pixels to where a layer's hits are.
FEWRAYS_INLINE void add_hits_of(const SampleBox& box, const Patch& patch, float reach, HitBox& hits) {
    const auto pixels = [](float at) {
        return static_cast<std::uint32_t>(std::fmin(std::fmax(at, 1.0f), 2.0f * far_off));
    };
    const auto left = static_cast<float>(patch.left), top = static_cast<float>(patch.top);
    atomic_most(&hits.to_left, pixels(far_off - std::floor(box.x_min - reach - left)));
    atomic_most(&hits.right, pixels(far_off + std::ceil(box.x_max + reach - left)));
    atomic_most(&hits.to_top, pixels(far_off - std::floor(box.y_min - reach - top)));
    atomic_most(&hits.bottom, pixels(far_off + std::ceil(box.y_max + reach - top)));
}

// Finds out where the patch may see hits of the tile's layers.
inline void find_hits(const TilesArguments& a, const Patch& patch, const Block& block, TilesShared& shared) {
    const TileLayer* const found = a.tile_layers + static_cast<std::int64_t>(patch.tile) * a.layers;
    block.each([&](int thread) {
        if (thread == 0) shared.next = shared.farthest_around = 0;
    });
    block.each([&](int thread) {
        for (int i = thread; i < a.layers; i += tile_threads) {
            shared.slopes[i] = found[i].slope;
            shared.radii[i] = found[i].count > 0 ? found[i].radius : 0;
            shared.hits[i] = {0, 0, 0, 0};
            const PassLayer layer = pass_layer(a, shared, i);
            const float cells = static_cast<float>(layer.around * layer.size);
            shared.around[i] = found[i].count > 0 && !layer.whole ? cells + catchment(a, layer) : 0.0f;
            atomic_most(&shared.farthest_around, std::bit_cast<std::uint32_t>(shared.around[i]));
        }
    });
    const auto left = static_cast<float>(patch.left), right = static_cast<float>(patch.left + patch.columns);
    const auto top = static_cast<float>(patch.top), bottom = static_cast<float>(patch.top + patch.rows);
    const float most = std::bit_cast<float>(shared.farthest_around);
    const BlockRange range = blocks_around(a.survey, left - most, right + most, top - most, bottom + most);
    block.each([&](int thread) {
        for (std::int64_t i = thread; i < static_cast<std::int64_t>(range.count()) * a.layers; i += tile_threads) {
            const auto layer = static_cast<int>(i % a.layers);
            const std::int64_t at = range.block(a.survey, static_cast<int>(i / a.layers));
            const float around = shared.around[layer];
            if (around <= 0.0f || a.counts[at * a.layers + layer] == 0) continue;
            const SampleBox box = a.survey.boxes[at];
            if (box.meets(left - around, right + around, top - around, bottom + around))
                add_hits_of(box, patch, a.reaches[layer], shared.hits[layer]);
        }
    });
}

}  // namespace fewrays
