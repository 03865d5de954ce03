// The temporal method on a GPU. Twin of src/fewrays/temporal/reference.py and surfaces.py.
//
// View after view: all samples are seen from the view's lens point at its time and sorted into a grid of cells, and
// every pixel of the image finds out which surface it shows among the samples around it. No hierarchy is needed,
// because all pixels share the view.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/reprojection.h"
#include "atomics.h"
#include "block.h"
#include "cell_sort.h"
#include "device_samples.h"
#include "location.h"
#include "surfaces.h"

namespace fewrays {

struct ProjectArguments {
    DeviceSamples samples;
    SeenSample* seen;       // (samples)
    std::uint32_t* counts;  // (cells)
    CellGrid grid;
    float u, v, time;
};

inline void run_temporal_project(const ProjectArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        const DeviceSamples& s = a.samples;
        a.seen[i].source = -1;
        const Path path = path_of_sample(s, i);
        if (!(depth_at(path, a.time) >= nearest_depth)) return;
        const Sight sight = sight_of(path, a.u, a.v, a.time, within_reach(s.c1));
        const float x = (sight.x - a.grid.left) / a.grid.side, y = (sight.y - a.grid.top) / a.grid.side;
        if (!(x >= 0.0f && y >= 0.0f && x < static_cast<float>(a.grid.columns) && y < static_cast<float>(a.grid.rows)))
            return;
        a.seen[i] = {sight.x, sight.y, sight.slope, sight.speed_x, sight.speed_y, static_cast<std::int32_t>(i)};
        atomic_increase(&a.counts[a.grid.row(sight.y) * a.grid.columns + a.grid.column(sight.x)], std::uint32_t{1});
    });
}

struct SortArguments {
    const SeenSample* seen;       // (samples)
    const std::uint32_t* starts;  // (cells + 1)
    std::uint32_t* taken;         // (cells): 0 at first
    std::int32_t* order;          // (samples)
    SeenSample* sorted;           // (samples): cell by cell, in each by number
    CellGrid grid;
    std::int32_t samples;
};

// Puts every sample into its cell, in any order.
inline void run_temporal_fill(const SortArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t i = static_cast<std::int64_t>(block.x()) * sample_threads + thread;
        if (i >= a.samples || a.seen[i].source < 0) return;
        const int cell = a.grid.row(a.seen[i].y) * a.grid.columns + a.grid.column(a.seen[i].x);
        put_into_cell(a.starts, a.taken, a.order, cell, i);
    });
}

// Every thread arranges a cell.
inline void run_temporal_arrange(const SortArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const int cell = block.x() * sample_threads + thread;
        if (cell >= a.grid.rows * a.grid.columns) return;
        const std::uint32_t first = a.starts[cell], end = a.starts[cell + 1];
        sort_numbers(a.order + first, static_cast<int>(end - first));
        for (std::uint32_t k = first; k < end; ++k) a.sorted[k] = a.seen[a.order[k]];
    });
}

constexpr int resolve_threads = 128;

struct ResolveArguments {
    const float *color, *uv, *bandwidth;  // (samples, 3), (samples, 2), (samples); the last null where all are matte
    float* bands;                         // (height, width, band_count, 4): added to
    float offset_x, offset_y, weight;     // of the view
    float band_starts[most_bands];
    std::int32_t band_count, height, width;
    SortedView view;
};

// Every thread has a pixel.
inline void run_temporal_resolve(const ResolveArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t pixel = static_cast<std::int64_t>(block.x()) * resolve_threads + thread;
        if (pixel >= static_cast<std::int64_t>(a.height) * a.width) return;
        const float x = static_cast<float>(pixel % a.width) + 0.5f + a.offset_x;
        const float y = static_cast<float>(pixel / a.width) + 0.5f + a.offset_y;
        Location location(a.view, a.uv, a.bandwidth, x, y);
        if (!location.resolve()) return;
        float total = 0.0f, radiance[3] = {};
        location.visit_found([&](std::int32_t source, float, float, float weight) {
            total += weight;
            for (int c = 0; c < 3; ++c) radiance[c] += weight * a.color[3 * static_cast<std::int64_t>(source) + c];
        });
        float* const sums =
            a.bands + 4 * (a.band_count * pixel + band_of(location.slope(), a.band_starts, a.band_count));
        for (int c = 0; c < 3; ++c) sums[c] += a.weight * (radiance[c] / total);
        sums[3] += a.weight;
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(temporal_project, fewrays::sample_threads, fewrays::ProjectArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_fill, fewrays::sample_threads, fewrays::SortArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_arrange, fewrays::sample_threads, fewrays::SortArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_resolve, fewrays::resolve_threads, fewrays::ResolveArguments, fewrays::NothingShared)
