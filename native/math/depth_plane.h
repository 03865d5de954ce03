// A plane of the multiplane method, and where a view looks at it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../simd.h"

namespace fewrays {

constexpr int block_columns = 32, block_rows = 8;  // a block's size in pixels

struct DepthPlane {
    float slope, motion_x, motion_y;  // pixels per lens unit; pixels per shutter interval
    float scale;                      // of radiance: what stored numbers have to be multiplied with
    std::int32_t cells;               // per pixel and axis, 1 to 3
    std::int32_t left, top;           // of the first block, in pixels
    std::int32_t columns, rows;       // of blocks
    std::int32_t first_slot;          // of the blocks, row by row
};

// Halves that a block of a plane takes, in units of those of one cell per pixel: (cells, cells) interleaved maps, each
// of four channels of block_rows + 1 by block_columns + 1 values. The last row and column repeat the neighbours'.
constexpr std::int64_t unit_halves = std::int64_t{4} * (block_rows + 1) * (block_columns + 1);

constexpr int map_row = block_columns + 1, map_size = map_row * (block_rows + 1);

FEWRAYS_INLINE int divide_down(int a, int b) { return a >= 0 ? a / b : -((b - 1 - a) / b); }

// Pixels beyond which there is no plane, and all numbers are still exact integers.
FEWRAYS_INLINE float within_image_reach(float x) { return std::clamp(x, -1048576.0f, 1048576.0f); }

// Pixels by which a pixel looks beside its own place on a plane.
struct Shift {
    float x, y;
};

// Of a view: u, v, time, offset from the pixel's centre (x, y), weight. `shrink` makes up for the plane's own blur.
FEWRAYS_INLINE Shift shift_of(const DepthPlane& plane, float shrink, const float* view) {
    const float since = view[2] - 0.5f;
    return {shrink * (view[3] - plane.slope * view[0]) - plane.motion_x * since,
            shrink * (view[4] - plane.slope * view[1]) - plane.motion_y * since};
}

// How a view reads a plane: a pixel's four cells lie at the same places in every block.
struct Taps {
    int column, row;       // pixels of the plane, relative to the pixel's own
    std::ptrdiff_t at[4];  // of the cells, in places from the pixel's own in the first map of a channel
    float weights[4];
};

FEWRAYS_INLINE Taps taps_of(const DepthPlane& plane, const Shift& shift) {
    const float x = within_image_reach(shift.x), y = within_image_reach(shift.y);
    const int cells = plane.cells;
    // The cell's coordinate for pixel 0, and how it falls apart into pixel and cell of it.
    const float cell_x = (0.5f + x - static_cast<float>(plane.left)) * static_cast<float>(cells) - 0.5f;
    const float cell_y = (0.5f + y - static_cast<float>(plane.top)) * static_cast<float>(cells) - 0.5f;
    const int left = static_cast<int>(std::floor(cell_x)), top = static_cast<int>(std::floor(cell_y));
    const float right_share = cell_x - static_cast<float>(left), down_share = cell_y - static_cast<float>(top);
    Taps taps;
    taps.column = divide_down(left, cells);
    taps.row = divide_down(top, cells);
    const int a = left - taps.column * cells, b = top - taps.row * cells;
    for (int k = 0; k < 4; ++k) {
        const int a_k = a + k % 2, b_k = b + k / 2;
        const int map = (b_k % cells) * cells + a_k % cells;
        taps.at[k] = std::ptrdiff_t{map} * map_size + (b_k / cells) * map_row + a_k / cells;
        taps.weights[k] = (k % 2 ? right_share : 1.0f - right_share) * (k / 2 ? down_share : 1.0f - down_share);
    }
    return taps;
}

}  // namespace fewrays
