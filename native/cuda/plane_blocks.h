// How planes are cut into blocks on a GPU.
#pragma once

#include <cstdint>

#include "../math/depth_plane.h"

namespace fewrays {

// The last of `count` ascending numbers, given by number_of(i), that is not above `value`; the first if all are.
template <typename Number, typename NumberOf>
FEWRAYS_INLINE int last_not_above(Number value, int count, const NumberOf& number_of) {
    int first = 0, end = count;
    while (end - first > 1) {
        const int middle = (first + end) / 2;
        (number_of(middle) <= value ? first : end) = middle;
    }
    return first;
}

// The plane that a place for a block belongs to.
FEWRAYS_INLINE int plane_of_block(const DepthPlane* planes, int count, std::int32_t place) {
    return last_not_above(place, count, [&](int k) { return planes[k].first_slot; });
}

// Where a cell of a block is, in places from the block's first; cells are numbered from the block's corner.
FEWRAYS_INLINE int place_of_cell(int cells, int row, int column) {
    return (row % cells * cells + column % cells) * map_size + row / cells * map_row + column / cells;
}

}  // namespace fewrays
