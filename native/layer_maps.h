// Scatters samples to where the lens centre sees them, layer by layer, and blurs the layers' maps.
#pragma once

#include <cstdint>
#include <vector>

#include "block_index.h"
#include "layer_lookup.h"
#include "layered.h"
#include "scratch.h"

namespace fewrays {

// How well a cell is known, then opacity and premultiplied radiance.
enum Channel { known, opacity, red, green, blue, channel_count };

// Rows or columns [first, end).
struct Span {
    int first, end;
};

// A layer's filtered map over a rectangle of cells: pixels, or bins of a coarse layer.
struct FilteredMap {
    float* values = nullptr;  // (channel_count, rows, stride)
    int rows = 0, stride = 0;

    std::ptrdiff_t plane() const { return std::ptrdiff_t{rows} * stride; }
    float* channel(int index) const { return values + index * plane(); }
};

// What to filter: one layer, and the bins that its samples are scattered to, relative to the caller's origin.
struct LayerTarget {
    int layer;
    float slope;            // of its samples, on average
    Rectangle extent;       // of its samples at the lens centre, in pixels of the image
    float left, top, cell;  // of the wanted rectangle, and the side of a cell, in pixels
    int rows, columns;      // of the wanted rectangle, in cells
    bool near;              // near focus: fine bins, and one view of the whole aperture
    float reach;            // how far samples may lie from their place at the lens centre, in pixels
    double blur_variance;   // in bins²

    int bins_per_cell;      // along a side
    double first_distance;  // of the blur's nearest tap, in bins
    int taps_beside;        // of the blur's kernel on each side

    int margin;                  // cells around those wanted that the blur reads
    int width, segment;          // cells of a row of the result and of the bins, in memory
    int stride, bin_rows, size;  // bins from row to row (stored phase by phase), rows of bins, bins in all

    // Asks for the part of a grid of cells (its corner relative to the origin, its size) that the layer can cover;
    // false if that is nothing.
    bool want(float grid_left, float grid_top, int grid_rows, int grid_columns, float origin_x, float origin_y);
    void lay_out();
    Rectangle catchment() const;
    // The first bin that the first cell's blur reads.
    int first_tap() const { return margin * bins_per_cell + bins_per_cell / 2 - taps() / 2; }
    int taps() const { return first_distance > 0 ? 2 * taps_beside : 2 * taps_beside - 1; }
};

// What has been scattered to the bins of a target, and later, in its place, the filtered map.
struct Bins {
    float* values;
    std::size_t count;  // with strays

    float* holes() const { return values; }         // (count)
    float* hits() const { return values + count; }  // (count, 4): radiance and number of samples
};

// Where the bins of a target are; samples beyond them go to the stray bins after the last, in turn, so that none of
// these is waited for.
struct BinGrid {
    float left, top, per_pixel;
    int bins_per_cell, columns, rows, stride, size;
    float hole_spread;  // in pixels
};

// Largest |u| or |v| of the centre of a part of the aperture, in lens units.
float farthest_part(const LayeredPlan& plan);

const CoarseMap& map_of_layer(const CoarseMap* maps, int count, int layer);

class LayerMaps {
public:
    LayerMaps(const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan);

    // The layers, front to back, that have samples close enough to a rectangle of pixels to matter there.
    std::vector<LayerTarget> layers_near(const Rectangle& pixels, int first_level, int last_level) const;

    // Filters all targets, whose rectangles are relative to (left, top). Maps last until the next call.
    std::vector<FilteredMap> filter(std::vector<LayerTarget>& targets, float left, float top);

private:
    void scatter(const std::vector<LayerTarget>& targets, float left, float top);
    int deepest_layer(int block_row, int block_column) const;
    void sort_batch(int target_count, float left, float top);
    void find_places(int n, int keys);
    void put_in_place(std::ptrdiff_t first, int count, int from);
    void scatter_batch(const std::vector<LayerTarget>& targets, const std::vector<char>& wanted);
    void add_hits(const Bins& to, const BinGrid& grid, int first, int n);
    void share_hits(const Bins& to, const BinGrid& grid, int first, int n);
    FilteredMap blur(const LayerTarget& target, const Bins& bins);
    void blur_counts(const LayerTarget& target, const float* counts, int row, int rows, float* out);
    void blur_hits(const LayerTarget& target, const float* hits, int row, int rows, float* out, std::ptrdiff_t plane);
    void make_taps(const LayerTarget& target);

    const Samples& samples_;
    const BlockLayers& blocks_;
    const LayeredPlan& plan_;
    const BlockIndex index_;
    const LayerLookup lookup_;
    const float part_reach_;  // of the farthest part of the aperture, in lens units

    struct Run {
        std::ptrdiff_t first;
        int count;
    };
    Scratch scratch_;              // for bins
    std::vector<Bins> scattered_;  // of each target
    std::vector<Run> runs_;        // of samples that make up a batch
    std::vector<float> slope_;     // in the order of samples
    std::vector<std::int32_t> key_, place_;
    std::vector<float> xy_, uv_, c_, color_, x_, y_, u_, v_;  // sorted
    std::vector<std::int32_t> key_of_layer_, start_, cursors_, bins_;
    std::vector<float> right_, down_;
    std::vector<float> taps_, seen_, columns_blurred_, planes_, weight_, blurred_;
    std::vector<std::ptrdiff_t> tap_rows_, tap_hit_rows_, tap_columns_;
};

}  // namespace fewrays
