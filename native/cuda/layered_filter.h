// The bins of a pass's layers, weighed and blurred in place along columns and rows: the maps that they become.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "block.h"
#include "layered_passes.h"
#include "layered_scatter.h"

namespace fewrays {

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

}  // namespace fewrays
