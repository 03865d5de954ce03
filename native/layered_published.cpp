#include "layered_published.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <utility>
#include <vector>

#include "block_index.h"
#include "math/slope.h"
#include "separable_blur.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int batch = 256;  // samples whose bins and weights are computed before they are scattered
constexpr float min_weight = 1e-20f;
constexpr float min_opacity = 1e-3f;

// Neighbouring partitions that are filtered as one, with their samples' place in the tile's sorted samples.
struct Layer {
    int first_partition;
    double c_min, c_max;
    int begin, end;
};

// The samples in the outer tile, sorted by partition front to back; positions are relative to its corner.
struct TileSamples {
    std::vector<float> x, y, u, v, color;  // color: 3 floats a sample
    std::vector<std::uint8_t> partition;   // in the order of visits, before sorting
    int count = 0;

    void resize(int n) {
        count = n;
        if (static_cast<int>(x.size()) >= n) return;
        for (auto* field : {&x, &y, &u, &v}) field->resize(n);
        color.resize(std::size_t{3} * n);
    }
};

int partition_of(float c, const PublishedPlan& plan) {
    // Compare before converting: a slope may exceed the integers.
    const float bin = c * plan.bins_per_pixel;
    const int last = plan.bin_count - 1;
    if (bin < static_cast<float>(plan.first_bin)) return plan.partition_of_bin[0];
    if (bin >= static_cast<float>(plan.first_bin + last)) return plan.partition_of_bin[last];
    return plan.partition_of_bin[floor_to_int(bin) - plan.first_bin];
}

// The bins of an outer tile: one a pixel, row by row. One more collects what falls outside.
struct BinGrid {
    int side;    // rows, and columns in use: pixels of tile and ring
    int stride;  // floats from row to row: the columns that the blurs read
    int size() const { return side * stride; }
};

// Bins and weights of `n` samples, whose positions are relative to the outer tile.
FEWRAYS_CLONES void bins_and_weights(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y,
                                     const float* FEWRAYS_RESTRICT u, const float* FEWRAYS_RESTRICT v, int n, float eta,
                                     float falloff, BinGrid grid, std::int32_t* FEWRAYS_RESTRICT bins,
                                     float* FEWRAYS_RESTRICT weights) {
    const std::int32_t stride = grid.stride, outside = grid.size();
    const float last = std::nextafter(static_cast<float>(grid.side), 0.0f);
    for (int i = 0; i < n; ++i) {
        const float qx = x[i] - eta * u[i], qy = y[i] - eta * v[i];
        float in_x = qx > 0.0f ? qx : 0.0f, in_y = qy > 0.0f ? qy : 0.0f;
        in_x = in_x < last ? in_x : last;
        in_y = in_y < last ? in_y : last;
        const std::int32_t bin = static_cast<std::int32_t>(in_y) * stride + static_cast<std::int32_t>(in_x);
        // A choice by arithmetic: written with ?: the compiler would branch around all of the above.
        const std::int32_t inside = -(static_cast<std::int32_t>(in_x == qx) & static_cast<std::int32_t>(in_y == qy));
        bins[i] = (bin & inside) | (outside & ~inside);
        weights[i] = exp_negative(-falloff * (u[i] * u[i] + v[i] * v[i]));
    }
}

// Composites one layer behind what is there (Eq. 35) and leaves its normalised radiance and opacity in `sums`.
FEWRAYS_CLONES void composite(float* FEWRAYS_RESTRICT red, float* FEWRAYS_RESTRICT green, float* FEWRAYS_RESTRICT blue,
                              float* FEWRAYS_RESTRICT hits, const float* FEWRAYS_RESTRICT total,
                              float* FEWRAYS_RESTRICT radiance, float* FEWRAYS_RESTRICT transmittance, int n) {
    for (int i = 0; i < n; ++i) {
        const float reciprocal = total[i] > min_weight ? 1.0f / std::max(total[i], min_weight) : 0.0f;
        red[i] *= reciprocal;
        green[i] *= reciprocal;
        blue[i] *= reciprocal;
        hits[i] *= reciprocal;
        radiance[i] += transmittance[i] * red[i];
        radiance[n + i] += transmittance[i] * green[i];
        radiance[2 * n + i] += transmittance[i] * blue[i];
        transmittance[i] *= 1.0f - hits[i];
    }
}

// One thread's working memory, and the stages of a tile in the order in which they run.
class TileReconstruction {
public:
    TileReconstruction(const Samples& samples, const Extent* extents, int block, const PublishedPlan& plan)
        : samples_(samples),
          index_(samples, extents, block),
          block_(block),
          plan_(plan),
          width_(whole_groups(plan.tile)),
          pixels_(plan.tile * width_),
          bins_{plan.tile + 2 * plan.ring, width_ + 2 * plan.ring},
          taps_(2 * plan.ring + 1),
          in_row_(taps_.size()),
          in_column_(taps_.size()),
          bin_sums_(channels * (std::size_t(bins_.size()) + 1)),
          row_sums_(std::size_t(bins_.side) * width_),
          sums_(std::size_t{channels} * pixels_),
          radiance_(std::size_t{3} * pixels_),
          transmittance_(pixels_) {
        std::iota(in_row_.begin(), in_row_.end(), 0);
        for (std::size_t k = 0; k < in_column_.size(); ++k) in_column_[k] = in_row_[k] * width_;
    }

    void run(int tile, const PublishedOutput& output) {
        const int tile_columns = (samples_.width + plan_.tile - 1) / plan_.tile;
        const int row = tile / tile_columns * plan_.tile, column = tile % tile_columns * plan_.tile;
        gather(row, column);
        std::fill(radiance_.begin(), radiance_.end(), 0.0f);
        std::fill(transmittance_.begin(), transmittance_.end(), 1.0f);
        for (const Layer& layer : layers_) {
            filter(layer);
            composite(sum(red), sum(green), sum(blue), sum(hits), sum(total), radiance_.data(), transmittance_.data(),
                      pixels_);
            if (output.layer_images) store_layer(layer, row, column, output);
        }
        output.counts[tile] = static_cast<std::int32_t>(layers_.size());
        store_image(row, column, output.image);
    }

private:
    enum Channel { red, green, blue, hits, total, channels };

    float* sum(int channel) { return sums_.data() + std::ptrdiff_t{channel} * pixels_; }

    // Calls visit(index) for every sample in the rectangle, always in the same order.
    template <typename Visit>
    void visit_samples(const Rectangle& rectangle, Visit&& visit) const {
        index_.visit(rectangle, [&](int row, int column) {
            const int i_end = std::min((row + 1) * block_, samples_.height);
            const int j_end = std::min((column + 1) * block_, samples_.width);
            for (int i = row * block_; i < i_end; ++i) {
                const std::ptrdiff_t pixel = std::ptrdiff_t{i} * samples_.width;
                const std::ptrdiff_t end = (pixel + j_end) * samples_.spp;
                for (std::ptrdiff_t k = (pixel + column * block_) * samples_.spp; k < end; ++k)
                    if (rectangle.contains(samples_.xy[2 * k], samples_.xy[2 * k + 1])) visit(k);
            }
        });
    }

    // Sorts the samples of the outer tile by partition (twice over the same samples: count, then place), and
    // finds the layers with the slopes that their samples really have (section 6.2).
    void gather(int row, int column) {
        const float x0 = static_cast<float>(column - plan_.ring), y0 = static_cast<float>(row - plan_.ring);
        const auto size = static_cast<float>(plan_.tile + 2 * plan_.ring);
        const Rectangle outer{x0, x0 + size, y0, y0 + size};

        std::vector<Layer> partitions(plan_.partition_count, Layer{0, 1e300, -1e300, 0, 0});
        auto& visited = gathered_.partition;
        visited.clear();
        visit_samples(outer, [&](std::ptrdiff_t k) {
            const float c = slope(samples_.depth[k], samples_.c0, samples_.c1);
            const int index = partition_of(c, plan_);
            Layer& partition = partitions[index];
            partition.c_min = std::min(partition.c_min, double{c});
            partition.c_max = std::max(partition.c_max, double{c});
            ++partition.end;
            visited.push_back(static_cast<std::uint8_t>(index));
        });

        int begin = 0;
        for (int i = 0; i < plan_.partition_count; ++i) {
            Layer& partition = partitions[i];
            partition.first_partition = i;
            partition.begin = begin;
            begin += partition.end;
            partition.end = partition.begin;  // grows back while the samples are placed
        }
        gathered_.resize(begin);
        std::size_t visit = 0;
        visit_samples(outer, [&](std::ptrdiff_t k) {
            const int place = partitions[visited[visit++]].end++;
            gathered_.x[place] = samples_.xy[2 * k] - x0;
            gathered_.y[place] = samples_.xy[2 * k + 1] - y0;
            gathered_.u[place] = samples_.uv[2 * k];
            gathered_.v[place] = samples_.uv[2 * k + 1];
            std::memcpy(&gathered_.color[std::size_t{3} * place], samples_.color + 3 * k, 3 * sizeof(float));
        });

        layers_.clear();
        for (const Layer& partition : partitions)
            if (partition.end > partition.begin) layers_.push_back(partition);
        join_layers();
    }

    // Joins neighbours until the limit is met, always the pair whose union has the most effective filter.
    void join_layers() {
        const auto limit = static_cast<std::size_t>(plan_.max_layers);
        while (limit > 0 && layers_.size() > limit) {
            std::size_t best = 0;
            auto cost = [&](std::size_t i) {
                const double c_min = layers_[i].c_min, c_max = layers_[i + 1].c_max;
                const bool one_side = c_min * c_max > 0;
                return std::pair(!one_side, one_side ? (c_max - c_min) / (c_min * c_max) : c_max - c_min);
            };
            for (std::size_t i = 1; i + 1 < layers_.size(); ++i)
                if (cost(i) < cost(best)) best = i;
            layers_[best].c_max = layers_[best + 1].c_max;
            layers_[best].end = layers_[best + 1].end;
            layers_.erase(layers_.begin() + static_cast<std::ptrdiff_t>(best) + 1);
        }
    }

    // Algorithm 1: scatter along the layer's shear, then blur. Hits are the layer's samples, holes all behind.
    void filter(const Layer& layer) {
        const LayerFilter shape = layer_filter(layer.c_min, layer.c_max, plan_.rule);
        const std::ptrdiff_t plane = bins_.size() + 1;
        std::fill(bin_sums_.begin(), bin_sums_.end(), 0.0f);
        float* const sums = bin_sums_.data();
        scatter(layer.begin, layer.end, shape, [=, this](int i, std::int32_t bin, float weight) {
            const float* color = &gathered_.color[std::size_t{3} * i];
            sums[red * plane + bin] += weight * color[0];
            sums[green * plane + bin] += weight * color[1];
            sums[blue * plane + bin] += weight * color[2];
            sums[hits * plane + bin] += weight;
        });
        float* const all = sums + total * plane;
        std::memcpy(all, sums + hits * plane, sizeof(float) * plane);
        scatter(layer.end, gathered_.count, shape, [=](int, std::int32_t bin, float weight) { all[bin] += weight; });

        make_taps(shape.variance);
        const int tap_count = static_cast<int>(taps_.size());
        for (int channel = 0; channel < channels; ++channel) {
            blur_pass(sums + channel * plane, bins_.stride, row_sums_.data(), bins_.side, width_, taps_.data(),
                      in_row_.data(), tap_count);
            blur_pass(row_sums_.data(), width_, sum(channel), plan_.tile, width_, taps_.data(), in_column_.data(),
                      tap_count);
        }
    }

    // The screen-space filter from its first tap to its last: as wide as the ring.
    void make_taps(double variance) {
        float* const center = taps_.data() + plan_.ring;
        layer_taps(variance, plan_.ring, center);
        for (int d = 1; d <= plan_.ring; ++d) center[-d] = center[d];
    }

    template <typename Add>
    void scatter(int begin, int end, const LayerFilter& shape, Add&& add) {
        std::int32_t bins[batch];
        float weights[batch];
        for (int first = begin; first < end; first += batch) {
            const int n = std::min(batch, end - first);
            bins_and_weights(&gathered_.x[first], &gathered_.y[first], &gathered_.u[first], &gathered_.v[first], n,
                             static_cast<float>(shape.eta), static_cast<float>(shape.falloff), bins_, bins, weights);
            for (int i = 0; i < n; ++i) add(first + i, bins[i], weights[i]);
        }
    }

    void store_layer(const Layer& layer, int row, int column, const PublishedOutput& output) {
        const int slot = plan_.slot_of_partition[layer.first_partition];
        for_pixels(row, column, [&](std::ptrdiff_t pixel, int i) {
            float* target = output.layer_images + (pixel * output.slots + slot) * 4;
            for (int channel : {red, green, blue, hits}) target[channel] = sum(channel)[i];
        });
    }

    // What is left transparent is missing data, not a dark background.
    void store_image(int row, int column, float* image) {
        for_pixels(row, column, [&](std::ptrdiff_t pixel, int i) {
            const float opacity = 1.0f - transmittance_[i];
            const float scale = opacity > min_opacity ? 1.0f / opacity : 1.0f;
            for (int channel = 0; channel < 3; ++channel)
                image[3 * pixel + channel] = scale * radiance_[std::ptrdiff_t{channel} * pixels_ + i];
        });
    }

    template <typename Store>
    void for_pixels(int row, int column, Store&& store) {
        const int rows = std::min(plan_.tile, samples_.height - row);
        const int columns = std::min(plan_.tile, samples_.width - column);
        for (int i = 0; i < rows; ++i)
            for (int j = 0; j < columns; ++j)
                store(std::ptrdiff_t{row + i} * samples_.width + column + j, i * width_ + j);
    }

    const Samples& samples_;
    const BlockIndex index_;
    const int block_;
    const PublishedPlan& plan_;
    const int width_;   // of the tile in memory: a whole number of column groups
    const int pixels_;  // of the tile in memory
    const BinGrid bins_;

    TileSamples gathered_;
    std::vector<Layer> layers_;
    std::vector<float> taps_;
    std::vector<std::ptrdiff_t> in_row_, in_column_;  // where the taps read
    std::vector<float> bin_sums_, row_sums_, sums_, radiance_, transmittance_;
};

}  // namespace

void published_tiles(const Samples& samples, const Extent* extents, int block, const PublishedPlan& plan, int first,
                     int last, const PublishedOutput& output) {
    TileReconstruction reconstruction(samples, extents, block, plan);
    for (int tile = first; tile < last; ++tile) reconstruction.run(tile, output);
}

}  // namespace fewrays
