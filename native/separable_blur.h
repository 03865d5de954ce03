// One pass of a separable blur.
#pragma once

#include <cstddef>
#include <cstdint>

#include "simd.h"

namespace fewrays {

constexpr int columns_at_once = 16;  // the blurs keep this many sums in registers

// `columns`, or as many more as fill the last group of them.
inline int whole_groups(int columns) { return (columns + columns_at_once - 1) / columns_at_once * columns_at_once; }

// out[row][column] = Σ taps[k] in[row * row_step + offsets[k] + column]; `columns` is a multiple of columns_at_once.
// Along rows or along columns, whichever `offsets` and `row_step` say.
void blur_pass(const float* FEWRAYS_RESTRICT in, std::ptrdiff_t row_step, float* FEWRAYS_RESTRICT out, int rows,
               int columns, const float* FEWRAYS_RESTRICT taps, const std::ptrdiff_t* FEWRAYS_RESTRICT offsets,
               int tap_count);

}  // namespace fewrays
