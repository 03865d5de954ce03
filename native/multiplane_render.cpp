#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "multiplane.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = 16;  // pixels that are composited at once
constexpr int tile_pixels = tile_rows * tile_columns;
constexpr float opaque = 0.01f;  // transmittance below which what lies behind does not show

// What one view sees in a tile, front to back.
struct Sheet {
    alignas(64) float transmittance[tile_pixels];
    alignas(64) float color[3][tile_pixels];
};

// Lays up to 16 pixels of a block behind what a view has seen so far.
FEWRAYS_INLINE void lay_behind(const Half* FEWRAYS_RESTRICT block, const Taps& taps, std::ptrdiff_t channel,
                               float scale, const float* FEWRAYS_RESTRICT mask, float* FEWRAYS_RESTRICT transmittance,
                               float* FEWRAYS_RESTRICT red, float* FEWRAYS_RESTRICT green,
                               float* FEWRAYS_RESTRICT blue) {
    const Half* FEWRAYS_RESTRICT p0 = block + taps.at[0];
    const Half* FEWRAYS_RESTRICT p1 = block + taps.at[1];
    const Half* FEWRAYS_RESTRICT p2 = block + taps.at[2];
    const Half* FEWRAYS_RESTRICT p3 = block + taps.at[3];
    const float w0 = half_bias * taps.weights[0], w1 = half_bias * taps.weights[1];
    const float w2 = half_bias * taps.weights[2], w3 = half_bias * taps.weights[3];
    const auto read = [&](std::ptrdiff_t i) {
        return w0 * half_bits(p0[i]) + w1 * half_bits(p1[i]) + w2 * half_bits(p2[i]) + w3 * half_bits(p3[i]);
    };
    for (std::ptrdiff_t i = 0; i < lanes; ++i) {
        const float before = transmittance[i], through = before * mask[i], share = scale * through;
        transmittance[i] = before - through * read(i);
        red[i] += share * read(i + channel);
        green[i] += share * read(i + 2 * channel);
        blue[i] += share * read(i + 3 * channel);
    }
}

// Lays a plane behind what a view has seen of a tile so far.
FEWRAYS_CLONES
void lay_plane(const DepthPlane& plane, const std::int32_t* slots, const Half* halves, const Taps& taps, int tile_row,
               int tile_column, Sheet& sheet) {
    const std::ptrdiff_t channel = std::ptrdiff_t{map_size} * plane.cells * plane.cells;
    const int top = tile_row + taps.row, left = tile_column + taps.column;  // in the plane
    const int first_row = std::max(divide_down(top, block_rows), 0);
    const int last_row = std::min(divide_down(top + tile_rows - 1, block_rows), plane.rows - 1);
    const int first_column = std::max(divide_down(left, block_columns), 0);
    const int last_column = std::min(divide_down(left + tile_columns - 1, block_columns), plane.columns - 1);
    for (int row = first_row; row <= last_row; ++row) {
        const int from = std::max(row * block_rows - top, 0), to = std::min((row + 1) * block_rows - top, tile_rows);
        for (int column = first_column; column <= last_column; ++column) {
            const std::int32_t slot = slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
            if (slot < 0) continue;
            const Half* block = halves + half_padding + slot * unit_halves;
            const int begin = std::max(column * block_columns - left, 0);
            const int end = std::min((column + 1) * block_columns - left, tile_columns);
            for (int i = begin / lanes * lanes; i < end; i += lanes) {
                alignas(64) float mask[lanes];
                for (int k = 0; k < lanes; ++k) mask[k] = i + k >= begin && i + k < end ? 1.0f : 0.0f;
                for (int j = from; j < to; ++j) {
                    const int at = j * tile_columns + i;
                    float* transmittance = sheet.transmittance + at;
                    float most = 0.0f;
                    for (int k = 0; k < lanes; ++k) most = std::max(most, transmittance[k] * mask[k]);
                    if (most < opaque) continue;
                    const Half* place = block + std::ptrdiff_t{top + j - row * block_rows} * map_row +
                                        (left + i - column * block_columns);
                    lay_behind(place, taps, channel, plane.scale, mask, transmittance, sheet.color[0] + at,
                               sheet.color[1] + at, sheet.color[2] + at);
                }
            }
        }
    }
}

// Adds what a view has seen to the image; where it has seen less than a pixel's worth, that stands for all of it.
FEWRAYS_CLONES
void add_view(const Sheet& sheet, const float* FEWRAYS_RESTRICT weights, float* FEWRAYS_RESTRICT sums) {
    for (int i = 0; i < tile_pixels; ++i) {
        const float seen = 1.0f - sheet.transmittance[i];
        const float scale = seen > 1e-3f ? weights[i] / seen : 0.0f;
        sums[i] += scale * sheet.color[0][i];
        sums[tile_pixels + i] += scale * sheet.color[1][i];
        sums[2 * tile_pixels + i] += scale * sheet.color[2][i];
        sums[3 * tile_pixels + i] += seen > 1e-3f ? weights[i] : 0.0f;
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
        std::fill(sheet->transmittance, sheet->transmittance + tile_pixels, 1.0f);
        std::fill(sheet->color[0], sheet->color[0] + 3 * tile_pixels, 0.0f);
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
