#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "multiplane.h"
#include "multiplane_sheet.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int tile_pixels = tile_rows * tile_columns;

// Adds what a view has seen to the image; where it has seen less than a pixel's worth, that stands for all of it.
FEWRAYS_CLONES
void add_view(const TileSheet& sheet, const float* FEWRAYS_RESTRICT weights, float* FEWRAYS_RESTRICT sums) {
    for (int row = 0; row < tile_rows; ++row, weights += tile_columns, sums += tile_columns) {
        const int first = row * TileSheet::stride + sheet_margin;
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

// The part of an image, or of one of half its resolution, that is looked at.
struct Window {
    int row, column, rows, columns;
};

// Whether any of a plane's blocks can be seen through a window by views that shift it so far at most.
bool is_near(const DepthPlane& plane, const std::int32_t* slots, const Window& window, float reach_x, float reach_y) {
    const int across = static_cast<int>(std::ceil(within_image_reach(reach_x))) + 1;
    const int down = static_cast<int>(std::ceil(within_image_reach(reach_y))) + 1;
    const int top = window.row - plane.top, left = window.column - plane.left;
    const int first_row = std::max(divide_down(top - down, block_rows), 0);
    const int last_row = std::min(divide_down(top + window.rows + down, block_rows), plane.rows - 1);
    const int first_column = std::max(divide_down(left - across, block_columns), 0);
    const int last_column = std::min(divide_down(left + window.columns + across, block_columns), plane.columns - 1);
    for (int i = first_row; i <= last_row; ++i) {
        const std::int32_t* own = slots + plane.first_slot + std::ptrdiff_t{i} * plane.columns;
        if (std::any_of(own + first_column, own + std::max(last_column + 1, first_column),
                        [](std::int32_t slot) { return slot >= 0; }))
            return true;
    }
    return false;
}

// The planes that a tile's pixels can see from anywhere on the lens: those of half resolution that come before all
// others, those of full resolution, and the rest.
struct NearPlanes {
    std::vector<int> front, middle, back;
};

NearPlanes planes_near(const PlaneSet& set, const Blocks& blocks, const ViewSet& views, const Window& tile,
                       const Window& halved) {
    NearPlanes near;
    bool before_others = true;
    for (int k = 0; k < set.count; ++k) {
        const bool is_halved = blocks.is_halved[k] != 0;
        const float scale = is_halved ? 0.5f : 1.0f;
        before_others = before_others && is_halved;
        if (is_near(set.planes[k], set.slots, is_halved ? halved : tile, scale * views.reach[2 * k],
                    scale * views.reach[2 * k + 1]))
            (before_others ? near.front : is_halved ? near.back : near.middle).push_back(k);
    }
    return near;
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

// Lays planes behind what a view has seen so far of pixels from (row, column) on.
template <class Sheet>
void lay_planes(const PlaneSet& set, const Blocks& blocks, const float* shrink, const float* view,
                const std::vector<int>& planes, int row, int column, Sheet& sheet) {
    for (const int k : planes) {
        const DepthPlane& plane = set.planes[k];
        const Half* halves = blocks.is_smoothed[k] ? blocks.smoothed : blocks.built;
        lay_plane(plane, set.slots, halves, taps_of(plane, shift_of(plane, shrink[k], view)), row, column, sheet);
    }
}

// What a view sees of a tile.
struct Sheets {
    TileSheet tile;
    HalfSheet halved;
};

void look(const PlaneSet& set, const Blocks& blocks, const ViewSet& views, const float* view, const NearPlanes& near,
          const Window& tile, const Window& halved, Sheets& sheets) {
    // Where the view looks in pixels of twice the size.
    const float half_view[] = {view[0], view[1], view[2], 0.5f * view[3], 0.5f * view[4], view[5]};
    sheets.tile.clear();
    if (!near.front.empty()) {
        sheets.halved.clear();
        lay_planes(set, blocks, views.shrink, half_view, near.front, halved.row, halved.column, sheets.halved);
        start_with(sheets.halved, sheets.tile);
    }
    lay_planes(set, blocks, views.shrink, view, near.middle, tile.row, tile.column, sheets.tile);
    if (!near.back.empty()) {
        sheets.halved.clear();
        lay_planes(set, blocks, views.shrink, half_view, near.back, halved.row, halved.column, sheets.halved);
        finish_with(sheets.halved, sheets.tile);
    }
}

void render_tile(const PlaneSet& set, const Blocks& blocks, const ViewSet& views, int row, int column,
                 const RenderTarget& target) {
    const Window tile{row, column, tile_rows, tile_columns};
    const Window halved{row / 2 - 1, column / 2 - 1, HalfSheet::rows, HalfSheet::columns};
    const NearPlanes near = planes_near(set, blocks, views, tile, halved);
    std::vector<float> sums(4 * tile_pixels, 0.0f), weights(tile_pixels);
    const std::vector<float> passing = light_of_tile(views, row, column);
    const auto sheets = std::make_unique<Sheets>();
    for (int n = 0; n < views.count; ++n) {
        const float* view = views.views + std::ptrdiff_t{6} * n;
        look(set, blocks, views, view, near, tile, halved, *sheets);
        weigh(view, row, column, views, passing, weights);
        add_view(sheets->tile, weights.data(), sums.data());
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
    const int columns = (target.width + tile_columns - 1) / tile_columns;
    for (int tile = first; tile < last; ++tile)
        render_tile(set, blocks, views, tile / columns * tile_rows, tile % columns * tile_columns, target);
}

}  // namespace fewrays
