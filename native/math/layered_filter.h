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
    Sampling sampling;
    double sampling_sigma;
    double aperture_moment;
    double k;
};

struct LayerFilter {
    double eta;       // shear: samples are scattered to xy - eta * uv
    double variance;  // of the screen-space kernel along one axis, in pixels²
    double falloff;   // a sample at lens radius r weighs exp(-falloff r²)
};

constexpr double bin_variance = 1.0 / 12.0;

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

// Axis-aligned filter after Mehta et al. 2012 (section 7 of the layered paper).
FEWRAYS_HD inline LayerFilter axis_aligned_filter(double c_min, double c_max, const FilterRule& rule) {
    const bool crosses = c_min <= 0 && c_max >= 0;
    const double nearest = crosses ? 0.0 : std::fmin(std::fabs(c_min), std::fabs(c_max));
    const double sigma = std::fmin(std::fmax(nearest * rule.sigma_u / rule.k, rule.sigma_pix), rule.max_sigma_x);
    const double density =
        rule.sampling == Sampling::gaussian ? 1 / (rule.sampling_sigma * rule.sampling_sigma) : 0.0;
    const double falloff = 0.5 * std::fmax(1 / (rule.sigma_u * rule.sigma_u) - density, 0.0);
    return {0.0, std::fmax(sigma * sigma - bin_variance, 0.0), falloff};
}

// Sheared filter: small shear (Eq. 27 to 29), wide wedge (Eq. 11) or transformed axes (Eq. 12 to 22).
FEWRAYS_HD inline LayerFilter sheared_filter(double c_min, double c_max, const FilterRule& rule) {
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
        const bool unlimited = product >= rule.max_sigma_x * spread / (2 * sigma_u);
        const double sigma_x = unlimited ? rule.max_sigma_x : 2 * sigma_u * product / spread;
        center = 2 * product / (c_min + c_max);
        const double s = center != 0 ? sigma_x / center : 0.0;
        const double gamma2 = sigma_u * sigma_u + s * s;
        eta = s * sigma_x / gamma2;
        lens_precision = 1 / gamma2;
        sigma_screen = std::fmax(sigma_x * sigma_u / std::sqrt(gamma2), sigma_pix);
    }

    double density_precision = 0;
    if (rule.sampling == Sampling::gaussian) {
        density_precision = 1 / (rule.sampling_sigma * rule.sampling_sigma);
        lens_precision = std::fmax(lens_precision, density_precision);
    }
    const double falloff = 0.5 * (lens_precision - density_precision);
    if (rule.family == FilterFamily::paper) return {eta, sigma_screen * sigma_screen, falloff};

    const double residual = (center - eta) * (center - eta) * lens_moment(lens_precision, rule.sampling);
    const double variance = sigma_pix * sigma_pix + center * center * rule.aperture_moment - residual - bin_variance;
    return {eta, std::fmax(variance, 0.0), falloff};
}

FEWRAYS_HD inline LayerFilter layer_filter(double c_min, double c_max, const FilterRule& rule) {
    return rule.family == FilterFamily::axis_aligned ? axis_aligned_filter(c_min, c_max, rule)
                                                     : sheared_filter(c_min, c_max, rule);
}

// Exponent t for which the discrete kernel exp(-t d²), |d| <= ring, has the given variance.
FEWRAYS_HD inline double exponent_of_variance(double variance, int ring) {
    if (variance >= ring * (ring + 1) / 3.0) return 0.0;  // even a box is not wide enough
    double t = 1 / (2 * variance);
    if (variance <= 0.5) t = std::fmin(t, std::log(2 / variance));
    for (int step = 0; step < 12; ++step) {
        double sum = 0.5, second = 0, fourth = 0;  // of one half of the kernel
        for (int d = 1; d <= ring; ++d) {
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

// Normalised taps at distances 0 … ring of the screen-space kernel.
FEWRAYS_HD inline void screen_taps(double variance, int ring, bool exact, float* taps) {
    const bool point = variance < 1e-9;
    const double t = exact && !point ? exponent_of_variance(variance, ring) : 1 / (2 * variance);
    double sum = 1;
    for (int d = 1; d <= ring; ++d) sum += 2 * (point ? 0.0 : std::exp(-t * d * d));
    taps[0] = float(1 / sum);
    for (int d = 1; d <= ring; ++d) taps[d] = point ? 0.0f : float(std::exp(-t * d * d) / sum);
}

}  // namespace fewrays
