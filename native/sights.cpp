#include "sights.h"

#include <cmath>
#include <limits>

#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = read_beyond;
constexpr float infinity = std::numeric_limits<float>::infinity();

template <typename Combine>
FEWRAYS_INLINE float across(const float* values, Combine&& combine) {
    float result = values[0];
    for (int lane = 1; lane < lanes; ++lane) result = combine(result, values[lane]);
    return result;
}

FEWRAYS_INLINE float lesser(float a, float b) { return a < b ? a : b; }
FEWRAYS_INLINE float greater(float a, float b) { return a > b ? a : b; }

// The range of a quantity.
struct Span {
    float low[lanes], high[lanes];

    FEWRAYS_INLINE Span() {
        for (int lane = 0; lane < lanes; ++lane) {
            low[lane] = infinity;
            high[lane] = -infinity;
        }
    }
    FEWRAYS_INLINE void include(int lane, bool wanted, float value) {
        low[lane] = wanted & (value < low[lane]) ? value : low[lane];
        high[lane] = wanted & (value > high[lane]) ? value : high[lane];
    }
    FEWRAYS_INLINE float least() const { return across(low, lesser); }
    FEWRAYS_INLINE float most() const { return across(high, greater); }
    FEWRAYS_INLINE float width() const { return most() - least(); }
};

template <bool moving>
FEWRAYS_INLINE Range find_range(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                float farthest, const SurfaceRule& rule) {
    Span slopes, speeds_x, speeds_y;
    const float radius2 = place.radius * place.radius, at_x = place.x, at_y = place.y;
    for (int row = 0; row < row_count; ++row)
        for (std::int32_t first = rows[row].first; first < rows[row].end; first += lanes) {
            const std::int32_t left = rows[row].end - first;
            for (int lane = 0; lane < lanes; ++lane) {
                const float dx = sights.x[first + lane] - at_x, dy = sights.y[first + lane] - at_y;
                const float c = sights.slope[first + lane];
                const bool wanted = (dx * dx + dy * dy <= radius2) & (lane < left) & (c <= farthest);
                slopes.include(lane, wanted, c);
                if constexpr (moving) {
                    speeds_x.include(lane, wanted, sights.speed_x[first + lane]);
                    speeds_y.include(lane, wanted, sights.speed_y[first + lane]);
                }
            }
        }
    Range range{slopes.least(), slopes.most(), slopes.width() * rule.along_lens};
    if constexpr (moving) range.spread += greater(speeds_x.width(), speeds_y.width()) * rule.along_time;
    return range;
}

FEWRAYS_CLONES Range range_of_still(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                    float farthest, const SurfaceRule& rule) {
    return find_range<false>(sights, rows, row_count, place, farthest, rule);
}
FEWRAYS_CLONES Range range_of_moving(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                     float farthest, const SurfaceRule& rule) {
    return find_range<true>(sights, rows, row_count, place, farthest, rule);
}

enum class Sums { weights, radiance, weighted_radiance };

template <Sums sums_of>
FEWRAYS_INLINE Group add_up(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                            float farthest) {
    float sums[4][lanes] = {};
    std::int32_t quadrants[lanes] = {};
    const float radius2 = place.radius * place.radius, per_tent = 1.0f / place.tent, at_x = place.x, at_y = place.y;
    for (int row = 0; row < row_count; ++row)
        for (std::int32_t first = rows[row].first; first < rows[row].end; first += lanes) {
            const std::int32_t left = rows[row].end - first;
            for (int lane = 0; lane < lanes; ++lane) {
                const float dx = sights.x[first + lane] - at_x, dy = sights.y[first + lane] - at_y;
                const float distance2 = dx * dx + dy * dy;
                const bool wanted = (distance2 <= radius2) & (lane < left) & (sights.slope[first + lane] <= farthest);
                const std::int32_t beside = dx >= 0 ? 2 : 1, quadrant = dy >= 0 ? 4 * beside : beside;
                quadrants[lane] |= wanted ? quadrant : 0;
                const float under = 1.0f - std::sqrt(wanted ? distance2 : 0.0f) * per_tent;
                float weight = wanted & (under > 0.0f) ? under : 0.0f;
                if constexpr (sums_of == Sums::weighted_radiance) weight *= sights.weight[first + lane];
                sums[0][lane] += weight;
                if constexpr (sums_of == Sums::weights) continue;
                sums[1][lane] += weight * sights.red[first + lane];
                sums[2][lane] += weight * sights.green[first + lane];
                sums[3][lane] += weight * sights.blue[first + lane];
            }
        }
    Group group{};
    for (int lane = 0; lane < lanes; ++lane) {
        group.quadrants |= quadrants[lane];
        group.weight += sums[0][lane];
        group.red += sums[1][lane];
        group.green += sums[2][lane];
        group.blue += sums[3][lane];
    }
    return group;
}

FEWRAYS_CLONES Group group_of_matte(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                    float farthest) {
    return add_up<Sums::radiance>(sights, rows, row_count, place, farthest);
}
FEWRAYS_CLONES Group group_of_glossy(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                     float farthest) {
    return add_up<Sums::weighted_radiance>(sights, rows, row_count, place, farthest);
}
FEWRAYS_CLONES Group group_of_numbers(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                      float farthest) {
    return add_up<Sums::weights>(sights, rows, row_count, place, farthest);
}

// The sample next behind a slope, of those within a distance.
struct Next {
    float slope;         // infinite if there is none
    std::int32_t index;  // of the sample
    bool crosses;        // whether it, or another of its slope, crosses one of those in front
};

// Whether any of the samples within a distance that have a slope crosses one of those up to another slope.
bool any_crosses(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float farthest,
                 float slope, const SurfaceRule& rule) {
    const auto within = [&](std::int32_t i) {
        const float dx = sights.x[i] - place.x, dy = sights.y[i] - place.y;
        return dx * dx + dy * dy <= place.radius * place.radius;
    };
    const auto any = [&](auto&& holds) {
        for (int row = 0; row < row_count; ++row)
            for (std::int32_t i = rows[row].first; i < rows[row].end; ++i)
                if (holds(i)) return true;
        return false;
    };
    return any([&](std::int32_t i) {
        return sights.slope[i] == slope && within(i) && any([&](std::int32_t j) {
                   return sights.slope[j] <= farthest && within(j) && crossing_of(sights, i, j, rule) > rule.tolerance;
               });
    });
}

template <bool moving>
FEWRAYS_INLINE Next find_next(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                              float farthest, const SurfaceRule& rule) {
    float best[lanes], equals[lanes] = {};
    std::int32_t which[lanes] = {};
    for (int lane = 0; lane < lanes; ++lane) best[lane] = infinity;
    const float radius2 = place.radius * place.radius, at_x = place.x, at_y = place.y;
    for (int row = 0; row < row_count; ++row)
        for (std::int32_t first = rows[row].first; first < rows[row].end; first += lanes) {
            const std::int32_t left = rows[row].end - first;
            for (int lane = 0; lane < lanes; ++lane) {
                const float dx = sights.x[first + lane] - at_x, dy = sights.y[first + lane] - at_y;
                const float c = sights.slope[first + lane];
                const bool behind = (dx * dx + dy * dy <= radius2) & (lane < left) & (c > farthest);
                const bool better = behind & (c < best[lane]);
                equals[lane] = better ? 0.0f : (behind & (c == best[lane]) ? 1.0f : equals[lane]);
                which[lane] = better ? first + lane : which[lane];
                best[lane] = better ? c : best[lane];
            }
        }
    int nearest = 0;
    for (int lane = 1; lane < lanes; ++lane)
        if (best[lane] < best[nearest]) nearest = lane;
    Next next{best[nearest], which[nearest], false};
    if (!(next.slope < infinity)) return next;
    bool alone = equals[nearest] == 0.0f;
    for (int lane = 0; lane < lanes; ++lane) alone &= lane == nearest || best[lane] != next.slope;
    if (!alone) {
        next.crosses = any_crosses(sights, rows, row_count, place, farthest, next.slope, rule);
        return next;
    }

    const float x = sights.x[next.index], y = sights.y[next.index];
    for (int row = 0; row < row_count; ++row)
        for (std::int32_t first = rows[row].first; first < rows[row].end; first += lanes) {
            const std::int32_t left = rows[row].end - first;
            int crosses = 0;
            for (int lane = 0; lane < lanes; ++lane) {
                const float dx = sights.x[first + lane] - at_x, dy = sights.y[first + lane] - at_y;
                const float c = sights.slope[first + lane];
                const bool in_front = (dx * dx + dy * dy <= radius2) & (lane < left) & (c <= farthest);
                float over_x = (next.slope - c) * rule.along_lens - rule.tolerance, over_y = over_x;
                if constexpr (moving) {
                    over_x += std::fabs(sights.speed_x[next.index] - sights.speed_x[first + lane]) * rule.along_time;
                    over_y += std::fabs(sights.speed_y[next.index] - sights.speed_y[first + lane]) * rule.along_time;
                }
                const bool over =
                    (over_x > std::fabs(x - sights.x[first + lane])) | (over_y > std::fabs(y - sights.y[first + lane]));
                crosses |= static_cast<int>(in_front & over);
            }
            if (crosses) {
                next.crosses = true;
                return next;
            }
        }
    return next;
}

FEWRAYS_CLONES Next next_still(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                               float farthest, const SurfaceRule& rule) {
    return find_next<false>(sights, rows, row_count, place, farthest, rule);
}
FEWRAYS_CLONES Next next_moving(const Sights& sights, const SightRow* rows, int row_count, const Place& place,
                                float farthest, const SurfaceRule& rule) {
    return find_next<true>(sights, rows, row_count, place, farthest, rule);
}

}  // namespace

Range range_of(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float farthest,
               const SurfaceRule& rule) {
    return (sights.speed_x ? range_of_moving : range_of_still)(sights, rows, row_count, place, farthest, rule);
}

Group group_of(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float farthest) {
    const auto group = sights.number ? group_of_numbers : sights.weight ? group_of_glossy : group_of_matte;
    return group(sights, rows, row_count, place, farthest);
}

float end_of_surface(const Sights& sights, const SightRow* rows, int row_count, const Place& place, float least,
                     int steps, const SurfaceRule& rule) {
    float farthest = least + 0.999f * rule.tolerance / rule.along_lens;
    if (sights.speed_x && range_of_moving(sights, rows, row_count, place, farthest, rule).spread > rule.tolerance)
        return -infinity;
    const auto find = sights.speed_x ? next_moving : next_still;
    for (int step = 0; step < steps; ++step) {
        const Next next = find(sights, rows, row_count, place, farthest, rule);
        if (next.crosses || !(next.slope < infinity)) return farthest;
        farthest = next.slope;
    }
    return -infinity;
}

}  // namespace fewrays
