// The filtered maps of coarse layers, tile by tile.
#include <algorithm>
#include <cstring>
#include <vector>

#include "layer_maps.h"
#include "layered.h"

namespace fewrays {

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

}  // namespace fewrays
