// What remains to blur a layer's map by: the twin of blur_variance in src/fewrays/layered/reference.py.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

constexpr double magnified_variance = 0.25;     // of the quadratic B-spline that reads coarse maps, in bins²
constexpr double bin_variance = 1.0 / 12.0;     // of the bin that a sample is rounded to, in bins²
constexpr double shared_variance = 1.0 / 12.0;  // what sharing hits between bins adds to that

// Variances along one axis: of the pixel filter in pixels², of the aperture and of one of its parts in lens units², and
// what reading maps between their cells adds, in cells².
struct BlurWidths {
    double pixel, aperture, part, interpolation;
};

// The variance in bins² that remains to blur a layer of bins of 2^level pixels by. Wanted is the pixel filter's and
// that of the aperture, or of a part of it, at the layer's slope. Bins and interpolation have each a share in it
// already.
FEWRAYS_HD inline double layer_blur_variance(int level, double slope, const BlurWidths& widths) {
    const bool near = level < 0;
    const double bin = std::exp2(static_cast<double>(level));
    double variance = widths.pixel + slope * slope * (near ? widths.aperture : widths.part);
    if (!near) variance -= widths.interpolation;
    variance /= bin * bin;
    if (level > 0) variance -= magnified_variance + shared_variance;
    return std::fmax(variance - bin_variance, 0.0);
}

}  // namespace fewrays
