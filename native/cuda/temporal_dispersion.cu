// How large the holes between reprojected samples get, on a GPU. Twin of src/fewrays/temporal/dispersion.py, in double
// precision as there.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "../simd.h"
#include "atomics.h"
#include "block.h"

namespace fewrays {

constexpr int most_planes = 16;
constexpr int hole_side = 12;   // pixels of the square whose holes are measured
constexpr int hole_border = 2;  // pixels around it, whose samples may be the nearest
constexpr int hole_places = 8;  // in a pixel along each axis
constexpr int hole_threads = hole_places * hole_places;
constexpr int points_at_once = 256;

struct HoleArguments {
    const float *xy, *uv, *time;  // of all samples; uv and time null where they do not matter
    std::uint64_t* holes;         // (planes): bits of the square of the largest; 0 at first
    double slopes[most_planes], speeds_x[most_planes], speeds_y[most_planes], reach;
    std::int32_t first_row, first_column, side, width, spp;  // the square of pixels whose samples are looked at
};

// Samples around a pixel, as a plane shows them.
struct NearPoints {
    double x[2 * points_at_once], y[2 * points_at_once];
    std::uint32_t count;
};

struct Point {
    double x, y;
};

// Where a plane shows the i-th sample of the square, from the corner of the pixels that are looked at.
FEWRAYS_INLINE Point point_of(const HoleArguments& a, int plane, int i) {
    const int pixel = i / a.spp, row = a.first_row + pixel / a.side, column = a.first_column + pixel % a.side;
    const std::int64_t sample = (static_cast<std::int64_t>(row) * a.width + column) * a.spp + i % a.spp;
    double x = a.xy[2 * sample] - static_cast<float>(a.first_column);
    double y = a.xy[2 * sample + 1] - static_cast<float>(a.first_row);
    if (a.uv) {
        x -= a.slopes[plane] * static_cast<double>(a.uv[2 * sample]);
        y -= a.slopes[plane] * static_cast<double>(a.uv[2 * sample + 1]);
    }
    if (a.time) {
        x -= a.speeds_x[plane] * static_cast<double>(a.time[sample] - 0.5f);
        y -= a.speeds_y[plane] * static_cast<double>(a.time[sample] - 0.5f);
    }
    return {x - a.reach, y - a.reach};
}

// A block has a pixel and a plane, a thread a place in that pixel. The samples that may be the nearest are listed, a
// part at a time; of what is listed only the least distance counts, in any order.
inline void run_temporal_holes(const HoleArguments& a, const Block& block, NearPoints& near) {
    const int plane = block.y(), row = block.x() / hole_side, column = block.x() % hole_side;
    const int samples = a.side * a.side * a.spp;
    Own<double, hole_threads> nearest;
    block.each([&](int thread) {
        nearest[thread] = INFINITY;
        if (thread == 0) near.count = 0;
    });
    for (int first = 0; first < samples; first += points_at_once) {
        block.each([&](int thread) {
            for (int i = first + thread; i < std::min(first + points_at_once, samples); i += hole_threads) {
                const Point point = point_of(a, plane, i);
                const double down = std::floor(point.y) - row, right = std::floor(point.x) - column;
                if (!(down >= 0 && down <= 2 * hole_border && right >= 0 && right <= 2 * hole_border)) continue;
                const std::uint32_t place = atomic_take(&near.count);
                near.x[place] = point.x;
                near.y[place] = point.y;
            }
        });
        const bool last = first + points_at_once >= samples;
        if (!block.any([&](int) { return last || near.count > points_at_once; })) continue;
        block.each([&](int thread) {
            const double x = column + hole_border + (thread % hole_places + 0.5) / hole_places;
            const double y = row + hole_border + (thread / hole_places + 0.5) / hole_places;
            for (std::uint32_t k = 0; k < near.count; ++k) {
                const double right = x - near.x[k], down = y - near.y[k];
                nearest[thread] = std::min(nearest[thread], right * right + down * down);
            }
        });
        block.each([&](int thread) {
            if (thread == 0) near.count = 0;
        });
    }
    block.each([&](int thread) { near.x[thread] = nearest[thread]; });
    block.each([&](int thread) {
        if (thread > 0) return;
        double largest = 0;
        for (int i = 0; i < hole_threads; ++i) largest = std::max(largest, near.x[i]);
        atomic_most(&a.holes[plane], std::bit_cast<std::uint64_t>(largest));
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(temporal_holes, fewrays::hole_threads, fewrays::HoleArguments, fewrays::NearPoints)
