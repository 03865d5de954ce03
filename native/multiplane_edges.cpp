#include "multiplane_edges.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "math/edge_way.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = 8;  // of a cell's sums: hits, all rays, radiance, and room for wide instructions
constexpr int walk_reach = static_cast<int>(farthest_along);

std::size_t place(int row, int column, int columns) {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(column);
}

// What is seen of a row of cells.
FEWRAYS_CLONES
void light_of_row(const EstimateMaps& maps, std::size_t first, int count, float* FEWRAYS_RESTRICT light) {
    const std::size_t size = maps.cell_count();
    const float* FEWRAYS_RESTRICT opacity = maps.opacity.data() + first;
    const float* FEWRAYS_RESTRICT red = maps.color.data() + first;
    const float* FEWRAYS_RESTRICT green = red + size;
    const float* FEWRAYS_RESTRICT blue = green + size;
    for (int j = 0; j < count; ++j) light[j] = light_seen(opacity[j], red[j], green[j], blue[j]);
}

// Products of a map's gradient in a row of cells; rows are `stride` apart.
FEWRAYS_CLONES
void gradient_of_row(const float* FEWRAYS_RESTRICT map, std::ptrdiff_t stride, int count, float* FEWRAYS_RESTRICT xx,
                     float* FEWRAYS_RESTRICT xy, float* FEWRAYS_RESTRICT yy) {
    const float* FEWRAYS_RESTRICT above = map - stride;
    const float* FEWRAYS_RESTRICT below = map + stride;
    for (int j = 0; j < count; ++j) {
        const Gradient slope = gradient_between(above[j - 1], above[j], above[j + 1], map[j - 1], map[j + 1],
                                                below[j - 1], below[j], below[j + 1]);
        xx[j] = slope.x * slope.x;
        xy[j] = slope.x * slope.y;
        yy[j] = slope.y * slope.y;
    }
}

// A weighted mean of seven rows or, with stride 1, of seven neighbours in a row: binomial weights.
FEWRAYS_CLONES
void blur_row(const float* FEWRAYS_RESTRICT map, std::ptrdiff_t stride, int count, float* FEWRAYS_RESTRICT out) {
    for (int j = 0; j < count; ++j) {
        const float* at = map + j;
        out[j] = binomial_mean(at[0], at[-stride] + at[stride], at[-2 * stride] + at[2 * stride],
                               at[-3 * stride] + at[3 * stride]);
    }
}

// Moments of the gradient of each of some wide cells, one map after the other.
std::vector<float> moments_of_cells(const EstimateMaps& coarse, const CellRange& range) {
    const int rows = range.bottom - range.top, columns = range.right - range.left;
    // Light of the cells that the gradients need, with one more around.
    const int stride = columns + 2;
    std::vector<float> light(place(rows + 2, 0, stride));
    for (int i = 0; i < rows + 2; ++i)
        light_of_row(coarse, place(range.top - 1 + i, range.left - 1, coarse.columns), stride,
                     light.data() + place(i, 0, stride));
    const std::size_t size = place(rows, 0, columns);
    std::vector<float> moments(edge_moments * size);
    for (int i = 0; i < rows; ++i) {
        const std::size_t own = place(range.top + i, range.left, coarse.columns);
        float* out = moments.data() + place(i, 0, columns);
        gradient_of_row(coarse.opacity.data() + own, coarse.columns, columns, out + opacity_xx * size,
                        out + opacity_xy * size, out + opacity_yy * size);
        const float* seen = light.data() + place(i + 1, 1, stride);
        gradient_of_row(seen, stride, columns, out + light_xx * size, out + light_xy * size, out + light_yy * size);
        for (std::size_t j = 0; j < static_cast<std::size_t>(columns); ++j) {
            out[light_square * size + j] = seen[j] * seen[j];
            out[rays * size + j] = 0.25f * coarse.total[own + j];
        }
    }
    return moments;
}

// Which way edges run through wide cells.
class EdgeWays {
public:
    EdgeWays(const EstimateMaps& coarse, const CellRange& range)
        : range_(range),
          columns_(range.right - range.left),
          size_(place(range.bottom - range.top, 0, columns_)),
          moments_(edge_moments * size_) {
        const CellRange around{range.top - moment_reach, range.bottom + moment_reach, range.left - moment_reach,
                               range.right + moment_reach};
        const int rows = around.bottom - around.top, columns = around.right - around.left;
        const std::vector<float> sharp = moments_of_cells(coarse, around);
        std::vector<float> across(place(rows, 0, columns_));
        for (std::size_t m = 0; m < edge_moments; ++m) {
            for (int i = 0; i < rows; ++i)
                blur_row(sharp.data() + m * place(rows, 0, columns) + place(i, moment_reach, columns), 1, columns_,
                         across.data() + place(i, 0, columns_));
            for (int i = 0; i < range.bottom - range.top; ++i)
                blur_row(across.data() + place(i + moment_reach, 0, columns_), columns_, columns_,
                         moments_.data() + m * size_ + place(i, 0, columns_));
        }
    }

    EdgeWay at(int row, int column, float along) const {
        const float* own = moments_.data() + place(row - range_.top, column - range_.left, columns_);
        return edge_way([&](int m) { return own[static_cast<std::size_t>(m) * size_]; }, along);
    }

private:
    CellRange range_;
    int columns_;
    std::size_t size_;
    std::vector<float> moments_;  // means around each cell, one map after the other
};

// Adds the cells of a walk, to both sides, to the sums of 2 x 2 cells.
FEWRAYS_CLONES
void walk(const float* FEWRAYS_RESTRICT first, std::ptrdiff_t columns, const EdgeWay& way,
          float* FEWRAYS_RESTRICT sums) {
    const std::ptrdiff_t corners[4] = {0, lanes, columns * lanes, (columns + 1) * lanes};
    for (int k = 0; k < 4; ++k)
        for (int c = 0; c < lanes; ++c) sums[k * lanes + c] = first[corners[k] + c];
    for (int step = 1; step <= way.steps; ++step) {
        const std::ptrdiff_t sideways = aside(way, step);
        const std::ptrdiff_t to = lanes * (way.steep ? step * columns + sideways : step + sideways * columns);
        const float share = weight(way, step);
        for (int k = 0; k < 4; ++k) {
            const float* ahead = first + corners[k] + to;
            const float* back = first + corners[k] - to;
            for (int c = 0; c < lanes; ++c) sums[k * lanes + c] += share * (ahead[c] + back[c]);
        }
    }
}

}  // namespace

void gather_along_edges(const EstimateMaps& coarse, float along, const CellRange& range, EstimateMaps& fine) {
    const CellRange wide{range.top / 2, (range.bottom + 1) / 2, range.left / 2, (range.right + 1) / 2};
    const EdgeWays ways(coarse, wide);
    const std::size_t size = fine.cell_count();
    // What may be read, with the sums of a cell side by side.
    const int top = 2 * wide.top - walk_reach, left = 2 * wide.left - walk_reach;
    const int rows = 2 * wide.bottom + walk_reach - top, columns = 2 * wide.right + walk_reach - left;
    const auto own = std::make_unique_for_overwrite<float[]>(place(rows, 0, columns) * lanes);
    for (int i = 0; i < rows; ++i)
        for (int j = 0; j < columns; ++j) {
            const std::size_t at = place(top + i, left + j, fine.columns);
            float* sums = own.get() + lanes * place(i, j, columns);
            for (int c = 5; c < lanes; ++c) sums[c] = 0.0f;
            sums[0] = fine.hits[at];
            sums[1] = fine.total[at];
            for (std::size_t c = 0; c < 3; ++c) sums[2 + c] = fine.radiance[c * size + at];
        }
    for (int row = wide.top; row < wide.bottom; ++row)
        for (int column = wide.left; column < wide.right; ++column) {
            const EdgeWay way = ways.at(row, column, along);
            if (way.steps == 0) continue;
            float sums[4 * lanes];
            walk(own.get() + lanes * place(2 * row - top, 2 * column - left, columns), columns, way, sums);
            for (int k = 0; k < 4; ++k) {
                const std::size_t at = place(2 * row + k / 2, 2 * column + k % 2, fine.columns);
                fine.hits[at] = sums[k * lanes];
                fine.total[at] = sums[k * lanes + 1];
                for (std::size_t c = 0; c < 3; ++c)
                    fine.radiance[c * size + at] = sums[static_cast<std::size_t>(k) * lanes + 2 + c];
            }
        }
}

}  // namespace fewrays
