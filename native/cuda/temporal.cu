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
#include "surfaces.h"

namespace fewrays {

constexpr int most_samples = 512;      // near a location that are looked at closely: of more, the nearest
constexpr float widest = 8.0f;         // radius in R up to which samples are looked for
constexpr float least_weight = 1e-6f;  // of a sample however far it is from its own lens point

// Square cells over the image and a border around it.
struct CellGrid {
    float left, top, side;  // in pixels
    std::int32_t columns, rows;

    FEWRAYS_INLINE int column(float x) const { return static_cast<int>(std::floor((x - left) / side)); }
    FEWRAYS_INLINE int row(float y) const { return static_cast<int>(std::floor((y - top) / side)); }
};

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
        const Path path = path_of(s.xy[2 * i], s.xy[2 * i + 1], s.uv[2 * i], s.uv[2 * i + 1], s.depth[i],
                                  s.time ? s.time[i] : 0.0f, s.motion ? s.motion + 3 * i : nullptr, s.c0, s.c1);
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
constexpr int most_bands = 8;

struct ResolveArguments {
    const SeenSample* sorted;
    const std::uint32_t* starts;
    const float *color, *uv, *bandwidth;  // (samples, 3), (samples, 2), (samples); the last null where all are matte
    float* bands;                         // (height, width, band_count, 4): added to
    CellGrid grid;
    DeviceRule rule;
    float u, v, offset_x, offset_y, weight;  // of the view
    float band_starts[most_bands];
    std::int32_t band_count, height, width;
};

// Samples around a location, at positions relative to it.
struct NearSamples {
    std::int32_t place[most_samples];
    int count;
};

// What one location sees.
class Location {
public:
    FEWRAYS_INLINE Location(const ResolveArguments& a, float x, float y) : a_(a), x_(x), y_(y) {}

    // Whether any sample is near; then `seen` is its radiance and slope.
    FEWRAYS_INLINE bool resolve(float* seen) {
        const float radius = a_.rule.radius;
        if (glance(radius)) {
            filter(0, near_.count, a_.rule.tent * radius, seen);
            return true;
        }
        if (near_.count > 0) {
            NearSurfaces surfaces = near_surfaces();
            surfaces.sort_by_slope();
            const int end = surfaces.end_of_group(0);
            if (end == near_.count || surfaces.fills_quadrants(0, end) || surfaces.covers(0, end)) {
                filter(0, end, a_.rule.tent * radius, seen);
                return true;
            }
            look(2 * radius);
            choose(a_.rule.tent * radius, seen);
            return true;
        }
        for (float wide = 2 * radius; wide <= widest * radius; wide *= 2) {
            look(wide);
            if (near_.count == 0) continue;
            choose(a_.rule.tent * wide, seen);
            return true;
        }
        return false;
    }

private:
    FEWRAYS_INLINE NearSurfaces near_surfaces() { return {a_.rule, a_.sorted, near_.place, near_.count, x_, y_}; }
    FEWRAYS_INLINE const SeenSample& sample(int i) const { return a_.sorted[near_.place[i]]; }
    FEWRAYS_INLINE float away_x(int i) const { return sample(i).x - x_; }
    FEWRAYS_INLINE float away_y(int i) const { return sample(i).y - y_; }

    // Calls visit(place) for the samples within a radius, cell by cell.
    template <typename Visit>
    FEWRAYS_INLINE void visit_within(float radius, Visit&& visit) const {
        const CellGrid& grid = a_.grid;
        const int first_row = std::max(grid.row(y_ - radius), 0);
        const int last_row = std::min(grid.row(y_ + radius), grid.rows - 1);
        const int first_column = std::max(grid.column(x_ - radius), 0);
        const int last_column = std::min(grid.column(x_ + radius), grid.columns - 1);
        if (first_column > last_column) return;
        for (int row = first_row; row <= last_row; ++row) {
            const std::uint32_t end = a_.starts[row * grid.columns + last_column + 1];
            for (std::uint32_t k = a_.starts[row * grid.columns + first_column]; k < end; ++k) {
                const float x = a_.sorted[k].x - x_, y = a_.sorted[k].y - y_;
                if (x * x + y * y <= radius * radius) visit(static_cast<std::int32_t>(k));
            }
        }
    }

    // Collects the samples within a radius; of very many those within a smaller one.
    FEWRAYS_INLINE void look(float radius) {
        near_.count = 0;
        visit_within(radius, [&](std::int32_t place) {
            if (near_.count < most_samples) near_.place[near_.count] = place;
            ++near_.count;
        });
        if (near_.count <= most_samples) return;
        float most = radius, least = 0.0f;
        for (int step = 0; step < 20; ++step) {
            const float middle = 0.5f * (least + most);
            int count = 0;
            visit_within(middle, [&](std::int32_t) { ++count; });
            (count <= most_samples ? least : most) = middle;
        }
        near_.count = 0;
        visit_within(least, [&](std::int32_t place) { near_.place[near_.count++] = place; });
    }

    // Looks within R. Whether what is there is one surface for certain: slopes and speeds differ too little for any
    // two to cross.
    FEWRAYS_INLINE bool glance(float radius) {
        look(radius);
        if (near_.count == 0) return false;
        SeenRange range;
        for (int i = 0; i < near_.count; ++i) range.include(sample(i));
        return range.one_surface(a_.rule);
    }

    // The first surface that covers the location, or the last. One of too few samples is joined with the next.
    FEWRAYS_INLINE void choose(float tent, float* seen) {
        NearSurfaces surfaces = near_surfaces();
        surfaces.sort_by_slope();
        int first = 0, end = surfaces.end_of_group(0);
        while (end < near_.count) {
            if (end - first >= least_samples) {
                if (surfaces.covers(first, end)) break;
                first = end;
            }
            end = surfaces.end_of_group(end);
        }
        filter(first, end, tent, seen);
    }

    // How much a sample counts from the view's lens point.
    FEWRAYS_INLINE float gloss(std::int32_t source) const {
        if (!a_.bandwidth) return 1.0f;
        const float u = a_.uv[2 * source] - a_.u, v = a_.uv[2 * source + 1] - a_.v;
        const float away = std::sqrt(u * u + v * v) / a_.bandwidth[source];
        return std::max(std::exp(-0.5f * away * away), least_weight);
    }

    // Averages the radiance of samples [first, end) under a tent, which is doubled while there is none under it; the
    // slope is the least.
    FEWRAYS_INLINE void filter(int first, int end, float tent, float* seen) const {
        int nearest = first;
        float least = INFINITY;
        seen[3] = INFINITY;
        for (int i = first; i < end; ++i) {
            const float distance = std::hypot(away_x(i), away_y(i));
            if (distance < least) {
                least = distance;
                nearest = i;
            }
            seen[3] = std::min(seen[3], sample(i).slope);
        }
        const bool single = tent <= 0.0f;
        while (!single && tent <= least) tent *= 2;
        float total = 0.0f, sums[3] = {};
        for (int i = first; i < end; ++i) {
            if (single && i != nearest) continue;
            const std::int32_t source = sample(i).source;
            const float share = single ? 1.0f : std::max(1.0f - std::hypot(away_x(i), away_y(i)) / tent, 0.0f);
            const float weight = share * gloss(source);
            total += weight;
            for (int c = 0; c < 3; ++c) sums[c] += weight * a_.color[3 * static_cast<std::int64_t>(source) + c];
        }
        for (int c = 0; c < 3; ++c) seen[c] = sums[c] / total;
    }

    const ResolveArguments& a_;
    const float x_, y_;
    NearSamples near_;
};

// Every thread has a pixel.
inline void run_temporal_resolve(const ResolveArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const std::int64_t pixel = static_cast<std::int64_t>(block.x()) * resolve_threads + thread;
        if (pixel >= static_cast<std::int64_t>(a.height) * a.width) return;
        const float x = static_cast<float>(pixel % a.width) + 0.5f + a.offset_x;
        const float y = static_cast<float>(pixel / a.width) + 0.5f + a.offset_y;
        Location location(a, x, y);
        float seen[4];
        if (!location.resolve(seen)) return;
        int band = 0;
        while (band + 1 < a.band_count && std::fabs(seen[3]) >= a.band_starts[band + 1]) ++band;
        float* const sums = a.bands + 4 * (a.band_count * pixel + band);
        for (int c = 0; c < 3; ++c) sums[c] += a.weight * seen[c];
        sums[3] += a.weight;
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(temporal_project, fewrays::sample_threads, fewrays::ProjectArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_fill, fewrays::sample_threads, fewrays::SortArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_arrange, fewrays::sample_threads, fewrays::SortArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(temporal_resolve, fewrays::resolve_threads, fewrays::ResolveArguments, fewrays::NothingShared)
