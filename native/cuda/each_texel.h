// An image's pixels, a thread each.
#pragma once

#include <cstdint>

#include "block.h"

namespace fewrays {

constexpr int texel_threads = 256;

// Calls work(row, column) for a block's share of an image's pixels.
template <typename Work>
inline void each_texel(const Block& block, int height, int width, Work&& work) {
    block.each([&](int thread) {
        const std::int64_t at = static_cast<std::int64_t>(block.x()) * texel_threads + thread;
        const int row = static_cast<int>(at / width), column = static_cast<int>(at % width);
        if (row < height) work(row, column);
    });
}

}  // namespace fewrays
