// Whether nothing that light samples have met can come between a point and any point of a lamp that stands still.
#pragma once

#include <algorithm>
#include <cmath>

#include "host_device.h"
#include "receiver.h"
#include "reprojection.h"
#include "tree_node.h"

namespace fewrays {

// The places on the second plane from which a hit could be in a receiver's way: as the lamp's point moves by u lens
// units, from `at` by u times the slope, and around that.
struct Swath {
    float at, slope, radius;

    // Whether a group between two planes may have samples in it, seen from any light point, along one axis.
    FEWRAYS_HD bool meets(const Plane& low, const Plane& high, float farthest, float first_time,
                          float last_time) const {
        float from = -farthest, to = farthest;
        const auto keep_negative = [&](float rise, float start) {  // where start + u * rise <= 0
            const float turn = -start / rise;
            if (rise > 0) to = to < turn ? to : turn;
            if (rise < 0) from = from > turn ? from : turn;
            if (rise == 0 && start > 0) to = from - 1;
        };
        keep_negative(low.a - slope, low.c + std::min(low.b * first_time, low.b * last_time) - at - radius);
        keep_negative(slope - high.a, at - radius - (high.c + std::max(high.b * first_time, high.b * last_time)));
        return from <= to;
    }
};

class ClearView {
public:
    // Of a point in camera space, with the normal of its tangent plane, from all light points up to `farthest` units
    // off the lamp's centre. R is in units of spacing.
    FEWRAYS_HD ClearView(const LightFrame& frame, Vector point, Vector normal, float spacing, float radius,
                         float farthest, float first_time, float last_time)
        : farthest_(farthest), first_time_(first_time), last_time_(last_time), radius_(radius), spacing_(spacing) {
        const Vector local = frame.enter(point);
        Vector facing = frame.turn(normal);
        const float above = -dot(facing, local);
        const float sideways = farthest * frame.unit() * std::sqrt(facing.x * facing.x + facing.y * facing.y);
        decides_ = std::fabs(above) > sideways;
        facing = above > 0 ? facing : -1.0f * facing;
        const float nearest = std::max(length(local) - farthest * frame.unit(), 0.0f);
        const float precision = rounding * (nearest + length(point) + length(frame.center));
        const PlanePosition at = on_second_plane(frame, {}, local);
        const float slope = frame.unit() * (1.0f - frame.distance / local.z), reach = radius * spacing;
        plane_ = tangent_plane(frame, {}, {local, facing, at, spacing, precision});
        across_ = {at.x, slope, reach};
        down_ = {at.y, slope, reach};
    }

    // Whether all of the lamp is on one side of the tangent plane. Otherwise nothing can be said.
    FEWRAYS_HD bool decides() const { return decides_; }

    // Whether a group may have samples that come in between.
    FEWRAYS_HD bool may_matter(const TreeNode& node) const {
        if (!across_.meets(node.left, node.right, farthest_, first_time_, last_time_) ||
            !down_.meets(node.top, node.bottom, farthest_, first_time_, last_time_))
            return false;
        // The height over the tangent plane is a multiple of a linear function of the place, for every depth.
        const float step = plane_.step + most(plane_.across_x, node.left, node.right, across_.at) +
                           most(plane_.across_y, node.top, node.bottom, down_.at);
        const float height =
            plane_.start + std::max(plane_.share(node.nearest) * step, plane_.share(node.farthest) * step);
        return height > plane_.precision;
    }

    // Whether a light sample may; everything that moves may.
    FEWRAYS_HD bool may_block(const Path& path, float far_slope, float spacing) const {
        if (!still(path)) return true;
        const Sight sight = sight_of(path, 0, 0, 0, far_slope);
        const float dx = sight.x - across_.at, dy = sight.y - down_.at;
        const float turns = farthest_ * std::fabs(sight.slope - across_.slope);
        const float away = std::max(std::sqrt(dx * dx + dy * dy) - turns, 0.0f);
        return away <= radius_ * std::min(spacing, spacing_) &&
               plane_.height(plane_.share(sight.slope), dx, dy) > plane_.precision + plane_.roughness * away;
    }

private:
    FEWRAYS_HD float most(float factor, const Plane& low, const Plane& high, float middle) const {
        const float first = low.c + std::min(low.b * first_time_, low.b * last_time_) - middle;
        const float last = high.c + std::max(high.b * first_time_, high.b * last_time_) - middle;
        return std::max(factor * first, factor * last);
    }

    float farthest_, first_time_, last_time_, radius_, spacing_;
    bool decides_;
    TangentPlane plane_;
    Swath across_, down_;
};

}  // namespace fewrays
