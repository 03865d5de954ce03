// The multiplane method's CPU kernels, one thread. Twin of src/fewrays/multiplane/reference.py.
//
// A plane is a sparse map, at the lens centre, of radiance and opacity. From lens point (u, v) at time t it is seen
// shifted by slope (u, v) + motion (t - 1/2) pixels. It is cut into blocks, of which only those with samples are kept.
#pragma once

#include <cstdint>

#include "half.h"
#include "math/cats_eye.h"
#include "math/depth_plane.h"
#include "sample_tree.h"

namespace fewrays {

// Halves before the first block and after the last: pixels are read sixteen at a time, some of them outside the block.
constexpr std::int64_t half_padding = 64;

struct PlaneSet {
    const DepthPlane* planes;  // front to back
    int count;
    const std::int32_t* slots;  // of each block, the place of its halves in units; -1 without one
    float most_blur;            // samples of larger slopes, in size, count as such
};

// Samples of one run: where they lie in the image, and the hindmost plane that they hit.
struct Run {
    float x_min, x_max, y_min, y_max;
    std::int32_t last_plane;  // -1 for none
};

// Marks the blocks that samples touch: `marks` has a place for every slot. `reach` takes, for every plane, how far from
// its image position a sample hits it, in pixels, and `brightest` the largest of its radiances in size. Samples of
// plane -1 are left out.
void multiplane_mark(const LightField& field, const std::int16_t* plane_of, const PlaneSet& set, std::uint8_t* marks,
                     float* reach, float* brightest);

// Describes runs of `length` samples each, [first, last).
void multiplane_runs(const LightField& field, const std::int16_t* plane_of, int length, int first, int last, Run* runs);

struct BuildPlan {
    int run_length, run_count;
    const Run* runs;
    const float* reach;  // of each plane
    float prior;         // samples that a neighbourhood's estimate counts as
    const float* along;  // of each plane, samples that cells look for along edges, to each side
};

// A part of a plane that is worked on at once: rows of blocks [first_row, last_row).
struct PlanePart {
    std::int32_t plane, first_row, last_row;
};

void multiplane_build(const LightField& field, const std::int16_t* plane_of, const PlaneSet& set, const BuildPlan& plan,
                      const PlanePart& part, Half* halves);

// Smoothed copies of planes. Those at half resolution have their slopes, motions and places in units of two pixels, and
// one cell in each of these.
struct SmoothCopies {
    const DepthPlane* planes;
    const std::uint8_t* is_halved;  // (planes,)
    std::int32_t* places;           // of each block, as `PlaneSet::slots`; -1 where none is wanted
    Half* halves;
};

// Smooths a part of a plane, in blocks of its copy. The Gaussian's standard deviation is in pixels. Places for blocks
// that the plane itself does not have become -1 where next to nothing comes.
void multiplane_smooth(const PlaneSet& set, const Half* halves, float sigma, const SmoothCopies& copies,
                       const PlanePart& part);

// Where blocks are: planes are smoothed copies, or as they were built.
struct Blocks {
    const Half *built, *smoothed;
    const std::uint8_t* is_smoothed;  // (planes,)
    const std::uint8_t* is_halved;    // (planes,): only planes in front of all others, and behind all others
};

// What every pixel is the mean of.
struct ViewSet {
    int count;
    const float* views;   // (count, 6): u, v, time, offset from the pixel's centre (x, y), weight
    const float* shrink;  // (planes,): scale of offsets and lens points, which makes up for the maps' own blur
    const float* reach;   // (planes, 2): how far any view shifts a plane at most, in pixels (x, y)
    FrontRim rim;         // of the lens
    bool vignetted, darken;
};

struct RenderTarget {
    int height, width;
    float* image;  // (H, W, 4): radiance, and the share of the light that planes account for
};

// Renders tiles [first, last), which are numbered row by row.
constexpr int tile_rows = 16, tile_columns = 128;
void multiplane_render(const PlaneSet& set, const Blocks& blocks, const ViewSet& views, int first, int last,
                       const RenderTarget& target);

}  // namespace fewrays
