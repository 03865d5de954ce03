// Which plane every sample belongs to, and what samples touch. Twin of src/fewrays/multiplane/slabs.py.
//
// 1. multiplane_keys sorts every sample into a slab, by its slope, and a cell, by its motion.
// 2. multiplane_means finds out where the planes stand: where their samples are on average.
// 3. multiplane_mark finds the blocks that samples hit, multiplane_tiles the tiles that have blocks.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/depth_plane.h"
#include "../math/plane_place.h"
#include "../math/slope.h"
#include "atomics.h"
#include "block.h"
#include "device_samples.h"
#include "plane_blocks.h"
#include "plane_tiles.h"

namespace fewrays {

struct KeyArguments {
    DeviceSamples samples;
    double thickness, linear_to, most_blur;  // of slabs, in pixels: `SlabRule`
    double motion_cell, farthest;            // pixels of motion of a cell, and beyond which cells are not told apart
    double c0, c1;
    std::int64_t* keys;     // (samples): (slab - first_slab) side² + motion cell; -1 for those dropped
    float* seen;            // (samples, 3): slope at half time, and motion along x and y, of what the lens centre sees
    std::uint8_t* present;  // for every key, 1 where any sample has it; or null
    std::int32_t first_slab, middle, side;
};

FEWRAYS_INLINE double limited(double slope, const KeyArguments& a) {
    return std::fmin(std::fmax(slope, -a.most_blur), a.most_blur);
}

FEWRAYS_INLINE int slab_of(const KeyArguments& a, double slope) {
    constexpr double wide = 4.0;  // times the blur up to which slabs are even
    const double times = std::fabs(slope) / a.linear_to;
    const double beyond =
        1 + std::log(std::fmin(std::fmax(times, 1.0), wide)) + 2 - 2 / std::sqrt(std::fmax(times / wide, 1.0));
    const double distance = (times <= 1 ? times : beyond) * (a.linear_to / a.thickness);
    return static_cast<int>(std::floor(std::copysign(distance, slope) + 0.5));
}

// How the lens centre sees a point that moves: its homogeneous screen position as the shutter opens, and the change.
struct CenterPath {
    double start[3], change[3];

    FEWRAYS_INLINE double depth(double time) const { return start[2] + time * change[2]; }
    FEWRAYS_INLINE double at(int axis, double time) const { return (start[axis] + time * change[axis]) / depth(time); }
};

FEWRAYS_INLINE CenterPath center_path(const KeyArguments& a, std::int64_t i) {
    const double depth = a.samples.depth[i], time = a.samples.time[i], own = a.c0 / depth + a.c1;
    CenterPath path;
    for (int axis = 0; axis < 3; ++axis) {
        path.change[axis] = a.samples.motion[3 * i + axis];
        const double now = axis < 2 ? (a.samples.xy[2 * i + axis] - a.samples.uv[2 * i + axis] * own) * depth : depth;
        path.start[axis] = now - time * path.change[axis];
    }
    return path;
}

FEWRAYS_INLINE int motion_cell_of(const KeyArguments& a, double moved) {
    return static_cast<int>(std::floor(moved / a.motion_cell + 0.5)) + a.middle;
}

inline void run_multiplane_keys(const KeyArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        a.keys[i] = -1;
        double c = slope(a.samples.depth[i], a.samples.c0, a.samples.c1), moved[2] = {};
        if (a.samples.motion) {
            const CenterPath path = center_path(a, i);
            const double least = static_cast<double>(nearest_depth) * a.samples.depth[i];
            if (path.depth(0.5) >= least) c = a.c0 / path.depth(0.5) + a.c1;
            for (int axis = 0; axis < 2 && path.depth(0) >= least && path.depth(1) >= least; ++axis)
                moved[axis] = std::fmin(std::fmax(path.at(axis, 1) - path.at(axis, 0), -a.farthest), a.farthest);
        }
        c = limited(c, a);
        a.seen[3 * i] = static_cast<float>(c);
        for (int axis = 0; axis < 2; ++axis) a.seen[3 * i + 1 + axis] = static_cast<float>(moved[axis]);
        if (is_dropped(a.samples, i)) return;
        const std::int64_t cell =
            static_cast<std::int64_t>(motion_cell_of(a, moved[0])) * a.side + motion_cell_of(a, moved[1]);
        const std::int64_t key = static_cast<std::int64_t>(slab_of(a, c) - a.first_slab) * a.side * a.side + cell;
        a.keys[i] = key;
        if (a.present) a.present[key] = 1;
    });
}

FEWRAYS_INLINE int plane_of_key(std::int64_t key, const std::int64_t* plane_keys, int count) {
    return last_not_above(key, count, [&](int k) { return plane_keys[k]; });
}

// Sums over the samples of a plane: their number, slopes, and motion along x and y, in units.
struct PlaneTally {
    std::uint64_t sums[4];
};

constexpr int means_each = 16;     // samples of a thread
constexpr int most_tallies = 512;  // planes that a block of threads adds up by itself
constexpr float mean_unit = 65536.0f;

struct MeansArguments {
    const std::int64_t *keys, *plane_keys;  // (samples), and of the planes, ascending
    const float* seen;                      // (samples, 3): slope, and motion along x and y
    PlaneTally* tallies;                    // (count)
    std::int64_t samples;
    std::int32_t count, unused;
};

struct MeansShared {
    PlaneTally tallies[most_tallies];
};

// Planes stand where their samples are on average.
inline void run_multiplane_means(const MeansArguments& a, const Block& block, MeansShared& shared) {
    const int own_tallies = a.count <= most_tallies ? a.count : 0;
    PlaneTally* const tallies = own_tallies ? shared.tallies : a.tallies;
    block.each([&](int thread) {
        for (int k = thread; k < own_tallies; k += sample_threads) shared.tallies[k] = {};
    });
    block.each([&](int thread) {
        const std::int64_t first = static_cast<std::int64_t>(block.x()) * sample_threads * means_each + thread;
        for (int k = 0; k < means_each; ++k) {
            const std::int64_t i = first + static_cast<std::int64_t>(k) * sample_threads;
            if (i >= a.samples) break;
            if (a.keys[i] < 0) continue;
            PlaneTally& tally = tallies[plane_of_key(a.keys[i], a.plane_keys, a.count)];
            atomic_increase(&tally.sums[0], std::uint64_t{1});
            for (int c = 0; c < 3; ++c)
                if (a.seen[3 * i + c] != 0.0f)
                    atomic_increase(&tally.sums[1 + c], in_units(a.seen[3 * i + c], mean_unit));
        }
    });
    block.each([&](int thread) {
        for (int k = thread; k < 4 * own_tallies; k += sample_threads)
            if (shared.tallies[k / 4].sums[k % 4] != 0)
                atomic_increase(&a.tallies[k / 4].sums[k % 4], shared.tallies[k / 4].sums[k % 4]);
    });
}

struct MarkArguments {
    DeviceSamples samples;
    const DepthPlane* planes;
    const std::int64_t *keys, *plane_keys;  // (samples), and of the planes, ascending
    const std::int16_t* ranks;              // of these among all planes, front to back
    std::int16_t* plane_of;                 // (samples): -1 for those dropped
    float* places;                          // (samples, 2): where the lens centre sees the surface at half time
    std::uint8_t* marks;                    // of every place for a block: 1 where a sample touches it
    std::uint32_t* brightest;               // (count): the largest radiance in size, as the bits of a float
    std::int32_t count;
    float most_blur;
};

inline void run_multiplane_mark(const MarkArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        const DeviceSamples& s = a.samples;
        a.plane_of[i] = -1;
        a.places[2 * i] = a.places[2 * i + 1] = 0.0f;
        if (a.keys[i] < 0) return;
        const int number = a.ranks[plane_of_key(a.keys[i], a.plane_keys, a.count)];
        a.plane_of[i] = static_cast<std::int16_t>(number);
        const DepthPlane plane = a.planes[number];
        const float u = s.uv[2 * i], v = s.uv[2 * i + 1];
        const Path path = path_of(s.xy[2 * i], s.xy[2 * i + 1], u, v, s.depth[i], s.time ? s.time[i] : 0.0f,
                                  s.motion ? s.motion + 3 * i : nullptr, s.c0, s.c1);
        const Place place = place_on_plane(path, slope(s.depth[i], s.c0, s.c1), u, v, a.most_blur, s.motion != nullptr,
                                           within_reach(s.c1));
        a.places[2 * i] = place.x;
        a.places[2 * i + 1] = place.y;
        float most = 0.0f;
        for (int c = 0; c < 3; ++c) most = std::max(most, std::fabs(s.color[3 * i + c]));
        atomic_most(&a.brightest[number], std::bit_cast<std::uint32_t>(most));
        // Cells that share the sample, and one more to each side.
        const float around = 2.0f / static_cast<float>(plane.cells);
        const float x = place.x - static_cast<float>(plane.left), y = place.y - static_cast<float>(plane.top);
        const int left = std::max(floor_to_int((x - around) / block_columns), 0);
        const int right = std::min(floor_to_int((x + around) / block_columns), plane.columns - 1);
        const int top = std::max(floor_to_int((y - around) / block_rows), 0);
        const int bottom = std::min(floor_to_int((y + around) / block_rows), plane.rows - 1);
        for (int row = top; row <= bottom; ++row)
            for (int column = left; column <= right; ++column)
                a.marks[plane.first_slot + row * plane.columns + column] = 1;
    });
}

struct TileArguments {
    const DepthPlane* planes;
    const std::int32_t* first_tile;  // (count): of each plane, among all places for tiles
    const std::uint8_t* marks;
    std::uint8_t* kept;  // of every place for a tile: 1 where it has a block
    std::int32_t count, tiles;
};

inline void run_multiplane_tiles(const TileArguments& a, const Block& block, NothingShared&) {
    block.each([&](int thread) {
        const int place = block.x() * sample_threads + thread;
        if (place >= a.tiles) return;
        const TilePlace tile = tile_place(a.planes, a.first_tile, a.count, place);
        const DepthPlane plane = a.planes[tile.plane];
        const int height = block_rows * plane.cells, column = tile.column / plane.cells;
        const int first = tile.row * tile_cells / height;
        const int last = std::min((tile.row * tile_cells + tile_cells - 1) / height, plane.rows - 1);
        std::uint8_t any = 0;
        for (int row = first; row <= last; ++row) any |= a.marks[plane.first_slot + row * plane.columns + column];
        a.kept[place] = any;
    });
}

}  // namespace fewrays

FEWRAYS_KERNEL(multiplane_keys, fewrays::sample_threads, fewrays::KeyArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(multiplane_means, fewrays::sample_threads, fewrays::MeansArguments, fewrays::MeansShared)
FEWRAYS_KERNEL(multiplane_mark, fewrays::sample_threads, fewrays::MarkArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(multiplane_tiles, fewrays::sample_threads, fewrays::TileArguments, fewrays::NothingShared)
