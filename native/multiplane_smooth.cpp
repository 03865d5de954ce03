#include <algorithm>
#include <cmath>
#include <vector>

#include "multiplane.h"
#include "multiplane_blocks.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int map_cells = (block_rows + 1) * (block_columns + 1);  // of one of a block's maps
constexpr int most_reach = 32;                                     // cells; a wider Gaussian is cut off
constexpr float least_opacity = 1.0f / 32.0f;                      // of a block that smoothing adds
constexpr int region_cells = 192;                                  // of a region's sides, at most
constexpr int strip = 32;                                          // cells whose sums are kept in registers

// Cells [row, row + rows) x [column, column + columns) of a plane, as floats; 0 where it has no block.
class Region {
public:
    Region(int row_, int column_, int rows_, int columns_)
        : row(row_), column(column_), rows(rows_), stride((columns_ + strip - 1) / strip * strip), columns(columns_) {
        values_.resize(block_channels * size(), 0.0f);
    }

    // Of a map, with what blurring spoils behind it.
    std::size_t size() const { return static_cast<std::size_t>(rows + 1) * static_cast<std::size_t>(stride); }
    float* channel(int c) { return values_.data() + static_cast<std::size_t>(c) * size(); }

    int row, column, rows, stride, columns;

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

// Means of the 2 x 2 cells of pixels, which lie at the same place of four maps.
FEWRAYS_CLONES
void average_row(const Half* FEWRAYS_RESTRICT halves, int count, float* FEWRAYS_RESTRICT out) {
    constexpr float quarter = 0.25f * half_bias;
    for (int i = 0; i < count; ++i)
        out[i] = quarter * (half_bits(halves[i]) + half_bits(halves[i + map_cells]) +
                            half_bits(halves[i + 2 * map_cells]) + half_bits(halves[i + 3 * map_cells]));
}

// Reads what a region has of one block, or with `factor` 2 the means of its pixels.
template <int cells, int factor>
void read_block(const Half* block, int block_row, int block_column, Region& region) {
    constexpr int own = cells / factor;
    const int top = block_row * block_rows * own - region.row,
              left = block_column * block_columns * own - region.column;
    for (int c = 0; c < block_channels; ++c)
        for (int b = 0; b < own; ++b)
            for (int a = 0; a < own; ++a) {
                const Half* map = block + std::ptrdiff_t{c * cells * cells + b * own + a} * map_cells;
                const int begin = left + a >= 0 ? 0 : (-left - a + own - 1) / own;
                const int end = std::min(block_columns, (region.columns - left - a + own - 1) / own);
                for (int j = 0; j < block_rows; ++j) {
                    const int row = top + j * own + b;
                    if (row < 0 || row >= region.rows || begin >= end) continue;
                    const Half* from = map + j * (block_columns + 1) + begin;
                    float* to = region.channel(c) + std::ptrdiff_t{row} * region.stride + left + a + begin * own;
                    if constexpr (factor == 2)
                        average_row(from, end - begin, to);
                    else
                        unpack_row(from, end - begin, own, to);
                }
            }
}

// Sums of `strip` cells: the middle one times the first tap, and both that are k steps away times the k-th.
FEWRAYS_INLINE void blur_strip(const float* FEWRAYS_RESTRICT middle, std::ptrdiff_t step,
                               const float* FEWRAYS_RESTRICT taps, int reach, float* FEWRAYS_RESTRICT out) {
    float sums[strip];
    for (int j = 0; j < strip; ++j) sums[j] = taps[0] * middle[j];
    for (int k = 1; k <= reach; ++k) {
        const float *before = middle - k * step, *after = middle + k * step;
        for (int j = 0; j < strip; ++j) sums[j] += taps[k] * (before[j] + after[j]);
    }
    for (int j = 0; j < strip; ++j) out[j] = sums[j];
}

// Cells [first_row, last_row) x [first_column, last_column) of a map with rows of `stride` cells, and how far apart are
// those that are added up.
struct Strips {
    int first_row, last_row, first_column, last_column, stride;
    std::ptrdiff_t step;
};

// Convolves cells with the Gaussian's taps, the middle one first. The last strip of a row spoils what follows on it.
FEWRAYS_CLONES
void blur(const float* map, const Strips& cells, const float* taps, int reach, float* out) {
    for (int i = cells.first_row; i < cells.last_row; ++i)
        for (int j = cells.first_column; j < cells.last_column; j += strip) {
            const std::ptrdiff_t at = std::ptrdiff_t{i} * cells.stride + j;
            blur_strip(map + at, cells.step, taps, reach, out + at);
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

// Reads what lies in and around a span of blocks; with `factor` 2 half as many cells as blocks have along each axis.
template <int cells, int factor>
Region read_region(const PlaneSet& set, const Half* halves, const DepthPlane& plane, const Span& span, int reach) {
    constexpr int own = cells / factor, width = block_columns * own, height = block_rows * own;
    // The blocks' last rows and columns repeat what follows on them.
    Region region(span.top * height - reach, span.left * width - reach,
                  (span.bottom - span.top) * height + own + 2 * reach,
                  (span.right - span.left) * width + own + 2 * reach);
    const int around_rows = (reach + height) / height, around_columns = (reach + width) / width;
    for (int row = std::max(span.top - around_rows, 0); row < std::min(span.bottom + around_rows, plane.rows); ++row)
        for (int column = std::max(span.left - around_columns, 0);
             column < std::min(span.right + around_columns, plane.columns); ++column)
            if (const std::int32_t slot = set.slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
                slot >= 0)
                read_block<cells, factor>(halves + half_padding + slot * unit_halves, row, column, region);
    return region;
}

// Whether a block of a region holds anything to speak of.
FEWRAYS_CLONES
bool any_opacity(const float* opacity, int stride, int rows, int columns) {
    int speaking = 0;
    for (int i = 0; i < rows; ++i)
        for (int j = 0; j < columns; ++j) speaking |= opacity[std::ptrdiff_t{i} * stride + j] > least_opacity;
    return speaking != 0;
}

// Writes the blocks of a span. Places for blocks that the plane does not have are given up where next to nothing came.
template <int cells>
void write_span(Region& region, const PlaneSet& set, const DepthPlane& plane, const Span& span, std::int32_t* places,
                Half* smoothed) {
    constexpr int width = block_columns * cells, height = block_rows * cells;
    const float* const sources[block_channels] = {region.channel(0), region.channel(1), region.channel(2),
                                                  region.channel(3)};
    for (int row = span.top; row < span.bottom; ++row)
        for (int column = span.left; column < span.right; ++column) {
            const std::ptrdiff_t at = plane.first_slot + std::ptrdiff_t{row} * plane.columns + column;
            if (places[at] < 0) continue;
            const int top = row * height - region.row, left = column * width - region.column;
            const float* corner = sources[0] + std::ptrdiff_t{top} * region.stride + left;
            if (set.slots[at] < 0 && !any_opacity(corner, region.stride, height, width))
                places[at] = -1;
            else
                write_block<cells>(sources, region.stride, top, left,
                                   smoothed + half_padding + places[at] * unit_halves);
        }
}

template <int cells, int factor>
void smooth(const PlaneSet& set, const Half* halves, float sigma, std::int32_t* places, const PlanePart& part,
            Half* smoothed) {
    constexpr int own = cells / factor;
    const DepthPlane& plane = set.planes[part.plane];
    const std::vector<float> taps = gaussian_taps(sigma * static_cast<float>(own));
    const int reach = static_cast<int>(taps.size()) - 1;
    constexpr int down = region_cells / (block_rows * own), across = region_cells / (block_columns * own);
    for (int top = part.first_row; top < part.last_row; top += down)
        for (int left = 0; left < plane.columns; left += across) {
            const Span span =
                wanted_in(places, plane,
                          {top, std::min(top + down, part.last_row), left, std::min(left + across, plane.columns)});
            if (span.top >= span.bottom) continue;
            Region region = read_region<cells, factor>(set, halves, plane, span, reach);
            std::vector<float> spare(region.size());
            for (int c = 0; c < block_channels; ++c) {
                const Strips columns{reach, region.rows - reach, 0, region.columns, region.stride, region.stride};
                const Strips inner{reach, region.rows - reach, reach, region.columns - reach, region.stride, 1};
                blur(region.channel(c), columns, taps.data(), reach, spare.data());
                blur(spare.data(), inner, taps.data(), reach, region.channel(c));
            }
            write_span<own>(region, set, plane, span, places, smoothed);
        }
}

}  // namespace

void multiplane_smooth(const PlaneSet& set, const Half* halves, float sigma, int cells, std::int32_t* places,
                       const PlanePart& part, Half* smoothed) {
    switch (set.planes[part.plane].cells) {
        case 1:
            return smooth<1, 1>(set, halves, sigma, places, part, smoothed);
        case 2:
            if (cells == 1) return smooth<2, 2>(set, halves, sigma, places, part, smoothed);
            return smooth<2, 1>(set, halves, sigma, places, part, smoothed);
        default:
            return smooth<3, 1>(set, halves, sigma, places, part, smoothed);
    }
}

}  // namespace fewrays
