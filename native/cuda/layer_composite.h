// Layers' maps, read as parts of the aperture see them, and composited front to back.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "layered.h"

namespace fewrays {

constexpr float min_covered = 1e-3f;  // cover, by which what it hides is divided

// A layer's map, in planes of a channel each.
struct MapView {
    const float* values;
    std::int32_t plane, stride, rows, columns;
    std::int32_t size;         // of a cell, in pixels
    std::int32_t row, column;  // of the first pixel that looks at it, in pixels from its corner
};

// Which cells are read along one axis, and with what weights: for what lies a fraction of the way from one pixel to the
// next, and for what changes between the two.
template <int cells>
struct AxisWeights {
    std::int32_t at[cells];
    float seen[cells], step[cells];
};

// Of cells of one pixel. Beyond the map its outermost cells go on.
FEWRAYS_INLINE AxisWeights<2> between_pixels(int pixel, float fraction, int cells) {
    return {{std::clamp(pixel, 0, cells - 1), std::clamp(pixel + 1, 0, cells - 1)},
            {1.0f - fraction, fraction},
            {-1.0f, 1.0f}};
}

// Quadratic B-splines at the centre of a pixel: the cell nearest to it, and the weights of that before it, its own and
// that behind it. Linear ones would flatten every peak.
struct Spline {
    int nearest;
    float weights[3];

    FEWRAYS_INLINE Spline(int pixel, float per_pixel) {
        const float position = (static_cast<float>(pixel) + 0.5f) * per_pixel - 0.5f;
        nearest = static_cast<int>(std::floor(position + 0.5f));
        const float beyond = position - static_cast<float>(nearest);
        weights[0] = 0.5f * (0.5f - beyond) * (0.5f - beyond);
        weights[1] = 0.75f - beyond * beyond;
        weights[2] = 0.5f * (0.5f + beyond) * (0.5f + beyond);
    }
};

// Of cells of several pixels, which splines read at two neighbouring pixels.
FEWRAYS_INLINE AxisWeights<4> between_splines(int pixel, float fraction, int cells, int size) {
    const float per_pixel = 1.0f / static_cast<float>(size);
    const Spline first(pixel, per_pixel), next(pixel + 1, per_pixel);
    const bool moved = next.nearest > first.nearest;
    AxisWeights<4> axis;
    for (int k = 0; k < 4; ++k) {
        axis.at[k] = std::clamp(first.nearest - 1 + k, 0, cells - 1);
        const float here = k < 3 ? first.weights[k] : 0.0f;
        const float kept = k < 3 ? next.weights[k] : 0.0f, shifted = k > 0 ? next.weights[k - 1] : 0.0f;
        axis.step[k] = (moved ? shifted : kept) - here;
        axis.seen[k] = here + fraction * axis.step[k];
    }
    return axis;
}

// A map between four pixels: its value, and how much it changes from one pixel to the next.
struct MapCell {
    float known, value[4], step_x[4], step_y[4];
};

// One channel: its value, and its change along x and y.
template <int cells>
FEWRAYS_INLINE void read_channel(const float* values, int stride, const AxisWeights<cells>& down,
                                 const AxisWeights<cells>& along, float& value, float& step_x, float& step_y) {
    value = step_x = step_y = 0.0f;
    for (int i = 0; i < cells; ++i) {
        const float* const line = values + down.at[i] * stride;
        float seen = 0.0f, step = 0.0f;
        for (int j = 0; j < cells; ++j) {
            const float here = line[along.at[j]];
            seen += along.seen[j] * here;
            step += along.step[j] * here;
        }
        value += down.seen[i] * seen;
        step_x += down.seen[i] * step;
        step_y += down.step[i] * seen;
    }
}

// False where the map is transparent all around.
template <int cells>
FEWRAYS_INLINE bool read_cell(const MapView& map, const AxisWeights<cells>& down, const AxisWeights<cells>& along,
                              MapCell& cell) {
    const auto channel = [&](int c) {
        read_channel(map.values + (1 + c) * map.plane, map.stride, down, along, cell.value[c], cell.step_x[c],
                     cell.step_y[c]);
    };
    channel(0);
    if (cell.value[0] == 0.0f && cell.step_x[0] == 0.0f && cell.step_y[0] == 0.0f) return false;
    for (int c = 1; c < 4; ++c) channel(c);
    return true;
}

// How well a map is known at a pixel.
FEWRAYS_INLINE float read_known(const MapView& map, int row, int column) {
    if (map.size == 1)
        return map.values[std::clamp(row, 0, map.rows - 1) * map.stride + std::clamp(column, 0, map.columns - 1)];
    const float per_pixel = 1.0f / static_cast<float>(map.size);
    const Spline down(row, per_pixel), along(column, per_pixel);
    float known = 0.0f;
    for (int i = 0; i < 3; ++i) {
        const float* const line = map.values + std::clamp(down.nearest - 1 + i, 0, map.rows - 1) * map.stride;
        for (int j = 0; j < 3; ++j)
            known += down.weights[i] * along.weights[j] * line[std::clamp(along.nearest - 1 + j, 0, map.columns - 1)];
    }
    return known;
}

// The map at a pixel, moved by (x, y) pixels; false where it is transparent all around.
FEWRAYS_INLINE bool read_map(const MapView& map, int row, int column, float x, float y, MapCell& cell) {
    const float left = std::floor(x), top = std::floor(y);
    const int i = map.row + row + static_cast<int>(top), j = map.column + column + static_cast<int>(left);
    // Maps reach so far that their outermost cells are transparent, or so far that nothing looks beyond them.
    if (i < -1 || i >= map.rows * map.size || j < -1 || j >= map.columns * map.size) return false;
    const bool shows = map.size == 1 ? read_cell(map, between_pixels(i, y - top, map.rows),
                                                 between_pixels(j, x - left, map.columns), cell)
                                     : read_cell(map, between_splines(i, y - top, map.rows, map.size),
                                                 between_splines(j, x - left, map.columns, map.size), cell);
    if (shows) cell.known = read_known(map, i, j);
    return shows;
}

// What shows of what is behind, to first order in the place within a part.
struct Visibility {
    float mean, along_u, along_v;
};

// Adds a layer behind what is there; see _composite in reference.py, which says why.
FEWRAYS_INLINE void composite(const MapCell& cell, float shear, Visibility& behind, float* shown) {
    const float mean = behind.mean, opacity = cell.value[0];
    const float spare = (cell.known - mean) / std::max(1.0f - mean, min_covered);
    const float counts = opacity > min_weight ? shear * std::clamp(spare, 0.0f, 1.0f) : 0.0f;
    float unclamped[4];
    for (int c = 0; c < 4; ++c)
        unclamped[c] =
            mean * cell.value[c] + counts * (behind.along_u * cell.step_x[c] + behind.along_v * cell.step_y[c]);
    const float visible =
        std::min(std::max(unclamped[0], std::max(mean + opacity - 1.0f, 0.0f)), std::min(mean, opacity));
    const float clamped = (visible - unclamped[0]) / std::max(opacity, min_weight);
    shown[0] = visible;
    for (int c = 1; c < 4; ++c) shown[c] = std::max(unclamped[c] + clamped * cell.value[c], 0.0f);
    behind.along_u = behind.along_u * (1.0f - opacity) - mean * shear * cell.step_x[0];
    behind.along_v = behind.along_v * (1.0f - opacity) - mean * shear * cell.step_y[0];
    behind.mean = std::max(mean - visible, 0.0f);
}

// The same for a layer near focus, which looks the same from everywhere on the lens; false beyond its map.
FEWRAYS_INLINE bool composite_near(const MapView& map, int row, int column, Visibility& behind, float* shown) {
    const int i = map.row + row, j = map.column + column;
    if (i < 0 || i >= map.rows || j < 0 || j >= map.columns) return false;
    const float* const values = map.values + i * map.stride + j;
    for (int c = 0; c < 4; ++c) shown[c] = behind.mean * values[(1 + c) * map.plane];
    const float clear = 1.0f - values[map.plane];
    behind = {behind.mean * clear, behind.along_u * clear, behind.along_v * clear};
    return true;
}

}  // namespace fewrays
