// How much light comes from one point of a lamp to a point in the scene, found out by one thread. Twin of
// src/fewrays/temporal/shadows.py.
//
// The hierarchy of the lamp's light samples is walked without a stack: nodes lie in depth-first order, and each knows
// where to go on. Nothing is kept of what is found but sums, and the nearest of what is in the way.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "../math/receiver.h"
#include "../math/reprojection.h"
#include "../math/surround.h"
#include "../math/tree_node.h"
#include "../simd.h"
#include "surfaces.h"

namespace fewrays {

// A light sample, where the hierarchy has it.
struct FEWRAYS_WIDE PlacedSample {
    Path path;
    float spacing;
};

FEWRAYS_INLINE Vector vector_at(const float* values, std::int64_t i) {
    return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
}

// A lamp with its light samples, one for each camera sample.
struct DeviceLamp {
    const float* facing;  // (samples, 3): normal of the tangent plane at a camera sample's point, in camera space
    const float* light;   // (samples, 3): radiance
    const std::uint8_t* arrives;  // (samples): whether a light sample ends at its camera sample's point
    const float* points;          // (views, 2): light points in units of the frame, one for each view
    const float* times;           // (views)
    const TreeNode* nodes;
    const PlacedSample* placed;
    const std::int32_t* order;
    LightFrame frame;  // as the shutter opens
    Vector motion;
    float area, farthest, far_slope;  // farthest light point from the centre
    float even_radiance[3];           // of the whole lamp
    std::int32_t even;                // whether that is so
    DeviceRule rule;                  // lengths in units of spacing
    std::int32_t node_count;
};

// Calls visit(place) for the light samples in all nodes for which may(node) holds, until it returns true. Returns
// whether it has.
template <typename May, typename Visit>
FEWRAYS_INLINE bool walk(const DeviceLamp& a, May&& may, Visit&& visit) {
    for (std::int32_t next = 0; next < a.node_count;) {
        const TreeNode& node = a.nodes[next];
        const std::int32_t first = node.first, second = node.second;
        const bool inside = may(node);
        next = inside || first < 0 ? next + 1 : second;
        if (!inside || first >= 0) continue;
        for (std::int32_t place = ~first; place < second; ++place)
            if (visit(place)) return true;
    }
    return false;
}

// A lamp's light point and time.
struct LightView {
    LightFrame frame;
    Vector point;  // in light space
    View view;

    FEWRAYS_INLINE LightView(const DeviceLamp& a, int number) : frame(a.frame) {
        view = {a.points[2 * number], a.points[2 * number + 1], a.times[number]};
        frame.center = frame.center + view.time * a.motion;
        point = {frame.unit() * view.u, frame.unit() * view.v, 0.0f};
    }
};

FEWRAYS_INLINE void copy_even_radiance(const DeviceLamp& a, float* radiance) {
    for (int c = 0; c < 3; ++c) radiance[c] = a.even_radiance[c];
}

// A light sample near a receiver, at a position relative to it.
struct NearLight {
    SeenSample seen;
    float distance, reach;  // reach is R for it
    bool blocks;
};

// What light samples around a receiver bring to it.
class LightSums {
public:
    FEWRAYS_INLINE LightSums(const DeviceLamp& a, float spread) : a_(&a), spread_(spread) {}

    FEWRAYS_INLINE void add(const NearLight& near) {
        const bool within = near.distance <= near.reach;
        blocked_near |= near.blocks && within;
        ++(near.blocks ? blocked : lit);
        if (a_->even) return;
        // What is on its way to a blocker tells what the light sends as well, if nothing else does.
        const int which = near.blocks ? 2 : within ? 0 : 1;
        const float tent = near.reach * (within ? a_->rule.tent : spread_);
        const float weight = std::max(1.0f - near.distance / tent, least_weight);
        const float* const light = a_->light + 3 * static_cast<std::int64_t>(near.seen.source);
        for (int kind = 0; kind < 3; ++kind) {  // no index that varies: sums stay in registers
            const float own = kind == which ? weight : 0.0f;
            weights_[kind] += own;
            for (int c = 0; c < 3; ++c) sums_[kind][c] += own * light[c];
        }
    }

    FEWRAYS_INLINE void mean(float* radiance) const {
        if (a_->even) return copy_even_radiance(*a_, radiance);
        for (int c = 0; c < 3; ++c)
            radiance[c] = weights_[0] > 0.0f   ? sums_[0][c] / weights_[0]
                          : weights_[1] > 0.0f ? sums_[1][c] / weights_[1]
                          : weights_[2] > 0.0f ? sums_[2][c] / weights_[2]
                                               : 0.0f;
    }

    int lit = 0, blocked = 0;
    bool blocked_near = false;  // within R

private:
    const DeviceLamp* a_;
    float spread_;
    float weights_[3] = {}, sums_[3][3] = {};  // within R, farther off, and on its way to blockers
};

// The blockers nearest to a receiver.
class NearestBlockers {
public:
    FEWRAYS_INLINE void clear() { count_ = 0; }

    FEWRAYS_INLINE void add(const SeenSample& sample) {
        if (count_ < most_blockers) {
            kept_[count_++] = sample;
            if (count_ == most_blockers) find_farthest();
        } else if (is_nearer(sample, kept_[farthest_])) {
            kept_[farthest_] = sample;
            find_farthest();
        }
    }

    // Whether any surface covers the receiver. One of too few samples to tell what it covers blends with the next; what
    // all of them together leave open, none covers.
    FEWRAYS_INLINE bool any_covers(const DeviceRule& rule) const {
        std::int32_t names[most_blockers];
        for (int i = 0; i < count_; ++i) names[i] = i;
        NearSurfaces surfaces(rule, kept_, names, count_, 0.0f, 0.0f);
        if (!surfaces.surround(0, count_)) return false;
        surfaces.sort_by_slope();
        for (int first = 0, end = 0; end < count_;) {
            end = surfaces.end_of_group(end);
            if (end - first < least_samples) continue;
            if (surfaces.covers(first, end)) return true;
            first = end;
        }
        return false;
    }

private:
    FEWRAYS_INLINE static bool is_nearer(const SeenSample& a, const SeenSample& b) {
        const float own = a.x * a.x + a.y * a.y, other = b.x * b.x + b.y * b.y;
        if (own != other) return own < other;
        return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : a.source < b.source;
    }
    FEWRAYS_INLINE void find_farthest() {
        farthest_ = 0;
        for (int i = 1; i < count_; ++i)
            if (is_nearer(kept_[farthest_], kept_[i])) farthest_ = i;
    }

    SeenSample kept_[most_blockers];
    int count_ = 0, farthest_ = 0;
};

// A receiver, and the light samples around it as a light point sees them.
class LampReading {
public:
    FEWRAYS_INLINE LampReading(const DeviceLamp& a, const LightView& light, const Receiver& to)
        : a_(a),
          light_(light),
          to_(to),
          front_(tangent_plane(light.frame, light.point, to)),
          rule_(a.rule.scaled(second_look * to.spacing)) {}

    // Whether any light comes to the receiver, and its radiance. Most are lit, and nothing is in front of them; most
    // others are in the midst of a shadow or at its edge. A blocker is met by fewer samples than the receiver where the
    // camera does not see all that lies in its shadow: what few there are must do farther apart.
    FEWRAYS_INLINE bool shines(NearestBlockers& blockers, float* radiance) const {
        LightSums sums(a_, 1.0f);
        if (obviously_dark(sums)) return false;
        if (sums.lit > 0 && sums.blocked == 0) {
            sums.mean(radiance);
            return true;
        }
        // Where all is dark, only blockers on all sides prove it; and that there is no light far and wide.
        for (float spread = wide;; spread = std::min(2 * spread, widest)) {
            Overhang move;
            sums = look(spread, blockers, move);
            if (sums.lit == 0) {
                if (spread >= widest || blockers_surround(spread, move)) return false;
                continue;
            }
            sums.mean(radiance);
            return (!sums.blocked_near && spread == wide) || !blockers.any_covers(rule_);
        }
    }

private:
    // Looks within R. Whether samples of one surface that block lie in all four quadrants.
    FEWRAYS_INLINE bool obviously_dark(LightSums& sums) const {
        SeenRange range;
        unsigned quadrants = 0;
        visit_near(1.0f, [&](const NearLight& near) {
            sums.add(near);
            if (!near.blocks) return;
            range.include(near.seen);
            quadrants |= NearSurfaces::quadrant_of(near.seen.x, near.seen.y);
        });
        return quadrants == NearSurfaces::all_quadrants && range.one_surface(a_.rule.scaled(to_.spacing));
    }

    // Looks farther off, and collects what blocks.
    FEWRAYS_INLINE LightSums look(float spread, NearestBlockers& blockers, Overhang& move) const {
        LightSums sums(a_, spread);
        blockers.clear();
        visit_near(spread, [&](const NearLight& near) {
            sums.add(near);
            if (!near.blocks) return;
            blockers.add(near.seen);
            move.add(rule_, near.seen.x, near.seen.y);
        });
        return sums;
    }

    FEWRAYS_INLINE bool blockers_surround(float spread, Overhang move) const {
        move.scale_to(rule_);
        Surround surround;
        visit_near(spread, [&](const NearLight& near) {
            if (near.blocks) surround.add(near.seen.x - move.right, near.seen.y - move.down);
        });
        return surround.closed();
    }

    // Calls visit(near) for the light samples within so many R, each of the lesser of its own spacing and the
    // receiver's.
    template <typename Visit>
    FEWRAYS_INLINE void visit_near(float spread, Visit&& visit) const {
        const float most = spread * a_.rule.radius * to_.spacing;
        const Box box{to_.at.x - most, to_.at.x + most, to_.at.y - most, to_.at.y + most};
        const View& view = light_.view;
        const auto may = [&](const TreeNode& node) { return node.meets(box, view); };
        walk(a_, may, [&](std::int32_t place) {
            const PlacedSample& placed = a_.placed[place];
            if (depth_at(placed.path, view.time) < nearest_depth) return false;
            const Sight sight = sight_of(placed.path, view.u, view.v, view.time, a_.far_slope);
            const float dx = sight.x - to_.at.x, dy = sight.y - to_.at.y;
            const float reach = a_.rule.radius * std::min(placed.spacing, to_.spacing), limit = spread * reach;
            if (!(dx * dx + dy * dy <= limit * limit)) return false;
            const float away = std::sqrt(dx * dx + dy * dy);
            const SeenSample seen{dx, dy, sight.slope, sight.speed_x, sight.speed_y, a_.order[place]};
            visit(NearLight{seen, away, reach, blocks(seen, away)});
            return false;
        });
    }

    // Whether a light sample stops the receiver's light: not if it ends behind the receiver's tangent plane, or the
    // receiver lies in front of that of what it hit.
    FEWRAYS_INLINE bool blocks(const SeenSample& seen, float away) const {
        const float share = front_.share(seen.slope);
        if (!(front_.height(share, seen.x, seen.y) > front_.precision + front_.roughness * away)) return false;
        if (!a_.arrives[seen.source]) return true;
        const Vector normal = light_.frame.turn(vector_at(a_.facing, seen.source));
        return lies_behind(light_.frame, light_.point, to_, normal, share, seen.x, seen.y);
    }

    const DeviceLamp& a_;
    const LightView& light_;
    const Receiver& to_;
    const TangentPlane front_;
    const DeviceRule rule_;  // for where R does not tell
};

}  // namespace fewrays
