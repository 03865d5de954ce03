// Which way edges run through a tile of a plane on a GPU. Twin of EdgeWays in native/multiplane_edges.cpp.
#pragma once

#include "../math/edge_way.h"
#include "block.h"
#include "plane_tiles.h"

namespace fewrays {

// Wide cells, of 2 x 2 cells, of a tile's side, and how many around the tile its moments are made of.
constexpr int wide_cells = tile_cells / 2, gradient_ring = moment_reach, seen_ring = gradient_ring + 1;
constexpr int gradient_side = wide_cells + 2 * gradient_ring, seen_side = wide_cells + 2 * seen_ring;

// What the estimate of a wide cell shows, and its rays for each of its four cells.
struct SeenCell {
    float opacity, light, rays;
};

struct FEWRAYS_WIDE EdgeGradients {
    Gradient opacity, light;
};

struct EdgeShared {
    SeenCell seen[seen_side * seen_side];
    // The ways take the place of the gradients that they come from.
    union {
        EdgeGradients gradients[gradient_side * gradient_side];
        EdgeWay ways[wide_cells * wide_cells];
    };
    float across[edge_moments][gradient_side * wide_cells];  // moments that are blurred along rows
};

FEWRAYS_INLINE EdgeGradients gradients_at(const SeenCell* at) {
    const auto of = [&](float SeenCell::* map) {
        const SeenCell *const above = at - seen_side, *const below = at + seen_side;
        return gradient_between(above[-1].*map, above->*map, above[1].*map, at[-1].*map, at[1].*map, below[-1].*map,
                                below->*map, below[1].*map);
    };
    return {of(&SeenCell::opacity), of(&SeenCell::light)};
}

// One of a wide cell's `EdgeMoment`s, before they are blurred.
FEWRAYS_INLINE float sharp_moment(int moment, const EdgeGradients& slope, const SeenCell& seen) {
    switch (moment) {
        case opacity_xx:
            return slope.opacity.x * slope.opacity.x;
        case opacity_xy:
            return slope.opacity.x * slope.opacity.y;
        case opacity_yy:
            return slope.opacity.y * slope.opacity.y;
        case light_xx:
            return slope.light.x * slope.light.x;
        case light_xy:
            return slope.light.x * slope.light.y;
        case light_yy:
            return slope.light.y * slope.light.y;
        case light_square:
            return seen.light * seen.light;
        default:
            return seen.rays;
    }
}

// Makes `shared.ways`, row by row, of `shared.seen`, with as many threads as a tile has wide cells.
inline void find_ways(const Block& block, float along, EdgeShared& shared) {
    constexpr int threads = wide_cells * wide_cells;
    block.each([&](int thread) {
        for (int i = thread; i < gradient_side * gradient_side; i += threads)
            shared.gradients[i] =
                gradients_at(shared.seen + (i / gradient_side + 1) * seen_side + i % gradient_side + 1);
    });
    block.each([&](int thread) {
        for (int i = thread; i < gradient_side * wide_cells; i += threads) {
            const int row = i / wide_cells, column = i % wide_cells;
            const EdgeGradients* const slopes = shared.gradients + row * gradient_side + column + moment_reach;
            const SeenCell* const seen = shared.seen + (row + 1) * seen_side + column + moment_reach + 1;
            FEWRAYS_UNROLL
            for (int moment = 0; moment < edge_moments; ++moment) {
                const auto at = [&](int k) { return sharp_moment(moment, slopes[k], seen[k]); };
                shared.across[moment][i] = binomial_mean(at(0), at(-1) + at(1), at(-2) + at(2), at(-3) + at(3));
            }
        }
    });
    block.each([&](int thread) {
        const auto moment = [&](int m) {
            const float* const at = shared.across[m] + thread + moment_reach * wide_cells;
            return binomial_mean(at[0], at[-wide_cells] + at[wide_cells], at[-2 * wide_cells] + at[2 * wide_cells],
                                 at[-3 * wide_cells] + at[3 * wide_cells]);
        };
        shared.ways[thread] = edge_way(moment, along);
    });
}

}  // namespace fewrays
