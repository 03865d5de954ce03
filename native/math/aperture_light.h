// How densely light comes through an aperture, and how densely samples were drawn: twin of `density` in
// src/fewrays/aperture.py and `sampling_density` in src/fewrays/lens.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "host_device.h"

namespace fewrays {

constexpr double aperture_rim = 1e-5;  // positions this far beyond the rim still count as inside
constexpr double half_turn = 3.14159265358979323846;

// What lets light pass: a star-shaped aperture of equal sectors from corner to corner, or an image.
struct ApertureLight {
    const double* pixels;                   // (rows, columns): transmittances; null for none
    double scale_u, scale_v, area;          // of the squeeze; light in all
    double falloff;                         // 1 / (2 σ²) of a Gaussian, else 0
    double first_corner, rim_arc, rim_top;  // where the first sector begins, and the numbers of its rim
    std::int32_t sectors, rows, columns;
};

// Transmittance of the image's pixel that a position lies in.
FEWRAYS_HD inline double image_light_at(const ApertureLight& a, double u, double v) {
    const double column = std::clamp((u + 1) * (0.5 * a.columns), 0.0, a.columns - 1.0);
    const double row = std::clamp((v + 1) * (0.5 * a.rows), 0.0, a.rows - 1.0);
    return a.pixels[static_cast<std::int64_t>(row) * a.columns + static_cast<std::int64_t>(column)];
}

// The same, where on a border the lighter side counts.
FEWRAYS_HD inline double image_light(const ApertureLight& a, double u, double v) {
    if (std::fabs(u) > 1 + aperture_rim || std::fabs(v) > 1 + aperture_rim) return 0;
    double light = 0;
    for (int corner = 0; corner < 4; ++corner) {
        const double right = corner % 2 ? aperture_rim : -aperture_rim,
                     down = corner / 2 ? aperture_rim : -aperture_rim;
        light = std::max(light, image_light_at(a, u + right, v + down));
    }
    return light;
}

// Distance of the rim in the direction of a position.
FEWRAYS_HD inline double rim_towards(const ApertureLight& a, double u, double v) {
    if (a.rim_arc == 0) return a.rim_top;  // of a disc, in all directions
    const double turn = (std::atan2(v, u) - a.first_corner) / (2 * half_turn) * a.sectors;
    const double from_middle = (turn - std::floor(turn) - 0.5) * (2 * half_turn / a.sectors);
    const double sine = a.rim_arc * std::sin(from_middle);
    return a.rim_top / (a.rim_arc * std::cos(from_middle) + std::sqrt(1 - sine * sine));
}

// Share of the light per lens unit² at a lens position.
FEWRAYS_HD inline double aperture_density(const ApertureLight& a, double u, double v) {
    u /= a.scale_u;
    v /= a.scale_v;
    if (a.pixels) return image_light(a, u, v) / a.area;
    if (!(std::hypot(u, v) <= rim_towards(a, u, v) + aperture_rim)) return 0;
    return (a.falloff > 0 ? std::exp(-a.falloff * (u * u + v * v)) : 1.0) / a.area;
}

// Density per lens unit² that lens positions were drawn from: even, or a Gaussian.
struct LensSampling {
    double peak, falloff;

    FEWRAYS_HD double density(double u, double v) const {
        return falloff > 0 ? peak * std::exp(-falloff * (u * u + v * v)) : peak;
    }
};

}  // namespace fewrays
