// What one location sees, found out by one thread among the samples of its view: sections 3.2 and 3.3 of Lehtinen et
// al. 2011. Twin of src/fewrays/temporal/surfaces.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "../simd.h"
#include "surfaces.h"

namespace fewrays {

constexpr int most_samples = 512;     // near a location that are looked at closely: of more, the nearest
constexpr float widest_look = 8.0f;   // radius in R up to which samples are looked for
constexpr float least_gloss = 1e-6f;  // of a sample however far it is from its own lens point

// Square cells over the image and a border around it.
struct CellGrid {
    float left, top, side;  // in pixels
    std::int32_t columns, rows;

    FEWRAYS_INLINE int column(float x) const { return static_cast<int>(std::floor((x - left) / side)); }
    FEWRAYS_INLINE int row(float y) const { return static_cast<int>(std::floor((y - top) / side)); }
};

// Samples around a location, at positions relative to it.
struct NearSamples {
    std::int32_t place[most_samples];
    int count;
};

// All samples as one view sees them, cell by cell.
struct SortedView {
    const SeenSample* sorted;
    const std::uint32_t* starts;  // (cells + 1)
    CellGrid grid;
    DeviceRule rule;
    float u, v;  // the view's lens point
};

constexpr int most_bands = 8;

// The band of blur that a slope belongs to, of those that begin at the given sizes.
FEWRAYS_INLINE int band_of(float slope, const float* band_starts, int band_count) {
    int band = 0;
    while (band + 1 < band_count && std::fabs(slope) >= band_starts[band + 1]) ++band;
    return band;
}

// What one location sees.
class Location {
public:
    // Lens points and bandwidths of all samples: (samples, 2) and (samples), the last null where all are matte.
    FEWRAYS_INLINE Location(const SortedView& view, const float* uv, const float* bandwidth, float x, float y)
        : a_(view), uv_(uv), bandwidth_(bandwidth), x_(x), y_(y) {}

    // Finds the samples that the location sees; false if none is near.
    FEWRAYS_INLINE bool resolve() {
        const float radius = a_.rule.radius;
        if (glance(radius)) {
            filter(0, near_.count, a_.rule.tent * radius);
            return true;
        }
        if (near_.count > 0) {
            NearSurfaces surfaces = near_surfaces();
            surfaces.sort_by_slope();
            const int end = surfaces.end_of_group(0);
            if (end == near_.count || surfaces.fills_quadrants(0, end) || surfaces.covers(0, end)) {
                filter(0, end, a_.rule.tent * radius);
                return true;
            }
            look(2 * radius);
            choose(a_.rule.tent * radius);
            return true;
        }
        for (float wide = 2 * radius; wide <= widest_look * radius; wide *= 2) {
            look(wide);
            if (near_.count == 0) continue;
            choose(a_.rule.tent * wide);
            return true;
        }
        return false;
    }

    // The least of their slopes.
    FEWRAYS_INLINE float slope() const { return slope_; }

    // Calls visit(number, x, y, weight) for them, with positions relative to the location and weights under a tent.
    template <typename Visit>
    FEWRAYS_INLINE void visit_found(Visit&& visit) const {
        for (int i = first_; i < end_; ++i) {
            const std::int32_t source = sample(i).source;
            const float share = tent_ > 0.0f ? 1.0f - std::hypot(away_x(i), away_y(i)) / tent_ : 1.0f;
            if (share > 0.0f) visit(source, away_x(i), away_y(i), share * gloss(source));
        }
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
    FEWRAYS_INLINE void choose(float tent) {
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
        filter(first, end, tent);
    }

    // How much a sample counts from the view's lens point.
    FEWRAYS_INLINE float gloss(std::int32_t source) const {
        if (!bandwidth_) return 1.0f;
        const float u = uv_[2 * source] - a_.u, v = uv_[2 * source + 1] - a_.v;
        const float away = std::sqrt(u * u + v * v) / bandwidth_[source];
        return std::max(std::exp(-0.5f * away * away), least_gloss);
    }

    // Keeps samples [first, end) under a tent, which is doubled while there is none under it; without one, the nearest.
    FEWRAYS_INLINE void filter(int first, int end, float tent) {
        int nearest = first;
        float least = INFINITY;
        slope_ = INFINITY;
        for (int i = first; i < end; ++i) {
            const float distance = std::hypot(away_x(i), away_y(i));
            if (distance < least) {
                least = distance;
                nearest = i;
            }
            slope_ = std::min(slope_, sample(i).slope);
        }
        const bool single = tent <= 0.0f;
        while (!single && !(1.0f - least / tent > 0.0f)) tent *= 2;
        first_ = single ? nearest : first;
        end_ = single ? nearest + 1 : end;
        tent_ = tent;
    }

    const SortedView& a_;
    const float *const uv_, *const bandwidth_;
    const float x_, y_;
    NearSamples near_;
    // Which of those nearby are seen, under a tent of what radius; and their least slope.
    int first_ = 0, end_ = 0;
    float tent_ = 0.0f, slope_ = 0.0f;
};

}  // namespace fewrays
