// Samples as one lens point sees them at one time, and what is asked of those near a location, row by row: section 3.2
// of Lehtinen et al. 2011.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "math/reprojection.h"

namespace fewrays {

struct SurfaceRule {
    float radius;                  // R, in pixels: no hole of the samples is wider
    float along_lens, along_time;  // how far lens points and times vary within a location
    float tolerance;               // pixels that samples of a surface may cross
    float tent;                    // radius of the tent filter, in R; 0 takes the nearest sample instead
    float overhang;                // pixels that a surface juts out beyond its outermost samples, on average
};

// Samples as seen from one lens point at one time.
struct Sights {
    const float *x, *y, *slope;
    const float *speed_x, *speed_y;   // null where nothing moves
    const float* weight;              // less than 1 for samples far from their own lens point; null where all are matte
    const float *red, *green, *blue;  // null where nobody asks
    const float* spacing;             // as in LightField
    const std::int32_t* number;       // which of all samples it is; null where nobody asks
};

// Some of them, one after the other. Arrays have room for `read_beyond` more.
struct SightRow {
    std::int32_t first, end;
};
constexpr int read_beyond = 16;

// A location: where it is, within what distance samples count, and the radius of the tent that they are summed under.
struct Place {
    float x, y, radius, tent;
};

// The range of slopes within the distance, and by how much any two samples might cross at most.
struct Range {
    float least, most, spread;
};

// Of the samples up to the slope `farthest`; the least is infinite where there is none.
Range range_of(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float farthest,
               const SurfaceRule& rule);

// The samples within the distance up to a slope: the quadrants that they fill, as bits, and sums under the tent.
struct Group {
    int quadrants;
    float weight, red, green, blue;
};
constexpr int all_quadrants = 15;

// Sums of radiance only where nobody asks for the samples' numbers: who wants to know these adds radiance up himself.
Group group_of(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float farthest);

// By how much two samples cross.
inline float crossing_of(const Sights& s, std::ptrdiff_t a, std::ptrdiff_t b, const SurfaceRule& rule) {
    const float slopes = s.slope[a] - s.slope[b];
    const float speed_x = s.speed_x ? s.speed_x[a] - s.speed_x[b] : 0.0f;
    const float speed_y = s.speed_x ? s.speed_y[a] - s.speed_y[b] : 0.0f;
    return std::max(crossing(s.x[a] - s.x[b], slopes, speed_x, rule.along_lens, rule.along_time),
                    crossing(s.y[a] - s.y[b], slopes, speed_y, rule.along_lens, rule.along_time));
}

// How far back the surface reaches whose nearest sample has the slope `least` (Figure 7): samples of nearly that slope
// cross nowhere, and after them each joins until one crosses another. Infinite, but negative, where that is not so or
// takes long: the samples must be put in order then.
float end_of_surface(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float least,
                     int steps, const SurfaceRule& rule);

}  // namespace fewrays
