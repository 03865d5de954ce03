#include <algorithm>
#include <cmath>
#include <vector>

#include "multiplane.h"
#include "multiplane_blocks.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int most_reach = 32;     // cells; a wider Gaussian is cut off
constexpr int region_cells = 192;  // of a region's sides, at most

// Cells [row, row + rows) x [column, column + columns) of a plane, as floats; 0 where it has no block.
class Region {
public:
    Region(int row_, int column_, int rows_, int columns_)
        : row(row_), column(column_), rows(rows_), columns(columns_) {
        values_.resize(static_cast<std::size_t>(block_channels) * size(), 0.0f);
    }

    std::size_t size() const { return static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns); }
    float* channel(int c) { return values_.data() + static_cast<std::size_t>(c) * size(); }

    const int row, column, rows, columns;

private:
    std::vector<float> values_;
};

FEWRAYS_CLONES
void unpack_row(const Half* FEWRAYS_RESTRICT halves, int count, int step, float* FEWRAYS_RESTRICT out) {
    if (step == 1)
        for (int i = 0; i < count; ++i) out[i] = from_half(halves[i]);
    else
        for (int i = 0; i < count; ++i) out[i * step] = from_half(halves[i]);
}

// Reads what a region has of one block.
template <int cells>
void read_block(const Half* block, int block_row, int block_column, Region& region) {
    const int top = block_row * block_rows * cells - region.row,
              left = block_column * block_columns * cells - region.column;
    for (int c = 0; c < block_channels; ++c)
        for (int b = 0; b < cells; ++b)
            for (int a = 0; a < cells; ++a) {
                const Half* map =
                    block + std::ptrdiff_t{(c * cells + b) * cells + a} * (block_rows + 1) * (block_columns + 1);
                const int begin = left + a >= 0 ? 0 : (-left - a + cells - 1) / cells;
                const int end = std::min(block_columns, (region.columns - left - a + cells - 1) / cells);
                for (int j = 0; j < block_rows; ++j) {
                    const int row = top + j * cells + b;
                    if (row < 0 || row >= region.rows || begin >= end) continue;
                    unpack_row(map + j * (block_columns + 1) + begin, end - begin, cells,
                               region.channel(c) + std::ptrdiff_t{row} * region.columns + left + a + begin * cells);
                }
            }
}

// Convolves rows [reach, rows - reach) of a map along columns; `taps` holds the middle one first.
FEWRAYS_CLONES
void blur_down(const float* FEWRAYS_RESTRICT map, int rows, int columns, const float* taps, int reach,
               float* FEWRAYS_RESTRICT out) {
    for (int i = reach; i < rows - reach; ++i) {
        const float* middle = map + std::ptrdiff_t{i} * columns;
        float* FEWRAYS_RESTRICT sums = out + std::ptrdiff_t{i} * columns;
        for (int j = 0; j < columns; ++j) sums[j] = taps[0] * middle[j];
        for (int k = 1; k <= reach; ++k) {
            const float *above = middle - std::ptrdiff_t{k} * columns, *below = middle + std::ptrdiff_t{k} * columns;
            for (int j = 0; j < columns; ++j) sums[j] += taps[k] * (above[j] + below[j]);
        }
    }
}

// The same along rows, columns [reach, columns - reach).
FEWRAYS_CLONES
void blur_across(const float* FEWRAYS_RESTRICT map, int rows, int columns, const float* taps, int reach,
                 float* FEWRAYS_RESTRICT out) {
    for (int i = reach; i < rows - reach; ++i) {
        const float* middle = map + std::ptrdiff_t{i} * columns;
        float* FEWRAYS_RESTRICT sums = out + std::ptrdiff_t{i} * columns;
        for (int j = reach; j < columns - reach; ++j) sums[j] = taps[0] * middle[j];
        for (int k = 1; k <= reach; ++k)
            for (int j = reach; j < columns - reach; ++j) sums[j] += taps[k] * (middle[j - k] + middle[j + k]);
    }
}

std::vector<float> gaussian_taps(float sigma) {
    const int reach = std::min(static_cast<int>(std::ceil(3.0f * sigma)), most_reach);
    std::vector<float> taps(static_cast<std::size_t>(reach) + 1);
    float total = 0.0f;
    for (int k = 0; k <= reach; ++k) {
        const float distance = static_cast<float>(k) / sigma;
        taps[static_cast<std::size_t>(k)] = std::exp(-0.5f * distance * distance);
        total += (k ? 2.0f : 1.0f) * taps[static_cast<std::size_t>(k)];
    }
    for (float& tap : taps) tap /= total;
    return taps;
}

// The blocks of a region that are wanted: rows [top, bottom), columns [left, right); none if bottom <= top.
struct Span {
    int top, bottom, left, right;
};

Span wanted_in(const std::int32_t* places, const DepthPlane& plane, const Span& region) {
    Span span{region.bottom, region.top, region.right, region.left};
    for (int row = region.top; row < region.bottom; ++row)
        for (int column = region.left; column < region.right; ++column) {
            if (places[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column] < 0) continue;
            span = {std::min(span.top, row), std::max(span.bottom, row + 1), std::min(span.left, column),
                    std::max(span.right, column + 1)};
        }
    return span;
}

template <int cells>
void smooth_span(const PlaneSet& set, const Half* halves, const DepthPlane& plane, const Span& span,
                 const std::vector<float>& taps, const std::int32_t* places, Half* smoothed) {
    constexpr int width = block_columns * cells, height = block_rows * cells;
    const int reach = static_cast<int>(taps.size()) - 1;
    // The blocks' last rows and columns repeat what follows on them.
    Region region(span.top * height - reach, span.left * width - reach,
                  (span.bottom - span.top) * height + cells + 2 * reach,
                  (span.right - span.left) * width + cells + 2 * reach);
    const int around_rows = (reach + height) / height, around_columns = (reach + width) / width;
    for (int row = std::max(span.top - around_rows, 0); row < std::min(span.bottom + around_rows, plane.rows); ++row)
        for (int column = std::max(span.left - around_columns, 0);
             column < std::min(span.right + around_columns, plane.columns); ++column)
            if (const std::int32_t own = set.slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
                own >= 0)
                read_block<cells>(halves + half_padding + own * unit_halves, row, column, region);
    std::vector<float> spare(region.size());
    for (int c = 0; c < block_channels; ++c) {
        blur_down(region.channel(c), region.rows, region.columns, taps.data(), reach, spare.data());
        blur_across(spare.data(), region.rows, region.columns, taps.data(), reach, region.channel(c));
    }
    const float* const sources[block_channels] = {region.channel(0), region.channel(1), region.channel(2),
                                                  region.channel(3)};
    for (int row = span.top; row < span.bottom; ++row)
        for (int column = span.left; column < span.right; ++column)
            if (const std::int32_t own = places[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
                own >= 0)
                write_block<cells>(sources, region.columns, row * height - region.row, column * width - region.column,
                                   smoothed + half_padding + own * unit_halves);
}

template <int cells>
void smooth(const PlaneSet& set, const Half* halves, float sigma, const std::int32_t* places, const PlanePart& part,
            Half* smoothed) {
    const DepthPlane& plane = set.planes[part.plane];
    const std::vector<float> taps = gaussian_taps(sigma * static_cast<float>(cells));
    constexpr int down = region_cells / (block_rows * cells), across = region_cells / (block_columns * cells);
    for (int top = part.first_row; top < part.last_row; top += down)
        for (int left = 0; left < plane.columns; left += across) {
            const Span span =
                wanted_in(places, plane,
                          {top, std::min(top + down, part.last_row), left, std::min(left + across, plane.columns)});
            if (span.top < span.bottom) smooth_span<cells>(set, halves, plane, span, taps, places, smoothed);
        }
}

}  // namespace

void multiplane_smooth(const PlaneSet& set, const Half* halves, float sigma, const std::int32_t* places,
                       const PlanePart& part, Half* smoothed) {
    switch (set.planes[part.plane].cells) {
        case 1:
            return smooth<1>(set, halves, sigma, places, part, smoothed);
        case 2:
            return smooth<2>(set, halves, sigma, places, part, smoothed);
        default:
            return smooth<3>(set, halves, sigma, places, part, smoothed);
    }
}

}  // namespace fewrays
