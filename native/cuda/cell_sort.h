// Sorting into cells by counting, in the same order however threads come: cells are counted first, and the host adds
// counts up to where each cell starts.
#pragma once

#include <cstdint>

#include "../simd.h"
#include "atomics.h"
#include "block.h"

namespace fewrays {

// Puts the i-th thing into its cell, in any order.
FEWRAYS_INLINE void put_into_cell(const std::uint32_t* starts, std::uint32_t* taken, std::int32_t* order, int cell,
                                  std::int64_t i) {
    order[starts[cell] + atomic_take(&taken[cell])] = static_cast<std::int32_t>(i);
}

// Sorts the numbers of a cell, by Shell's method: most cells have few, some very many.
FEWRAYS_INLINE void sort_numbers(std::int32_t* numbers, int count) {
    int gap = 1;
    while (gap < count / 3) gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3)
        for (int i = gap; i < count; ++i) {
            const std::int32_t number = numbers[i];
            int to = i;
            for (; to >= gap && numbers[to - gap] > number; to -= gap) numbers[to] = numbers[to - gap];
            numbers[to] = number;
        }
}

}  // namespace fewrays
