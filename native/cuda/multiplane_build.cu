// From samples that know their planes to planes on a GPU. Twin of src/fewrays/multiplane/reference.py.
//
// 1. multiplane_evidence adds up, in every plane, the rays that hit or pass its cells.
// 2. multiplane_sums adds up cells to ever wider ones, tile by tile.
// 3. multiplane_estimate makes opacity and radiance of them, from wide neighbourhoods to single cells.
//    multiplane_estimate_edges does so for planes whose single cells gather rays along edges.
//
// Sums are whole numbers: they are the same in whatever order threads add to them.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../math/depth_plane.h"
#include "../math/plane_place.h"
#include "atomics.h"
#include "block.h"
#include "device_samples.h"
#include "halves.h"
#include "plane_blocks.h"
#include "plane_edges.h"
#include "plane_tiles.h"

namespace fewrays {

constexpr int map_cells = block_rows * block_columns;  // of a map, without those that repeat its neighbours'
constexpr float hit_unit = 0x1p32f, radiance_unit = 0x1p30f;

// Sums of planes [first_plane, end_plane), whose first map is number `first_map`: of each map's cells.
struct Evidence {
    std::uint32_t* passes;  // weights of the rays that pass, in `pass_unit`
    std::uint64_t* hits;    // (cells, 4): weights of the rays that hit, and their radiance, in units
    std::int32_t first_plane, end_plane;
    std::int64_t first_map;
    float pass_unit;
    float prior;  // rays that a neighbourhood's estimate counts as
};

// The cell's number among those of the evidence, or -1 where there is no block.
FEWRAYS_INLINE std::int64_t cell_number(const DepthPlane& plane, const std::int32_t* slots, const Evidence& evidence,
                                        int row, int column) {
    const int height = block_rows * plane.cells, width = block_columns * plane.cells;
    if (row < 0 || row >= plane.rows * height || column < 0 || column >= plane.columns * width) return -1;
    const std::int32_t slot = slots[plane.first_slot + row / height * plane.columns + column / width];
    if (slot < 0) return -1;
    return (slot - evidence.first_map) * map_cells + row % height * width + column % width;
}

// Shares a ray out among the four cells around the place where it crosses a plane: add(cell, weight).
template <typename Add>
FEWRAYS_INLINE void share_out(const DepthPlane& plane, const std::int32_t* slots, const Evidence& evidence, Place place,
                              const Add& add) {
    const auto cells = static_cast<float>(plane.cells);
    const float x = (place.x - static_cast<float>(plane.left)) * cells - 0.5f;
    const float y = (place.y - static_cast<float>(plane.top)) * cells - 0.5f;
    const int width = block_columns * plane.cells, height = block_rows * plane.cells;
    if (!(x >= -1.0f && y >= -1.0f && x < static_cast<float>(plane.columns * width) &&
          y < static_cast<float>(plane.rows * height)))
        return;
    const int column = floor_to_int(x), row = floor_to_int(y);
    const float right = x - static_cast<float>(column), down = y - static_cast<float>(row);
    for (int j = 0; j < 2; ++j)
        for (int i = 0; i < 2; ++i) {
            const std::int64_t cell = cell_number(plane, slots, evidence, row + j, column + i);
            if (cell >= 0) add(cell, (j ? down : 1.0f - down) * (i ? right : 1.0f - right));
        }
}

struct EvidenceArguments {
    DeviceSamples samples;
    const DepthPlane* planes;
    const std::int32_t* slots;
    const std::int16_t* plane_of;
    const float* places;
    Evidence evidence;
};

inline void run_multiplane_evidence(const EvidenceArguments& a, const Block& block, NothingShared&) {
    each_sample(block, a.samples, [&](std::int64_t i) {
        const DeviceSamples& s = a.samples;
        const int hit = a.plane_of[i];
        const Evidence& evidence = a.evidence;
        const float x = s.xy[2 * i], y = s.xy[2 * i + 1], u = s.uv[2 * i], v = s.uv[2 * i + 1];
        const float since = s.time ? s.time[i] - 0.5f : 0.0f;
        for (int k = evidence.first_plane; k < std::min(hit, evidence.end_plane); ++k) {
            const DepthPlane& plane = a.planes[k];
            const Place place{x - plane.slope * u - plane.motion_x * since,
                              y - plane.slope * v - plane.motion_y * since};
            share_out(plane, a.slots, evidence, place, [&](std::int64_t cell, float weight) {
                const auto units = static_cast<std::uint32_t>(weight * evidence.pass_unit + 0.5f);
                atomic_increase(evidence.passes + cell, units);
            });
        }
        if (hit < evidence.first_plane || hit >= evidence.end_plane) return;
        const DepthPlane& plane = a.planes[hit];
        const float scale = 1.0f / plane.scale;
        const Place place{a.places[2 * i], a.places[2 * i + 1]};
        share_out(plane, a.slots, evidence, place, [&](std::int64_t cell, float weight) {
            std::uint64_t* const sums = evidence.hits + 4 * cell;
            atomic_increase(sums, in_units(weight, hit_unit));
            for (int c = 0; c < 3; ++c)
                atomic_increase(sums + 1 + c, in_units(weight * (scale * s.color[3 * i + c]), radiance_unit));
        });
    });
}

constexpr int estimate_threads = 256;
constexpr int levels = 5;  // of neighbourhoods, each of four times the cells; the widest is a tile

// Weights of the rays that hit a cell, of all that it knows of, and the radiance of those that hit.
struct Sums {
    float hits, total, radiance[3];

    FEWRAYS_INLINE void operator+=(const Sums& other) {
        hits += other.hits;
        total += other.total;
        for (int c = 0; c < 3; ++c) radiance[c] += other.radiance[c];
    }

    FEWRAYS_INLINE void add(float weight, const Sums& other) {
        hits += weight * other.hits;
        total += weight * other.total;
        for (int c = 0; c < 3; ++c) radiance[c] += weight * other.radiance[c];
    }
};

FEWRAYS_INLINE Sums sums_of_cell(const DepthPlane& plane, const std::int32_t* slots, const Evidence& evidence, int row,
                                 int column) {
    const std::int64_t cell = cell_number(plane, slots, evidence, row, column);
    if (cell < 0) return {};
    const std::uint64_t* const hits = evidence.hits + 4 * cell;
    Sums sums{of_units(hits[0], hit_unit), 0.0f, {}};
    sums.total = sums.hits + static_cast<float>(evidence.passes[cell]) / evidence.pass_unit;
    for (int c = 0; c < 3; ++c) sums.radiance[c] = of_units(hits[1 + c], radiance_unit);
    return sums;
}

// Cells of a tile's side in a level, and where the level begins among the tile's sums of levels 1 to 5.
FEWRAYS_INLINE constexpr int side_of(int level) { return tile_cells >> level; }
FEWRAYS_INLINE constexpr int first_of(int level) {
    int first = 0;
    for (int finer = 1; finer < level; ++finer) first += side_of(finer) * side_of(finer);
    return first;
}
constexpr int tile_sums = first_of(levels + 1);

// What the last two steps know of some of the planes [evidence.first_plane, evidence.end_plane) and their tiles.
struct EstimateArguments {
    const DepthPlane* planes;
    const std::int32_t* slots;
    const std::int32_t* first_tile;  // (count)
    const std::int32_t* tile_of;     // of every place for a tile: its number among those kept; -1 where it is not
    const std::int32_t* tiles;       // places of the tiles kept
    const float* along;              // (count): rays that cells look for along edges, to each side
    Sums* sums;                      // (tiles of these planes, tile_sums)
    HalfTexel* texels;               // blocks, which are 0 at first
    Evidence evidence;
    std::int32_t count, first_kept;  // of planes; the first tile of these planes among those kept
};

struct SumsShared {
    Sums sums[tile_sums];
};

// A block of threads has one tile.
inline void run_multiplane_sums(const EstimateArguments& a, const Block& block, SumsShared& shared) {
    const TilePlace tile = tile_place(a.planes, a.first_tile, a.count, a.tiles[a.first_kept + block.x()]);
    block.each([&](int thread) {
        const DepthPlane plane = a.planes[tile.plane];
        const int row = tile.row * tile_cells + thread / side_of(1) * 2;
        const int column = tile.column * tile_cells + thread % side_of(1) * 2;
        Sums sums{};
        for (int k = 0; k < 4; ++k) sums += sums_of_cell(plane, a.slots, a.evidence, row + k / 2, column + k % 2);
        shared.sums[thread] = sums;
    });
    for (int level = 2; level <= levels; ++level)
        block.each([&](int thread) {
            const int side = side_of(level);
            if (thread >= side * side) return;
            const Sums* const fine = shared.sums + first_of(level - 1);
            Sums sums{};
            for (int k = 0; k < 4; ++k)
                sums += fine[(thread / side * 2 + k / 2) * 2 * side + thread % side * 2 + k % 2];
            shared.sums[first_of(level) + thread] = sums;
        });
    block.each([&](int thread) {
        Sums* const to = a.sums + static_cast<std::int64_t>(block.x()) * tile_sums;
        for (int i = thread; i < tile_sums; i += estimate_threads) to[i] = shared.sums[i];
    });
}

// What a neighbourhood is believed to be like; `known` is 1 where there is an estimate of radiance, else 0.
struct Estimate {
    float opacity, known, color[3];

    FEWRAYS_INLINE void add(float weight, const Estimate& other) {
        opacity += weight * other.opacity;
        known += weight * other.known;
        for (int c = 0; c < 3; ++c) color[c] += weight * other.color[c];
    }
};

// Cells around a tile that a level is estimated for, given those of level 1 around it. Each draws on the next wider
// ones.
FEWRAYS_INLINE constexpr int ring_of(int level, int ring) {
    for (int finer = 1; finer < level; ++finer) ring = ring / 2 + 1;
    return ring;
}
FEWRAYS_INLINE constexpr int stride_of(int level, int ring) { return side_of(level) + 2 * ring_of(level, ring); }
FEWRAYS_INLINE constexpr int first_estimate_of(int level, int ring) {
    int first = 0;
    for (int finer = 1; finer < level; ++finer) first += stride_of(finer, ring) * stride_of(finer, ring);
    return first;
}

// Estimates of a tile's levels 1 to 5, the first with `ring` cells around it, and the numbers of the tiles around.
template <int ring>
struct Pyramid {
    static constexpr int tiles_around = ring_of(levels, ring), tiles_across = 2 * tiles_around + 1;
    std::int32_t tiles[tiles_across * tiles_across];
    Estimate estimates[first_estimate_of(levels + 1, ring)];

    FEWRAYS_INLINE std::int32_t tile(int down, int along) const {
        return tiles[(down + tiles_around) * tiles_across + along + tiles_around];
    }
    FEWRAYS_INLINE const Estimate& at(int level, int row, int column) const {
        const int around = ring_of(level, ring), stride = stride_of(level, ring);
        return estimates[first_estimate_of(level, ring) + (row + around) * stride + column + around];
    }
};

// A level, interpolated linearly, at a cell of the next finer one.
template <int ring>
FEWRAYS_INLINE Estimate interpolated(const Pyramid<ring>& pyramid, int level, int row, int column) {
    const int own_row = row >> 1, own_column = column >> 1;
    Estimate result{};
    for (int k = 0; k < 4; ++k) {
        const int i = own_row + (k / 2) * (row & 1 ? 1 : -1), j = own_column + (k % 2) * (column & 1 ? 1 : -1);
        result.add((k / 2 ? 0.25f : 0.75f) * (k % 2 ? 0.25f : 0.75f), pyramid.at(level, i, j));
    }
    return result;
}

// Draws what few rays say of a cell towards the estimate of the neighbourhood around it.
FEWRAYS_INLINE Estimate refined(const Sums& sums, const Estimate& around, float prior) {
    constexpr float none = 1e-30f;  // rays that leave a cell's own ones alone
    const bool known = around.known > 0.0f;
    const float share = known ? prior / around.known : 0.0f, count = known ? prior : none;
    Estimate result;
    result.opacity = (sums.hits + prior * around.opacity) / (sums.total + prior);
    result.known = known || sums.hits > 0.0f ? 1.0f : 0.0f;
    for (int c = 0; c < 3; ++c) result.color[c] = (sums.radiance[c] + share * around.color[c]) / (sums.hits + count);
    return result;
}

FEWRAYS_INLINE Estimate widest(const Sums& sums) {
    const bool hit = sums.hits > 0.0f;
    Estimate result{sums.total > 0.0f ? sums.hits / sums.total : 0.0f, hit ? 1.0f : 0.0f, {}};
    for (int c = 0; c < 3; ++c) result.color[c] = hit ? sums.radiance[c] / sums.hits : 0.0f;
    return result;
}

// Sums of a cell of a level, which may lie in a tile around.
template <int ring>
FEWRAYS_INLINE Sums level_sums(const EstimateArguments& a, const Pyramid<ring>& pyramid, int level, int row,
                               int column) {
    const int side = side_of(level), down = row >> (levels - level), along = column >> (levels - level);
    const std::int32_t tile = pyramid.tile(down, along);
    if (tile < 0) return {};
    const int i = row - down * side, j = column - along * side;
    return a.sums[static_cast<std::int64_t>(tile - a.first_kept) * tile_sums + first_of(level) + i * side + j];
}

// Writes a cell to its block, which there is, and to those that repeat it beyond their last rows and columns.
FEWRAYS_INLINE void put_cell(const EstimateArguments& a, const DepthPlane& plane, int row, int column,
                             const Estimate& estimate) {
    const int cells = plane.cells, height = block_rows * cells, width = block_columns * cells;
    const int block_row = row / height, block_column = column / width;
    const std::int32_t* const slots = a.slots + plane.first_slot;
    HalfTexel texel;
    texel.channels[0] = to_half(estimate.opacity);
    for (int c = 0; c < 3; ++c) texel.channels[1 + c] = to_half(estimate.opacity * estimate.color[c]);
    const int i = row % height, j = column % width;
    for (int up = 0; up <= (i < cells && block_row > 0); ++up)
        for (int before = 0; before <= (j < cells && block_column > 0); ++before) {
            const std::int32_t slot = slots[(block_row - up) * plane.columns + block_column - before];
            if (slot < 0) continue;
            const int place = place_of_cell(cells, i + up * height, j + before * width);
            a.texels[static_cast<std::int64_t>(slot) * map_size + place] = texel;
        }
}

FEWRAYS_INLINE TilePlace own_tile(const EstimateArguments& a, const Block& block) {
    return tile_place(a.planes, a.first_tile, a.count, a.tiles[a.first_kept + block.x()]);
}

// Estimates levels 5 to 1 of a block's tile.
template <int ring>
FEWRAYS_INLINE void estimate_levels(const EstimateArguments& a, const Block& block, const TilePlace& tile,
                                    Pyramid<ring>& pyramid) {
    constexpr int around = Pyramid<ring>::tiles_around, across = Pyramid<ring>::tiles_across;
    block.each([&](int thread) {
        if (thread >= across * across) return;
        const DepthPlane plane = a.planes[tile.plane];
        const int row = tile.row + thread / across - around, column = tile.column + thread % across - around;
        const bool inside = row >= 0 && row < tile_rows_of(plane) && column >= 0 && column < tile_columns_of(plane);
        const std::int32_t first = a.first_tile[tile.plane];
        pyramid.tiles[thread] = inside ? a.tile_of[first + row * tile_columns_of(plane) + column] : -1;
    });
    FEWRAYS_UNROLL
    for (int level = levels; level > 0; --level)
        block.each([&](int thread) {
            const int stride = stride_of(level, ring), before = ring_of(level, ring);
            Estimate* const own = pyramid.estimates + first_estimate_of(level, ring);
            for (int i = thread; i < stride * stride; i += estimate_threads) {
                const int row = i / stride - before, column = i % stride - before;
                const Sums sums = level_sums(a, pyramid, level, row, column);
                own[i] = level == levels
                             ? widest(sums)
                             : refined(sums, interpolated(pyramid, level + 1, row, column), a.evidence.prior);
            }
        });
}

// Estimates a tile's cells and writes them. Their sums are sums_at(plane, row, column, i), of the tile's i-th.
template <int ring, typename SumsAt>
FEWRAYS_INLINE void estimate_cells(const EstimateArguments& a, const Block& block, const TilePlace& tile,
                                   const Pyramid<ring>& pyramid, const SumsAt& sums_at) {
    block.each([&](int thread) {
        const DepthPlane plane = a.planes[tile.plane];
        for (int i = thread; i < tile_cells * tile_cells; i += estimate_threads) {
            const int row = tile.row * tile_cells + i / tile_cells, column = tile.column * tile_cells + i % tile_cells;
            if (cell_number(plane, a.slots, a.evidence, row, column) < 0) continue;
            const Estimate around = interpolated(pyramid, 1, i / tile_cells, i % tile_cells);
            put_cell(a, plane, row, column, refined(sums_at(plane, row, column, i), around, a.evidence.prior));
        }
    });
}

// A block of threads has one tile.
inline void run_multiplane_estimate(const EstimateArguments& a, const Block& block, Pyramid<1>& pyramid) {
    const TilePlace tile = own_tile(a, block);
    estimate_levels(a, block, tile, pyramid);
    estimate_cells(a, block, tile, pyramid, [&](const DepthPlane& plane, int row, int column, int) {
        return sums_of_cell(plane, a.slots, a.evidence, row, column);
    });
}

// Sums of a cell and of those along the edge that runs through it.
FEWRAYS_INLINE Sums sums_along(const DepthPlane& plane, const std::int32_t* slots, const Evidence& evidence,
                               const EdgeWay& way, int row, int column) {
    Sums sums = sums_of_cell(plane, slots, evidence, row, column);
    for (int step = 1; step <= way.steps; ++step) {
        const int sideways = aside(way, step), down = way.steep ? step : sideways, right = way.steep ? sideways : step;
        Sums both = sums_of_cell(plane, slots, evidence, row + down, column + right);
        both += sums_of_cell(plane, slots, evidence, row - down, column - right);
        sums.add(weight(way, step), both);
    }
    return sums;
}

struct EstimateEdgesShared {
    Pyramid<seen_ring> pyramid;
    EdgeShared edges;
};

// A block of threads has one tile.
inline void run_multiplane_estimate_edges(const EstimateArguments& a, const Block& block, EstimateEdgesShared& shared) {
    const TilePlace tile = own_tile(a, block);
    estimate_levels(a, block, tile, shared.pyramid);
    block.each([&](int thread) {
        for (int i = thread; i < seen_side * seen_side; i += estimate_threads) {
            const int row = i / seen_side - seen_ring, column = i % seen_side - seen_ring;
            const Estimate& own = shared.pyramid.at(1, row, column);
            shared.edges.seen[i] = {own.opacity, light_seen(own.opacity, own.color[0], own.color[1], own.color[2]),
                                    0.25f * level_sums(a, shared.pyramid, 1, row, column).total};
        }
    });
    find_ways(block, a.along[tile.plane], shared.edges);
    estimate_cells(a, block, tile, shared.pyramid, [&](const DepthPlane& plane, int row, int column, int i) {
        const EdgeWay& way = shared.edges.ways[i / tile_cells / 2 * wide_cells + i % tile_cells / 2];
        return sums_along(plane, a.slots, a.evidence, way, row, column);
    });
}

static_assert(estimate_threads == wide_cells * wide_cells && wide_cells == side_of(1));

}  // namespace fewrays

FEWRAYS_KERNEL(multiplane_evidence, fewrays::sample_threads, fewrays::EvidenceArguments, fewrays::NothingShared)
FEWRAYS_KERNEL(multiplane_sums, fewrays::estimate_threads, fewrays::EstimateArguments, fewrays::SumsShared)
FEWRAYS_KERNEL(multiplane_estimate, fewrays::estimate_threads, fewrays::EstimateArguments, fewrays::Pyramid<1>)
FEWRAYS_KERNEL(multiplane_estimate_edges, fewrays::estimate_threads, fewrays::EstimateArguments,
               fewrays::EstimateEdgesShared)
