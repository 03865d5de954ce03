#include "layered.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "layer_maps.h"
#include "scratch.h"
#include "separable_blur.h"
#include "simd.h"

namespace fewrays {
namespace {

// Pixels that are composited at a time, to stay in the first cache.
constexpr int patch_rows = 8, patch_columns = 128;
constexpr int patch_area = patch_rows * patch_columns;
constexpr float min_opacity = 1e-3f;
constexpr float min_covered = 1e-3f;
constexpr float min_weight = 1e-12f;
constexpr float opaque = 1e-6f;  // of what shows through less, not even a light is seen
constexpr int any_level = 100;   // more levels than there are

// A layer's map as seen through one part of the aperture.
struct LayerView {
    const float* channels[channel_count];  // at the first pixel
    std::ptrdiff_t stride;
    float fraction_x, fraction_y;  // of the way to the next cell
    float shear;                   // pixels that the layer moves for one standard deviation of the part
};

// How much of what is behind shows, to first order in the place on the lens: a mean, and a slope for each standard
// deviation of the part of the aperture, in rows of `patch_columns`; and the sums of what has shown so far, in rows
// of `stride`.
struct Shown {
    float *mean, *along_u, *along_v;
    float *opacity, *red, *green, *blue;
    int rows, columns, stride;
    float weight;
};

struct Interpolated {
    float value, step_x, step_y;
};

// At the corners of a cell: p and q = p + 1, and the same in the row below.
FEWRAYS_INLINE Interpolated interpolate(float p, float q, float p_below, float q_below, float fx, float fy) {
    const float upper = q - p, lower = q_below - p_below;
    const float top = p + fx * upper, bottom = p_below + fx * lower;
    return {top + fy * (bottom - top), upper + fy * (lower - upper), bottom - top};
}

// One row of composite().
FEWRAYS_INLINE void composite_row(const float* FEWRAYS_RESTRICT seen, const float* FEWRAYS_RESTRICT covers,
                                  const float* FEWRAYS_RESTRICT r, const float* FEWRAYS_RESTRICT g,
                                  const float* FEWRAYS_RESTRICT b, std::ptrdiff_t stride, float fx, float fy,
                                  float shear, int columns, float weight, float* FEWRAYS_RESTRICT mean,
                                  float* FEWRAYS_RESTRICT along_u, float* FEWRAYS_RESTRICT along_v,
                                  float* FEWRAYS_RESTRICT sum_opacity, float* FEWRAYS_RESTRICT sum_red,
                                  float* FEWRAYS_RESTRICT sum_green, float* FEWRAYS_RESTRICT sum_blue) {
    for (int i = 0; i < columns; ++i) {
        const float t = mean[i], u = along_u[i], v = along_v[i];
        const Interpolated a =
            interpolate(covers[i], covers[i + 1], covers[i + stride], covers[i + stride + 1], fx, fy);
        const float covered = std::max(1.0f - t, min_covered), cover = std::max(a.value, min_weight);
        const float reciprocal = 1.0f / (covered * cover);  // of both at the price of one
        const float spare = (seen[i] - t) * cover * reciprocal;
        // A map's very edge has a slope but nothing to see.
        const float counts = a.value > min_weight ? shear * std::min(std::max(spare, 0.0f), 1.0f) : 0.0f;
        const float with_u = counts * u, with_v = counts * v;

        const float unclamped = t * a.value + with_u * a.step_x + with_v * a.step_y;
        const float visible = std::min(std::max(unclamped, std::max(t + a.value - 1.0f, 0.0f)), std::min(t, a.value));
        // What the clamp adds or takes away has the layer's mean radiance.
        const float alone = t + (visible - unclamped) * covered * reciprocal;
        sum_opacity[i] += weight * visible;
        const Interpolated er = interpolate(r[i], r[i + 1], r[i + stride], r[i + stride + 1], fx, fy);
        sum_red[i] += weight * std::max(alone * er.value + with_u * er.step_x + with_v * er.step_y, 0.0f);
        const Interpolated eg = interpolate(g[i], g[i + 1], g[i + stride], g[i + stride + 1], fx, fy);
        sum_green[i] += weight * std::max(alone * eg.value + with_u * eg.step_x + with_v * eg.step_y, 0.0f);
        const Interpolated eb = interpolate(b[i], b[i + 1], b[i + stride], b[i + stride + 1], fx, fy);
        sum_blue[i] += weight * std::max(alone * eb.value + with_u * eb.step_x + with_v * eb.step_y, 0.0f);

        const float clear = 1.0f - a.value, moved = t * shear;
        along_u[i] = u * clear - moved * a.step_x;
        along_v[i] = v * clear - moved * a.step_y;
        mean[i] = std::max(t - visible, 0.0f);
    }
}

FEWRAYS_CLONES float largest(const float* values, std::ptrdiff_t n) {
    float best[columns_at_once] = {};
    for (std::ptrdiff_t i = 0; i < n; i += columns_at_once)
        for (int k = 0; k < columns_at_once; ++k) best[k] = std::max(best[k], values[i + k]);
    return *std::max_element(best, best + columns_at_once);
}

// Adds a layer behind what is there: the mean over the part of visibility times radiance is the product of the means
// plus the covariance, to first order. What no ray has seen behind a cover is known only where the cover lets it
// through: there the means already belong together, so the covariance counts by how much more is known.
FEWRAYS_CLONES void composite(const LayerView& view, const Shown& shown) {
    for (int row = 0; row < shown.rows; ++row) {
        const std::ptrdiff_t in = row * view.stride, behind = std::ptrdiff_t{row} * patch_columns,
                             out = std::ptrdiff_t{row} * shown.stride;
        composite_row(view.channels[known] + in, view.channels[opacity] + in, view.channels[red] + in,
                      view.channels[green] + in, view.channels[blue] + in, view.stride, view.fraction_x,
                      view.fraction_y, view.shear, shown.columns, shown.weight, shown.mean + behind,
                      shown.along_u + behind, shown.along_v + behind, shown.opacity + out, shown.red + out,
                      shown.green + out, shown.blue + out);
    }
}

FEWRAYS_INLINE void composite_near_row(const float* FEWRAYS_RESTRICT covers, const float* FEWRAYS_RESTRICT r,
                                       const float* FEWRAYS_RESTRICT g, const float* FEWRAYS_RESTRICT b, int columns,
                                       float weight, float* FEWRAYS_RESTRICT mean, float* FEWRAYS_RESTRICT along_u,
                                       float* FEWRAYS_RESTRICT along_v, float* FEWRAYS_RESTRICT sum_opacity,
                                       float* FEWRAYS_RESTRICT sum_red, float* FEWRAYS_RESTRICT sum_green,
                                       float* FEWRAYS_RESTRICT sum_blue) {
    for (int i = 0; i < columns; ++i) {
        const float t = weight * mean[i], clear = 1.0f - covers[i];
        sum_opacity[i] += t * covers[i];
        sum_red[i] += t * r[i];
        sum_green[i] += t * g[i];
        sum_blue[i] += t * b[i];
        mean[i] *= clear;
        along_u[i] *= clear;
        along_v[i] *= clear;
    }
}

// The same for a layer near focus, which hardly moves over the lens.
FEWRAYS_CLONES void composite_near(const LayerView& view, const Shown& shown) {
    for (int row = 0; row < shown.rows; ++row) {
        const std::ptrdiff_t in = row * view.stride, behind = std::ptrdiff_t{row} * patch_columns,
                             out = std::ptrdiff_t{row} * shown.stride;
        composite_near_row(view.channels[opacity] + in, view.channels[red] + in, view.channels[green] + in,
                           view.channels[blue] + in, shown.columns, shown.weight, shown.mean + behind,
                           shown.along_u + behind, shown.along_v + behind, shown.opacity + out, shown.red + out,
                           shown.green + out, shown.blue + out);
    }
}

// Grows the box around samples, limits their slopes, and takes samples too far outside the image from their layers.
FEWRAYS_CLONES void survey_run(const float* FEWRAYS_RESTRICT xy, int n, float left_top, float right, float bottom,
                               std::int32_t no_layer, Extent& box, float* FEWRAYS_RESTRICT slopes,
                               std::int32_t* FEWRAYS_RESTRICT layers) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    constexpr int lanes = 16;  // each with a box of its own: the compiler keeps to the order of a single one
    float x_min[lanes], x_max[lanes], y_min[lanes], y_max[lanes];
    for (int lane = 0; lane < lanes; ++lane) {
        x_min[lane] = y_min[lane] = infinity;
        x_max[lane] = y_max[lane] = -infinity;
    }
    const auto look = [&](int k, int lane) {
        const float x = xy[2 * k], y = xy[2 * k + 1];
        const bool near_image = (x >= left_top) & (x <= right) & (y >= left_top) & (y <= bottom);
        const float low_x = near_image ? x : infinity, high_x = near_image ? x : -infinity;
        const float low_y = near_image ? y : infinity, high_y = near_image ? y : -infinity;
        x_min[lane] = low_x < x_min[lane] ? low_x : x_min[lane];
        x_max[lane] = high_x > x_max[lane] ? high_x : x_max[lane];
        y_min[lane] = low_y < y_min[lane] ? low_y : y_min[lane];
        y_max[lane] = high_y > y_max[lane] ? high_y : y_max[lane];
        slopes[k] = std::min(std::max(slopes[k], -max_slope), max_slope);
        layers[k] = near_image ? layers[k] : no_layer;
    };
    int k = 0;
    for (; k + lanes <= n; k += lanes)
        for (int lane = 0; lane < lanes; ++lane) look(k + lane, lane);
    for (; k < n; ++k) look(k, 0);
    for (int lane = 0; lane < lanes; ++lane)
        box = {std::min(box.x_min, x_min[lane]), std::max(box.x_max, x_max[lane]), std::min(box.y_min, y_min[lane]),
               std::max(box.y_max, y_max[lane])};
}

// Columns [first, end) of a row.
struct Span {
    int first, end;
};

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

// Where a row of opacities is not zero.
FEWRAYS_CLONES Span occupied(const float* row, int columns) {
    int first = 0, end = columns;
    const auto empty = [&](int from) {
        float largest_here = 0;
        for (int i = 0; i < columns_at_once; ++i) largest_here = std::max(largest_here, row[from + i]);
        return largest_here <= 0.0f;
    };
    while (first < end && empty(first)) first += columns_at_once;
    while (first < end && empty((end - 1) / columns_at_once * columns_at_once))
        end = (end - 1) / columns_at_once * columns_at_once;
    return {first, std::max(first, end)};
}

// Reads a coarse layer's map between its bins, at every pixel of a rectangle, by quadratic B-splines: linear ones would
// flatten every peak.
class Magnifier {
public:
    // Returns a map in `scratch`. The first of the `rows` x `columns` pixels lies `row` and `column` pixels from the
    // first bin's corner; load(channel, row, first, count, out) reads some of the `bin_rows` x `bin_columns` bins,
    // beyond which the outermost go on.
    template <typename Load>
    FilteredMap run(int level, int row, int column, int rows, int columns, int bin_rows, int bin_columns,
                    Scratch& scratch, Load&& load) {
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
            const int begin = std::clamp(first - 1, 0, bin_columns - 1);
            const int end = std::clamp(first - 1 + loaded_bins, begin + 1, bin_columns);
            const int skipped = std::clamp(begin - (first - 1), 0, loaded_bins - 1);
            const int count = std::min(end - begin, loaded_bins - skipped);
            load(channel, std::clamp(bin_row, 0, bin_rows - 1), begin, count, line.data() + skipped);
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
                magnify_row(between_.data(), bins, size, weights.before.data(), weights.here.data(),
                            weights.after.data(), pixels_.data());
                float* const out = map.channel(channel) + std::ptrdiff_t{i} * map.stride;
                std::copy_n(pixels_.begin() + (column & (size - 1)), columns, out);
                std::fill(out + columns, out + map.stride, 0.0f);
            }
        return map;
    }

private:
    std::vector<float> lines_[3], between_, pixels_;
};

const float* bins_of(const CoarseMap& map, int channel, int row, int column) {
    return map.values + (std::ptrdiff_t{channel} * map.rows + row) * map.columns + column;
}

// One thread's working memory, and the stages of a tile in the order in which they run.
class TileReconstruction {
public:
    TileReconstruction(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan,
                       const CoarseMap* coarse, int coarse_count)
        : samples_(samples),
          plan_(plan),
          coarse_(coarse),
          coarse_count_(coarse_count),
          layer_maps_(samples, blocks, plan),
          width_(whole_groups(plan.tile)),
          offset_(farthest_part(plan)),
          transmittance_(std::size_t{3} * patch_area),
          sums_(std::size_t{4} * plan.tile * width_) {}

    void run(int tile, const LayeredOutput& output) {
        const int tile_columns = (samples_.width + plan_.tile - 1) / plan_.tile;
        const int top = tile / tile_columns * plan_.tile, left = tile % tile_columns * plan_.tile;
        find_maps(left, top);
        output.counts[tile] = static_cast<std::int32_t>(layers_.size());
        std::fill(sums_.begin(), sums_.end(), 0.0f);
        if (output.contributions) layer_sums_.assign(layers_.size() * sums_.size(), 0.0f);
        for (int row = 0; row < plan_.tile; row += patch_rows)
            for (int column = 0; column < plan_.tile; column += patch_columns)
                composite_patch(
                    {row, std::min(row + patch_rows, plan_.tile), column, std::min(column + patch_columns, plan_.tile)},
                    output.contributions != nullptr);
        store(left, top, output);
    }

private:
    // A map and where it lies, relative to the tile, in pixels.
    struct PlacedMap {
        int left, top, rows, columns;
        FilteredMap map;
        std::vector<Span> spans;  // of each row, where the layer is not transparent
    };

    struct TileLayer {
        int layer, level;
        float slope;
        bool near;
        int target;                     // of `targets_` that it comes from, or -1
        std::vector<PlacedMap> places;  // one for all parts of the aperture, or one for each

        const PlacedMap& seen_from(int part) const { return places.size() > 1 ? places[part] : places.front(); }
    };

    void find_maps(int left, int top) {
        const auto x = static_cast<float>(left), y = static_cast<float>(top), side = static_cast<float>(plan_.tile);
        std::vector<LayerTarget> all = layer_maps_.layers_near({x, x + side, y, y + side}, -any_level, any_level);
        layers_.clear();
        targets_.clear();
        scratch_.clear();
        for (LayerTarget& target : all) {
            const int level = plan_.levels[target.layer];
            const int border = target.near ? 0 : static_cast<int>(std::ceil(offset_ * std::fabs(target.slope))) + 1;
            TileLayer layer{target.layer, level, target.slope, target.near, -1, {}};
            if (level > plan_.deepest_tile_level && smaller_apart(border)) {
                place_apart(layer, left, top);
            } else {
                if (!place_together(layer, target, border, x, y)) continue;
                if (level > plan_.deepest_tile_level) {
                    if (!magnify_coarse(layer, layer.places.front(), left, top)) continue;
                } else {
                    layer.target = static_cast<int>(targets_.size());
                    targets_.push_back(std::move(target));
                }
            }
            layers_.push_back(std::move(layer));
        }
        filtered_ = layer_maps_.filter(targets_, x, y);
        for (TileLayer& layer : layers_) {
            if (layer.target >= 0) take_filtered(layer);
            for (PlacedMap& place : layer.places)
                for (int row = 0; row < place.rows; ++row)
                    place.spans.push_back(
                        occupied(place.map.channel(opacity) + std::ptrdiff_t{row} * place.map.stride, place.columns));
        }
    }

    // One map for the tile and a border that the parts of the aperture look into: the pixels that have bins on all
    // sides. False if the layer does not reach there.
    bool place_together(TileLayer& layer, LayerTarget& target, int border, float x, float y) const {
        const int size = layer.level > 0 ? 1 << layer.level : 1, edge = layer.level > 0 ? size : 0;
        const int bins = layer.level > 0 ? (border + edge + size - 1) / size : border;  // of the border
        const auto corner = static_cast<float>(-bins * size);
        const int span = (plan_.tile + size - 1) / size + 2 * bins;
        if (!target.want(corner, corner, span, span, x, y)) return false;
        layer.places.push_back({static_cast<int>(target.left) + edge,
                                static_cast<int>(target.top) + edge,
                                target.rows * size - 2 * edge,
                                target.columns * size - 2 * edge,
                                {},
                                {}});
        return layer.places.front().rows > 0 && layer.places.front().columns > 0;
    }

    // Whether maps for each part of the aperture are smaller than one with a border.
    bool smaller_apart(int border) const {
        const std::int64_t together = plan_.tile + 2 * border, apart = plan_.tile + 1;
        return together * together > plan_.part_count * apart * apart;
    }

    // A map for each part of the aperture.
    void place_apart(TileLayer& layer, int left, int top) {
        for (int part = 0; part < plan_.part_count; ++part) {
            const float u = plan_.parts[3 * part], v = plan_.parts[3 * part + 1];
            layer.places.push_back({static_cast<int>(std::floor(-layer.slope * u)),
                                    static_cast<int>(std::floor(-layer.slope * v)),
                                    plan_.tile + 1,
                                    plan_.tile + 1,
                                    {},
                                    {}});
            PlacedMap& place = layer.places.back();
            if (!magnify_coarse(layer, place, left, top)) place = {};
        }
    }

    // False if the layer is transparent all over the place.
    bool magnify_coarse(const TileLayer& layer, PlacedMap& place, int left, int top) {
        const CoarseMap& coarse = map_of_layer(coarse_, coarse_count_, layer.layer);
        top -= coarse.row << layer.level;
        left -= coarse.column << layer.level;
        if (!shrink(coarse, layer.level, top, left, place)) return false;
        place.map =
            magnifier_.run(layer.level, top + place.top, left + place.left, place.rows, place.columns, coarse.rows,
                           coarse.columns, scratch_, [&](int channel, int row, int first, int count, float* out) {
                               std::copy_n(bins_of(coarse, channel, row, first), count, out);
                           });
        return true;
    }

    // Leaves of the place what the map's opaque bins touch.
    bool shrink(const CoarseMap& coarse, int level, int top, int left, PlacedMap& place) {
        const int size = 1 << level;
        const auto bins = [&](int first_pixel, int pixels, int limit) {
            const int first = std::clamp(first_pixel / size - 2, 0, limit - 1);
            return Span{first, std::clamp((first_pixel + pixels) / size + 3, first + 1, limit)};
        };
        const Span rows = bins(top + place.top, place.rows, coarse.rows);
        const Span columns = bins(left + place.left, place.columns, coarse.columns);
        Span opaque_rows{rows.end, rows.first}, opaque_columns{columns.end, columns.first};
        for (int row = rows.first; row < rows.end; ++row) {
            const float* const bins_here = bins_of(coarse, opacity, row, 0);
            const auto transparent = [&](int column) { return bins_here[column] <= 0; };
            int first = columns.first, end = columns.end;
            while (first < end && transparent(first)) ++first;
            if (first == end) continue;
            while (transparent(end - 1)) --end;
            opaque_rows = {std::min(opaque_rows.first, row), row + 1};
            opaque_columns = {std::min(opaque_columns.first, first), std::max(opaque_columns.end, end)};
        }
        const auto pixels = [&](const Span& opaque_bins, int origin, int& first, int& count) {
            // One more on each side: a pixel is read along with the next.
            const int begin = std::max((opaque_bins.first - 1) * size - origin - 1, first);
            const int end = std::min((opaque_bins.end + 1) * size - origin + 1, first + count);
            first = begin;
            count = end - begin;
            return count > 0;
        };
        return pixels(opaque_rows, top, place.top, place.rows) &&
               pixels(opaque_columns, left, place.left, place.columns);
    }

    void take_filtered(TileLayer& layer) {
        const FilteredMap& bins = filtered_[layer.target];
        PlacedMap& place = layer.places.front();
        if (layer.level <= 0) {
            place.map = bins;
            return;
        }
        const int size = 1 << layer.level;
        place.map = magnifier_.run(
            layer.level, size, size, place.rows, place.columns, bins.rows, place.columns / size + 2, scratch_,
            [&](int channel, int row, int first, int count, float* out) {
                const float* const values = bins.channel(channel) + std::ptrdiff_t{row} * bins.stride + first;
                std::copy(values, values + count, out);
            });
    }

    struct Pixels {
        int top, bottom, left, right;
    };

    // Every part of the aperture sees the layers from where it is.
    void composite_patch(const Pixels& patch, bool separately) {
        std::size_t covered = layers_.size();  // layers after which the last part showed nothing more
        for (int part = 0; part < plan_.part_count; ++part) {
            const float* const place = plan_.parts + std::ptrdiff_t{3} * part;
            std::fill_n(transmittance_.begin(), patch_area, 1.0f);
            std::fill_n(transmittance_.begin() + patch_area, 2 * patch_area, 0.0f);
            for (std::size_t i = 0; i < layers_.size(); ++i) {
                composite_layer(layers_[i], layers_[i].seen_from(part), patch, place[0], place[1], place[2],
                                separately ? &layer_sums_[i * sums_.size()] : sums_.data());
                const bool worth_a_look = part == 0 || i + 1 >= covered;
                if (worth_a_look && largest(transmittance_.data(), patch_area) < opaque) {
                    covered = i + 1;
                    break;
                }
            }
        }
    }

    // The part of the patch that the layer's map reaches, seen from (u, v).
    void composite_layer(const TileLayer& layer, const PlacedMap& place, const Pixels& patch, float u, float v,
                         float weight, float* sums) {
        const FilteredMap& map = place.map;
        const int beyond = layer.near ? 0 : 1;  // cells that interpolation reads besides a pixel's own
        const float x = layer.near ? 0.0f : -layer.slope * u, y = layer.near ? 0.0f : -layer.slope * v;
        const int shift_x = static_cast<int>(std::floor(x)), shift_y = static_cast<int>(std::floor(y));
        const int top = std::max(place.top - shift_y, patch.top);
        const int bottom = std::min(place.top - shift_y + place.rows - beyond, patch.bottom);
        Span span{place.columns, 0};
        for (int i = top; i < bottom + beyond; ++i) {
            const Span& here = place.spans[i + shift_y - place.top];
            if (here.first < here.end) span = {std::min(span.first, here.first), std::max(span.end, here.end)};
        }
        const int offset = place.left - shift_x;
        int left = std::max(offset + std::max(span.first - beyond, 0), patch.left);
        int right = std::min(offset + std::min(span.end, place.columns - beyond), patch.right);
        if (left >= right || top >= bottom) return;
        // Whole groups of columns where there is room: the layer is transparent beyond its span.
        const int columns = whole_groups(right - left);
        if (left + columns <= std::min(patch.right, offset + map.stride - beyond))
            right = left + columns;
        else if (right - columns >= std::max(patch.left, offset))
            left = right - columns;

        LayerView view{{},
                       map.stride,
                       x - static_cast<float>(shift_x),
                       y - static_cast<float>(shift_y),
                       -layer.slope * static_cast<float>(std::sqrt(plan_.widths.part))};
        for (int channel = 0; channel < channel_count; ++channel)
            view.channels[channel] = map.channel(channel) + std::ptrdiff_t{top + shift_y - place.top} * map.stride +
                                     left + shift_x - place.left;
        const std::ptrdiff_t plane = std::ptrdiff_t{plan_.tile} * width_;
        float* const behind = transmittance_.data() + (top - patch.top) * patch_columns + left - patch.left;
        sums += std::ptrdiff_t{top} * width_ + left;
        const Shown shown{behind,
                          behind + patch_area,
                          behind + 2 * patch_area,
                          sums,
                          sums + plane,
                          sums + 2 * plane,
                          sums + 3 * plane,
                          bottom - top,
                          right - left,
                          width_,
                          weight};
        if (layer.near)
            composite_near(view, shown);
        else
            composite(view, shown);
    }

    // What is left transparent is missing data, not a dark background.
    void store(int left, int top, const LayeredOutput& output) {
        const std::ptrdiff_t plane = std::ptrdiff_t{plan_.tile} * width_;
        const int rows = std::min(plan_.tile, samples_.height - top);
        const int columns = std::min(plan_.tile, samples_.width - left);
        for (std::size_t layer = 0; output.contributions && layer < layers_.size(); ++layer)
            for (std::size_t i = 0; i < sums_.size(); ++i) sums_[i] += layer_sums_[layer * sums_.size() + i];
        for (int i = 0; i < rows; ++i)
            for (int j = 0; j < columns; ++j) {
                const std::ptrdiff_t at = std::ptrdiff_t{i} * width_ + j;
                const std::ptrdiff_t pixel = std::ptrdiff_t{top + i} * samples_.width + left + j;
                const float scale = sums_[at] > min_opacity ? 1.0f / sums_[at] : 1.0f;
                for (int channel = 0; channel < 3; ++channel)
                    output.image[3 * pixel + channel] = scale * sums_[(channel + 1) * plane + at];
                for (std::size_t layer = 0; output.contributions && layer < layers_.size(); ++layer) {
                    const float* const sums = &layer_sums_[layer * sums_.size()];
                    float* const target = output.contributions + (pixel * plan_.layer_count + layers_[layer].layer) * 4;
                    for (int channel = 0; channel < 3; ++channel)
                        target[channel] = scale * sums[(channel + 1) * plane + at];
                    target[3] = scale * sums[at];
                }
            }
    }

    const Samples& samples_;
    const LayeredPlan& plan_;
    const CoarseMap* const coarse_;
    const int coarse_count_;
    LayerMaps layer_maps_;
    Magnifier magnifier_;
    const int width_;     // of a tile's row in memory
    const float offset_;  // of the farthest part of the aperture, in lens units

    std::vector<TileLayer> layers_;
    std::vector<LayerTarget> targets_;
    std::vector<FilteredMap> filtered_;
    Scratch scratch_;                                       // for magnified maps
    std::vector<float> transmittance_, sums_, layer_sums_;  // sums: opacity and radiance
};

}  // namespace

void block_layers(const Samples& samples, const LayeredPlan& plan, float margin, int first, int last,
                  const BlockLayersOutput& output) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    const LayerLookup lookup(plan.boundaries, plan.layer_count - 1);
    const int block = output.block, columns = (samples.width + block - 1) / block;
    const float right = static_cast<float>(samples.width) + margin;
    const float bottom = static_cast<float>(samples.height) + margin;
    std::vector<float> slopes;
    std::vector<std::int32_t> layers;
    struct Tally {
        double sum;
        std::int32_t count;
    };
    constexpr int tallies_at_once = 4;
    std::vector<Tally> tallies;  // of each layer, and of samples that no layer gets
    for (int cell = first * columns; cell < last * columns; ++cell) {
        const int top = cell / columns * block, left = cell % columns * block;
        const int i_end = std::min(top + block, samples.height), j_end = std::min(left + block, samples.width);
        Extent box{infinity, -infinity, infinity, -infinity};
        tallies.assign(std::size_t{tallies_at_once} * (plan.layer_count + 1), {0.0, 0});
        std::int32_t* const counts = output.counts + std::ptrdiff_t{cell} * plan.layer_count;
        float* const slope_sums = output.slope_sums + std::ptrdiff_t{cell} * plan.layer_count;
        for (int i = top; i < i_end; ++i) {
            const std::ptrdiff_t row = std::ptrdiff_t{i} * samples.width;
            const std::ptrdiff_t begin = (row + left) * samples.spp;
            const auto n = static_cast<int>((row + j_end) * samples.spp - begin);
            slopes.resize(n);
            layers.resize(n);
            lookup.run(samples.depth + begin, n, samples.c0, samples.c1, slopes.data(), layers.data());
            survey_run(samples.xy + 2 * begin, n, -margin, right, bottom, plan.layer_count, box, slopes.data(),
                       layers.data());
            // Several tallies in turn, so that none is waited for.
            for (int k = 0; k < n; ++k) {
                Tally& tally = tallies[tallies_at_once * layers[k] + k % tallies_at_once];
                ++tally.count;
                tally.sum += double{slopes[k]};
            }
        }
        for (int layer = 0; layer < plan.layer_count; ++layer) {
            double sum = 0;
            for (int i = 0; i < tallies_at_once; ++i) {
                counts[layer] += tallies[tallies_at_once * layer + i].count;
                sum += tallies[tallies_at_once * layer + i].sum;
            }
            slope_sums[layer] = static_cast<float>(sum);
        }
        output.extents[cell] = box;
    }
}

void coarse_tiles(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan, const CoarsePass& pass,
                  const CoarseMap* maps, int map_count, int first, int last) {
    LayerMaps layer_maps(samples, blocks, plan);
    const int tile_columns = (pass.right - pass.left + pass.side - 1) / pass.side;
    for (int tile = first; tile < last; ++tile) {
        const int left = pass.left + pass.side * (tile % tile_columns),
                  top = pass.top + pass.side * (tile / tile_columns);
        const auto x = static_cast<float>(left), y = static_cast<float>(top);
        const int width = std::min(pass.side, pass.right - left), height = std::min(pass.side, pass.bottom - top);
        std::vector<LayerTarget> targets = layer_maps.layers_near(
            {x, x + static_cast<float>(width), y, y + static_cast<float>(height)}, pass.first_level, pass.last_level);
        std::erase_if(targets, [&](LayerTarget& target) {
            const CoarseMap& map = map_of_layer(maps, map_count, target.layer);
            const int cell = static_cast<int>(target.cell);
            // Bins of the tile that are in the map.
            const auto bins = [&](int start, int first_bin, int bin_count) {
                const int skipped = std::max(first_bin * cell - start, 0) / cell;
                return Span{skipped, (std::min(pass.side, (first_bin + bin_count) * cell - start) + cell - 1) / cell};
            };
            const Span rows = bins(top, map.row, map.rows), columns = bins(left, map.column, map.columns);
            return rows.first >= rows.end || columns.first >= columns.end ||
                   !target.want(static_cast<float>(columns.first * cell), static_cast<float>(rows.first * cell),
                                rows.end - rows.first, columns.end - columns.first, x, y);
        });
        const std::vector<FilteredMap> filtered = layer_maps.filter(targets, x, y);
        for (std::size_t i = 0; i < targets.size(); ++i) {
            const LayerTarget& target = targets[i];
            const CoarseMap& map = map_of_layer(maps, map_count, target.layer);
            const int column = static_cast<int>((x + target.left) / target.cell) - map.column;
            const int row = static_cast<int>((y + target.top) / target.cell) - map.row;
            for (int channel = 0; channel < channel_count; ++channel)
                for (int k = 0; k < target.rows; ++k)
                    std::memcpy(map.values + (std::ptrdiff_t{channel} * map.rows + row + k) * map.columns + column,
                                filtered[i].channel(channel) + std::ptrdiff_t{k} * filtered[i].stride,
                                sizeof(float) * static_cast<std::size_t>(target.columns));
        }
    }
}

void layered_tiles(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan, const CoarseMap* maps,
                   int map_count, const std::int32_t* tiles, int tile_count, const LayeredOutput& output) {
    TileReconstruction reconstruction(samples, blocks, plan, maps, map_count);
    for (int i = 0; i < tile_count; ++i) reconstruction.run(tiles[i], output);
}

}  // namespace fewrays
