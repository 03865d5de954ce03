// The layered method, tile by tile in the memory that a block of threads shares.
//
// A block has a patch of a tile. Layer after layer, as many at once as there is room for: samples around the patch are
// added to bins, bins are weighed and blurred in place along columns and rows, and the maps that they have become are
// composited behind what every part of the aperture has seen. Where one layer's bins need more room than there is, the
// patch is done in strips of fewer rows. Maps of layers that are blurred too much for a patch lie in the card's memory.
//
// Sums are whole numbers of 32 bits, so that they do not depend on the order of threads. Radiance is counted in units
// of a power of two, such that a bin has room for a number of hits as bright as the brightest sample around the tile:
// for 2^room hits, a sample is rounded by at most 2^(room - 30) of that. Room is taken for 16 times the samples that a
// bin should hold. Should a bin get more hits than there is room for, which the number of hits tells, the strip is done
// again with twice the room.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/slope.h"
#include "atomics.h"
#include "block.h"
#include "device_samples.h"
#include "layer_composite.h"
#include "layered.h"

namespace fewrays {

constexpr float min_opacity = 1e-3f;  // of a pixel, below which it is empty
constexpr float opaque = 1e-6f;       // of what shows through less, not even a light is seen
constexpr int tile_threads = 480;     // as many as leave each the registers that compositing needs
constexpr int warp = 32;
constexpr int most_together = 8;  // layers in a pass
constexpr int share_steps = 256;  // in which hits are shared between the centres of two bins, where they are few
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

// Turns the sums of a bin into its weight, shares of hits and their radiance, and how well it is seen.
FEWRAYS_INLINE void weigh_bin(const TilesArguments& a, const PassLayer& layer, float unscale, SharedWord* bin) {
    const int plane = layer.plane();
    const float hits = static_cast<float>(bin[plane].whole) / static_cast<float>(layer.steps * layer.steps);
    const float samples = hits + static_cast<float>(bin[0].whole), expected = layer.samples_each(a.spp);
    const bool by_place = layer.level >= a.finest_by_place;
    const float weight = by_place ? std::min(samples / (a.full_weight * expected), 1.0f) : samples;
    const float share = by_place ? weight / std::max(samples, min_weight) : 1.0f;
    bin[0].real = weight;
    bin[plane].real = share * hits;
    for (int c = 2; c < hit_planes; ++c)
        bin[c * plane].real = share * (static_cast<float>(static_cast<std::int32_t>(bin[c * plane].whole)) * unscale);
    if (!layer.near) bin[hit_planes * plane].real = std::min(samples / (a.seen * expected), 1.0f);
}

// Blurs a line of bins, `stride` words apart, in place: what a cell becomes is written where nothing behind it reads.
// Four cells at a time, of `bins` bins each; a bin is read once for all of them.
template <int bins>
FEWRAYS_INLINE void blur_cells(SharedWord* line, int stride, int cells, const PassLayer& layer) {
    constexpr int at_once = 4;
    for (int cell = 0; cell < cells; cell += at_once) {
        const int count = std::min(at_once, cells - cell);
        const SharedWord* const from = line + (layer.first_tap + cell * bins) * stride;
        float sums[at_once] = {}, taps[(at_once - 1) * bins + 1] = {};
        for (int j = 0; j < (count - 1) * bins + layer.taps; ++j) {
            for (int k = (at_once - 1) * bins; k > 0; --k) taps[k] = taps[k - 1];
            taps[0] = j < layer.taps ? layer.taps_of[j] : 0.0f;
            const float value = from[j * stride].real;
            for (int k = 0; k < at_once; ++k) sums[k] += taps[k * bins] * value;
        }
        for (int k = 0; k < count; ++k) line[(cell + k) * stride].real = sums[k];
    }
}

FEWRAYS_INLINE void blur_line(SharedWord* line, int stride, int cells, const PassLayer& layer) {
    if (layer.bins == 1)
        blur_cells<1>(line, stride, cells, layer);
    else if (layer.bins == 2)
        blur_cells<2>(line, stride, cells, layer);
    else
        blur_cells<4>(line, stride, cells, layer);
}

// Turns blurred sums of a cell into how well it is known, opacity, and radiance times opacity.
FEWRAYS_INLINE void divide_cell(const TilesArguments& a, const PassLayer& layer, SharedWord* cell) {
    const int plane = layer.plane();
    const float weight = cell[0].real, reciprocal = weight > min_weight ? 1.0f / weight : 0.0f;
    for (int c = 1; c < hit_planes; ++c) cell[c * plane].real *= reciprocal;
    if (layer.near) return;
    // Samples miss some bins by chance, so that this share is what is seen where nothing is hidden.
    const float by_chance = 1.0f - std::exp(-layer.samples_each(a.spp));
    cell[0].real = std::min(cell[hit_planes * plane].real / by_chance, 1.0f);
}

// Calls work(layer, i) for the things that a pass's layers have, count(layer) each, shared out among threads.
template <typename Count, typename Work>
inline void each_thing(const Block& block, const TilesShared& shared, Count&& count, Work&& work) {
    block.each([&](int thread) {
        int i = thread;
        for (int k = 0; k < shared.count; ++k) {
            const PassLayer& layer = shared.layers[k];
            const int things = layer.whole ? 0 : count(layer);
            for (; i < things; i += tile_threads) work(layer, i);
            i -= things;
        }
    });
}

// Turns the bins of a pass's layers into maps.
inline void filter(const TilesArguments& a, const Patch& strip, const Block& block, SharedWord* words,
                   const TilesShared& shared) {
    each_thing(
        block, shared, [](const PassLayer& layer) { return layer.plane(); },
        [&](const PassLayer& layer, int i) {
            weigh_bin(a, layer, 1.0f / color_scale(layer, a.brightest[strip.tile]), words + layer.offset + i);
        });
    each_thing(
        block, shared, [](const PassLayer& layer) { return layer.planes * layer.bin_columns; },
        [&](const PassLayer& layer, int i) {
            SharedWord* const plane = words + layer.offset + i / layer.bin_columns * layer.plane();
            blur_line(plane + i % layer.bin_columns, layer.stride, layer.rows, layer);
        });
    each_thing(
        block, shared, [](const PassLayer& layer) { return layer.planes * layer.rows; },
        [&](const PassLayer& layer, int i) {
            SharedWord* const plane = words + layer.offset + i / layer.rows * layer.plane();
            blur_line(plane + i % layer.rows * layer.stride, 1, layer.columns, layer);
        });
    each_thing(
        block, shared, [](const PassLayer& layer) { return layer.rows * layer.columns; },
        [&](const PassLayer& layer, int i) {
            divide_cell(a, layer, words + layer.offset + i / layer.columns * layer.stride + i % layer.columns);
        });
}

FEWRAYS_INLINE MapView view_of(const TilesArguments& a, const PassLayer& layer, const Patch& strip,
                               const SharedWord* words) {
    if (!layer.whole)
        return {&words[layer.offset].real,
                layer.plane(),
                layer.stride,
                layer.rows,
                layer.columns,
                layer.size,
                (layer.above - layer.margin) / layer.bins * layer.size,
                (layer.before - layer.margin) / layer.bins * layer.size};
    const WholeMap& map = a.whole[layer.index];
    return {a.maps + map.first,     map.rows * map.columns, map.columns, map.rows, map.columns, layer.size,
            map.border + strip.top, map.border + strip.left};
}

// Composites a pass's layers behind what a pixel has seen through each part of the aperture. `state` holds that between
// passes, `pixels` apart.
FEWRAYS_INLINE void composite_pixel(const TilesArguments& a, const Patch& strip, int row, int column, bool first,
                                    float* state, int pixels, const SharedWord* words, const TilesShared& shared) {
    const std::int64_t pixel = static_cast<std::int64_t>(strip.top + row) * a.width + strip.left + column;
    float sums[4] = {};
    if (!first)
        for (int c = 0; c < 4; ++c) sums[c] = state[c * pixels];
    for (int part = 0; part < a.part_count; ++part) {
        float* const own = state + (4 + 3 * part) * pixels;
        const float* const place = a.parts + 3 * part;
        Visibility behind{1.0f, 0.0f, 0.0f};
        if (!first) behind = {own[0], own[pixels], own[2 * pixels]};
        for (int k = 0; k < shared.count && behind.mean >= opaque; ++k) {
            const PassLayer& layer = shared.layers[k];
            if (!layer.whole && layer.rows == 0) continue;
            const MapView map = view_of(a, layer, strip, words);
            float shown[4];
            if (layer.near) {
                if (!composite_near(map, row, column, behind, shown)) continue;
            } else {
                MapCell cell;
                if (!read_map(map, row, column, -layer.slope * place[0], -layer.slope * place[1], cell)) continue;
                composite(cell, -layer.slope * a.part_sigma, behind, shown);
            }
            for (int c = 0; c < 4; ++c) sums[c] += place[2] * shown[c];
            if (a.contributions) {
                float* const to = a.contributions + 4 * (pixel * a.layers + layer.index);
                for (int c = 0; c < 4; ++c) to[(c + 3) % 4] += place[2] * shown[c];
            }
        }
        if (shared.last) continue;
        own[0] = behind.mean;
        own[pixels] = behind.along_u;
        own[2 * pixels] = behind.along_v;
    }
    if (!shared.last) {
        for (int c = 0; c < 4; ++c) state[c * pixels] = sums[c];
        return;
    }
    // What stays transparent is missing data, not a dark background.
    const float scale = sums[0] > min_opacity ? 1.0f / sums[0] : 1.0f;
    for (int c = 0; c < 3; ++c) a.image[3 * pixel + c] = scale * sums[1 + c];
    if (a.contributions)
        for (int i = 0; i < 4 * a.layers; ++i) a.contributions[4 * pixel * a.layers + i] *= scale;
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

inline void reconstruct_patch(const TilesArguments& a, const Patch& patch, const Block& block, SharedWord* words,
                              TilesShared& shared) {
    const TileLayer* const found = a.tile_layers + static_cast<std::int64_t>(patch.tile) * a.layers;
    const int pixels = a.patch * a.patch;
    float* const behind = a.behind + static_cast<std::int64_t>(block.x()) * (3 * a.part_count + 4) * pixels;
    find_hits(a, patch, block, shared);
    bool last = false;
    for (bool first = true; !last; first = false) {
        block.each([&](int thread) {
            if (thread == 0) plan_pass(a, patch, shared);
        });
        block.each([&](int thread) {
            // Taps on both sides of a cell's centre, of which one in a bin's own centre is there once.
            for (int i = thread; i < shared.count * 2 * most_taps; i += tile_threads) {
                PassLayer& layer = shared.layers[i / (2 * most_taps)];
                const int tap = i % (2 * most_taps), radius = shared.radii[layer.index];
                if (layer.whole || tap >= layer.taps) continue;
                const int beside = tap < radius ? radius - 1 - tap : tap - (layer.taps - radius);
                layer.taps_of[tap] = found[layer.index].taps[beside];
            }
        });
        for (int row = 0; row < patch.rows; row += shared.rows) {
            const Patch strip{patch.tile, patch.top + row, patch.left, std::min(shared.rows, patch.rows - row),
                              patch.columns};
            block.each([&](int thread) {
                if (thread < shared.count) lay_out(a, shared, patch, row, strip.rows, shared.layers[thread]);
            });
            if (shared.words > 0) {
                scatter(a, strip, block, words, shared);
                filter(a, strip, block, words, shared);
            }
            block.each([&](int thread) {
                for (int i = thread; i < strip.rows * strip.columns; i += tile_threads) {
                    const int i_row = i / strip.columns, column = i % strip.columns;
                    composite_pixel(a, strip, i_row, column, first, behind + (row + i_row) * a.patch + column, pixels,
                                    words, shared);
                }
            });
        }
        last = shared.last;
        block.each([](int) {});  // all have read it
    }
}

// Each block of threads has some patches, one after the other.
inline void run_layered_tiles(const TilesArguments& a, const Block& block, TilesShared& shared, SharedWord* words) {
    const int beside = (a.tile + a.patch - 1) / a.patch;  // patches in a row of a tile
    const int tile_columns = (a.width + a.tile - 1) / a.tile, tile_rows = (a.height + a.tile - 1) / a.tile;
    for (int i = block.x(); i < tile_rows * tile_columns * beside * beside; i += a.workers) {
        const int tile = i / (beside * beside), of_tile = i % (beside * beside);
        const int row = of_tile / beside * a.patch, column = of_tile % beside * a.patch;
        const int top = tile / tile_columns * a.tile + row, left = tile % tile_columns * a.tile + column;
        const int rows = std::min(std::min(a.patch, a.tile - row), a.height - top);
        const int columns = std::min(std::min(a.patch, a.tile - column), a.width - left);
        if (rows > 0 && columns > 0) reconstruct_patch(a, {tile, top, left, rows, columns}, block, words, shared);
    }
}

}  // namespace fewrays

FEWRAYS_KERNEL_WITH_WORDS(layered_tiles, fewrays::tile_threads, fewrays::TilesArguments, fewrays::TilesShared)
