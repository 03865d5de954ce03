// Finds blocks of pixels by where in the image their samples lie.
#pragma once

#include <algorithm>
#include <vector>

#include "samples.h"

namespace fewrays {

struct Rectangle {
    float x_min, x_max, y_min, y_max;

    bool contains(float x, float y) const { return x >= x_min && x < x_max && y >= y_min && y < y_max; }
    bool meets(const Extent& box) const {
        return box.x_max >= x_min && box.x_min < x_max && box.y_max >= y_min && box.y_min < y_max;
    }
    template <typename Box>
    void include(const Box& box) {
        x_min = std::min(x_min, box.x_min);
        x_max = std::max(x_max, box.x_max);
        y_min = std::min(y_min, box.y_min);
        y_max = std::max(y_max, box.y_max);
    }
    Rectangle grown(float margin) const { return {x_min - margin, x_max + margin, y_min - margin, y_max + margin}; }
};

class BlockIndex {
public:
    BlockIndex(const Samples& samples, const Extent* extents, int block)
        : extents_(extents),
          rows_((samples.height + block - 1) / block),
          columns_((samples.width + block - 1) / block) {
        for (int row = 0; row < rows_; ++row) {
            Extent all = at(row, 0);
            for (int column = 1; column < columns_; ++column) {
                const Extent& box = at(row, column);
                all = {std::min(all.x_min, box.x_min), std::max(all.x_max, box.x_max), std::min(all.y_min, box.y_min),
                       std::max(all.y_max, box.y_max)};
            }
            row_extents_.push_back(all);
        }
    }

    int columns() const { return columns_; }
    const Extent& at(int row, int column) const { return extents_[std::ptrdiff_t{row} * columns_ + column]; }

    // Calls visit(row, column) for every block with a sample that may lie in the rectangle, always in the same order:
    // down one strip of blocks after the other, so that what neighbours write stays in the cache.
    template <typename Visit>
    void visit(const Rectangle& rectangle, Visit&& visit_block) const {
        int first = columns_, last = -1;
        std::vector<int> rows;
        for (int row = 0; row < rows_; ++row)
            if (rectangle.meets(row_extents_[row])) rows.push_back(row);
        for (int row : rows)
            for (int column = 0; column < columns_; ++column)
                if (rectangle.meets(at(row, column))) {
                    first = std::min(first, column);
                    last = std::max(last, column);
                }
        for (int strip = first; strip <= last; strip += strip_columns)
            for (int row : rows)
                for (int column = strip; column <= std::min(strip + strip_columns - 1, last); ++column)
                    if (rectangle.meets(at(row, column))) visit_block(row, column);
    }

private:
    static constexpr int strip_columns = 4;

    const Extent* extents_;
    const int rows_, columns_;
    std::vector<Extent> row_extents_;
};

}  // namespace fewrays
