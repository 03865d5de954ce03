// The layered method's CPU kernels: ranges of blocks or tiles, one thread. Twin of src/fewrays/layered/reference.py.
#pragma once

#include <cstdint>

#include "math/layer_blur.h"
#include "samples.h"

namespace fewrays {

struct LayeredPlan {
    int tile;  // side of a tile of the image, in pixels
    int layer_count;
    const float* boundaries;     // (layer_count - 1): slopes where one layer ends and the next begins, ascending
    const std::int32_t* levels;  // (layer_count): bins of 2^level pixels; below 0: near focus
    int deepest_tile_level;      // layers up to this level are filtered tile by tile, others as maps of the image
    const float* reaches;        // (layer_count): largest |slope| of a sample
    BlurWidths widths;
    int part_count;
    const float* parts;  // (part_count, 3): centre (u, v) and weight
    // Shares of its samples from which on a bin has its full weight, and from which on it is certainly seen.
    float full_weight, seen;
    int finest_by_place;  // level from which on bins have weights of their own, whatever the samples in them
};

// What each block of pixels holds of each layer, and where its samples lie.
struct BlockLayers {
    int block;                   // side in pixels
    const Extent* extents;       // (rows, columns)
    const std::int32_t* counts;  // (rows, columns, layer_count): samples
    const float* slope_sums;     // (rows, columns, layer_count)
};

struct BlockLayersOutput {
    int block;
    Extent* extents;
    std::int32_t* counts;
    float* slope_sums;
};

// The filtered map of a coarse layer: (5, rows, columns).
struct CoarseMap {
    float* values;
    int layer;
    int row, column;    // of the first bin, from the image's corner
    int rows, columns;  // of bins
};

// Levels of coarse layers that are filtered together, tile by tile.
struct CoarsePass {
    int first_level, last_level;
    int left, top, right, bottom;  // of all tiles, in pixels
    int side;                      // of a tile, in pixels
};

struct LayeredOutput {
    float* image;          // (H, W, 3)
    std::int32_t* counts;  // (tiles): active layers
    float* contributions;  // (H, W, layer_count, 4): each layer's part of the image, radiance and opacity; or null
};

constexpr float max_slope = 32768.0f;  // pixels; beyond, a sample's light is spread over far more than any image

// Surveys rows of blocks [first, last). Samples farther than `margin` pixels outside the image are left out.
void block_layers(const Samples& samples, const LayeredPlan& plan, float margin, int first, int last,
                  const BlockLayersOutput& output);

// Fills tiles [first, last) of the maps of all layers of a pass.
void coarse_tiles(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan, const CoarsePass& pass,
                  const CoarseMap* maps, int map_count, int first, int last);

// Reconstructs some tiles of the image; `maps` are those of all coarse layers, where these tiles look at them.
void layered_tiles(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan, const CoarseMap* maps,
                   int map_count, const std::int32_t* tiles, int tile_count, const LayeredOutput& output);

}  // namespace fewrays
