#include "layer_maps.h"

#include <cmath>
#include <cstring>
#include <utility>

#include "math/blur_taps.h"
#include "math/layer_blur.h"
#include "math/shared_hit.h"
#include "separable_blur.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int batch_size = 2048;  // samples that are sorted by layer at a time
constexpr int rows_at_once = 8;   // that are blurred, in cells
constexpr int stray_bins = 16;
constexpr int hit_channels = 4;  // red, green, blue, count
constexpr float min_weight = 1e-12f;
constexpr float tail = 4.0f;  // pixels around a layer's reach in which its samples still count

// `fine`: cells have several bins.
template <bool fine>
FEWRAYS_INLINE std::int32_t bin_of(float x, float y, const BinGrid& grid, int i) {
    const float qx = (x - grid.left) * grid.per_pixel, qy = (y - grid.top) * grid.per_pixel;
    const auto last_x = static_cast<float>(grid.columns) - 0.001f, last_y = static_cast<float>(grid.rows) - 0.001f;
    float in_x = qx > 0.0f ? qx : 0.0f, in_y = qy > 0.0f ? qy : 0.0f;
    in_x = in_x < last_x ? in_x : last_x;
    in_y = in_y < last_y ? in_y : last_y;
    const auto column = static_cast<std::int32_t>(in_x), row = static_cast<std::int32_t>(in_y);
    std::int32_t bin = row * grid.bins_per_cell * grid.stride + column;
    if constexpr (fine) {
        const auto phases = static_cast<float>(grid.bins_per_cell);
        const auto phase = static_cast<std::int32_t>((in_x - static_cast<float>(column)) * phases);
        const auto sub_row = static_cast<std::int32_t>((in_y - static_cast<float>(row)) * phases);
        bin += sub_row * grid.stride + phase * grid.columns;
    }
    // A choice by arithmetic: written with ?: the compiler would branch around all of the above.
    const std::int32_t inside = -(static_cast<std::int32_t>(in_x == qx) & static_cast<std::int32_t>(in_y == qy));
    return (bin & inside) | ((grid.size + i % stray_bins) & ~inside);
}

FEWRAYS_CLONES void hit_bins(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y,
                             const float* FEWRAYS_RESTRICT u, const float* FEWRAYS_RESTRICT v,
                             const float* FEWRAYS_RESTRICT c, int n, const BinGrid& grid,
                             std::int32_t* FEWRAYS_RESTRICT bins) {
    const BinGrid local = grid;
    if (local.bins_per_cell > 1)
        for (int i = 0; i < n; ++i) bins[i] = bin_of<true>(x[i] - c[i] * u[i], y[i] - c[i] * v[i], local, i);
    else
        for (int i = 0; i < n; ++i) bins[i] = bin_of<false>(x[i] - c[i] * u[i], y[i] - c[i] * v[i], local, i);
}

// The first of the two by two bins of a coarse layer that a hit is shared between, and how far it lies towards the
// others. A light that is small beside the bins keeps its place in this way.
FEWRAYS_CLONES void hit_corners(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y,
                                const float* FEWRAYS_RESTRICT u, const float* FEWRAYS_RESTRICT v,
                                const float* FEWRAYS_RESTRICT c, int n, const BinGrid& grid,
                                std::int32_t* FEWRAYS_RESTRICT bins, float* FEWRAYS_RESTRICT right,
                                float* FEWRAYS_RESTRICT down) {
    const float left = grid.left, top = grid.top, per_pixel = grid.per_pixel;
    const auto last_x = static_cast<float>(grid.columns - 1), last_y = static_cast<float>(grid.rows - 1);
    const std::int32_t stride = grid.stride, size = grid.size;
    for (int i = 0; i < n; ++i) {
        const float qx = (x[i] - c[i] * u[i] - left) * per_pixel - 0.5f;
        const float qy = (y[i] - c[i] * v[i] - top) * per_pixel - 0.5f;
        const std::int32_t inside = -(static_cast<std::int32_t>(qx >= 0.0f) & static_cast<std::int32_t>(qx < last_x) &
                                      static_cast<std::int32_t>(qy >= 0.0f) & static_cast<std::int32_t>(qy < last_y));
        const float in_x = inside ? qx : 0.0f, in_y = inside ? qy : 0.0f;
        const auto column = static_cast<std::int32_t>(in_x), row = static_cast<std::int32_t>(in_y);
        right[i] = share_of(in_x - static_cast<float>(column));
        down[i] = share_of(in_y - static_cast<float>(row));
        bins[i] = ((row * stride + column) & inside) | (size & ~inside);
    }
}

// Calls visit(k, lane) for all k < n, those of four lanes by turns: neighbours often fall into the same bin, and to
// read what has only just been written takes long.
constexpr int lanes = 4;

template <typename Visit>
FEWRAYS_INLINE void visit_by_turns(int n, Visit&& visit) {
    const int each = n / lanes;
    for (int i = 0; i < each; ++i)
        for (int lane = 0; lane < lanes; ++lane) visit(lane * each + i, lane);
    for (int k = lanes * each; k < n; ++k) visit(k, lanes - 1);
}

void count_each(const std::int32_t* bins, int n, float* holes) {
    visit_by_turns(n, [=](int k, int) { holes[bins[k]] += 1.0f; });
}

void add_each(const float* color, const std::int32_t* bins, int n, float* hits) {
    visit_by_turns(n, [=](int k, int) {
        float* const hit = hits + std::ptrdiff_t{hit_channels} * bins[k];
        float sum[hit_channels];  // all of it before any is stored: else compilers add one channel after the other
        for (int channel = 0; channel < hit_channels; ++channel)
            sum[channel] = hit[channel] + color[hit_channels * k + channel];
        std::copy_n(sum, hit_channels, hit);
    });
}

// Adds colours to two by two bins each, but those of strays.
FEWRAYS_CLONES void share(const float* FEWRAYS_RESTRICT color, const std::int32_t* FEWRAYS_RESTRICT bins,
                          const float* FEWRAYS_RESTRICT right, const float* FEWRAYS_RESTRICT down, int n,
                          std::int32_t stray, std::ptrdiff_t line, float* FEWRAYS_RESTRICT hits) {
    visit_by_turns(n, [=](int k, int) {
        if (bins[k] == stray) return;
        float pair[2 * hit_channels];  // to the left and to the right
        for (int channel = 0; channel < hit_channels; ++channel) {
            pair[channel] = (1 - right[k]) * color[hit_channels * k + channel];
            pair[hit_channels + channel] = right[k] * color[hit_channels * k + channel];
        }
        float* FEWRAYS_RESTRICT const above = hits + std::ptrdiff_t{hit_channels} * bins[k];
        float* FEWRAYS_RESTRICT const below = above + line;
        for (int i = 0; i < 2 * hit_channels; ++i) above[i] += (1 - down[k]) * pair[i];
        for (int i = 0; i < 2 * hit_channels; ++i) below[i] += down[k] * pair[i];
    });
}

// Holes of coarse layers are scattered over as much of the bins, on average, as shared hits are: otherwise these would
// widen what they cover.
FEWRAYS_CLONES void hole_bins(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y,
                              const float* FEWRAYS_RESTRICT u, const float* FEWRAYS_RESTRICT v, float c, int n,
                              const BinGrid& grid, std::int32_t* FEWRAYS_RESTRICT bins) {
    const BinGrid local = grid;
    const float spread = local.hole_spread;
    if (local.bins_per_cell > 1)
        for (int i = 0; i < n; ++i) bins[i] = bin_of<true>(x[i] - c * u[i], y[i] - c * v[i], local, i);
    else if (spread > 0)
        for (int i = 0; i < n; ++i)
            bins[i] = bin_of<false>(x[i] - c * u[i] + spread * scramble(u[i]),
                                    y[i] - c * v[i] + spread * scramble(v[i]), local, i);
    else
        for (int i = 0; i < n; ++i) bins[i] = bin_of<false>(x[i] - c * u[i], y[i] - c * v[i], local, i);
}

// Has memory fetched that is needed soon: runs are too short for the processor to see the pattern.
void ask_for(const float* values, int count) {
    constexpr int line = 64 / sizeof(float);
    for (int i = 0; i < count; i += line) FEWRAYS_PREFETCH(values + i);
}

// Pairs of coordinates, from a corner.
FEWRAYS_CLONES void split_pairs(const float* FEWRAYS_RESTRICT pairs, int n, float left, float top,
                                float* FEWRAYS_RESTRICT x, float* FEWRAYS_RESTRICT y) {
    for (int i = 0; i < n; ++i) {
        x[i] = pairs[2 * i] - left;
        y[i] = pairs[2 * i + 1] - top;
    }
}

// Weighs every bin by how well it is known instead of by the samples in it, so that clusters of samples count no
// more than their place: hits become shares of the bin, holes its weight. `seen` is 1 where samples are enough to tell
// that the place is not hidden.
FEWRAYS_CLONES void weigh_by_place(float* FEWRAYS_RESTRICT hits, float* FEWRAYS_RESTRICT holes,
                                   float* FEWRAYS_RESTRICT seen, int size, float for_weight, float for_seen) {
    for (int i = 0; i < size; ++i) {
        const float count = hits[hit_channels * i + 3] + holes[i];
        const float weight = std::min(count * for_weight, 1.0f);
        const float scale = std::min(for_weight, 1.0f / std::max(count, min_weight));
        for (int channel = 0; channel < hit_channels; ++channel) hits[hit_channels * i + channel] *= scale;
        holes[i] = weight;
        seen[i] = std::min(count * for_seen, 1.0f);
    }
}

// Opacity, red, green and blue, each on its own.
FEWRAYS_CLONES void separate(const float* FEWRAYS_RESTRICT hits, float* FEWRAYS_RESTRICT planes, std::ptrdiff_t plane,
                             int n) {
    for (int i = 0; i < n; ++i) {
        planes[i] = hits[hit_channels * i + 3];
        planes[plane + i] = hits[hit_channels * i];
        planes[2 * plane + i] = hits[hit_channels * i + 1];
        planes[3 * plane + i] = hits[hit_channels * i + 2];
    }
}

FEWRAYS_CLONES void add(const float* FEWRAYS_RESTRICT values, float* FEWRAYS_RESTRICT to, std::ptrdiff_t n) {
    for (std::ptrdiff_t i = 0; i < n; ++i) to[i] += values[i];
}

// Divides opacity and radiance by the weight that was blurred along with them.
FEWRAYS_CLONES void normalise(const float* FEWRAYS_RESTRICT weight, const float* FEWRAYS_RESTRICT blurred,
                              float* FEWRAYS_RESTRICT out, std::ptrdiff_t plane) {
    for (std::ptrdiff_t i = 0; i < plane; ++i) {
        const float reciprocal = weight[i] > min_weight ? 1.0f / std::max(weight[i], min_weight) : 0.0f;
        for (int channel = 0; channel < hit_channels; ++channel)
            out[channel * plane + i] = reciprocal * blurred[channel * plane + i];
    }
}

// Scales how much is known to what it would be were nothing hidden.
FEWRAYS_CLONES void scale_known(const float* FEWRAYS_RESTRICT blurred, float* FEWRAYS_RESTRICT out,
                                std::ptrdiff_t plane, float scale) {
    for (std::ptrdiff_t i = 0; i < plane; ++i) out[i] = std::min(blurred[i] * scale, 1.0f);
}

}  // namespace

bool LayerTarget::want(float grid_left, float grid_top, int grid_rows, int grid_columns, float origin_x,
                       float origin_y) {
    // Hits of coarse layers are shared with the next bins, and splines read bins on all sides.
    const float beyond = cell > 1.0f ? 4.0f : 2.0f;
    const float around = static_cast<float>(taps_beside) * cell / static_cast<float>(bins_per_cell) + beyond * cell;
    const auto cells = [&](float from, float to, float start, int count) {
        const float last = static_cast<float>(count);
        const float first_cell = std::floor(std::clamp((from - around - start) / cell, 0.0f, last));
        const float end_cell = std::ceil(std::clamp((to + around - start) / cell, 0.0f, last));
        return std::pair(static_cast<int>(first_cell), static_cast<int>(end_cell));
    };
    const auto [first_column, end_column] = cells(extent.x_min, extent.x_max, grid_left + origin_x, grid_columns);
    const auto [first_row, end_row] = cells(extent.y_min, extent.y_max, grid_top + origin_y, grid_rows);
    left = grid_left + static_cast<float>(first_column) * cell;
    top = grid_top + static_cast<float>(first_row) * cell;
    rows = end_row - first_row;
    columns = end_column - first_column;
    return rows > 0 && columns > 0;
}

void LayerTarget::lay_out() {
    margin = (taps() / 2 - bins_per_cell / 2 + bins_per_cell - 1) / bins_per_cell;
    if (cell > 1.0f) ++margin;  // shared hits begin one earlier
    width = whole_groups(columns);
    segment = whole_groups(width + 2 * margin);
    stride = segment * bins_per_cell;
    bin_rows = (rows + 2 * margin) * bins_per_cell;
    size = bin_rows * stride;
}

Rectangle LayerTarget::catchment() const {
    const float around = static_cast<float>(margin) * cell;
    const Rectangle window{left - around, left + static_cast<float>(columns) * cell + around, top - around,
                           top + static_cast<float>(rows) * cell + around};
    return window.grown(reach);
}

float farthest_part(const LayeredPlan& plan) {
    float farthest = 0;
    for (int i = 0; i < plan.part_count; ++i)
        farthest = std::max({farthest, std::fabs(plan.parts[3 * i]), std::fabs(plan.parts[3 * i + 1])});
    return farthest;
}

const CoarseMap& map_of_layer(const CoarseMap* maps, int count, int layer) {
    return *std::find_if(maps, maps + count, [&](const CoarseMap& map) { return map.layer == layer; });
}

LayerMaps::LayerMaps(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan)
    : samples_(samples),
      blocks_(blocks),
      plan_(plan),
      index_(samples, blocks.extents, blocks.block),
      lookup_(plan.boundaries, plan.layer_count - 1),
      part_reach_(farthest_part(plan) + static_cast<float>(taps_reach * std::sqrt(plan.widths.part))),
      key_(batch_size),
      place_(batch_size),
      color_(std::size_t{hit_channels} * batch_size, 1.0f),  // the count of a sample stays 1
      bins_(batch_size) {
    for (auto* field : {&slope_, &x_, &y_, &u_, &v_, &c_, &right_, &down_}) field->resize(batch_size);
    for (auto* field : {&xy_, &uv_}) field->resize(2 * batch_size);
}

std::vector<LayerTarget> LayerMaps::layers_near(const Rectangle& pixels, int first_level, int last_level) const {
    const int layers = plan_.layer_count;
    std::vector<std::int64_t> counts(layers);
    std::vector<double> sums(layers);
    std::vector<Rectangle> extents(layers, {INFINITY, -INFINITY, INFINITY, -INFINITY});
    std::vector<Rectangle> neighbourhoods;
    Rectangle all = pixels;
    for (int layer = 0; layer < layers; ++layer) {
        neighbourhoods.push_back(pixels.grown(plan_.reaches[layer] * (1 + part_reach_) + tail));
        all.include(neighbourhoods.back());
    }
    index_.visit(all, [&](int row, int column) {
        const std::ptrdiff_t block = (std::ptrdiff_t{row} * index_.columns() + column) * layers;
        const Extent& box = index_.at(row, column);
        for (int layer = 0; layer < layers; ++layer) {
            if (blocks_.counts[block + layer] == 0 || !neighbourhoods[layer].meets(box)) continue;
            counts[layer] += blocks_.counts[block + layer];
            sums[layer] += double{blocks_.slope_sums[block + layer]};
            extents[layer].include(box);
        }
    });

    std::vector<LayerTarget> targets;
    for (int layer = 0; layer < layers; ++layer) {
        const int level = plan_.levels[layer];
        if (counts[layer] == 0 || level < first_level || level > last_level) continue;
        LayerTarget target{};
        target.layer = layer;
        target.slope = static_cast<float>(sums[layer] / static_cast<double>(counts[layer]));
        target.reach = plan_.reaches[layer];
        target.extent = extents[layer].grown(target.reach);
        target.near = level < 0;
        target.bins_per_cell = target.near ? 1 << -level : 1;
        target.first_distance = target.near ? 0.5 : 0.0;
        target.cell = level > 0 ? static_cast<float>(1 << level) : 1.0f;
        target.blur_variance = layer_blur_variance(level, target.slope, plan_.widths);
        target.taps_beside = tap_count(target.blur_variance, target.first_distance);
        targets.push_back(std::move(target));
    }
    return targets;
}

std::vector<FilteredMap> LayerMaps::filter(std::vector<LayerTarget>& targets, float left, float top) {
    scratch_.clear();
    scattered_.clear();
    for (LayerTarget& target : targets) {
        target.lay_out();
        const std::size_t count = static_cast<std::size_t>(target.size) + stray_bins;
        const std::size_t numbers = (1 + hit_channels) * count;
        scattered_.push_back({scratch_.take(numbers), count});
        std::fill_n(scattered_.back().values, numbers, 0.0f);
    }
    scatter(targets, left, top);
    std::vector<FilteredMap> maps;
    for (std::size_t i = 0; i < targets.size(); ++i) maps.push_back(blur(targets[i], scattered_[i]));
    return maps;
}

// Visits every block that may matter to a target, and scatters a batch of samples at a time.
void LayerMaps::scatter(const std::vector<LayerTarget>& targets, float left, float top) {
    // Samples are sorted by a key that is odd for the targets' own samples and even in between.
    key_of_layer_.resize(plan_.layer_count);
    std::size_t next = 0;
    for (int layer = 0; layer < plan_.layer_count; ++layer) {
        const bool own = next < targets.size() && targets[next].layer == layer;
        key_of_layer_[layer] = static_cast<std::int32_t>(2 * next + own);
        next += own;
    }
    Rectangle all{INFINITY, -INFINITY, INFINITY, -INFINITY};
    std::vector<Rectangle> catchments;
    for (const LayerTarget& target : targets) {
        Rectangle area = target.catchment();
        area = {area.x_min + left, area.x_max + left, area.y_min + top, area.y_max + top};
        catchments.push_back(area);
        all.include(area);
    }
    std::vector<char> matters(targets.size()), wanted(targets.size());  // to whom: a block, the batch
    int space = batch_size;
    const auto flush = [&] {
        sort_batch(static_cast<int>(targets.size()), left, top);
        scatter_batch(targets, wanted);
        runs_.clear();
        space = batch_size;
    };
    index_.visit(all, [&](int block_row, int block_column) {
        const Extent& extent = index_.at(block_row, block_column);
        const int deepest = deepest_layer(block_row, block_column);
        bool any = false;
        for (std::size_t i = 0; i < targets.size(); ++i) {
            matters[i] = targets[i].layer <= deepest && catchments[i].meets(extent);
            wanted[i] |= matters[i];
            any |= matters[i];
        }
        if (!any) return;
        const int block = blocks_.block;
        const int i_end = std::min((block_row + 1) * block, samples_.height);
        const int j_end = std::min((block_column + 1) * block, samples_.width);
        for (int i = block_row * block; i < i_end; ++i) {
            const std::ptrdiff_t pixel = std::ptrdiff_t{i} * samples_.width;
            const std::ptrdiff_t end = (pixel + j_end) * samples_.spp;
            for (std::ptrdiff_t k = (pixel + block_column * block) * samples_.spp; k < end;) {
                const auto count = static_cast<int>(std::min<std::ptrdiff_t>(end - k, space));
                runs_.push_back({k, count});
                ask_for(samples_.depth + k, count);
                ask_for(samples_.xy + 2 * k, 2 * count);
                ask_for(samples_.uv + 2 * k, 2 * count);
                ask_for(samples_.color + 3 * k, 3 * count);
                k += count;
                space -= count;
                if (space > 0) continue;
                flush();
                wanted = matters;
            }
        }
    });
    if (!runs_.empty()) flush();
}

// Of the layers that a block has samples of, the last: what lies in front of a layer says nothing about it.
int LayerMaps::deepest_layer(int block_row, int block_column) const {
    const std::ptrdiff_t block = std::ptrdiff_t{block_row} * index_.columns() + block_column;
    const std::int32_t* const counts = blocks_.counts + block * plan_.layer_count;
    int layer = plan_.layer_count - 1;
    while (layer >= 0 && counts[layer] == 0) --layer;
    return layer;
}

// Sorts a batch by key. Samples in front of all targets come last: they say nothing about them.
void LayerMaps::sort_batch(int target_count, float left, float top) {
    int n = 0;
    for (const Run& run : runs_) {
        lookup_.run(samples_.depth + run.first, run.count, samples_.c0, samples_.c1, &slope_[n], &key_[n]);
        n += run.count;
    }
    for (int i = 0; i < n; ++i) key_[i] = key_of_layer_[key_[i]];
    find_places(n, 2 * target_count + 1);
    n = 0;
    for (const Run& run : runs_) {
        put_in_place(run.first, run.count, n);
        n += run.count;
    }
    split_pairs(xy_.data(), n, left, top, x_.data(), y_.data());
    split_pairs(uv_.data(), n, 0.0f, 0.0f, u_.data(), v_.data());
}

// Where each sample of a batch goes, and where each key starts.
void LayerMaps::find_places(int n, int keys) {
    start_.assign(keys + 1, 0);
    cursors_.assign(std::size_t{lanes} * keys, 0);
    std::int32_t *const key = key_.data(), *const place = place_.data(), *const cursors = cursors_.data();
    visit_by_turns(n, [=](int k, int lane) { ++cursors[lane * keys + key[k]]; });
    std::int32_t next = 0;
    for (int i = 1; i <= keys; ++i) {
        start_[i] = next;
        for (int lane = 0; lane < lanes; ++lane) next += std::exchange(cursors[lane * keys + i % keys], next);
    }
    visit_by_turns(n, [=](int k, int lane) { place[k] = cursors[lane * keys + key[k]]++; });
}

// Moves samples, of which the first is that of number `from` in its batch.
void LayerMaps::put_in_place(std::ptrdiff_t first, int count, int from) {
    const float* const xy = samples_.xy + 2 * first;
    const float* const uv = samples_.uv + 2 * first;
    const float* const rgb = samples_.color + 3 * first;
    for (int i = 0; i < count; ++i) {
        const std::ptrdiff_t place = place_[from + i];
        std::memcpy(&xy_[2 * place], xy + 2 * i, 2 * sizeof(float));
        std::memcpy(&uv_[2 * place], uv + 2 * i, 2 * sizeof(float));
        std::memcpy(&color_[hit_channels * place], rgb + 3 * i, 3 * sizeof(float));
        c_[place] = slope_[from + i];
    }
}

// A target's own samples are hits, all behind it are holes (Algorithm 1 of the paper).
void LayerMaps::scatter_batch(const std::vector<LayerTarget>& targets, const std::vector<char>& wanted) {
    const int end = start_[2 * targets.size() + 1];
    for (std::size_t i = 0; i < targets.size(); ++i) {
        if (!wanted[i]) continue;
        const LayerTarget& target = targets[i];
        const auto around = static_cast<float>(target.margin) * target.cell;
        const BinGrid grid{target.left - around, target.top - around, 1.0f / target.cell,
                           target.bins_per_cell, target.segment,      target.rows + 2 * target.margin,
                           target.stride,        target.size,         target.cell > 1.0f ? target.cell : 0.0f};
        const int hit = start_[2 * i + 1], hole = start_[2 * i + 2];
        if (target.cell > 1.0f)
            share_hits(scattered_[i], grid, hit, hole - hit);
        else
            add_hits(scattered_[i], grid, hit, hole - hit);
        hole_bins(&x_[hole], &y_[hole], &u_[hole], &v_[hole], target.slope, end - hole, grid, bins_.data());
        count_each(bins_.data(), end - hole, scattered_[i].holes());
    }
}

void LayerMaps::add_hits(const Bins& to, const BinGrid& grid, int first, int n) {
    hit_bins(&x_[first], &y_[first], &u_[first], &v_[first], &c_[first], n, grid, bins_.data());
    add_each(&color_[std::size_t{hit_channels} * first], bins_.data(), n, to.hits());
}

void LayerMaps::share_hits(const Bins& to, const BinGrid& grid, int first, int n) {
    hit_corners(&x_[first], &y_[first], &u_[first], &v_[first], &c_[first], n, grid, bins_.data(), right_.data(),
                down_.data());
    share(&color_[std::size_t{hit_channels} * first], bins_.data(), right_.data(), down_.data(), n, grid.size,
          std::ptrdiff_t{hit_channels} * grid.stride, to.hits());
}

// Some rows of the result at a time, so that what passes from one step to the next stays in the cache. The map comes to
// lie where the bins were.
FilteredMap LayerMaps::blur(const LayerTarget& target, const Bins& bins) {
    const bool by_place = plan_.levels[target.layer] >= plan_.finest_by_place;
    const float bin = target.cell / static_cast<float>(target.bins_per_cell);
    const float samples = static_cast<float>(samples_.spp) * bin * bin;
    if (by_place) seen_.resize(target.size);
    make_taps(target);
    const std::ptrdiff_t plane = std::ptrdiff_t{target.rows} * target.width;
    const std::size_t strip = std::size_t{rows_at_once} * target.stride + columns_at_once;
    columns_blurred_.resize(hit_channels * strip);
    planes_.resize(hit_channels * strip);
    blurred_.resize(static_cast<std::size_t>(channel_count * plane));
    weight_.resize(static_cast<std::size_t>(plane));
    std::ptrdiff_t weighed = 0;
    for (int row = 0; row < target.rows; row += rows_at_once) {
        const int rows = std::min(rows_at_once, target.rows - row);
        if (by_place) {
            const std::ptrdiff_t end_row = (row + rows - 1) * target.bins_per_cell + target.first_tap() + target.taps();
            weigh_by_place(bins.hits() + hit_channels * weighed, bins.holes() + weighed, seen_.data() + weighed,
                           static_cast<int>(end_row * target.stride - weighed), 1 / (plan_.full_weight * samples),
                           1 / (plan_.seen * samples));
            weighed = end_row * target.stride;
        }
        float* const out = &blurred_[static_cast<std::size_t>(row) * target.width];
        blur_counts(target, bins.holes(), row, rows, &weight_[static_cast<std::size_t>(row) * target.width]);
        if (!target.near) blur_counts(target, seen_.data(), row, rows, out);
        blur_hits(target, bins.hits(), row, rows, out + plane, plane);
    }

    const FilteredMap map{bins.values, target.rows, target.width};
    if (!by_place) add(&blurred_[static_cast<std::size_t>(plane)], weight_.data(), plane);
    if (!target.near) {
        const double expected = static_cast<double>(samples_.spp) * target.cell * target.cell;
        scale_known(blurred_.data(), map.channel(known), plane, static_cast<float>(1 / (1 - std::exp(-expected))));
    }
    normalise(weight_.data(), &blurred_[static_cast<std::size_t>(plane)], map.channel(opacity), plane);
    return map;
}

// Rows [row, row + rows) of a result of one number a bin.
void LayerMaps::blur_counts(const LayerTarget& target, const float* counts, int row, int rows, float* out) {
    const std::ptrdiff_t line = target.stride, step = target.bins_per_cell * line;
    blur_pass(counts + target.first_tap() * line + row * step, step, planes_.data(), rows, target.stride, taps_.data(),
              tap_rows_.data(), static_cast<int>(taps_.size()));
    blur_pass(planes_.data(), line, out, rows, target.width, taps_.data(), tap_columns_.data(),
              static_cast<int>(taps_.size()));
}

// The same for opacity and radiance, `plane` apart: along columns while those of a bin still lie side by side, then, on
// the few rows that are left, along rows.
void LayerMaps::blur_hits(const LayerTarget& target, const float* hits, int row, int rows, float* out,
                          std::ptrdiff_t plane) {
    const std::ptrdiff_t line = target.stride, step = hit_channels * target.bins_per_cell * line, strip = line * rows;
    blur_pass(hits + hit_channels * target.first_tap() * line + row * step, step, columns_blurred_.data(), rows,
              hit_channels * target.stride, taps_.data(), tap_hit_rows_.data(), static_cast<int>(taps_.size()));
    separate(columns_blurred_.data(), planes_.data(), strip, static_cast<int>(strip));
    for (int channel = 0; channel < hit_channels; ++channel)
        blur_pass(planes_.data() + channel * strip, line, out + channel * plane, rows, target.width, taps_.data(),
                  tap_columns_.data(), static_cast<int>(taps_.size()));
}

void LayerMaps::make_taps(const LayerTarget& target) {
    const int count = target.taps();
    taps_.resize(count);
    for (auto* offsets : {&tap_columns_, &tap_rows_, &tap_hit_rows_}) offsets->resize(count);
    float* const right = taps_.data() + count - target.taps_beside;
    gaussian_taps(target.blur_variance, target.first_distance, target.taps_beside, right);
    for (int k = 0; k < target.taps_beside; ++k) taps_[target.taps_beside - 1 - k] = right[k];
    for (int k = 0; k < count; ++k) {
        const int bin = target.first_tap() + k;
        tap_columns_[k] = bin % target.bins_per_cell * target.segment + bin / target.bins_per_cell;
        tap_rows_[k] = std::ptrdiff_t{k} * target.stride;
        tap_hit_rows_[k] = hit_channels * tap_rows_[k];
    }
}

}  // namespace fewrays
