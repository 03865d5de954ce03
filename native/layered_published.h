// The published layered method's CPU kernel: a range of tiles, one thread. Twin of
// src/fewrays/layered_published/reference.py.
#pragma once

#include <cstdint>

#include "math/sheared_filter.h"
#include "samples.h"

namespace fewrays {

struct PublishedPlan {
    int tile, ring;
    int max_layers;  // 0: no limit
    // Partition of a slope c, by bins of slope: partition_of_bin[clamp(floor(c * bins_per_pixel) - first_bin)].
    float bins_per_pixel;
    int first_bin, bin_count, partition_count;
    const std::uint8_t* partition_of_bin;   // (bin_count)
    const std::int32_t* slot_of_partition;  // (partition_count): place in the per-layer images, or -1
    FilterRule rule;
};

struct PublishedOutput {
    float* image;          // (H, W, 3)
    std::int32_t* counts;  // (tiles): active layers
    float* layer_images;   // (H, W, slots, 4): radiance and opacity of each layer, or null
    int slots;
};

// `extents` come from block_extents with the plan's ring as margin.
void published_tiles(const Samples& samples, const Extent* extents, int block, const PublishedPlan& plan, int first,
                     int last, const PublishedOutput& output);

}  // namespace fewrays
