// Taps of discrete Gaussians of a given variance: the twin of src/fewrays/layered/taps.py.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

// Exponent t for which the discrete kernel exp(-t d²), |d| <= radius, has the given variance.
FEWRAYS_HD inline double exponent_of_variance(double variance, int radius) {
    if (variance >= radius * (radius + 1) / 3.0) return 0.0;  // even a box is not wide enough
    double t = 1 / (2 * variance);
    if (variance <= 0.5) t = std::fmin(t, std::log(2 / variance));
    for (int step = 0; step < 12; ++step) {
        double sum = 0.5, second = 0, fourth = 0;  // of one half of the kernel
        for (int d = 1; d <= radius; ++d) {
            const double d2 = double(d) * d, tap = std::exp(-t * d2);
            sum += tap;
            second += tap * d2;
            fourth += tap * d2 * d2;
        }
        second /= sum;
        fourth /= sum;
        const double slope = (fourth - second * second) / (second * second);
        const double next = std::fmax(t - (1 / second - 1 / variance) / slope, 0.0);
        if (std::fabs(next - t) <= 1e-12 * t) return next;
        t = next;
    }
    return t;
}

constexpr double taps_reach = 3.0;       // standard deviations
constexpr double point_variance = 1e-9;  // of a kernel that is a single tap, in bins²

// Distance of the farthest tap of a kernel of the given variance, in bins.
FEWRAYS_HD inline int taps_radius(double variance) {
    return variance < point_variance ? 0 : static_cast<int>(std::ceil(taps_reach * std::sqrt(variance)));
}

// Normalised taps at distances 0 … radius of a Gaussian that has, discrete and cut off, the given variance (bins²).
FEWRAYS_HD inline void gaussian_taps(double variance, int radius, float* taps) {
    const double t = radius > 0 ? exponent_of_variance(variance, radius) : 0.0;
    double sum = 1;
    for (int d = 1; d <= radius; ++d) sum += 2 * std::exp(-t * d * d);
    for (int d = 0; d <= radius; ++d) taps[d] = static_cast<float>(std::exp(-t * d * d) / sum);
}

}  // namespace fewrays
