// How a plane's blocks hold its cells.
#pragma once

#include <cstddef>

#include "half.h"
#include "multiplane.h"
#include "simd.h"

namespace fewrays {

constexpr int block_channels = 4;  // opacity, and radiance times opacity

// Converts every `step`-th number.
FEWRAYS_CLONES
inline void pack_row(const float* FEWRAYS_RESTRICT from, int step, Half* FEWRAYS_RESTRICT halves) {
    if (step == 1)
        for (int i = 0; i <= block_columns; ++i) halves[i] = to_half(from[i]);
    else
        for (int i = 0; i <= block_columns; ++i) halves[i] = to_half(from[i * step]);
}

// Writes one block out of maps of all channels, `stride` cells wide, in which its first cell is at (row, column).
template <int cells>
void write_block(const float* const* sources, int stride, int row, int column, Half* halves) {
    for (int c = 0; c < block_channels; ++c)
        for (int b = 0; b < cells; ++b)
            for (int a = 0; a < cells; ++a)
                for (int j = 0; j <= block_rows; ++j) {
                    const float* from = sources[c] + std::ptrdiff_t{row + j * cells + b} * stride + column + a;
                    pack_row(from, cells, halves);
                    halves += block_columns + 1;
                }
}

}  // namespace fewrays
