#include "samples.h"

#include <algorithm>
#include <limits>

namespace fewrays {

void block_extents(const Samples& samples, int block, float margin, int first, int last, Extent* extents) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    const int columns = (samples.width + block - 1) / block;
    const float right = static_cast<float>(samples.width) + margin;
    const float bottom = static_cast<float>(samples.height) + margin;
    const std::ptrdiff_t width = samples.width, pair_row = 2 * width * samples.spp;
    for (int row = first; row < last; ++row) {
        const int i_end = std::min((row + 1) * block, samples.height);
        for (int column = 0; column < columns; ++column) {
            const std::ptrdiff_t begin = std::ptrdiff_t{2} * samples.spp * column * block;
            const std::ptrdiff_t end = std::min(begin + std::ptrdiff_t{2} * samples.spp * block, pair_row);
            Extent box{infinity, -infinity, infinity, -infinity};
            for (int i = row * block; i < i_end; ++i) {
                const float* xy_row = samples.xy + i * pair_row;
                for (std::ptrdiff_t k = begin; k < end; k += 2) {
                    const float x = xy_row[k], y = xy_row[k + 1];
                    if (x < -margin || x > right || y < -margin || y > bottom) continue;
                    box.x_min = std::min(box.x_min, x);
                    box.x_max = std::max(box.x_max, x);
                    box.y_min = std::min(box.y_min, y);
                    box.y_max = std::max(box.y_max, y);
                }
            }
            extents[std::ptrdiff_t{row} * columns + column] = box;
        }
    }
}

}  // namespace fewrays
