// What the layered method's kernels share: what is known of blocks of pixels and of the layers of a tile, and the taps
// of blurs. Twin of src/fewrays/layered/reference.py.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

#include "../math/blur_taps.h"
#include "../math/shared_hit.h"
#include "device_samples.h"

namespace fewrays {

constexpr float min_weight = 1e-12f;  // of a cell, below which no sample has said anything about it
constexpr int map_channels = 5;       // how well a cell is known, opacity, and radiance times opacity
constexpr int most_layers = 256;      // more than the thinnest layers are over all slopes there are
constexpr int most_taps = 16;         // beside each other, of the blurs that a tile does by itself

// Where the samples of a block of pixels lie, and what they are.
struct SampleBox {
    float x_min, x_max, y_min, y_max;  // the least is the larger where there is none
    float brightest;                   // the largest radiance in size
    std::int32_t deepest;              // of their layers, or -1

    // Whether a sample may lie in a rectangle.
    FEWRAYS_INLINE bool meets(float left, float right, float top, float bottom) const {
        return x_max >= left && x_min < right && y_max >= top && y_min < bottom;
    }
};

// All blocks of pixels, row by row.
struct Survey {
    const SampleBox* boxes;
    const std::uint32_t*
        farthest;  // one number: how far from its pixel's centre a sample is, at most, as a float's bits
    std::int32_t side, rows, columns;
};

// Rows and columns of blocks.
struct BlockRange {
    int row, column, rows, columns;

    FEWRAYS_INLINE int count() const { return rows * columns; }
    FEWRAYS_INLINE int block(const Survey& survey, int i) const {
        return (row + i / columns) * survey.columns + column + i % columns;
    }
};

// The blocks that may have samples in a rectangle: no sample is farther than `farthest` from its pixel's centre.
FEWRAYS_INLINE BlockRange blocks_around(const Survey& survey, float left, float right, float top, float bottom) {
    const float around = std::bit_cast<float>(*survey.farthest) + 1.0f,
                per_pixel = 1.0f / static_cast<float>(survey.side);
    const auto block = [&](float at, int count) {
        return static_cast<int>(std::fmin(std::fmax(std::floor(at * per_pixel), 0.0f), static_cast<float>(count - 1)));
    };
    const int row = block(top - around, survey.rows), column = block(left - around, survey.columns);
    return {row, column, block(bottom + around, survey.rows) + 1 - row,
            block(right + around, survey.columns) + 1 - column};
}

// A layer as a tile sees it.
struct TileLayer {
    float slope;          // of the samples around the tile, on average
    std::uint32_t count;  // of these samples; without any, the layer does not matter to the tile
    std::int32_t radius;  // taps of its blur on one side of a cell's centre
    float taps[most_taps];
};

}  // namespace fewrays
