// Maps of whole layers in a card's memory: those whose bins are coarse, or whose blur no tile has room for.
//
// Samples are scattered to where the lens centre sees them, bins are weighed and blurred along columns and rows.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/slope.h"
#include "atomics.h"
#include "block.h"
#include "device_samples.h"
#include "layered.h"

namespace fewrays {

constexpr float color_unit = 0x1p30f;
constexpr int hit_unit = 1 << 18;  // of shares of hits

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

}  // namespace fewrays

FEWRAYS_KERNEL(layered_scatter, fewrays::sample_threads, fewrays::ScatterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_weigh, fewrays::filter_threads, fewrays::FilterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_blur_down, fewrays::filter_threads, fewrays::FilterArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(layered_blur_along, fewrays::filter_threads, fewrays::FilterArguments, fewrays::NothingShared)
