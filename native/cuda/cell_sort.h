// Sorting into cells by counting, in the same order however threads come: cells are counted first, and the host adds
// counts up to where each cell starts.
#pragma once

#include <cstdint>

#include "../simd.h"
#include "atomics.h"
#include "block.h"
#include "shell_sort.h"

namespace fewrays {

// Puts the i-th thing into its cell, in any order.
FEWRAYS_INLINE void put_into_cell(const std::uint32_t* starts, std::uint32_t* taken, std::int32_t* order, int cell,
                                  std::int64_t i) {
    order[starts[cell] + atomic_take(&taken[cell])] = static_cast<std::int32_t>(i);
}

// Sorts the numbers of a cell.
FEWRAYS_INLINE void sort_numbers(std::int32_t* numbers, int count) {
    shell_sort(numbers, count, [](std::int32_t a, std::int32_t b) { return a < b; });
}

}  // namespace fewrays
