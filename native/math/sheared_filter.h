// Sheared filters of one depth layer: the twin of src/fewrays/layered_published/filters.py, which derives them.
#pragma once

#include <cmath>

#include "host_device.h"

namespace fewrays {

enum class FilterFamily { sheared, axis_aligned };
enum class Sampling { disc, square, gaussian };

// What a layer's filter depends on besides its slopes; see FilterRule in filters.py for the units.
struct FilterRule {
    FilterFamily family;
    double sigma_pix;
    double sigma_u;
    double max_sigma_x;
    Sampling sampling;
    double sampling_sigma;
    double k;
};

struct LayerFilter {
    double eta;       // shear: samples are scattered to xy - eta * uv
    double variance;  // of the screen-space filter along one axis, in pixels²
    double falloff;   // a sample at lens radius r weighs exp(-falloff r²)
};

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

// Sheared filter: small shear (Eq. 27 to 29), wide wedge (Eq. 11) or transformed axes (Eq. 12 to 22).
FEWRAYS_HD inline LayerFilter sheared_filter(double c_min, double c_max, const FilterRule& rule) {
    const double sigma_u = rule.sigma_u, sigma_pix = rule.sigma_pix;
    double eta, lens_precision, sigma_screen;
    if (std::fmax(-c_min, c_max) < sigma_pix / sigma_u) {
        eta = 0.5 * (c_min + c_max);
        const double root = (c_max - c_min) / (2 * sigma_pix);
        lens_precision = root * root;
        sigma_screen = sigma_pix;
    } else if (c_min * c_max <= 0) {
        eta = 0.0;
        lens_precision = 1 / (sigma_u * sigma_u);
        sigma_screen = sigma_pix;
    } else {
        const double product = c_min * c_max, spread = c_max - c_min;
        const bool unlimited = product >= rule.max_sigma_x * spread / (2 * sigma_u);
        const double sigma_x = unlimited ? rule.max_sigma_x : 2 * sigma_u * product / spread;
        const double s = sigma_x * (c_min + c_max) / (2 * product);
        const double gamma2 = sigma_u * sigma_u + s * s;
        eta = s * sigma_x / gamma2;
        lens_precision = 1 / gamma2;
        sigma_screen = std::fmax(sigma_x * sigma_u / std::sqrt(gamma2), sigma_pix);
    }
    lens_precision = std::fmax(lens_precision, density_precision(rule));
    return {eta, sigma_screen * sigma_screen, 0.5 * (lens_precision - density_precision(rule))};
}

FEWRAYS_HD inline LayerFilter layer_filter(double c_min, double c_max, const FilterRule& rule) {
    return rule.family == FilterFamily::axis_aligned ? axis_aligned_filter(c_min, c_max, rule)
                                                     : sheared_filter(c_min, c_max, rule);
}

// Normalised taps at distances 0 … radius (pixels) of a Gaussian of the given variance (pixels²).
FEWRAYS_HD inline void layer_taps(double variance, int radius, float* taps) {
    double sum = 1;
    for (int d = 1; d <= radius; ++d) sum += 2 * std::exp(-d * d / (2 * variance));
    for (int d = 0; d <= radius; ++d) taps[d] = static_cast<float>(std::exp(-d * d / (2 * variance)) / sum);
}

}  // namespace fewrays
