// The layered method on a GPU. Twin of src/fewrays/layered/reference.py, with the whole image for a tile.
//
// One layer after the other, front to back: samples are scattered to where the lens centre sees them, bins are weighed
// and blurred along columns and rows, and the map is composited behind what every part of the aperture has seen so far.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/shared_hit.h"
#include "../math/slope.h"
#include "atomics.h"
#include "block.h"
#include "device_samples.h"

namespace fewrays {

constexpr float min_weight = 1e-12f;   // of a cell, below which no sample has said anything about it
constexpr float min_covered = 1e-3f;   // cover, by which what it hides is divided
constexpr float min_opacity = 1e-3f;   // of a pixel, below which it is empty
constexpr float opaque = 1e-6f;        // of what shows through less, not even a light is seen
constexpr float max_slope = 32768.0f;  // pixels, beyond which slopes count as this
constexpr float slope_unit = 65536.0f, color_unit = 0x1p30f;
constexpr int hit_unit = 1 << 18;  // shares of hits are exact in it

constexpr int assign_threads = 256, samples_each = 16;
constexpr int most_tallies = 1024;  // layers that a block of threads adds up by itself

// What the samples of a layer are.
struct LayerTally {
    std::uint64_t slopes;  // their sum, in units
    std::uint32_t count, unused;
};

struct AssignArguments {
    DeviceSamples samples;
    const float* boundaries;   // (layers - 1): slopes where one layer ends and the next begins
    std::int16_t* layer_of;    // (samples): -1 for those too far outside the image
    LayerTally* tallies;       // (layers)
    std::uint32_t* brightest;  // the largest radiance in size, as the bits of a float
    std::int32_t layers, height, width;
    float margin;  // pixels around the image beyond which no sample can reach it
};

struct AssignShared {
    LayerTally tallies[most_tallies];
    std::uint32_t brightest;
};

inline void run_layered_assign(const AssignArguments& a, const Block& block, AssignShared& shared) {
    const int own_tallies = a.layers <= most_tallies ? a.layers : 0;
    LayerTally* const tallies = own_tallies ? shared.tallies : a.tallies;
    block.each([&](int thread) {
        if (thread == 0) shared.brightest = 0;
        for (int k = thread; k < own_tallies; k += assign_threads) shared.tallies[k] = {};
    });
    block.each([&](int thread) {
        const std::int64_t first = static_cast<std::int64_t>(block.x()) * assign_threads * samples_each + thread;
        float most = 0.0f;
        for (int k = 0; k < samples_each; ++k) {
            const std::int64_t i = first + static_cast<std::int64_t>(k) * assign_threads;
            if (i >= a.samples.count) break;
            const float x = a.samples.xy[2 * i], y = a.samples.xy[2 * i + 1];
            a.layer_of[i] = -1;
            if (!(x >= -a.margin && y >= -a.margin && x <= static_cast<float>(a.width) + a.margin &&
                  y <= static_cast<float>(a.height) + a.margin))
                continue;
            const float c = slope(a.samples.depth[i], a.samples.c0, a.samples.c1);
            int low = 0, high = a.layers - 1;  // boundaries that are not above it
            while (low < high) {
                const int middle = (low + high) / 2;
                if (a.boundaries[middle] <= c)
                    low = middle + 1;
                else
                    high = middle;
            }
            a.layer_of[i] = static_cast<std::int16_t>(low);
            atomic_increase(&tallies[low].count, std::uint32_t{1});
            atomic_increase(&tallies[low].slopes, in_units(std::clamp(c, -max_slope, max_slope), slope_unit));
            for (int channel = 0; channel < 3; ++channel)
                most = std::max(most, std::fabs(a.samples.color[3 * i + channel]));
        }
        atomic_most(&shared.brightest, std::bit_cast<std::uint32_t>(most));
    });
    block.each([&](int thread) {
        if (thread == 0) atomic_most(a.brightest, shared.brightest);
        for (int k = thread; k < own_tallies; k += assign_threads) {
            if (shared.tallies[k].count == 0) continue;
            atomic_increase(&a.tallies[k].count, shared.tallies[k].count);
            atomic_increase(&a.tallies[k].slopes, shared.tallies[k].slopes);
        }
    });
}

// A rectangle of square cells around the image, each of bins by bins bins, with `radius` more bins on all sides.
struct LayerWindow {
    float left, top, cell;  // in pixels
    std::int32_t rows, columns, bins, radius;

    FEWRAYS_INLINE int bin_rows() const { return rows * bins + 2 * radius; }
    FEWRAYS_INLINE int bin_columns() const { return columns * bins + 2 * radius; }
};

// What fell into a bin: summed radiance of the layer's own samples, their number in units of a share, and the number of
// those that passed.
struct LayerBin {
    std::uint64_t color[3], hits, holes;
};

struct ScatterArguments {
    DeviceSamples samples;
    const std::int16_t* layer_of;
    LayerBin* bins;  // (bin rows, bin columns)
    LayerWindow window;
    std::int32_t layer;
    float slope;  // of the layer: where what lies behind it passed
    float scale;  // of radiance, so that no sum is too large
};

FEWRAYS_INLINE LayerBin* bin_at(const ScatterArguments& a, float column, float row) {
    const LayerWindow& window = a.window;
    if (!(column >= 0.0f && row >= 0.0f && column < static_cast<float>(window.bin_columns()) &&
          row < static_cast<float>(window.bin_rows())))
        return nullptr;
    return a.bins + static_cast<std::int64_t>(row) * window.bin_columns() + static_cast<int>(column);
}

FEWRAYS_INLINE void add_hit(const ScatterArguments& a, std::int64_t i, int share, LayerBin* bin) {
    if (!bin) return;
    const float weight = static_cast<float>(share) / static_cast<float>(hit_unit) * a.scale;
    atomic_increase(&bin->hits, static_cast<std::uint64_t>(share));
    for (int c = 0; c < 3; ++c)
        atomic_increase(&bin->color[c], in_units(weight * a.samples.color[3 * i + c], color_unit));
}

inline void run_layered_scatter(const ScatterArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        const int layer = a.layer_of[i];
        if (layer < a.layer) return;
        const DeviceSamples& s = a.samples;
        const LayerWindow& window = a.window;
        const float u = s.uv[2 * i], v = s.uv[2 * i + 1];
        const bool own = layer == a.layer;
        const float c = own ? slope(s.depth[i], s.c0, s.c1) : a.slope;
        float x = s.xy[2 * i] - c * u - window.left, y = s.xy[2 * i + 1] - c * v - window.top;
        const float per_pixel = static_cast<float>(window.bins) / window.cell,
                    radius = static_cast<float>(window.radius);
        if (window.cell > 1.0f && own) {
            // Shared between the four nearest bins, so that a light smaller than a bin keeps its place.
            const float column = x * per_pixel + radius - 0.5f, row = y * per_pixel + radius - 0.5f;
            const float left = std::floor(column), top = std::floor(row);
            const auto right = static_cast<int>(share_of(column - left) * 512.0f + 0.5f);
            const auto down = static_cast<int>(share_of(row - top) * 512.0f + 0.5f);
            for (int k = 0; k < 4; ++k)
                add_hit(a, i, (k % 2 ? right : 512 - right) * (k / 2 ? down : 512 - down),
                        bin_at(a, left + static_cast<float>(k % 2), top + static_cast<float>(k / 2)));
            return;
        }
        if (window.cell > 1.0f) {
            x += window.cell * scramble(u);
            y += window.cell * scramble(v);
        }
        LayerBin* const bin = bin_at(a, std::floor(x * per_pixel) + radius, std::floor(y * per_pixel) + radius);
        if (own)
            add_hit(a, i, hit_unit, bin);
        else if (bin)
            atomic_increase(&bin->holes, std::uint64_t{1});
    });
}

constexpr int filter_threads = 256;
constexpr int bin_channels = 6;  // weight, how well it is seen, number of hits, and their radiance
constexpr int map_channels = 5;  // how well a cell is known, opacity, and radiance times opacity

struct FilterArguments {
    const LayerBin* bins;
    float* weighed;     // (bin_channels, bin rows, bin columns)
    float* down;        // (bin_channels, rows, bin columns)
    float* map;         // (map_channels, rows, columns)
    const float* taps;  // (radius): at the distances 0, 1, … or 1/2, 3/2, … from a cell's centre, in bins
    LayerWindow window;
    std::int32_t by_place;    // whether bins weigh by place, or by their samples
    float full_weight, seen;  // samples from which on a bin weighs 1, and from which on it is certainly seen
    float by_chance;          // the share of bins that samples reach where nothing is hidden
    float scale;              // of radiance
};

// Calls work(i) for a block's share of `count` things.
template <typename Work>
inline void each_of(const Block& block, std::int64_t count, Work&& work) {
    block.each([&](int thread) {
        const std::int64_t i = static_cast<std::int64_t>(block.x()) * filter_threads + thread;
        if (i < count) work(i);
    });
}

inline void run_layered_weigh(const FilterArguments& a, const Block& block, NothingShared&) {
    const std::int64_t count = static_cast<std::int64_t>(a.window.bin_rows()) * a.window.bin_columns();
    each_of(block, count, [&](std::int64_t i) {
        const LayerBin bin = a.bins[i];
        const float hits = static_cast<float>(bin.hits) / static_cast<float>(hit_unit);
        const float samples = hits + static_cast<float>(bin.holes);
        const float weight = a.by_place ? std::min(samples / a.full_weight, 1.0f) : samples;
        const float share = a.by_place ? weight / std::max(samples, min_weight) : 1.0f;
        a.weighed[i] = weight;
        a.weighed[count + i] = std::min(samples / a.seen, 1.0f);
        a.weighed[2 * count + i] = share * hits;
        for (int c = 0; c < 3; ++c)
            a.weighed[(3 + c) * count + i] = share * (of_units(bin.color[c], color_unit) / a.scale);
    });
}

// The sum of taps around the centre of a cell, whose first bin is number `first` along an axis of some stride.
FEWRAYS_INLINE float blurred(const FilterArguments& a, const float* line, int first, std::int64_t stride) {
    const int before = first + (a.window.bins - 1) / 2, after = first + a.window.bins / 2;
    float sum = before == after ? -a.taps[0] * line[before * stride] : 0.0f;
    for (int k = 0; k < a.window.radius; ++k)
        sum += a.taps[k] * (line[(before - k) * stride] + line[(after + k) * stride]);
    return sum;
}

// Blocks along y share out the channels.
inline void run_layered_blur_down(const FilterArguments& a, const Block& block, NothingShared&) {
    const int columns = a.window.bin_columns(), channel = block.y();
    each_of(block, static_cast<std::int64_t>(a.window.rows) * columns, [&](std::int64_t i) {
        const int row = static_cast<int>(i / columns), column = static_cast<int>(i % columns);
        const float* const line =
            a.weighed + static_cast<std::int64_t>(channel) * a.window.bin_rows() * columns + column;
        a.down[static_cast<std::int64_t>(channel) * a.window.rows * columns + i] =
            blurred(a, line, a.window.radius + row * a.window.bins, columns);
    });
}

inline void run_layered_blur_along(const FilterArguments& a, const Block& block, NothingShared&) {
    const std::int64_t cells = static_cast<std::int64_t>(a.window.rows) * a.window.columns;
    each_of(block, cells, [&](std::int64_t i) {
        const int row = static_cast<int>(i / a.window.columns), column = static_cast<int>(i % a.window.columns);
        const std::int64_t stride = a.window.bin_columns(), plane = a.window.rows * stride;
        const int first = a.window.radius + column * a.window.bins;
        float sums[bin_channels];
        for (int channel = 0; channel < bin_channels; ++channel)
            sums[channel] = blurred(a, a.down + channel * plane + row * stride, first, 1);
        const float reciprocal = sums[0] > min_weight ? 1.0f / sums[0] : 0.0f;
        a.map[i] = std::min(sums[1] / a.by_chance, 1.0f);
        for (int channel = 1; channel < map_channels; ++channel)
            a.map[channel * cells + i] = reciprocal * sums[channel + 1];
    });
}

struct CompositeArguments {
    const float* map;    // (map_channels, rows, columns)
    const float* parts;  // (part_count, 3): centre (u, v) and weight
    float* visibility;   // (part_count, 3, height, width): what shows of what is behind, and its changes
    float* sums;         // (4, height, width): opacity and radiance
    std::int32_t part_count, height, width;
    std::int32_t rows, columns;  // of the map
    std::int32_t size, border;   // of its cells, in pixels, and pixels from its corner to the image's
    std::int32_t near;           // near focus: the map looks the same from everywhere on the lens
    float slope, part_sigma;
};

// A map between four pixels: its value, and how much it changes from one pixel to the next.
struct MapCell {
    float known, value[4], step_x[4], step_y[4];
};

// Weights of the three cells around a place, for quadratic B-splines: linear ones would flatten every peak.
struct Spline {
    int nearest;
    float weights[3];

    FEWRAYS_INLINE Spline(int pixel, int size) {
        const float position = (static_cast<float>(pixel) + 0.5f) / static_cast<float>(size) - 0.5f;
        nearest = static_cast<int>(std::floor(position + 0.5f));
        const float beyond = position - static_cast<float>(nearest);
        weights[0] = 0.5f * (0.5f - beyond) * (0.5f - beyond);
        weights[1] = 0.75f - beyond * beyond;
        weights[2] = 0.5f * (0.5f + beyond) * (0.5f + beyond);
    }
};

// One channel of a map at the centre of a pixel, counted from the map's corner. Beyond the map its outermost cells go
// on.
FEWRAYS_INLINE float read_map(const CompositeArguments& a, int channel, int row, int column) {
    const float* const map = a.map + static_cast<std::int64_t>(channel) * a.rows * a.columns;
    if (a.size == 1)
        return map[static_cast<std::int64_t>(std::clamp(row, 0, a.rows - 1)) * a.columns +
                   std::clamp(column, 0, a.columns - 1)];
    const Spline down(row, a.size), along(column, a.size);
    float sum = 0.0f;
    for (int i = 0; i < 3; ++i) {
        const float* const line =
            map + static_cast<std::int64_t>(std::clamp(down.nearest + i - 1, 0, a.rows - 1)) * a.columns;
        float of_line = 0.0f;
        for (int j = 0; j < 3; ++j)
            of_line += along.weights[j] * line[std::clamp(along.nearest + j - 1, 0, a.columns - 1)];
        sum += down.weights[i] * of_line;
    }
    return sum;
}

// The map as a part of the aperture sees it at a pixel.
FEWRAYS_INLINE MapCell map_cell(const CompositeArguments& a, const float* part, int row, int column) {
    const float x = -a.slope * part[0], y = -a.slope * part[1];
    const float left = std::floor(x), top = std::floor(y), right_share = x - left, down_share = y - top;
    const int i = row + static_cast<int>(top) + a.border, j = column + static_cast<int>(left) + a.border;
    MapCell cell;
    cell.known = read_map(a, 0, i, j);
    for (int c = 0; c < 4; ++c) {
        const float p = read_map(a, 1 + c, i, j), q = read_map(a, 1 + c, i, j + 1);
        const float p_below = read_map(a, 1 + c, i + 1, j), q_below = read_map(a, 1 + c, i + 1, j + 1);
        const float above = p + right_share * (q - p), below = p_below + right_share * (q_below - p_below);
        cell.value[c] = above + down_share * (below - above);
        cell.step_x[c] = q - p + down_share * (q_below - p_below - (q - p));
        cell.step_y[c] = below - above;
    }
    return cell;
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

FEWRAYS_INLINE void composite_near(const float* value, Visibility& behind, float* shown) {
    for (int c = 0; c < 4; ++c) shown[c] = behind.mean * value[c];
    const float clear = 1.0f - value[0];
    behind = {behind.mean * clear, behind.along_u * clear, behind.along_v * clear};
}

inline void run_layered_composite(const CompositeArguments& a, const Block& block, NothingShared&) {
    const std::int64_t pixels = static_cast<std::int64_t>(a.height) * a.width;
    each_of(block, pixels, [&](std::int64_t i) {
        const int row = static_cast<int>(i / a.width), column = static_cast<int>(i % a.width);
        float sums[4] = {};
        for (int part = 0; part < a.part_count; ++part) {
            float* const state = a.visibility + 3 * part * pixels + i;
            Visibility behind{state[0], state[pixels], state[2 * pixels]};
            if (behind.mean < opaque) continue;
            float shown[4];
            if (a.near) {
                float value[4];
                for (int c = 0; c < 4; ++c) value[c] = read_map(a, 1 + c, row + a.border, column + a.border);
                composite_near(value, behind, shown);
            } else {
                composite(map_cell(a, a.parts + 3 * part, row, column), -a.slope * a.part_sigma, behind, shown);
            }
            for (int c = 0; c < 4; ++c) sums[c] += a.parts[3 * part + 2] * shown[c];
            state[0] = behind.mean;
            state[pixels] = behind.along_u;
            state[2 * pixels] = behind.along_v;
        }
        for (int c = 0; c < 4; ++c) a.sums[c * pixels + i] += sums[c];
    });
}

struct FinishArguments {
    const float* sums;  // (4, pixels)
    float* image;       // (pixels, 3)
    std::int64_t pixels;
};

// What stays transparent is missing data, not a dark background.
inline void run_layered_finish(const FinishArguments& a, const Block& block, NothingShared&) {
    each_of(block, a.pixels, [&](std::int64_t i) {
        const float scale = a.sums[i] > min_opacity ? 1.0f / a.sums[i] : 1.0f;
        for (int c = 0; c < 3; ++c) a.image[3 * i + c] = scale * a.sums[(1 + c) * a.pixels + i];
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(layered_assign, fewrays::assign_threads, fewrays::AssignArguments, fewrays::AssignShared)
FEWRAYS_KERNEL(layered_scatter, fewrays::sample_threads, fewrays::ScatterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_weigh, fewrays::filter_threads, fewrays::FilterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_blur_down, fewrays::filter_threads, fewrays::FilterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_blur_along, fewrays::filter_threads, fewrays::FilterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_composite, fewrays::filter_threads, fewrays::CompositeArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_finish, fewrays::filter_threads, fewrays::FinishArguments, fewrays::NothingShared)
