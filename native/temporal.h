// The temporal method's CPU kernels, one thread. Twin of src/fewrays/temporal/reference.py.
#pragma once

#include <cstdint>

#include "sample_tree.h"
#include "shadows.h"
#include "surfaces.h"

namespace fewrays {

// Where every pixel is reconstructed: all pixels share the lens points and times of the views.
struct ViewPlan {
    int height, width;
    int tile;  // side of a tile of the image, in pixels
    int view_count;
    const float* views;  // (view_count, 6): u, v, time, offset from the pixel's centre (x, y), weight
    SurfaceRule rule;
    // What is seen is added up in bands of blur: band k holds slopes from band_starts[k] on, in size.
    int band_count;
    const float* band_starts;
};

// Reconstructs single locations, (count, 5): x, y, u, v, time. Where no sample is near, `found` is 0.
void temporal_locations(const SampleTree& tree, const SurfaceRule& rule, const float* locations, std::int64_t count,
                        float* colors, std::uint8_t* found, SurfaceStatistics& statistics);

// Reconstructs tiles [first, last) of the image, (H, W, band_count, 4): sums of radiance and weights. With lights, the
// radiance is what the points that are seen reflect of them, and what is not theirs.
void temporal_tiles(const SampleTree& tree, const ViewPlan& plan, const LitPlan* lit, int first, int last, float* bands,
                    SurfaceStatistics& statistics);

}  // namespace fewrays
