// Pixel filters along one axis: twin of `weight` in src/fewrays/pixel_filter.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "host_device.h"

namespace fewrays {

enum FilterShape : std::int32_t { box_filter, gaussian_filter, blackman_harris_filter, mitchell_filter };

struct PixelFilter {
    double radius, sigma;       // in pixels
    std::int32_t shape, reach;  // a FilterShape; pixels to each side of its own that a sample can touch
};

FEWRAYS_HD inline double blackman_harris(double x) {
    constexpr double pi = 3.14159265358979323846;
    return 0.35875 + 0.48829 * std::cos(pi * x) + 0.14128 * std::cos(2 * pi * x) + 0.01168 * std::cos(3 * pi * x);
}

FEWRAYS_HD inline double mitchell_netravali(double x) {
    if (x < 1) return (7.0 / 6 * x - 2) * x * x + 8.0 / 9;
    return ((-7.0 / 18 * x + 2) * x - 10.0 / 3) * x + 16.0 / 9;
}

// The filter's factor at a distance from the pixel's centre.
FEWRAYS_HD inline double filter_weight(const PixelFilter& filter, double distance) {
    const double x = std::fabs(distance);
    if (x > filter.radius) return 0;
    switch (filter.shape) {
        case gaussian_filter:
            return std::exp(-0.5 * (x / filter.sigma) * (x / filter.sigma));
        case blackman_harris_filter:
            return blackman_harris(x / 2);
        case mitchell_filter:
            return mitchell_netravali(x);
        default:
            return 1;
    }
}

}  // namespace fewrays
