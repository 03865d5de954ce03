#include "magnifier.h"

#include <algorithm>

#include "separable_blur.h"
#include "simd.h"

namespace fewrays {
namespace {

// Weights of the three bins nearest to each pixel of a bin, along one axis: quadratic B-splines.
struct SplineWeights {
    std::vector<float> before, here, after;

    explicit SplineWeights(int size) {
        for (int pixel = 0; pixel < size; ++pixel) {
            const float beyond = (static_cast<float>(pixel) + 0.5f) / static_cast<float>(size) - 0.5f;
            before.push_back(0.5f * (0.5f - beyond) * (0.5f - beyond));
            here.push_back(0.75f - beyond * beyond);
            after.push_back(0.5f * (0.5f + beyond) * (0.5f + beyond));
        }
    }
};

FEWRAYS_CLONES void between_rows(const float* FEWRAYS_RESTRICT above, const float* FEWRAYS_RESTRICT here,
                                 const float* FEWRAYS_RESTRICT below, float above_weight, float here_weight,
                                 float below_weight, int n, float* FEWRAYS_RESTRICT out) {
    for (int i = 0; i < n; ++i) out[i] = above_weight * above[i] + here_weight * here[i] + below_weight * below[i];
}

// The pixels of a row of bins of `size` pixels, or of a part of each bin; `bins` points to the one before the first.
template <int size>
FEWRAYS_INLINE void magnify_bins(const float* FEWRAYS_RESTRICT bins, int count, int step,
                                 const float* FEWRAYS_RESTRICT before, const float* FEWRAYS_RESTRICT here,
                                 const float* FEWRAYS_RESTRICT after, float* FEWRAYS_RESTRICT out) {
    for (int k = 0; k < count; ++k)
        for (int i = 0; i < size; ++i)
            out[k * step + i] = before[i] * bins[k] + here[i] * bins[k + 1] + after[i] * bins[k + 2];
}

FEWRAYS_CLONES void magnify_row(const float* FEWRAYS_RESTRICT bins, int count, int size,
                                const float* FEWRAYS_RESTRICT before, const float* FEWRAYS_RESTRICT here,
                                const float* FEWRAYS_RESTRICT after, float* FEWRAYS_RESTRICT out) {
    if (size == 2) return magnify_bins<2>(bins, count, 2, before, here, after, out);
    if (size == 4) return magnify_bins<4>(bins, count, 4, before, here, after, out);
    if (size == 8) return magnify_bins<8>(bins, count, 8, before, here, after, out);
    for (int i = 0; i < size; i += 16) magnify_bins<16>(bins, count, size, before + i, here + i, after + i, out + i);
}

}  // namespace

FilteredMap Magnifier::run(const CoarseBins& source, int level, int row, int column, int rows, int columns,
                           Scratch& scratch) {
    const int size = 1 << level, first = column >> level;
    const int bins = ((column + columns - 1) >> level) + 1 - first, loaded_bins = bins + 2;
    const SplineWeights weights(size);
    FilteredMap map{nullptr, rows, whole_groups(columns)};
    // A pair of columns may begin at the last.
    map.values = scratch.take(static_cast<std::size_t>(channel_count * map.plane()) + 1);
    for (auto& line : lines_) line.resize(loaded_bins);
    between_.resize(loaded_bins);
    pixels_.resize(std::size_t(bins) << level);
    const auto load_line = [&](int channel, int bin_row, std::vector<float>& line) {
        const int begin = std::clamp(first - 1, 0, source.columns - 1);
        const int end = std::clamp(first - 1 + loaded_bins, begin + 1, source.columns);
        const int skipped = std::clamp(begin - (first - 1), 0, loaded_bins - 1);
        const int count = std::min(end - begin, loaded_bins - skipped);
        std::copy_n(source.at(channel, std::clamp(bin_row, 0, source.rows - 1), begin), count, line.data() + skipped);
        std::fill(line.begin(), line.begin() + skipped, line[skipped]);
        std::fill(line.begin() + skipped + count, line.end(), line[skipped + count - 1]);
    };
    for (int channel = 0; channel < channel_count; ++channel)
        for (int i = 0; i < rows; ++i) {
            const int bin_row = (row + i) >> level, pixel = (row + i) & (size - 1);
            if (i == 0)
                for (int k = 0; k < 3; ++k) load_line(channel, bin_row - 1 + k, lines_[k]);
            else if (pixel == 0) {
                std::rotate(lines_, lines_ + 1, lines_ + 3);
                load_line(channel, bin_row + 1, lines_[2]);
            }
            between_rows(lines_[0].data(), lines_[1].data(), lines_[2].data(), weights.before[pixel],
                         weights.here[pixel], weights.after[pixel], loaded_bins, between_.data());
            magnify_row(between_.data(), bins, size, weights.before.data(), weights.here.data(), weights.after.data(),
                        pixels_.data());
            float* const out = map.channel(channel) + std::ptrdiff_t{i} * map.stride;
            std::copy_n(pixels_.begin() + (column & (size - 1)), columns, out);
            std::fill(out + columns, out + map.stride, 0.0f);
        }
    return map;
}

}  // namespace fewrays
