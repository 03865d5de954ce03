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

// Which of `count` cells, the first of them at `first` and each `step` after the last, lie in [0, end).
struct Range {
    int begin, end;

    Range(int first, int step, int count, int limit)
        : begin(first >= 0 ? 0 : (-first + step - 1) / step), end(std::min(count, (limit - first + step - 1) / step)) {}
};

// Reads what a region has of one block, whose first cell is at (top, left) in it, or the means of its pixels.
template <int cells, int factor>
void read_block(const Half* block, int top, int left, Region& region) {
    constexpr int own = cells / factor;
    for (int c = 0; c < block_channels; ++c)
        for (int b = 0; b < own; ++b)
            for (int a = 0; a < own; ++a) {
                const Half* map = block + std::ptrdiff_t{c * cells * cells + b * own + a} * map_cells;
                const Range within(left + a, own, block_columns, region.columns);
                for (int j = 0; j < block_rows; ++j) {
                    const int row = top + j * own + b;
                    if (row < 0 || row >= region.rows || within.begin >= within.end) continue;
                    const Half* from = map + j * (block_columns + 1) + within.begin;
                    float* to = region.channel(c) + std::ptrdiff_t{row} * region.stride + left + a + within.begin * own;
                    if constexpr (factor == 2)
                        average_row(from, within.end - within.begin, to);
                    else
                        unpack_row(from, within.end - within.begin, own, to);
                }
            }
}

// Means of 2 x 2 pixels, of two rows of them.
FEWRAYS_CLONES
void average_pairs(const float* FEWRAYS_RESTRICT above, const float* FEWRAYS_RESTRICT below, int first, int count,
                   float* FEWRAYS_RESTRICT out) {
    for (int i = 0; i < count; ++i) {
        const int at = 2 * (first + i);
        out[i] = 0.25f * ((above[at] + above[at + 1]) + (below[at] + below[at + 1]));
    }
}

// Reads what a region of half the resolution has of one block: the means of 2 x 2 pixels.
template <int cells>
void read_halved(const Half* block, int top, int left, Region& region) {
    const Range within(left, 1, block_columns / 2, region.columns);
    if (within.begin >= within.end) return;
    for (int c = 0; c < block_channels; ++c)
        for (int j = 0; j < block_rows / 2; ++j) {
            const int row = top + j;
            if (row < 0 || row >= region.rows) continue;
            const Half* from = block + std::ptrdiff_t{c * cells * cells} * map_cells + 2 * j * map_row;
            float pixels[2][block_columns];
            for (int k = 0; k < 2; ++k)
                if constexpr (cells == 2)
                    average_row(from + k * map_row, block_columns, pixels[k]);
                else
                    unpack_row(from + k * map_row, block_columns, 1, pixels[k]);
            average_pairs(pixels[0], pixels[1], within.begin, within.end - within.begin,
                          region.channel(c) + std::ptrdiff_t{row} * region.stride + left + within.begin);
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

// Reads what lies in and around a span of a copy's blocks.
template <int cells, int own, int pitch>
Region read_region(const PlaneSet& set, const Half* halves, const DepthPlane& plane, const DepthPlane& copy,
                   const Span& span, int reach) {
    constexpr int width = block_columns * own, height = block_rows * own;
    // The blocks' last rows and columns repeat what follows on them.
    Region region(
        (copy.top + span.top * block_rows) * own - reach, (copy.left + span.left * block_columns) * own - reach,
        (span.bottom - span.top) * height + own + 2 * reach, (span.right - span.left) * width + own + 2 * reach);
    constexpr int of_width = width / pitch, of_height = height / pitch;  // a block of the plane, in the copy's cells
    const int top = plane.top * own / pitch - region.row, left = plane.left * own / pitch - region.column;
    const int first_row = std::max(divide_down(-top, of_height), 0);
    const int last_row = std::min(divide_down(region.rows - 1 - top, of_height), plane.rows - 1);
    const int first_column = std::max(divide_down(-left, of_width), 0);
    const int last_column = std::min(divide_down(region.columns - 1 - left, of_width), plane.columns - 1);
    for (int row = first_row; row <= last_row; ++row)
        for (int column = first_column; column <= last_column; ++column) {
            const std::int32_t slot = set.slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
            if (slot < 0) continue;
            const Half* block = halves + half_padding + slot * unit_halves;
            if constexpr (pitch == 2)
                read_halved<cells>(block, top + row * of_height, left + column * of_width, region);
            else
                read_block<cells, cells / own>(block, top + row * of_height, left + column * of_width, region);
        }
    return region;
}

// Whether the plane itself has something where its copy has a block.
template <int pitch>
bool has_own(const PlaneSet& set, const DepthPlane& plane, const DepthPlane& copy, int row, int column) {
    const int top = ((copy.top + row * block_rows) * pitch - plane.top) / block_rows;
    const int left = ((copy.left + column * block_columns) * pitch - plane.left) / block_columns;
    for (int i = std::max(top, 0); i < std::min(top + pitch, plane.rows); ++i)
        for (int j = std::max(left, 0); j < std::min(left + pitch, plane.columns); ++j)
            if (set.slots[plane.first_slot + std::ptrdiff_t{i} * plane.columns + j] >= 0) return true;
    return false;
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
template <int own, int pitch>
void write_span(Region& region, const PlaneSet& set, const DepthPlane& plane, const SmoothCopies& copies,
                const DepthPlane& copy, const Span& span) {
    constexpr int width = block_columns * own, height = block_rows * own;
    const float* const sources[block_channels] = {region.channel(0), region.channel(1), region.channel(2),
                                                  region.channel(3)};
    for (int row = span.top; row < span.bottom; ++row)
        for (int column = span.left; column < span.right; ++column) {
            std::int32_t& place = copies.places[copy.first_slot + std::ptrdiff_t{row} * copy.columns + column];
            if (place < 0) continue;
            const int top = (copy.top + row * block_rows) * own - region.row;
            const int left = (copy.left + column * block_columns) * own - region.column;
            const float* corner = sources[0] + std::ptrdiff_t{top} * region.stride + left;
            if (!has_own<pitch>(set, plane, copy, row, column) && !any_opacity(corner, region.stride, height, width))
                place = -1;
            else
                write_block<own>(sources, region.stride, top, left, copies.halves + half_padding + place * unit_halves);
        }
}

// A plane of `cells` per pixel and axis, and its copy, which has `own` per `pitch` pixels.
template <int cells, int own, int pitch>
void smooth(const PlaneSet& set, const Half* halves, float sigma, const SmoothCopies& copies, const PlanePart& part) {
    const DepthPlane &plane = set.planes[part.plane], &copy = copies.planes[part.plane];
    const std::vector<float> taps = gaussian_taps(sigma * static_cast<float>(own) / static_cast<float>(pitch));
    const int reach = static_cast<int>(taps.size()) - 1;
    constexpr int down = region_cells / (block_rows * own), across = region_cells / (block_columns * own);
    for (int top = part.first_row; top < part.last_row; top += down)
        for (int left = 0; left < copy.columns; left += across) {
            const Span span =
                wanted_in(copies.places, copy,
                          {top, std::min(top + down, part.last_row), left, std::min(left + across, copy.columns)});
            if (span.top >= span.bottom) continue;
            Region region = read_region<cells, own, pitch>(set, halves, plane, copy, span, reach);
            std::vector<float> spare(region.size());
            for (int c = 0; c < block_channels; ++c) {
                const Strips columns{reach, region.rows - reach, 0, region.columns, region.stride, region.stride};
                const Strips inner{reach, region.rows - reach, reach, region.columns - reach, region.stride, 1};
                blur(region.channel(c), columns, taps.data(), reach, spare.data());
                blur(spare.data(), inner, taps.data(), reach, region.channel(c));
            }
            write_span<own, pitch>(region, set, plane, copies, copy, span);
        }
}

}  // namespace

void multiplane_smooth(const PlaneSet& set, const Half* halves, float sigma, const SmoothCopies& copies,
                       const PlanePart& part) {
    const int own = copies.planes[part.plane].cells;
    const bool halved = copies.is_halved[part.plane] != 0;
    switch (set.planes[part.plane].cells) {
        case 1:
            if (halved) return smooth<1, 1, 2>(set, halves, sigma, copies, part);
            return smooth<1, 1, 1>(set, halves, sigma, copies, part);
        case 2:
            if (halved) return smooth<2, 1, 2>(set, halves, sigma, copies, part);
            if (own == 1) return smooth<2, 1, 1>(set, halves, sigma, copies, part);
            return smooth<2, 2, 1>(set, halves, sigma, copies, part);
        default:
            return smooth<3, 3, 1>(set, halves, sigma, copies, part);
    }
}

}  // namespace fewrays
