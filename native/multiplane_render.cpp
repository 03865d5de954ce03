#include <algorithm>
#include <bit>
#include <cmath>
#include <iterator>
#include <memory>
#include <vector>

#include "multiplane.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = 16;  // pixels that are composited at once: half a block's row
constexpr int margin = lanes;
constexpr int sheet_columns = tile_columns + 2 * margin;
constexpr int tile_pixels = tile_rows * tile_columns;
constexpr int channels = 4;      // opacity, and radiance times opacity
constexpr float opaque = 0.01f;  // transmittance below which what lies behind does not show
static_assert(block_columns % lanes == 0);

// What one view sees in a tile, front to back. Blocks do not begin where tiles do: what they have beside the tile falls
// into margins, so that they are read in whole halves and no pixel has to be left out.
struct Sheet {
    alignas(64) float transmittance[tile_rows * sheet_columns];
    alignas(64) float color[3][tile_rows * sheet_columns];
};

// How a view reads a plane's blocks: by four cells, which count (left, right) times (upper, lower).
struct Reader {
    const DepthPlane& plane;
    const Taps& taps;
    std::ptrdiff_t channel;  // from one channel's first map to the next one's
    float left, right, upper, lower;

    Reader(const DepthPlane& plane_, const Taps& taps_)
        : plane(plane_),
          taps(taps_),
          channel(std::ptrdiff_t{map_size} * plane.cells * plane.cells),
          left(half_bias * (taps.weights[0] + taps.weights[2])),
          right(half_bias * (taps.weights[1] + taps.weights[3])),
          upper(taps.weights[0] + taps.weights[1]),
          lower(taps.weights[2] + taps.weights[3]) {}
};

// Numbers of so many pixels, by channel.
struct Values {
    alignas(64) float of[channels][lanes];
};

// The upper two cells of pixels, or the lower two, with what each of them counts.
FEWRAYS_INLINE void read_pair(const Reader& from, const Half* FEWRAYS_RESTRICT first,
                              const Half* FEWRAYS_RESTRICT second, Values& values) {
    for (int c = 0; c < channels; ++c)
        for (int i = 0; i < lanes; ++i)
            values.of[c][i] = from.left * half_bits(first[c * from.channel + i]) +
                              from.right * half_bits(second[c * from.channel + i]);
}

// Lays pixels behind what a view has seen so far.
FEWRAYS_INLINE void lay_behind(const Reader& from, const Values& above, const Values& below, std::ptrdiff_t at,
                               Sheet& sheet) {
    float* FEWRAYS_RESTRICT transmittance = sheet.transmittance + at;
    float* FEWRAYS_RESTRICT red = sheet.color[0] + at;
    float* FEWRAYS_RESTRICT green = sheet.color[1] + at;
    float* FEWRAYS_RESTRICT blue = sheet.color[2] + at;
    const float scale = from.plane.scale, upper = from.upper, lower = from.lower;
    for (int i = 0; i < lanes; ++i) {
        const float before = transmittance[i], share = scale * before;
        transmittance[i] = before - before * (upper * above.of[0][i] + lower * below.of[0][i]);
        red[i] += share * (upper * above.of[1][i] + lower * below.of[1][i]);
        green[i] += share * (upper * above.of[2][i] + lower * below.of[2][i]);
        blue[i] += share * (upper * above.of[3][i] + lower * below.of[3][i]);
    }
}

// Whether anything shows behind pixels. Positive numbers are in the order of their bits.
FEWRAYS_INLINE bool shows_behind(const float* FEWRAYS_RESTRICT transmittance) {
    std::int32_t most[lanes / 2];
    for (int i = 0; i < lanes / 2; ++i) {
        const auto a = std::bit_cast<std::int32_t>(transmittance[i]);
        const auto b = std::bit_cast<std::int32_t>(transmittance[i + lanes / 2]);
        most[i] = a > b ? a : b;
    }
    for (int half = lanes / 4; half > 0; half /= 2)
        for (int i = 0; i < half; ++i) most[i] = most[i] > most[i + half] ? most[i] : most[i + half];
    return most[0] >= std::bit_cast<std::int32_t>(opaque);
}

// Lays rows of half a block behind what a view has seen: from `block` on, to `at` in the sheet. Cells of a whole pixel
// are read once, as the lower ones of a row and the upper ones of the next.
template <bool whole_pixels>
FEWRAYS_INLINE void lay_rows(const Reader& from, const Half* block, int rows, std::ptrdiff_t at, Sheet& sheet) {
    const Half* cells[4] = {block + from.taps.at[0], block + from.taps.at[1], block + from.taps.at[2],
                            block + from.taps.at[3]};
    Values above, below;
    bool known = false;
    for (int j = 0; j < rows; ++j, at += sheet_columns) {
        const bool shows = shows_behind(sheet.transmittance + at);
        if (shows) {
            if (!known) read_pair(from, cells[0], cells[1], above);
            read_pair(from, cells[2], cells[3], below);
            lay_behind(from, above, below, at, sheet);
            if (whole_pixels) above = below;
        }
        known = whole_pixels && shows;
        for (const Half*& cell : cells) cell += map_row;
    }
}

// Lays a plane behind what a view has seen of a tile so far.
FEWRAYS_CLONES
void lay_plane(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps, int tile_row,
               int tile_column, Sheet& sheet) {
    const Reader from(plane, taps);
    const int top = tile_row + taps.row, left = tile_column + taps.column;  // in the plane
    const int first_row = std::max(divide_down(top, block_rows), 0);
    const int last_row = std::min(divide_down(top + tile_rows - 1, block_rows), plane.rows - 1);
    const int first_column = std::max(divide_down(left, block_columns), 0);
    const int last_column = std::min(divide_down(left + tile_columns - 1, block_columns), plane.columns - 1);
    for (int row = first_row; row <= last_row; ++row) {
        const int begin = std::max(row * block_rows - top, 0), end = std::min((row + 1) * block_rows - top, tile_rows);
        for (int column = first_column; column <= last_column; ++column) {
            const std::int32_t slot = slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
            if (slot < 0) continue;
            const Half* block =
                halves + half_padding + slot * unit_halves + std::ptrdiff_t{top + begin - row * block_rows} * map_row;
            for (int half = 0; half < block_columns; half += lanes) {
                const int to = column * block_columns + half - left;
                if (to <= -lanes || to >= tile_columns) continue;
                const std::ptrdiff_t at = begin * sheet_columns + margin + to;
                if (plane.cells == 1)
                    lay_rows<true>(from, block + half, end - begin, at, sheet);
                else
                    lay_rows<false>(from, block + half, end - begin, at, sheet);
            }
        }
    }
}

// Adds what a view has seen to the image; where it has seen less than a pixel's worth, that stands for all of it.
FEWRAYS_CLONES
void add_view(const Sheet& sheet, const float* FEWRAYS_RESTRICT weights, float* FEWRAYS_RESTRICT sums) {
    for (int row = 0; row < tile_rows; ++row, weights += tile_columns, sums += tile_columns) {
        const int first = row * sheet_columns + margin;
        for (int i = 0; i < tile_columns; ++i) {
            const float seen = 1.0f - sheet.transmittance[first + i];
            const float scale = seen > 1e-3f ? weights[i] / seen : 0.0f;
            sums[i] += scale * sheet.color[0][first + i];
            sums[tile_pixels + i] += scale * sheet.color[1][first + i];
            sums[2 * tile_pixels + i] += scale * sheet.color[2][first + i];
            sums[3 * tile_pixels + i] += seen > 1e-3f ? weights[i] : 0.0f;
        }
    }
}

// The planes that a tile's pixels can see from anywhere on the lens.
std::vector<int> planes_near(const PlaneSet& set, const std::vector<float>& reach, int row, int column) {
    std::vector<int> near;
    for (int k = 0; k < set.count; ++k) {
        const DepthPlane& plane = set.planes[k];
        const int around = static_cast<int>(std::ceil(reach[static_cast<std::size_t>(k)])) + 1;
        const int first_row = std::max(divide_down(row - around - plane.top, block_rows), 0);
        const int last_row = std::min(divide_down(row + tile_rows + around - plane.top, block_rows), plane.rows - 1);
        const int first_column = std::max(divide_down(column - around - plane.left, block_columns), 0);
        const int last_column =
            std::min(divide_down(column + tile_columns + around - plane.left, block_columns), plane.columns - 1);
        bool any = false;
        for (int i = first_row; i <= last_row && !any; ++i) {
            const std::int32_t* slots = set.slots + plane.first_slot + std::ptrdiff_t{i} * plane.columns;
            any = std::any_of(slots + first_column, slots + std::max(last_column + 1, first_column),
                              [](std::int32_t slot) { return slot >= 0; });
        }
        if (any) near.push_back(k);
    }
    return near;
}

// The farthest that any view shifts each plane, in pixels.
std::vector<float> reach_of_views(const PlaneSet& set, const ViewSet& views) {
    std::vector<float> reach(static_cast<std::size_t>(set.count), 0.0f);
    for (int k = 0; k < set.count; ++k) {
        const DepthPlane& plane = set.planes[k];
        for (int n = 0; n < views.count; ++n) {
            const float* view = views.views + std::ptrdiff_t{6} * n;
            const Shift shift = shift_of(plane, views.shrink[k], view);
            float& farthest = reach[static_cast<std::size_t>(k)];
            farthest =
                std::max({farthest, std::fabs(within_image_reach(shift.x)), std::fabs(within_image_reach(shift.y))});
        }
    }
    return reach;
}

// How much light of a view passes the lens's rim on its way to a pixel of a tile.
float passing_rim(const float* view, int row, int column, int pixel, const ViewSet& views) {
    const float x = static_cast<float>(column + pixel % tile_columns) + 0.5f;
    const float y = static_cast<float>(row + pixel / tile_columns) + 0.5f;
    return cats_eye_weight(view[0], view[1], x, y, views.rim);
}

// The light of all views that reaches a tile's pixels, without an aperture's rim 1.
std::vector<float> light_of_tile(const ViewSet& views, int row, int column) {
    std::vector<float> light(tile_pixels, views.vignetted ? 0.0f : 1.0f);
    if (!views.vignetted) return light;
    for (int n = 0; n < views.count; ++n) {
        const float* view = views.views + std::ptrdiff_t{6} * n;
        for (int i = 0; i < tile_pixels; ++i)
            light[static_cast<std::size_t>(i)] += view[5] * passing_rim(view, row, column, i, views);
    }
    return light;
}

// The weights of a view in a tile's pixels. Where the rim lets no view pass, all count unless that shall darken.
void weigh(const float* view, int row, int column, const ViewSet& views, const std::vector<float>& light,
           std::vector<float>& weights) {
    std::fill(weights.begin(), weights.end(), view[5]);
    if (!views.vignetted) return;
    for (int i = 0; i < tile_pixels; ++i)
        if (views.darken || light[static_cast<std::size_t>(i)] > 0.0f)
            weights[static_cast<std::size_t>(i)] *= passing_rim(view, row, column, i, views);
}

void render_tile(const PlaneSet& set, const Blocks& blocks, const ViewSet& views, const std::vector<int>& near, int row,
                 int column, const RenderTarget& target) {
    std::vector<float> sums(4 * tile_pixels, 0.0f), weights(tile_pixels);
    const std::vector<float> passing = light_of_tile(views, row, column);
    const auto sheet = std::make_unique<Sheet>();
    for (int n = 0; n < views.count; ++n) {
        const float* view = views.views + std::ptrdiff_t{6} * n;
        std::fill(std::begin(sheet->transmittance), std::end(sheet->transmittance), 1.0f);
        for (auto& channel : sheet->color) std::fill(std::begin(channel), std::end(channel), 0.0f);
        for (const int k : near) {
            const DepthPlane& plane = set.planes[k];
            const Shift shift = shift_of(plane, views.shrink[k], view);
            const Half* halves = blocks.is_smoothed[k] ? blocks.smoothed : blocks.built;
            lay_plane(plane, set.slots, halves, taps_of(plane, shift), row, column, *sheet);
        }
        weigh(view, row, column, views, passing, weights);
        add_view(*sheet, weights.data(), sums.data());
    }
    for (int i = 0; i < std::min(tile_rows, target.height - row); ++i)
        for (int j = 0; j < std::min(tile_columns, target.width - column); ++j) {
            const std::size_t at = static_cast<std::size_t>(i * tile_columns + j);
            float* pixel = target.image + 4 * (std::ptrdiff_t{row + i} * target.width + column + j);
            const float seen = sums[3 * tile_pixels + at];
            const float light = views.darken || passing[at] > 0.0f ? passing[at] : 1.0f;
            const float lit = views.darken ? light : 1.0f;
            for (std::size_t c = 0; c < 3; ++c)
                pixel[c] = seen != 0.0f ? lit * sums[c * tile_pixels + at] / seen : 0.0f;
            pixel[3] = light != 0.0f ? seen / light : 0.0f;
        }
}

}  // namespace

void multiplane_render(const PlaneSet& set, const Blocks& blocks, const ViewSet& views, int first, int last,
                       const RenderTarget& target) {
    const std::vector<float> reach = reach_of_views(set, views);
    const int columns = (target.width + tile_columns - 1) / tile_columns;
    for (int tile = first; tile < last; ++tile) {
        const int row = tile / columns * tile_rows, column = tile % columns * tile_columns;
        render_tile(set, blocks, views, planes_near(set, reach, row, column), row, column, target);
    }
}

}  // namespace fewrays
