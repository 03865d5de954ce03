#include "surfaces.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "math/surround.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = read_beyond;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr int least_samples = 4;                       // of a surface that stands on its own
constexpr int steps_at_a_glance = 2, most_steps = 12;  // samples that join one by one before all are put in order
constexpr float taken = infinity;                      // the depth of samples that a surface has taken
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

// The usual cases: one surface, or a front one that fills all four quadrants around the location.
Surfaces::Verdict Surfaces::glance(const Sights& sights, const SightRow* rows, int row_count, float x, float y,
                                   float* seen) {
    const Place place{x, y, rule_.radius, rule_.tent * rule_.radius};
    const Range range = range_of(sights, rows, row_count, place, infinity, rule_);
    if (range.least == infinity) return Verdict::nothing;
    if (rule_.tent == 0) return Verdict::several;  // for whom which sample is nearest matters
    const float farthest = range.spread <= rule_.tolerance
                               ? range.most
                               : end_of_surface(sights, rows, row_count, place, range.least, steps_at_a_glance, rule_);
    if (farthest == -infinity) return Verdict::several;
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
    const Range range = range_of(sights, &all, 1, place, infinity, rule_);
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
    for (int i : surface_) seen[3] = std::min(sights_.slope[i], seen[3]);
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
