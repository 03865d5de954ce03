#include "layered.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "layer_maps.h"
#include "layer_visibility.h"
#include "magnifier.h"
#include "scratch.h"
#include "separable_blur.h"

namespace fewrays {
namespace {

constexpr float min_opacity = 1e-3f;
constexpr float opaque = 1e-6f;  // of what shows through less, not even a light is seen
constexpr int any_level = 100;   // more levels than there are

CoarseBins bins_of(const CoarseMap& map) {
    return {map.values, std::ptrdiff_t{map.rows} * map.columns, map.columns, map.rows, map.columns};
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
        place.map = magnifier_.run(bins_of(coarse), layer.level, top + place.top, left + place.left, place.rows,
                                   place.columns, scratch_);
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
            const float* const bins_here = bins_of(coarse).at(opacity, row, 0);
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
        const CoarseBins source{bins.values, bins.plane(), bins.stride, bins.rows, place.columns / size + 2};
        place.map = magnifier_.run(source, layer.level, size, size, place.rows, place.columns, scratch_);
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

void layered_tiles(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan, const CoarseMap* maps,
                   int map_count, const std::int32_t* tiles, int tile_count, const LayeredOutput& output) {
    TileReconstruction reconstruction(samples, blocks, plan, maps, map_count);
    for (int i = 0; i < tile_count; ++i) reconstruction.run(tiles[i], output);
}

}  // namespace fewrays
