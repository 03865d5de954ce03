// Estimates of opacity and radiance from what few rays tell of a region of a plane.
#pragma once

#include <cstddef>
#include <vector>

namespace fewrays {

constexpr int estimate_levels = 5;  // of neighbourhoods, each of four times the cells
constexpr int estimate_halo = 32;   // cells around a region that its estimate draws on: the widest neighbourhood

// EstimateMaps of a region, or of one of its ever coarser copies.
struct EstimateMaps {
    int rows, columns;
    std::vector<float> hits, total, radiance;  // sums of rays; radiance has three maps, one after the other
    std::vector<float> opacity, color;         // the estimate
    std::vector<float> known;                  // 1 where there is an estimate of radiance, else 0
    std::vector<float> share, count;           // how much the next wider cells count: room to work in

    EstimateMaps(int rows_, int columns_) : rows(rows_), columns(columns_) {
        const std::size_t size = cell_count();
        hits.resize(size);
        total.resize(size);
        radiance.resize(3 * size);
        opacity.resize(size);
        known.resize(size);
        color.resize(3 * size);
        share.resize(size);
        count.resize(size);
    }
    std::size_t cell_count() const { return static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns); }
};

// The finest maps first.
std::vector<EstimateMaps> make_pyramid(int rows, int columns);

// Cells of a map.
struct CellRange {
    int top, bottom, left, right;
};

struct EstimateRule {
    float prior;  // rays that a neighbourhood's estimate counts as
    float along;  // rays that cells look for along edges, to each side; 0 for none
};

// Estimates opacity and radiance of the finest maps from their sums, in the rows of `range`. Rays are gathered along
// edges in `range`, which ends `estimate_halo` cells before the maps' borders or, to the right and below, at most three
// cells later.
void estimate(std::vector<EstimateMaps>& pyramid, const EstimateRule& rule, const CellRange& range);

}  // namespace fewrays
