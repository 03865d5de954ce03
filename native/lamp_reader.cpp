#include "lamp_reader.h"

#include <algorithm>
#include <cmath>

#include "simd.h"

namespace fewrays {
namespace {

constexpr int lanes = read_beyond;

// What is within R: how many hits are in front, and sums under the tent over the others.
struct Glimpse {
    int in_front;
    float weight, red, green, blue;
};

template <bool colored>
FEWRAYS_INLINE Glimpse look_around(const Sights& sights, const SightRow* rows, int row_count, const Receiver& to,
                                   const SurfaceRule& rule, const TangentPlane& front) {
    float sums[4][lanes] = {};
    std::int32_t in_front[lanes] = {};
    const float at_x = to.at.x, at_y = to.at.y, spacing = to.spacing, radius = rule.radius, tent = rule.tent;
    for (int row = 0; row < row_count; ++row)
        for (std::int32_t first = rows[row].first; first < rows[row].end; first += lanes) {
            const std::int32_t left = rows[row].end - first;
            for (int lane = 0; lane < lanes; ++lane) {
                const float dx = sights.x[first + lane] - at_x, dy = sights.y[first + lane] - at_y;
                const float own = sights.spacing[first + lane];
                const float reach = radius * (own < spacing ? own : spacing), distance2 = dx * dx + dy * dy;
                const bool near = (distance2 <= reach * reach) & (lane < left);
                const float away = std::sqrt(near ? distance2 : 0.0f);
                const bool blocks = front.height(front.share(sights.slope[first + lane]), dx, dy) >
                                    front.precision + front.roughness * away;
                in_front[lane] += near & blocks;
                const float under = 1.0f - away / (tent * reach);
                const float weight = near & !blocks & (under > 0.0f) ? under : 0.0f;
                sums[0][lane] += weight;
                if constexpr (!colored) continue;
                sums[1][lane] += weight * sights.red[first + lane];
                sums[2][lane] += weight * sights.green[first + lane];
                sums[3][lane] += weight * sights.blue[first + lane];
            }
        }
    Glimpse glimpse{};
    for (int lane = 0; lane < lanes; ++lane) {
        glimpse.in_front += in_front[lane];
        glimpse.weight += sums[0][lane];
        glimpse.red += sums[1][lane];
        glimpse.green += sums[2][lane];
        glimpse.blue += sums[3][lane];
    }
    return glimpse;
}

FEWRAYS_CLONES Glimpse glimpse_in_color(const Sights& sights, const SightRow* rows, int row_count, const Receiver& to,
                                        const SurfaceRule& rule, const TangentPlane& front) {
    return look_around<true>(sights, rows, row_count, to, rule, front);
}
FEWRAYS_CLONES Glimpse glimpse_of_weight(const Sights& sights, const SightRow* rows, int row_count, const Receiver& to,
                                         const SurfaceRule& rule, const TangentPlane& front) {
    return look_around<false>(sights, rows, row_count, to, rule, front);
}

}  // namespace

void LampReader::fill(const Box& places, float most_spacing, int view, float time) {
    frame_ = lamp_.frame_at(time);
    light_point_ = lamp_.light_point(view);
    view_ = {lamp_.points[2 * view], lamp_.points[2 * view + 1], time};
    const float cell = most_spacing * rule_.radius, margin = wide * cell;
    grid_.fill({places.left - margin, places.right + margin, places.top - margin, places.bottom + margin}, view_, cell);
}

// Whether a light sample that ends in front of the receiver's tangent plane stops its light.
bool LampReader::blocks(const Receiver& to, std::ptrdiff_t number, float share, float dx, float dy) const {
    if (!lamp_.arrives[number]) return true;
    return lies_behind(frame_, light_point_, to, frame_.turn(lamp_.facing_at(number)), share, dx, dy);
}

// Makes a crowd of the samples within `spread` times R that stop light, and averages the radiance of the others within
// R, or of those farther off if there are none, unless it is known.
LampReader::Sorted LampReader::sort_out(const Sights& sights, const SightRow* rows, int row_count, PlanePosition at,
                                        const Receiver& to, float spread, float* radiance) {
    find_near(sights, rows, row_count, at, to, spread * rule_.radius);
    const TangentPlane front = tangent_plane(frame_, light_point_, to);
    Crowd& crowd = surfaces_.crowd();
    crowd.begin(sights, static_cast<int>(near_.size()));
    Sorted result{};
    float near[4] = {}, far[4] = {}, stopped[4] = {};  // sums of weights and radiance
    for (std::int32_t i : near_) {
        const float dx = sights.x[i] - at.x, dy = sights.y[i] - at.y, distance2 = dx * dx + dy * dy;
        const float reach = rule_.radius * std::min(sights.spacing[i], to.spacing);
        const bool within = distance2 <= reach * reach;
        const float share = front.share(sights.slope[i]);
        const float least = to.precision + front.roughness * std::sqrt(distance2);
        const bool blocked = front.height(share, dx, dy) > least && blocks(to, sights.number[i], share, dx, dy);
        crowd.add(dx, dy, i, blocked);
        result.blocked_near |= blocked && within;
        result.lit += !blocked;
        if (lamp_.radiance) continue;
        // What is on its way to a blocker tells what the light sends as well, if nothing else does.
        float* const sums = blocked ? stopped : within ? near : far;
        const float tent = reach * (within ? rule_.tent : spread);
        const float weight = std::max(1.0f - std::sqrt(distance2) / tent, least_weight);
        sums[0] += weight;
        sums[1] += weight * sights.red[i];
        sums[2] += weight * sights.green[i];
        sums[3] += weight * sights.blue[i];
    }
    result.blocked = crowd.size();
    if (lamp_.radiance) return result;
    const float* const sums = near[0] > 0 ? near : far[0] > 0 ? far : stopped;
    for (int channel = 0; channel < 3; ++channel) radiance[channel] = sums[0] > 0 ? sums[1 + channel] / sums[0] : 0.0f;
    return result;
}

// Numbers of the samples within a radius, that counts in units of the lesser of their spacing and the receiver's.
void LampReader::find_near(const Sights& sights, const SightRow* rows, int row_count, PlanePosition at,
                           const Receiver& to, float radius) {
    std::size_t most = 0, count = 0;
    for (int row = 0; row < row_count; ++row) most += static_cast<std::size_t>(rows[row].end - rows[row].first);
    near_.resize(most + 1);
    for (int row = 0; row < row_count; ++row)
        for (std::int32_t i = rows[row].first; i < rows[row].end; ++i) {
            const float dx = sights.x[i] - at.x, dy = sights.y[i] - at.y;
            const float reach = radius * std::min(sights.spacing[i], to.spacing);
            near_[count] = i;
            count += dx * dx + dy * dy <= reach * reach;
        }
    near_.resize(count);
}

// Most receivers are lit, and nothing is in front of them; most others are in the midst of a shadow or at its edge. A
// blocker is met by fewer samples than the receiver where the camera does not see all that lies in its shadow: what few
// there are must do farther apart.
bool LampReader::shines(const Receiver& receiver, float* radiance) {
    const Sights sights = grid_.sights();
    const float near = rule_.radius * receiver.spacing;
    SightRow rows[ViewGrid::most_rows];
    const auto rows_within = [&](float radius) {
        return grid_.rows_around(receiver.at.x, receiver.at.y, radius, rows);
    };
    const Glimpse glimpse = (lamp_.radiance ? glimpse_of_weight : glimpse_in_color)(
        sights, rows, rows_within(near), receiver, rule_, tangent_plane(frame_, light_point_, receiver));
    if (glimpse.in_front == 0 && glimpse.weight > 0) {
        if (lamp_.radiance) return true;
        radiance[0] = glimpse.red / glimpse.weight;
        radiance[1] = glimpse.green / glimpse.weight;
        radiance[2] = glimpse.blue / glimpse.weight;
        return true;
    }
    surfaces_.scale(receiver.spacing);
    Sorted sorted = sort_out(sights, rows, rows_within(near), receiver.at, receiver, 1, radiance);
    if (sorted.lit > 0 && sorted.blocked == 0) return true;
    if (surfaces_.obviously_covers()) return false;
    float spread = wide;
    sorted = sort_out(sights, rows, rows_within(spread * near), receiver.at, receiver, spread, radiance);
    surfaces_.scale(second_look * receiver.spacing);
    // Where all is dark, only blockers on all sides prove it; and that there is no light far and wide.
    while (sorted.lit == 0 && spread < widest && !surfaces_.all_surround()) {
        spread = std::min(2 * spread, widest);
        gatherer_.gather({receiver.at.x, receiver.at.y, view_.u, view_.v, view_.time}, spread * near, gathered_);
        const SightRow all{0, gathered_.size()};
        sorted = sort_out(gatherer_.sights(), &all, 1, {0, 0}, receiver, spread, radiance);
    }
    if (sorted.lit > 0 && !sorted.blocked_near && spread == wide) return true;
    surfaces_.crowd().thin(most_blockers);
    return sorted.lit > 0 && !surfaces_.any_covers();
}

void LampReader::read(const Receiver& receiver, float* radiance) {
    if (lamp_.radiance) std::copy_n(lamp_.radiance, 3, radiance);
    if (!shines(receiver, radiance)) std::fill_n(radiance, 3, 0.0f);
}

}  // namespace fewrays
