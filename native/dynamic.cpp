#include "dynamic.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "math/disparity.h"
#include "math/sheet_lookup.h"
#include "simd.h"
#include "thread_clock.h"

namespace fewrays {
namespace {

constexpr int beyond = 1 << 20;  // any image
constexpr int largest_block = 64;

struct Rectangle {
    int top, left, bottom, right;  // the last two not included
};

// A block of a sheet's pixels.
struct Block {
    int sheet;
    Rectangle pixels;
    BlockRange range;
};

// The part of a view that a tile shows: keys of the nearest opaque pixels, and of a sheet's nearest others.
struct ViewTile {
    Rectangle part;
    std::uint64_t *opaque, *veil;
};

// What a row's pixels cover of a part of a view.
struct CoveredRow {
    std::int32_t left[largest_block], right[largest_block], top[largest_block], bottom[largest_block];
    std::int32_t cell[largest_block];  // row times columns plus column, where it is one; or `none` or `several`
    std::uint32_t order[largest_block];
};
constexpr std::int32_t none = -1, several = -2;

// Finds what `count` pixels of a row cover. One loop without branches.
FEWRAYS_INLINE void cover(const WarpPixel* FEWRAYS_RESTRICT pixels, int count, float x, float y, float u, float v,
                          float around, float behind, int view_rows, int view_columns,
                          CoveredRow& FEWRAYS_RESTRICT covered) {
    const float half_u = 0.5f * std::fabs(u), half_v = 0.5f * std::fabs(v);
    for (int k = 0; k < count; ++k) {
        const float slope = pixels[k].slope, spread = pixels[k].spread;
        const Covered columns = covered_pixels(x + static_cast<float>(k) + slope * u, around + half_u * spread);
        const Covered rows = covered_pixels(y + slope * v, around + half_v * spread);
        // Arithmetic instead of short cuts: it is vectorised.
        const bool inside = (columns.first < view_columns) & (columns.end > 0) & (rows.first < view_rows) &
                            (rows.end > 0) & (spread >= 0);
        const bool one = (columns.end - columns.first == 1) & (rows.end - rows.first == 1);
        const std::int32_t only = rows.first * view_columns + columns.first;
        const std::int32_t cell = one ? only : several;
        covered.left[k] = columns.first;
        covered.right[k] = columns.end;
        covered.top[k] = rows.first;
        covered.bottom[k] = rows.end;
        covered.cell[k] = inside ? cell : none;
        covered.order[k] = ascending_bits(slope + behind);
    }
}

FEWRAYS_INLINE void keep_nearest(std::uint64_t& kept, std::uint64_t key) { kept = std::min(kept, key); }

// Warps the pixels of a block to a tile of a view.
FEWRAYS_INLINE void warp_block(const Sheets& sheets, const Block& block, float u, float v, float growth,
                               const ViewTile& view) {
    const Rectangle& area = block.pixels;
    const int rows = view.part.bottom - view.part.top, columns = view.part.right - view.part.left;
    const int count = area.right - area.left;
    const float margin = 1 + growth + 0.5f * std::fabs(v) * block.range.spread;
    const float up = std::min(block.range.least * v, block.range.most * v) - margin;
    const float down = std::max(block.range.least * v, block.range.most * v) + margin;
    CoveredRow covered;
    for (int i = area.top; i < area.bottom; ++i) {
        const float y = static_cast<float>(i - view.part.top);
        const bool border = i == 0 || i == sheets.height - 1;
        if (!border && (y + down < 0 || y + up > static_cast<float>(rows))) continue;
        const std::ptrdiff_t first = (std::ptrdiff_t{block.sheet} * sheets.height + i) * sheets.width + area.left;
        const WarpPixel* const pixels = sheets.pixels + first;
        cover(pixels, count, static_cast<float>(area.left - view.part.left), y, u, v, 0.5f + growth,
              sheets.behind[block.sheet], rows, columns, covered);
        // The image's border stands for all that lies beyond it.
        const auto extend = [&](int k) {
            if (area.left + k == 0) covered.left[k] = 0;
            if (area.left + k == sheets.width - 1) covered.right[k] = columns;
            if (i == 0) covered.top[k] = 0;
            if (i == sheets.height - 1) covered.bottom[k] = rows;
            covered.cell[k] = pixels[k].spread >= 0 ? several : none;
        };
        if (border) {
            for (int k = 0; k < count; ++k) extend(k);
        } else {
            if (area.left == 0) extend(0);
            if (area.right == sheets.width) extend(count - 1);
        }
        for (int k = 0; k < count; ++k) {
            if (covered.cell[k] == none) continue;
            const std::uint64_t key = visibility_key(covered.order[k], static_cast<std::uint32_t>(first + k));
            const bool veils = block.range.translucent > 0 && sheets.texels[first + k].coverage < 1;
            std::uint64_t* const nearest = veils ? view.veil : view.opaque;
            if (covered.cell[k] != several) {
                keep_nearest(nearest[covered.cell[k]], key);
                continue;
            }
            const int left = std::max(covered.left[k], 0), right = std::min(covered.right[k], columns);
            const int top = std::max(covered.top[k], 0), bottom = std::min(covered.bottom[k], rows);
            for (int to_row = top; to_row < bottom; ++to_row)
                for (int to_column = left; to_column < right; ++to_column)
                    keep_nearest(nearest[to_row * columns + to_column], key);
        }
    }
}

// All views of one tile after the other.
class TileViews {
public:
    TileViews(const Sheets& sheets, const DynamicPlan& plan) : sheets_(sheets), plan_(plan) {
        const auto cells = static_cast<std::size_t>(plan.tile) * static_cast<std::size_t>(plan.tile);
        opaque_.resize(cells);
        veils_.resize(static_cast<std::size_t>(sheets.sheet_count), std::vector<std::uint64_t>(cells));
    }

    void run(int tile, float* sums, StageSeconds& seconds) {
        const int tile_columns = (sheets_.width + plan_.tile - 1) / plan_.tile;
        const int top = tile / tile_columns * plan_.tile, left = tile % tile_columns * plan_.tile;
        view_ = {top, left, std::min(top + plan_.tile, sheets_.height), std::min(left + plan_.tile, sheets_.width)};
        double before = thread_seconds();
        find_candidates();
        for (int view = 0; view < plan_.view_count; ++view) {
            const float* const point = plan_.views + std::ptrdiff_t{3} * view;
            warp(point[0], point[1]);
            const double between = thread_seconds();
            synthesize(point[0], point[1], point[2], sums);
            const double after = thread_seconds();
            seconds.warping += between - before;
            seconds.synthesis += after - between;
            before = after;
        }
    }

private:
    void find_candidates();
    void warp(float u, float v);
    void synthesize(float u, float v, float weight, float* sums) const;

    // Share of a lens point's light that passes the front rim of the lens.
    float passing_at(float u, float v, int row, int column) const {
        if (!plan_.rim) return 1;
        return cats_eye_weight(u, v, static_cast<float>(column) + 0.5f, static_cast<float>(row) + 0.5f, *plan_.rim);
    }

    // Pixels of a block that the image has.
    Rectangle pixels_of(int block_row, int block_column) const {
        const int top = block_row * plan_.block, left = block_column * plan_.block;
        return {top, left, std::min(top + plan_.block, sheets_.height), std::min(left + plan_.block, sheets_.width)};
    }

    // Whether a block's pixels may be seen in the tile from lens points with u and v in the given ranges.
    bool reaches(const Block& block, float u_least, float u_most, float v_least, float v_most) const {
        const float u_size = std::max(std::fabs(u_least), std::fabs(u_most));
        const float v_size = std::max(std::fabs(v_least), std::fabs(v_most));
        const auto growth = static_cast<float>(plan_.growth);
        const auto overlaps = [&](int first, int end, float least, float most, float size, int view_first, int view_end,
                                  int image_end) {
            const float a = block.range.least * least, b = block.range.least * most;
            const float c = block.range.most * least, d = block.range.most * most;
            const float margin = 1 + growth + 0.5f * size * block.range.spread;
            if (first == 0) first = -beyond;
            if (end == image_end) end = beyond;
            return static_cast<float>(first) + std::min(std::min(a, b), std::min(c, d)) - margin <
                       static_cast<float>(view_end) &&
                   static_cast<float>(end) + std::max(std::max(a, b), std::max(c, d)) + margin >
                       static_cast<float>(view_first);
        };
        return overlaps(block.pixels.left, block.pixels.right, u_least, u_most, u_size, view_.left, view_.right,
                        sheets_.width) &&
               overlaps(block.pixels.top, block.pixels.bottom, v_least, v_most, v_size, view_.top, view_.bottom,
                        sheets_.height);
    }

    const Sheets& sheets_;
    const DynamicPlan& plan_;
    std::vector<std::uint64_t> opaque_;
    std::vector<std::vector<std::uint64_t>> veils_;  // of each sheet
    std::vector<int> veiled_;                        // sheets that may show something translucent
    std::vector<Block> candidates_;                  // blocks that some view may show in the tile
    Rectangle view_{};
};

void TileViews::find_candidates() {
    const int block_rows = (sheets_.height + plan_.block - 1) / plan_.block;
    const int block_columns = (sheets_.width + plan_.block - 1) / plan_.block;
    candidates_.clear();
    veiled_.clear();
    const BlockRange* range = plan_.blocks;
    for (int sheet = 0; sheet < sheets_.sheet_count; ++sheet) {
        bool translucent = false;
        for (int row = 0; row < block_rows; ++row)
            for (int column = 0; column < block_columns; ++column, ++range) {
                const Block block{sheet, pixels_of(row, column), *range};
                if (range->least > range->most || !reaches(block, -1, 1, -1, 1)) continue;
                candidates_.push_back(block);
                translucent = translucent || range->translucent > 0;
            }
        if (translucent) veiled_.push_back(sheet);
    }
}

FEWRAYS_CLONES void TileViews::warp(float u, float v) {
    const std::size_t cells =
        static_cast<std::size_t>(view_.bottom - view_.top) * static_cast<std::size_t>(view_.right - view_.left);
    std::fill_n(opaque_.begin(), cells, nothing_visible);
    for (int sheet : veiled_) std::fill_n(veils_[sheet].begin(), cells, nothing_visible);
    for (const Block& block : candidates_)
        if (reaches(block, u, u, v, v))
            warp_block(sheets_, block, u, v, static_cast<float>(plan_.growth),
                       {view_, opaque_.data(), veils_[block.sheet].data()});
}

FEWRAYS_CLONES void TileViews::synthesize(float u, float v, float weight, float* sums) const {
    const int columns = view_.right - view_.left;
    const TexelImage sheet{sheets_.texels, sheets_.height, sheets_.width, plan_.tolerance};
    for (int i = view_.top; i < view_.bottom; ++i)
        for (int j = view_.left; j < view_.right; ++j) {
            const int cell = (i - view_.top) * columns + j - view_.left;
            const std::ptrdiff_t pixel = std::ptrdiff_t{i} * sheets_.width + j;
            const float passing = weight * passing_at(u, v, i, j);
            if (plan_.passed) plan_.passed[pixel] += passing;
            const RayPlace ray{static_cast<float>(j), static_cast<float>(i), u, v};
            const auto key_of_veil = [&](std::size_t k) {
                return veils_[static_cast<std::size_t>(veiled_[k])][static_cast<std::size_t>(cell)];
            };
            add_ray(sheet, ray, opaque_[static_cast<std::size_t>(cell)], veiled_.size(), key_of_veil, passing,
                    sums + ray_channels * pixel);
        }
}

}  // namespace

void dynamic_blocks(const Sheets& sheets, int block, int first, int last, BlockRange* blocks) {
    const int block_rows = (sheets.height + block - 1) / block, block_columns = (sheets.width + block - 1) / block;
    constexpr float infinity = std::numeric_limits<float>::infinity();
    for (int row = first; row < last; ++row)
        for (int column = 0; column < block_columns; ++column) {
            const int top = row % block_rows * block, left = column * block;
            BlockRange range{infinity, -infinity, 0, 0};
            for (int i = top; i < std::min(top + block, sheets.height); ++i)
                for (int j = left; j < std::min(left + block, sheets.width); ++j) {
                    const std::ptrdiff_t sheet_row = std::ptrdiff_t{row / block_rows} * sheets.height + i;
                    const std::ptrdiff_t number = sheet_row * sheets.width + j;
                    const WarpPixel& pixel = sheets.pixels[number];
                    if (pixel.spread < 0) continue;
                    range.least = std::min(range.least, pixel.slope);
                    range.most = std::max(range.most, pixel.slope);
                    range.spread = std::max(range.spread, pixel.spread);
                    if (sheets.texels[number].coverage < 1) range.translucent = 1;
                }
            blocks[std::ptrdiff_t{row} * block_columns + column] = range;
        }
}

StageSeconds dynamic_tiles(const Sheets& sheets, const DynamicPlan& plan, int first, int last, float* sums) {
    StageSeconds seconds{};
    TileViews views(sheets, plan);
    for (int tile = first; tile < last; ++tile) views.run(tile, sums, seconds);
    return seconds;
}

}  // namespace fewrays
