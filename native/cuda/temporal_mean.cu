// The samples' own mean of every pixel, and the noise of it. Twin of `sample_mean` in src/fewrays/temporal/refine.py.
//
// Samples are weighed, and sorted into pixels by counting. Then each pixel has a thread, which adds up the samples
// around it in the order of their numbers, in double precision: the variance is a difference of sums.
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "../math/aperture_light.h"
#include "../math/pixel_filter.h"
#include "../math/shutter_light.h"
#include "block.h"
#include "cell_sort.h"
#include "device_samples.h"
#include "each_texel.h"

namespace fewrays {

constexpr double several_samples = 1.5;  // fewer, of equal weight, do not tell their own variance

// What the samples of pixels are, and of those around the image, as far as the pixel filter reaches.
struct MeanArguments {
    DeviceSamples samples;
    ApertureLight aperture;
    LensSampling sampling;
    ShutterLight shutter;
    PixelFilter filter;
    double* weights;        // (samples)
    std::int32_t* cells;    // (samples): -1 for those that do not count
    std::uint32_t* counts;  // (cells): how many have come to each; 0 at first, and again before they are filled
    std::uint32_t* starts;  // (cells + 1)
    std::int32_t* order;    // (samples): numbers cell by cell
    float* mean;            // (height, width, 4): radiance; 1 where there are samples, else 0
    float* variance;        // (height, width): of the mean, summed over the channels
    std::uint8_t* several;  // alike: whether there were enough samples to know that
    std::int32_t height, width;

    FEWRAYS_INLINE int columns() const { return width + 2 * filter.reach; }
    FEWRAYS_INLINE int rows() const { return height + 2 * filter.reach; }
};

// Weighs every sample, and finds the pixel that it lies in.
inline void run_temporal_weigh(const MeanArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        const DeviceSamples& s = a.samples;
        const double u = s.uv[2 * i], v = s.uv[2 * i + 1];
        double weight = aperture_density(a.aperture, u, v) / a.sampling.density(u, v);
        if (s.time) weight *= shutter_density(a.shutter, s.time[i]);
        const float column = std::floor(s.xy[2 * i]) + static_cast<float>(a.filter.reach);
        const float row = std::floor(s.xy[2 * i + 1]) + static_cast<float>(a.filter.reach);
        const bool inside = column >= 0.0f && row >= 0.0f && column < static_cast<float>(a.columns()) &&
                            row < static_cast<float>(a.rows());
        a.weights[i] = weight;
        a.cells[i] = -1;
        if (!inside || !(weight > 0)) return;
        a.cells[i] = static_cast<int>(row) * a.columns() + static_cast<int>(column);
        atomic_increase(&a.counts[a.cells[i]], std::uint32_t{1});
    });
}

inline void run_temporal_mean_fill(const MeanArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        if (a.cells[i] >= 0) put_into_cell(a.starts, a.counts, a.order, a.cells[i], i);
    });
}

inline void run_temporal_mean_sort(const MeanArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.rows(), a.columns(), [&](int row, int column) {
        const std::int64_t cell = static_cast<std::int64_t>(row) * a.columns() + column;
        sort_numbers(a.order + a.starts[cell], static_cast<int>(a.starts[cell + 1] - a.starts[cell]));
    });
}

// Sums over the samples of a pixel.
struct PixelSums {
    double weight = 0, square = 0, radiance[3] = {}, energy = 0;  // energy: of squares of weight and radiance

    FEWRAYS_INLINE void add(double filtered, const float* color) {
        double light = 0;
        for (int c = 0; c < 3; ++c) {
            radiance[c] += filtered * color[c];
            light += static_cast<double>(color[c]) * color[c];
        }
        weight += filtered;
        square += filtered * filtered;
        energy += filtered * filtered * light;
    }
    // How many samples of equal weight would serve as well.
    FEWRAYS_INLINE double count() const { return square > 0 ? weight * weight / square : 0; }
};

FEWRAYS_INLINE PixelSums sums_around(const MeanArguments& a, int row, int column) {
    const int reach = a.filter.reach;
    PixelSums sums;
    for (int down = -reach; down <= reach; ++down)
        for (int right = -reach; right <= reach; ++right) {
            const int cell = (row + reach - down) * a.columns() + column + reach - right;
            for (std::uint32_t k = a.starts[cell]; k < a.starts[cell + 1]; ++k) {
                const std::int64_t i = a.order[k];
                const double x = static_cast<double>(a.samples.xy[2 * i]) - column - 0.5;
                const double y = static_cast<double>(a.samples.xy[2 * i + 1]) - row - 0.5;
                const double filtered = filter_weight(a.filter, x) * filter_weight(a.filter, y);
                sums.add(a.weights[i] * filtered, a.samples.color + 3 * i);
            }
        }
    return sums;
}

inline void run_temporal_mean(const MeanArguments& a, const Block& block, NothingShared&) {
    each_texel(block, a.height, a.width, [&](int row, int column) {
        const std::int64_t pixel = static_cast<std::int64_t>(row) * a.width + column;
        const PixelSums sums = sums_around(a, row, column);
        const bool known = sums.weight > 0, several = known && sums.count() > several_samples;
        const double reciprocal = known ? 1 / sums.weight : 0;
        float* const mean = a.mean + 4 * pixel;
        float light = 0;
        for (int c = 0; c < 3; ++c) {
            mean[c] = static_cast<float>(sums.radiance[c] * reciprocal);
            light += mean[c] * mean[c];
        }
        mean[3] = known;
        const double spread = std::max(sums.energy - sums.square * static_cast<double>(light), 0.0);
        const double bias = several ? sums.count() / (sums.count() - 1) : 1;
        a.variance[pixel] = static_cast<float>(spread * (reciprocal * reciprocal) * bias);
        a.several[pixel] = several;
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(temporal_weigh, fewrays::sample_threads, fewrays::MeanArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_mean_fill, fewrays::sample_threads, fewrays::MeanArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_mean_sort, fewrays::texel_threads, fewrays::MeanArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_mean, fewrays::texel_threads, fewrays::MeanArguments, fewrays::NothingShared)
