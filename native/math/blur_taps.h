// Taps of discrete Gaussians of a given variance: the twin of src/fewrays/layered/taps.py.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

constexpr double taps_reach = 3.0;       // standard deviations
constexpr double point_variance = 1e-9;  // of a kernel that is as narrow as can be, in bins²

// Taps on each side of a kernel of the given variance (bins²). `first` is the distance of the nearest: 0 for a kernel
// around a bin, where the first tap is on both sides at once, 1/2 for one around the border of two.
FEWRAYS_HD inline int tap_count(double variance, double first) {
    if (variance - first * first < point_variance) return 1;
    return static_cast<int>(std::ceil(taps_reach * std::sqrt(variance) - first)) + 1;
}

// Exponent t for which the kernel exp(-t d²) with `count` taps on each side has the given variance.
FEWRAYS_HD inline double exponent_of_variance(double variance, double first, int count) {
    const auto excess = [&](int k) { return k * (k + 2 * first); };  // of d², over that of the nearest taps
    const auto times = [&](int k) { return first + k > 0 ? 2 : 1; };
    const double wanted = variance - first * first;
    double box = 0, taps = 0;
    for (int k = 0; k < count; ++k) {
        box += times(k) * excess(k);
        taps += times(k);
    }
    if (wanted >= box / taps) return 0.0;  // even a box is not wide enough
    double t = 1 / (2 * variance);
    // Narrow kernels are almost those of the nearest two distances.
    if (wanted <= 0.5) t = std::log(double(times(1)) / times(0) * (excess(1) - wanted) / wanted) / excess(1);
    for (int step = 0; step < 12; ++step) {
        double sum = 0, mean = 0, square = 0;
        for (int k = 0; k < count; ++k) {
            const double e = excess(k), tap = times(k) * std::exp(-t * e);
            sum += tap;
            mean += tap * e;
            square += tap * e * e;
        }
        mean /= sum;
        const double spread = square / sum - mean * mean;
        const double next = std::fmax(t - (1 / mean - 1 / wanted) * mean * mean / spread, 0.0);
        if (std::fabs(next - t) <= 1e-12 * t) return next;
        t = next;
    }
    return t;
}

// Normalised taps at the distances first, first + 1, … of a Gaussian that has, discrete and cut off, the given
// variance.
FEWRAYS_HD inline void gaussian_taps(double variance, double first, int count, float* taps) {
    const double t = count > 1 ? exponent_of_variance(variance, first, count) : 0.0;
    const auto tap = [&](int k) { return std::exp(-t * k * (k + 2 * first)); };
    double sum = 0;
    for (int k = 0; k < count; ++k) sum += (first + k > 0 ? 2 : 1) * tap(k);
    for (int k = 0; k < count; ++k) taps[k] = static_cast<float>(tap(k) / sum);
}

}  // namespace fewrays
