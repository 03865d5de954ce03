// Which layers the layered method has where: of every sample, of every block of pixels, of every tile.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/layer_blur.h"
#include "../math/slope.h"
#include "atomics.h"
#include "block.h"
#include "device_samples.h"
#include "layered.h"

namespace fewrays {

constexpr float max_slope = 32768.0f;  // pixels, beyond which slopes count as this
constexpr int survey_threads = 256, box_groups = 32;
constexpr int tallies_each = 4;  // of a layer, taken in turn: else all threads would wait for the same one

struct SurveyArguments {
    DeviceSamples samples;
    const float* boundaries;  // (layers - 1): slopes where one layer ends and the next begins
    const float* reaches;     // (layers): the largest slope in size
    std::int16_t* layer_of;   // (samples): -1 for those too far outside the image
    SampleBox* boxes;         // (blocks)
    std::uint32_t* counts;    // (blocks, layers): samples
    std::int32_t* slopes;     // (blocks, layers): sums of their slopes, as shares of the layer's reach in `slope_unit`
    std::uint32_t* farthest;  // see Survey
    std::int32_t layers, height, width, spp, side;
    float margin;  // pixels around the image beyond which no sample can reach it
    float slope_unit;
};

struct SurveyShared {
    SampleBox boxes[survey_threads];
    std::uint32_t counts[most_layers * tallies_each];
    std::uint32_t slopes[most_layers * tallies_each];
    std::uint32_t farthest, deepest;
};

FEWRAYS_INLINE SampleBox no_samples() { return {INFINITY, -INFINITY, INFINITY, -INFINITY, 0.0f, -1}; }

FEWRAYS_INLINE SampleBox joined(const SampleBox& a, const SampleBox& b) {
    return {std::min(a.x_min, b.x_min), std::max(a.x_max, b.x_max),         std::min(a.y_min, b.y_min),
            std::max(a.y_max, b.y_max), std::max(a.brightest, b.brightest), std::max(a.deepest, b.deepest)};
}

// The layer of a slope: the number of boundaries that are not above it.
FEWRAYS_INLINE int layer_of_slope(const SurveyArguments& a, float c) {
    int low = 0, high = a.layers - 1;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (a.boundaries[middle] <= c)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

// Tallies a sample and returns the box around it.
FEWRAYS_INLINE SampleBox survey_sample(const SurveyArguments& a, std::int64_t i, int turn, SurveyShared& shared) {
    const float x = a.samples.xy[2 * i], y = a.samples.xy[2 * i + 1];
    a.layer_of[i] = -1;
    if (!(x >= -a.margin && y >= -a.margin && x <= static_cast<float>(a.width) + a.margin &&
          y <= static_cast<float>(a.height) + a.margin))
        return no_samples();
    const float c = slope(a.samples.depth[i], a.samples.c0, a.samples.c1);
    const int layer = layer_of_slope(a, c), tally = layer * tallies_each + turn % tallies_each;
    a.layer_of[i] = static_cast<std::int16_t>(layer);
    const float reach = a.reaches[layer];
    const float share = reach > 0.0f ? std::clamp(c, -max_slope, max_slope) / reach : 0.0f;
    atomic_increase(&shared.counts[tally], std::uint32_t{1});
    atomic_increase(&shared.slopes[tally], static_cast<std::uint32_t>(in_units(share, a.slope_unit)));
    float brightest = 0.0f;
    for (int channel = 0; channel < 3; ++channel)
        brightest = std::max(brightest, std::fabs(a.samples.color[3 * i + channel]));
    return {x, x, y, y, brightest, layer};
}

// A block of threads has a block of pixels.
inline void run_layered_survey(const SurveyArguments& a, const Block& block, SurveyShared& shared) {
    const int top = block.y() * a.side, left = block.x() * a.side;
    const int rows = std::min(a.side, a.height - top), columns = std::min(a.side, a.width - left);
    const std::int64_t blocks_before =
        static_cast<std::int64_t>(block.y()) * ((a.width + a.side - 1) / a.side) + block.x();
    block.each([&](int thread) {
        if (thread == 0) shared.farthest = 0;
        for (int k = thread; k < a.layers * tallies_each; k += survey_threads) shared.counts[k] = shared.slopes[k] = 0;
    });
    block.each([&](int thread) {
        SampleBox all = no_samples();
        float farthest = 0.0f;
        for (int k = thread; k < rows * columns * a.spp; k += survey_threads) {
            const int row = top + k / (columns * a.spp), in_row = k % (columns * a.spp), column = left + in_row / a.spp;
            const std::int64_t i = (static_cast<std::int64_t>(row) * a.width + left) * a.spp + in_row;
            const SampleBox box = survey_sample(a, i, thread, shared);
            if (box.deepest < 0) continue;
            all = joined(all, box);
            farthest = std::max(farthest, std::fabs(box.x_min - static_cast<float>(column) - 0.5f));
            farthest = std::max(farthest, std::fabs(box.y_min - static_cast<float>(row) - 0.5f));
        }
        shared.boxes[thread] = all;
        atomic_most(&shared.farthest, std::bit_cast<std::uint32_t>(farthest));
    });
    block.each([&](int thread) {
        if (thread >= box_groups) return;
        for (int k = thread + box_groups; k < survey_threads; k += box_groups)
            shared.boxes[thread] = joined(shared.boxes[thread], shared.boxes[k]);
    });
    block.each([&](int thread) {
        if (thread == 0) {
            for (int k = 1; k < box_groups; ++k) shared.boxes[0] = joined(shared.boxes[0], shared.boxes[k]);
            a.boxes[blocks_before] = shared.boxes[0];
            atomic_most(a.farthest, shared.farthest);
        }
        for (int layer = thread; layer < a.layers; layer += survey_threads) {
            std::uint32_t count = 0, slopes = 0;
            for (int k = layer * tallies_each; k < (layer + 1) * tallies_each; ++k) {
                count += shared.counts[k];
                slopes += shared.slopes[k];
            }
            a.counts[blocks_before * a.layers + layer] = count;
            a.slopes[blocks_before * a.layers + layer] = static_cast<std::int32_t>(slopes);
        }
    });
}

constexpr int near_threads = 512;
static_assert(near_threads >= most_layers);

struct NearArguments {
    Survey survey;
    const std::uint32_t* counts;  // (blocks, layers), as surveyed
    const std::int32_t* slopes;
    const float* reaches;        // (layers)
    const std::int32_t* levels;  // (layers): bins of 2^level pixels
    TileLayer* tile_layers;      // (tiles, layers)
    float* brightest;            // (tiles): the largest radiance of what may matter
    std::int32_t* layer_counts;  // (tiles)
    BlurWidths widths;
    std::int32_t layers, tile, tile_columns;
    float part_reach;  // of the farthest part of the aperture, in lens units
    float tail;        // pixels around what a layer can reach in which its samples still count
    float slope_unit;
};

struct NearShared {
    std::uint64_t counts[near_threads];
    std::int64_t slopes[near_threads];
    std::uint32_t brightest, layers;
};

FEWRAYS_INLINE TileLayer tile_layer(const NearArguments& a, int layer, std::uint64_t count, std::int64_t slopes) {
    TileLayer found{0.0f, static_cast<std::uint32_t>(count), 0, {}};
    if (count == 0) return found;
    const double mean = static_cast<double>(slopes) / static_cast<double>(count);
    found.slope = static_cast<float>(mean / a.slope_unit * a.reaches[layer]);
    const double variance = layer_blur_variance(a.levels[layer], found.slope, a.widths);
    const double first = a.levels[layer] < 0 ? 0.5 : 0.0;
    found.radius = tap_count(variance, first);
    if (found.radius <= most_taps) gaussian_taps(variance, first, found.radius, found.taps);
    return found;
}

// A block of threads has a tile of the image, and in it each thread a layer, or with others one that it shares.
inline void run_layered_near(const NearArguments& a, const Block& block, NearShared& shared) {
    const int chunks = near_threads / a.layers;
    const auto left = static_cast<float>(block.x() % a.tile_columns * a.tile);
    const auto top = static_cast<float>(block.x() / a.tile_columns * a.tile), side = static_cast<float>(a.tile);
    const auto around = [&](int layer) { return a.reaches[layer] * (1.0f + a.part_reach) + a.tail; };
    const float most = std::max(around(0), around(a.layers - 1));  // reaches grow away from focus
    const BlockRange range = blocks_around(a.survey, left - most, left + side + most, top - most, top + side + most);
    block.each([&](int thread) {
        if (thread == 0) shared.brightest = shared.layers = 0;
    });
    block.each([&](int thread) {
        shared.counts[thread] = 0;
        shared.slopes[thread] = 0;
        const int layer = thread % a.layers, chunk = thread / a.layers;
        if (chunk >= chunks) return;
        const float beyond = around(layer);
        float brightest = 0.0f;
        for (int i = chunk; i < range.count(); i += chunks) {
            const std::int64_t at = range.block(a.survey, i);
            const SampleBox box = a.survey.boxes[at];
            if (!box.meets(left - beyond, left + side + beyond, top - beyond, top + side + beyond)) continue;
            brightest = std::max(brightest, box.brightest);
            shared.counts[thread] += a.counts[at * a.layers + layer];
            shared.slopes[thread] += a.slopes[at * a.layers + layer];
        }
        atomic_most(&shared.brightest, std::bit_cast<std::uint32_t>(brightest));
    });
    block.each([&](int thread) {
        if (thread >= a.layers) return;
        std::uint64_t count = 0;
        std::int64_t slopes = 0;
        for (int k = thread; k < chunks * a.layers; k += a.layers) {
            count += shared.counts[k];
            slopes += shared.slopes[k];
        }
        a.tile_layers[static_cast<std::int64_t>(block.x()) * a.layers + thread] = tile_layer(a, thread, count, slopes);
        if (count > 0) atomic_increase(&shared.layers, std::uint32_t{1});
    });
    block.each([&](int thread) {
        if (thread > 0) return;
        a.brightest[block.x()] = std::bit_cast<float>(shared.brightest);
        a.layer_counts[block.x()] = static_cast<std::int32_t>(shared.layers);
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(layered_survey, fewrays::survey_threads, fewrays::SurveyArguments, fewrays::SurveyShared)
FEWRAYS_KERNEL(layered_near, fewrays::near_threads, fewrays::NearArguments, fewrays::NearShared)
