// Sorting by one thread, by Shell's method: for lists of which most are short and some very long.
#pragma once

#include <cstdint>

#include "../simd.h"

namespace fewrays {

// Sorts so that before(later, earlier) holds nowhere.
template <typename Before>
FEWRAYS_INLINE void shell_sort(std::int32_t* values, int count, const Before& before) {
    int gap = 1;
    while (gap < count / 3) gap = 3 * gap + 1;
    for (; gap > 0; gap /= 3)
        for (int i = gap; i < count; ++i) {
            const std::int32_t value = values[i];
            int to = i;
            for (; to >= gap && before(value, values[to - gap]); to -= gap) values[to] = values[to - gap];
            values[to] = value;
        }
}

}  // namespace fewrays
