// Surfaces among the samples around a location, told apart by one thread: sections 3.2 and 3.3 of Lehtinen et al. 2011.
// Twin of src/fewrays/temporal/surfaces.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "../math/reprojection.h"
#include "../math/surround.h"
#include "../simd.h"
#include "shell_sort.h"

namespace fewrays {

constexpr int least_samples = 4;  // of a surface that stands on its own

struct DeviceRule {
    float radius, along_lens, along_time, tolerance, tent, overhang;  // as of SurfaceRule in plan.py

    // The rule for where a pixel's length counts so many times.
    FEWRAYS_INLINE DeviceRule scaled(float factor) const {
        return {factor * radius, along_lens, along_time, factor * tolerance, tent, factor * overhang};
    }
};

// Samples as a view sees them.
struct SeenSample {
    float x, y, slope, speed_x, speed_y;
    std::int32_t source;  // its number; -1 where the view does not see it
};

// By how much slopes and speeds of samples differ.
class SeenRange {
public:
    FEWRAYS_INLINE void include(const SeenSample& sample) {
        slopes_.include(sample.slope);
        speeds_x_.include(sample.speed_x);
        speeds_y_.include(sample.speed_y);
    }
    // Whether they are one surface for certain, as no two of them can cross.
    FEWRAYS_INLINE bool one_surface(const DeviceRule& rule) const {
        return rule.along_lens * slopes_.width() + rule.along_time * std::max(speeds_x_.width(), speeds_y_.width()) <=
               rule.tolerance;
    }

private:
    struct Span {
        float low = INFINITY, high = -INFINITY;

        FEWRAYS_INLINE void include(float value) {
            low = std::min(low, value);
            high = std::max(high, value);
        }
        FEWRAYS_INLINE float width() const { return high - low; }
    };

    Span slopes_, speeds_x_, speeds_y_;
};

// By how much a surface's samples are moved towards the location, because it reaches beyond them: against the mean
// direction of those within R.
class Overhang {
public:
    FEWRAYS_INLINE void add(const DeviceRule& rule, float x, float y) {
        const float weight = std::max(1.0f - (x * x + y * y) / (rule.radius * rule.radius), 0.0f);
        right += weight * x;
        down += weight * y;
    }
    FEWRAYS_INLINE void scale_to(const DeviceRule& rule) {
        const float length = std::hypot(right, down), scale = length > 0.0f ? rule.overhang / length : 0.0f;
        right *= scale;
        down *= scale;
    }

    float right = 0.0f, down = 0.0f;
};

// Some samples, named by where they are among others, and a location.
class NearSurfaces {
public:
    FEWRAYS_INLINE NearSurfaces(const DeviceRule& rule, const SeenSample* from, std::int32_t* place, int count, float x,
                                float y)
        : rule_(rule), from_(from), place_(place), count_(count), x_(x), y_(y) {}

    FEWRAYS_INLINE const SeenSample& sample(int i) const { return from_[place_[i]]; }
    FEWRAYS_INLINE float away_x(int i) const { return sample(i).x - x_; }
    FEWRAYS_INLINE float away_y(int i) const { return sample(i).y - y_; }

    // Puts the names in order, from the front to the back.
    FEWRAYS_INLINE void sort_by_slope() {
        shell_sort(place_, count_, [this](std::int32_t a, std::int32_t b) { return is_before(a, b); });
    }

    // Where the surface ends that begins with sample `first`. Samples of one slope all join it, or none does.
    FEWRAYS_INLINE int end_of_group(int first) const {
        int next = first;
        while (next < count_) {
            int end = next + 1;
            while (end < count_ && sample(end).slope == sample(next).slope) ++end;
            for (int i = next; i < end; ++i)
                for (int j = first; j < next; ++j)
                    if (crosses(i, j)) return next;
            next = end;
        }
        return next;
    }

    FEWRAYS_INLINE bool fills_quadrants(int first, int end) const {
        unsigned quadrants = 0;
        for (int i = first; i < end; ++i) quadrants |= quadrant_of(away_x(i), away_y(i));
        return quadrants == all_quadrants;
    }

    // Whether samples [first, end), moved in the same way, lie on all sides, however far off.
    FEWRAYS_INLINE bool surround(int first, int end) const {
        const Overhang move = overhang(first, end);
        Surround surround;
        for (int i = first; i < end; ++i) surround.add(away_x(i) - move.right, away_y(i) - move.down);
        return surround.closed();
    }

    // Whether a valid triangle of samples [first, end), moved towards the location by the overhang, holds it.
    FEWRAYS_INLINE bool covers(int first, int end) const {
        const float radius2 = rule_.radius * rule_.radius;
        const Overhang move = overhang(first, end);
        const auto x_of = [&](int i) { return away_x(i) - move.right; };
        const auto y_of = [&](int i) { return away_y(i) - move.down; };
        const auto is_short = [&](int i, int j) {
            const float x = x_of(i) - x_of(j), y = y_of(i) - y_of(j);
            return x * x + y * y <= 4 * radius2;
        };
        const auto turn = [&](int i, int j) { return x_of(i) * y_of(j) - y_of(i) * x_of(j); };
        for (int corner = first; corner < end; ++corner) {
            if (x_of(corner) * x_of(corner) + y_of(corner) * y_of(corner) > radius2) continue;
            for (int second = first; second < end; ++second) {
                if (second == corner || !(turn(corner, second) >= 0) || !is_short(corner, second)) continue;
                for (int third = first; third < end; ++third)
                    if (third != corner && third != second && turn(third, corner) >= 0 && turn(second, third) >= 0 &&
                        is_short(corner, third) && is_short(second, third))
                        return true;
            }
        }
        return false;
    }

    static constexpr unsigned all_quadrants = 15u;
    FEWRAYS_INLINE static unsigned quadrant_of(float x, float y) { return 1u << ((x >= 0) + 2 * (y >= 0)); }

private:
    FEWRAYS_INLINE Overhang overhang(int first, int end) const {
        Overhang move;
        for (int i = first; i < end; ++i) move.add(rule_, away_x(i), away_y(i));
        move.scale_to(rule_);
        return move;
    }

    FEWRAYS_INLINE bool is_before(std::int32_t a, std::int32_t b) const {
        const SeenSample &p = from_[a], &q = from_[b];
        return p.slope != q.slope ? p.slope < q.slope : p.x != q.x ? p.x < q.x : p.y < q.y;
    }

    FEWRAYS_INLINE bool crosses(int i, int j) const {
        const SeenSample &p = sample(i), &q = sample(j);
        const float slopes = p.slope - q.slope;
        return std::max(crossing(p.x - q.x, slopes, p.speed_x - q.speed_x, rule_.along_lens, rule_.along_time),
                        crossing(p.y - q.y, slopes, p.speed_y - q.speed_y, rule_.along_lens, rule_.along_time)) >
               rule_.tolerance;
    }

    const DeviceRule& rule_;
    const SeenSample* const from_;
    std::int32_t* const place_;
    const int count_;
    const float x_, y_;
};

}  // namespace fewrays
