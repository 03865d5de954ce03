// Tiles of a plane on a GPU: the widest neighbourhoods of cells, of which a block of threads makes one.
#pragma once

#include <cstdint>

#include "../math/depth_plane.h"
#include "plane_blocks.h"

namespace fewrays {

constexpr int tile_cells = 32;  // of a tile's side: the widest neighbourhood

// Tiles across a plane, and down it.
FEWRAYS_INLINE int tile_columns_of(const DepthPlane& plane) { return plane.columns * plane.cells; }
FEWRAYS_INLINE int tile_rows_of(const DepthPlane& plane) {
    return (plane.rows * block_rows * plane.cells + tile_cells - 1) / tile_cells;
}

// A tile of a plane.
struct TilePlace {
    int plane, row, column;
};

FEWRAYS_INLINE TilePlace tile_place(const DepthPlane* planes, const std::int32_t* first_tile, int count, int place) {
    const int number = last_not_above(place, count, [&](int k) { return first_tile[k]; });
    const int columns = tile_columns_of(planes[number]), within = place - first_tile[number];
    return {number, within / columns, within % columns};
}

}  // namespace fewrays
