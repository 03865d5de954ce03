// What one view sees of a tile, front to back, and how planes are laid behind that. Part of the multiplane method.
#pragma once

#include <algorithm>
#include <iterator>

#include "multiplane.h"

namespace fewrays {

constexpr int sheet_margin = 16;  // pixels to the left and right of those that count

// Transmittance and radiance of some rows and columns of pixels. Blocks do not begin where tiles do: what they have
// beside the tile falls into margins, so that they are read in whole halves and no pixel has to be left out.
template <int rows_, int columns_>
struct Sheet {
    static constexpr int rows = rows_, columns = columns_, stride = columns + 2 * sheet_margin;
    alignas(64) float transmittance[rows * stride];
    alignas(64) float color[3][rows * stride];

    void clear() {
        std::fill(std::begin(transmittance), std::end(transmittance), 1.0f);
        for (auto& channel : color) std::fill(std::begin(channel), std::end(channel), 0.0f);
    }
};

using TileSheet = Sheet<tile_rows, tile_columns>;

// The same at half the resolution, with a pixel around the tile to interpolate.
using HalfSheet = Sheet<tile_rows / 2 + 2, tile_columns / 2 + 2>;

// Lays a plane behind what a view has seen so far of the pixels from (row, column) on.
void lay_plane(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps, int row,
               int column, TileSheet& sheet);
void lay_plane(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps, int row,
               int column, HalfSheet& sheet);

// Begins a tile with what a view has seen of it at half its resolution.
void start_with(const HalfSheet& front, TileSheet& sheet);

// Lays what a view sees at half resolution behind what it has seen of a tile.
void finish_with(const HalfSheet& back, TileSheet& sheet);

}  // namespace fewrays
