// Sheared filters of one depth layer: the twin of src/fewrays/layered/filters.py, which derives them.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

enum class FilterFamily { paper, matched, axis_aligned };
enum class Sampling { disc, square, gaussian };

// What a layer's filter depends on besides its slopes; see FilterRule in filters.py for the units.
struct FilterRule {
    FilterFamily family;
    double sigma_pix;
    double sigma_u;
    double max_sigma_x;
    double occluded_sigma_x;
    Sampling sampling;
    double sampling_sigma;
    double aperture_moment;
    double k;
};

struct LayerFilter {
    double eta;       // shear: samples are scattered to xy - eta * uv
    double variance;  // of the screen-space filter along one axis, in pixels²
    double falloff;   // a sample at lens radius r weighs exp(-falloff r²)
};

constexpr double bin_variance = 1.0 / 12.0;  // in bins²

// Second moment along one axis of a Gaussian of the given precision, cut off where the samples end.
FEWRAYS_HD inline double lens_moment(double precision, Sampling sampling) {
    if (sampling == Sampling::disc) {
        const double b = 0.5 * precision;
        return b < 1e-2 ? 0.25 - b / 24 : 0.5 * (1 / b - 1 / std::expm1(b));
    }
    if (precision < 0.05) return 1.0 / 3 - 2.0 / 45 * precision + 2.0 / 945 * precision * precision;
    const double two_over_pi = 0.63661977236758134;
    const double edge =
        std::sqrt(two_over_pi * precision) * std::exp(-0.5 * precision) / std::erf(std::sqrt(precision / 2));
    return (1 - edge) / precision;
}

// Reciprocal variance of a Gaussian sampling density; 0 for a uniform one.
FEWRAYS_HD inline double density_precision(const FilterRule& rule) {
    return rule.sampling == Sampling::gaussian ? 1 / (rule.sampling_sigma * rule.sampling_sigma) : 0.0;
}

// Axis-aligned filter after Mehta et al. 2012 (section 7 of the layered paper).
FEWRAYS_HD inline LayerFilter axis_aligned_filter(double c_min, double c_max, const FilterRule& rule) {
    const bool crosses = c_min <= 0 && c_max >= 0;
    const double nearest = crosses ? 0.0 : std::fmin(std::fabs(c_min), std::fabs(c_max));
    const double sigma = std::fmin(std::fmax(nearest * rule.sigma_u / rule.k, rule.sigma_pix), rule.max_sigma_x);
    const double falloff = 0.5 * std::fmax(1 / (rule.sigma_u * rule.sigma_u) - density_precision(rule), 0.0);
    return {0.0, sigma * sigma, falloff};
}

// Largest sigma_x of a layer of which others cover the share `occlusion`.
FEWRAYS_HD inline double sigma_x_limit(double occlusion, const FilterRule& rule) {
    const double uncovered = std::fmax(0.0, 1 - occlusion / 0.3);
    return rule.occluded_sigma_x + (rule.max_sigma_x - rule.occluded_sigma_x) * uncovered;
}

// Share of its samples with which a layer in front, of slope `front`, covers one of slope `center`.
FEWRAYS_HD inline double covering_share(double front, double center) {
    return center != 0 ? std::fmin(1.0, 0.5 * std::fabs(front - center) / std::fabs(center)) : 1.0;
}

// Central slope of a layer (Eq. 13); 0 where it spans the focal plane.
FEWRAYS_HD inline double central_slope(double c_min, double c_max) {
    const double product = c_min * c_max;
    return product > 0 ? 2 * product / (c_min + c_max) : 0.0;
}

// Sheared filter: small shear (Eq. 27 to 29), wide wedge (Eq. 11) or transformed axes (Eq. 12 to 22).
FEWRAYS_HD inline LayerFilter sheared_filter(double c_min, double c_max, const FilterRule& rule, double limit) {
    const double sigma_u = rule.sigma_u, sigma_pix = rule.sigma_pix;
    double center, eta, lens_precision, sigma_screen;
    if (std::fmax(-c_min, c_max) < sigma_pix / sigma_u) {
        center = eta = 0.5 * (c_min + c_max);
        const double root = (c_max - c_min) / (2 * sigma_pix);
        lens_precision = root * root;
        sigma_screen = sigma_pix;
    } else if (c_min < 0 && c_max > 0) {
        center = eta = 0.0;
        lens_precision = 1 / (sigma_u * sigma_u);
        sigma_screen = sigma_pix;
    } else {
        const double product = c_min * c_max, spread = c_max - c_min;
        const bool unlimited = product >= limit * spread / (2 * sigma_u);
        const double sigma_x = unlimited ? limit : 2 * sigma_u * product / spread;
        center = central_slope(c_min, c_max);
        const double s = center != 0 ? sigma_x / center : 0.0;
        const double gamma2 = sigma_u * sigma_u + s * s;
        eta = s * sigma_x / gamma2;
        lens_precision = 1 / gamma2;
        sigma_screen = std::fmax(sigma_x * sigma_u / std::sqrt(gamma2), sigma_pix);
    }

    lens_precision = std::fmax(lens_precision, density_precision(rule));
    const double falloff = 0.5 * (lens_precision - density_precision(rule));
    if (rule.family == FilterFamily::paper) return {eta, sigma_screen * sigma_screen, falloff};

    const double residual = (center - eta) * (center - eta) * lens_moment(lens_precision, rule.sampling);
    const double variance = sigma_pix * sigma_pix + center * center * rule.aperture_moment - residual;
    return {eta, variance, falloff};
}

FEWRAYS_HD inline LayerFilter layer_filter(double c_min, double c_max, double occlusion, const FilterRule& rule) {
    return rule.family == FilterFamily::axis_aligned
               ? axis_aligned_filter(c_min, c_max, rule)
               : sheared_filter(c_min, c_max, rule, sigma_x_limit(occlusion, rule));
}

// The grid of a layer's discrete screen-space filter.
struct ScreenGrid {
    int bins_per_pixel;  // odd: a pixel's centre is the centre of a bin
    int radius;          // of the kernel, in bins
};

FEWRAYS_HD inline ScreenGrid screen_grid(double variance, int ring, FilterFamily family) {
    if (family == FilterFamily::paper) return {1, ring};
    const double sigma = std::sqrt(variance);
    const int bins = sigma >= 1.6 ? 1 : 3 * sigma >= 1.6 ? 3 : 5;
    const double radius = std::ceil(4 * sigma * bins);
    return {bins, radius < ring * bins ? static_cast<int>(radius) : ring * bins};
}

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

// Normalised taps at distances 0 … radius (bins) of a Gaussian of the given variance (bins²).
FEWRAYS_HD inline void screen_taps(double variance, int radius, bool exact, float* taps) {
    const bool point = variance < 1e-9;
    const double t = exact && !point ? exponent_of_variance(variance, radius) : 1 / (2 * variance);
    double sum = 1;
    for (int d = 1; d <= radius; ++d) sum += 2 * (point ? 0.0 : std::exp(-t * d * d));
    taps[0] = float(1 / sum);
    for (int d = 1; d <= radius; ++d) taps[d] = point ? 0.0f : float(std::exp(-t * d * d) / sum);
}

// The taps of a layer's screen-space filter: `taps` holds grid.radius + 1.
FEWRAYS_HD inline void layer_taps(double variance, ScreenGrid grid, FilterFamily family, float* taps) {
    if (family == FilterFamily::paper) return screen_taps(variance, grid.radius, false, taps);
    const double in_bins = variance * grid.bins_per_pixel * grid.bins_per_pixel;
    screen_taps(in_bins - bin_variance, grid.radius, true, taps);
}

}  // namespace fewrays
