#include "surfaces.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>
#include <vector>

#include "math/reprojection.h"
#include "math/surround.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = read_beyond;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr int least_samples = 4;  // of a surface that stands on its own

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

struct Place {
    float x, y, radius, tent;
};

// The range of slopes within R, up to one, and by how much any two samples might cross at most.
struct Range {
    float least, most, spread;
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

// The samples within R up to a slope: the quadrants that they fill, as bits, and sums under the tent.
struct Group {
    int quadrants;
    float weight, red, green, blue;
};

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
constexpr int all_quadrants = 15;

float crossing_of(const Sights& s, std::ptrdiff_t a, std::ptrdiff_t b, const SurfaceRule& rule) {
    const float slopes = s.slope[a] - s.slope[b];
    const float speed_x = s.speed_x ? s.speed_x[a] - s.speed_x[b] : 0.0f;
    const float speed_y = s.speed_x ? s.speed_y[a] - s.speed_y[b] : 0.0f;
    return std::max(crossing(s.x[a] - s.x[b], slopes, speed_x, rule.along_lens, rule.along_time),
                    crossing(s.y[a] - s.y[b], slopes, speed_y, rule.along_lens, rule.along_time));
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

constexpr int steps_at_a_glance = 2, most_steps = 12;  // samples that join one by one before all are put in order

// How far back the surface reaches whose nearest sample has the slope `least` (Figure 7): samples of nearly that slope
// cross nowhere, and after them each joins until one crosses another. Infinite, but negative, where that is not so or
// takes long: the samples must be put in order then.
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

constexpr float taken = infinity;  // the depth of samples that a surface has taken
constexpr float far_away = 1e18f;

// Whether one of the points after the j-th forms a triangle with the i-th and the j-th that holds the origin and has no
// longer edges.
FEWRAYS_CLONES bool closes_triangle(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y, int n, int i,
                                    int j, float longest) {
    const float ax = x[i], ay = y[i], bx = x[j], by = y[j], ab = ax * by - ay * bx;
    for (int first = j + 1; first < n; first += lanes) {
        int closes = 0;
        for (int lane = 0; lane < lanes; ++lane) {
            const float cx = x[first + lane], cy = y[first + lane];
            const float bc = bx * cy - by * cx, ca = cx * ay - cy * ax;
            const bool inside = ((ab >= 0) & (bc >= 0) & (ca >= 0)) | ((ab <= 0) & (bc <= 0) & (ca <= 0));
            const bool near = ((cx - ax) * (cx - ax) + (cy - ay) * (cy - ay) <= longest) &
                              ((cx - bx) * (cx - bx) + (cy - by) * (cy - by) <= longest);
            closes |= static_cast<int>(inside & near);
        }
        if (closes) return true;
    }
    return false;
}

}  // namespace

SurfaceStatistics& SurfaceStatistics::operator+=(const SurfaceStatistics& other) {
    locations += other.locations;
    empty += other.empty;
    single += other.single;
    quadrants += other.quadrants;
    covered += other.covered;
    last += other.last;
    wide += other.wide;
    surfaces += other.surfaces;
    merged += other.merged;
    return *this;
}

void Crowd::begin(const Sights& from, int most) {
    from_ = from;
    size_ = 0;
    const std::size_t room = static_cast<std::size_t>(most) + read_beyond;
    if (x_.size() >= room) return;
    source_.resize(room);
    for (auto* field : {&x_, &y_, &slope_, &speed_x_, &speed_y_}) field->resize(room);
}

void Crowd::finish() {
    thin(most_samples);
    for (int i = 0; i < size_; ++i) slope_[i] = from_.slope[source_[i]];
    if (!from_.speed_x) return;
    for (int i = 0; i < size_; ++i) {
        speed_x_[i] = from_.speed_x[source_[i]];
        speed_y_[i] = from_.speed_y[source_[i]];
    }
}

void Crowd::thin(int most) {
    if (size_ <= most) return;
    order_.resize(static_cast<std::size_t>(size_));
    for (int i = 0; i < size_; ++i) order_[i] = {x_[i] * x_[i] + y_[i] * y_[i], x_[i], y_[i], source_[i]};
    std::nth_element(order_.begin(), order_.begin() + most, order_.end());
    for (size_ = 0; size_ < most; ++size_) {
        const Nearness& kept = order_[size_];
        x_[size_] = kept.x;
        y_[size_] = kept.y;
        source_[size_] = kept.source;
    }
}

Sights Crowd::sights() const {
    Sights sights{};
    sights.x = x_.data();
    sights.y = y_.data();
    sights.slope = slope_.data();
    if (from_.speed_x) {
        sights.speed_x = speed_x_.data();
        sights.speed_y = speed_y_.data();
    }
    return sights;
}

// The usual cases: one surface, or a front one that fills all four quadrants around the location.
Surfaces::Verdict Surfaces::glance(const Sights& sights, const SightRow* rows, int row_count, float x, float y,
                                   float* seen) {
    const Place place{x, y, rule_.radius, rule_.tent * rule_.radius};
    const Range range =
        (sights.speed_x ? range_of_moving : range_of_still)(sights, rows, row_count, place, infinity, rule_);
    if (range.least == infinity) return Verdict::nothing;
    if (rule_.tent == 0) return Verdict::several;  // for whom which sample is nearest matters
    const float farthest = range.spread <= rule_.tolerance
                               ? range.most
                               : end_of_surface(sights, rows, row_count, place, range.least, steps_at_a_glance, rule_);
    if (farthest == -infinity) return Verdict::several;
    // Who wants to know the samples' numbers averages them for himself.
    const auto group_of = sights.number ? group_of_numbers : sights.weight ? group_of_glossy : group_of_matte;
    const Group front = group_of(sights, rows, row_count, place, farthest);
    const bool single = farthest >= range.most;
    if (!(front.weight > 0) || (!single && front.quadrants != all_quadrants)) return Verdict::several;
    ++(single ? statistics_.single : statistics_.quadrants);
    statistics_.surfaces += single ? 1 : 2;
    seen[0] = front.red / front.weight;
    seen[1] = front.green / front.weight;
    seen[2] = front.blue / front.weight;
    seen[3] = range.least;
    found_ = {true, farthest, place.tent, -1};
    return Verdict::found;
}

// The same with a close look at the crowd within R, where a triangle may show as well that the front surface covers the
// location.
Surfaces::Verdict Surfaces::front_surface(float* seen) {
    begin_surfaces();
    next_surface();
    std::int64_t* counter = nullptr;
    if (left_ == 0)
        counter = &statistics_.single;
    else if (fills_quadrants())
        counter = &statistics_.quadrants;
    else if (covers(true))
        counter = &statistics_.covered;
    else
        return Verdict::several;
    ++*counter;
    statistics_.surfaces += left_ == 0 ? 1 : 2;
    filter(rule_.radius, seen);
    return Verdict::found;
}

void Surfaces::begin_surfaces() {
    sights_ = crowd_.sights();
    left_ = crowd_.size();
    depth_.assign(sights_.slope, sights_.slope + left_);
    depth_.resize(static_cast<std::size_t>(left_) + read_beyond, taken);
    surface_.clear();
}

// The first surface of the crowd that covers the location, or the last of all. Surfaces of too few samples to tell what
// they cover blend with the next behind them.
void Surfaces::choose(float radius, float* seen) {
    begin_surfaces();
    while (true) {
        next_surface();
        ++statistics_.surfaces;
        const bool last = left_ == 0;
        if (!last && surface_.size() < least_samples) {
            ++statistics_.merged;
            continue;
        }
        if (last || covers(false)) {
            ++(last ? statistics_.last : statistics_.covered);
            return filter(radius, seen);
        }
        surface_.clear();
    }
}

// Samples of one surface in all four quadrants.
bool Surfaces::obviously_covers() {
    if (crowd_.size() < least_samples) return false;
    crowd_.finish();
    const Sights sights = crowd_.sights();
    const SightRow all{0, crowd_.size()};
    const Place place{0.0f, 0.0f, far_away, rule_.radius};
    const Range range = (sights.speed_x ? range_of_moving : range_of_still)(sights, &all, 1, place, infinity, rule_);
    if (range.spread > rule_.tolerance) return false;
    begin_surfaces();
    take_all();
    return fills_quadrants();
}

// A surface of too few samples to tell what it covers blends with the next. What all of them together leave open, none
// covers.
bool Surfaces::any_covers() {
    if (!all_surround()) return false;
    begin_surfaces();
    while (left_ > 0) {
        next_surface();
        if (surface_.size() < least_samples) continue;
        if (covers(false)) return true;
        surface_.clear();
    }
    return false;
}

bool Surfaces::all_surround() {
    crowd_.finish();
    begin_surfaces();
    take_all();
    move_towards_location();
    return !surface_.empty() && !on_one_side(static_cast<int>(surface_.size()));
}

void Surfaces::take_all() {
    surface_.resize(static_cast<std::size_t>(crowd_.size()));
    std::iota(surface_.begin(), surface_.end(), 0);
}

// Takes the frontmost samples that are left, as long as each crosses none of those taken (Figure 7). Those of equal
// slope are one surface, whatever their speed.
void Surfaces::next_surface() {
    Sights left = sights_;
    left.slope = depth_.data();
    const SightRow all{0, crowd_.size()};
    const float least = *std::min_element(depth_.begin(), depth_.end());
    const float farthest = end_of_surface(left, &all, 1, {0.0f, 0.0f, far_away, 0.0f}, least, most_steps, rule_);
    if (farthest > -infinity) {
        std::size_t size = surface_.size();
        surface_.resize(size + static_cast<std::size_t>(left_));
        for (int i = 0; left_ > 0 && i < crowd_.size(); ++i) {
            const bool takes = depth_[i] <= farthest;
            surface_[size] = i;
            depth_[i] = takes ? taken : depth_[i];
            size += takes;
            left_ -= takes;
        }
        surface_.resize(size);
        return;
    }
    order_.clear();
    for (int i = 0; i < crowd_.size(); ++i)
        if (depth_[i] < taken) order_.push_back(i);
    std::sort(order_.begin(), order_.end(), [&](int a, int b) {
        if (sights_.slope[a] != sights_.slope[b]) return sights_.slope[a] < sights_.slope[b];
        return sights_.x[a] != sights_.x[b] ? sights_.x[a] < sights_.x[b] : sights_.y[a] < sights_.y[b];
    });
    // Samples of equal slope join together or not at all.
    const auto fits = [&](int sample, std::vector<int>::iterator end) {
        return std::all_of(order_.begin(), end,
                           [&](int other) { return crossing_of(sights_, sample, other, rule_) <= rule_.tolerance; });
    };
    for (auto first = order_.begin(); first != order_.end();) {
        const auto end =
            std::find_if(first, order_.end(), [&](int i) { return sights_.slope[i] != sights_.slope[*first]; });
        if (!std::all_of(first, end, [&](int sample) { return fits(sample, first); })) return;
        for (; first != end; ++first) {
            surface_.push_back(*first);
            depth_[*first] = taken;
            --left_;
        }
    }
}

// Whether a triangle of samples holds the location: no edge longer than 2R, and a corner within R. A surface reaches
// farther than its outermost samples: they are moved towards the location by what it juts out on average. Of samples
// that all lie within R no edge is longer, and wherever they surround the location, every one of them is the corner of
// a triangle that holds it.
bool Surfaces::covers(bool all_within_radius) {
    move_towards_location();
    const auto n = static_cast<int>(surface_.size());
    if (on_one_side(n)) return false;
    const float radius2 = rule_.radius * rule_.radius, longest = 4 * radius2;
    int corners = 0;  // those within R come first: one of them is a corner
    for (int i = 0; i < n; ++i)
        if (ring_x_[i] * ring_x_[i] + ring_y_[i] * ring_y_[i] <= radius2) {
            if (all_within_radius) return true;
            std::swap(ring_x_[i], ring_x_[corners]);
            std::swap(ring_y_[i], ring_y_[corners++]);
        }
    for (int i = 0; i < corners; ++i)
        for (int j = i + 1; j < n; ++j) {
            const float x = ring_x_[j] - ring_x_[i], y = ring_y_[j] - ring_y_[i];
            if (x * x + y * y <= longest && closes_triangle(ring_x_.data(), ring_y_.data(), n, i, j, longest))
                return true;
        }
    return false;
}

// Copies the surface's positions, moved by the overhang against the mean direction of those within R.
void Surfaces::move_towards_location() {
    float x = 0, y = 0;
    for (int i : surface_) {
        const float distance2 = sights_.x[i] * sights_.x[i] + sights_.y[i] * sights_.y[i];
        const float weight = std::max(1 - distance2 / (rule_.radius * rule_.radius), 0.0f);
        x += weight * sights_.x[i];
        y += weight * sights_.y[i];
    }
    const float length = std::sqrt(x * x + y * y);
    const float step = length > 0 ? rule_.overhang / length : 0.0f;
    const std::size_t n = surface_.size();
    for (auto* axis : {&ring_x_, &ring_y_}) axis->assign(n + read_beyond, far_away);
    for (std::size_t i = 0; i < n; ++i) {
        ring_x_[i] = sights_.x[surface_[i]] - step * x;
        ring_y_[i] = sights_.y[surface_[i]] - step * y;
    }
}

bool Surfaces::fills_quadrants() const {
    int quadrants = 0;
    for (int i : surface_) quadrants |= 1 << ((sights_.x[i] >= 0) + 2 * (sights_.y[i] >= 0));
    return quadrants == all_quadrants;
}

// Whether a line through the location has all of the surface on one side: then no triangle holds it.
bool Surfaces::on_one_side(int n) const {
    Surround surround;
    for (int i = 0; i < n; ++i)
        if (surround.add(ring_x_[i], ring_y_[i])) return false;
    return !surround.closed();
}

// The mean of the surface under a tent, which is widened until it holds a sample; or the nearest sample.
void Surfaces::filter(float radius, float* seen) {
    const Sights& from = crowd_.from();
    const auto distance = [&](int i) { return std::sqrt(sights_.x[i] * sights_.x[i] + sights_.y[i] * sights_.y[i]); };
    seen[3] = infinity;
    for (int i : surface_) seen[3] = lesser(seen[3], sights_.slope[i]);
    if (rule_.tent == 0) {
        const int nearest = *std::min_element(surface_.begin(), surface_.end(),
                                              [&](int a, int b) { return distance(a) < distance(b); });
        found_ = {false, 0.0f, 0.0f, nearest};
        const std::ptrdiff_t source = crowd_.source(nearest);
        seen[0] = from.red[source];
        seen[1] = from.green[source];
        seen[2] = from.blue[source];
        return;
    }
    float sums[4] = {};
    for (radius *= rule_.tent; !(sums[0] > 0); radius *= 2) {
        found_ = {false, 0.0f, radius, -1};
        std::fill_n(sums, 4, 0.0f);
        for (int i : surface_) {
            const std::ptrdiff_t source = crowd_.source(i);
            float weight = std::max(1 - distance(i) / radius, 0.0f);
            if (from.weight) weight *= from.weight[source];
            sums[0] += weight;
            sums[1] += weight * from.red[source];
            sums[2] += weight * from.green[source];
            sums[3] += weight * from.blue[source];
        }
    }
    for (int channel = 0; channel < 3; ++channel) seen[channel] = sums[1 + channel] / sums[0];
}

}  // namespace fewrays
