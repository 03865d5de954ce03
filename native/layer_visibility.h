// How a layer hides what is behind it, and shows where nothing hides it, for one part of the aperture.
#pragma once

#include <cstddef>

#include "layer_maps.h"

namespace fewrays {

// Pixels that are composited at a time, to stay in the first cache.
constexpr int patch_rows = 8, patch_columns = 128;
constexpr int patch_area = patch_rows * patch_columns;

// A layer's map as seen through one part of the aperture.
struct LayerView {
    const float* channels[channel_count];  // at the first pixel
    std::ptrdiff_t stride;
    float fraction_x, fraction_y;  // of the way to the next cell
    float shear;                   // pixels that the layer moves for one standard deviation of the part
};

// How much of what is behind shows, to first order in the place on the lens: a mean, and a slope for each standard
// deviation of the part of the aperture, in rows of `patch_columns`; and the sums of what has shown so far, in rows
// of `stride`.
struct Shown {
    float *mean, *along_u, *along_v;
    float *opacity, *red, *green, *blue;
    int rows, columns, stride;
    float weight;
};

// Adds a layer behind what is there: the mean over the part of visibility times radiance is the product of the means
// plus the covariance, to first order. What no ray has seen behind a cover is known only where the cover lets it
// through: there the means already belong together, so the covariance counts by how much more is known.
void composite(const LayerView& view, const Shown& shown);

// The same for a layer near focus, which hardly moves over the lens.
void composite_near(const LayerView& view, const Shown& shown);

// The largest of a whole number of groups of columns.
float largest(const float* values, std::ptrdiff_t n);

// Where a row of opacities is not zero.
Span occupied(const float* row, int columns);

}  // namespace fewrays
