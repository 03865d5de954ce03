// The layered method, tile by tile in the memory that a block of threads shares.
//
// A block has a patch of a tile. Pass after pass, samples around the patch are added to bins, bins become maps, and
// these are composited behind what every part of the aperture has seen. Maps of layers that are blurred too much for a
// patch lie in the card's memory.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "block.h"
#include "layer_composite.h"
#include "layered_filter.h"
#include "layered_passes.h"
#include "layered_scatter.h"

namespace fewrays {

constexpr float min_opacity = 1e-3f;  // of a pixel, below which it is empty
constexpr float opaque = 1e-6f;       // of what shows through less, not even a light is seen

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
