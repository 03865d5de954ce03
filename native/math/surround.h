// Whether points lie on all sides of the origin.
#pragma once

#include "host_device.h"

namespace fewrays {

// Gets one point after the other, and keeps the first and those farthest off it, turning either way.
class Surround {
public:
    // Returns whether the points so far lie on all sides for certain; then more of them change nothing.
    FEWRAYS_HD bool add(float x, float y) {
        if (!any_) {
            any_ = true;
            first_ = left_ = {x, y};
            return false;
        }
        const Point point{x, y};
        const float side = turn(first_, point);
        if (side >= 0) {
            if (side == 0 && first_.x * x + first_.y * y <= 0) around_ = true;
            if (turn(left_, point) > 0) left_ = point;
        } else if (!right_found_ || turn(right_, point) < 0) {
            right_found_ = true;
            right_ = point;
        }
        return around_;
    }

    // Whether no line through the origin has all points on one side.
    FEWRAYS_HD bool closed() const { return any_ && (around_ || (right_found_ && !(turn(right_, left_) > 0))); }

private:
    struct Point {
        float x, y;
    };

    FEWRAYS_HD static float turn(Point a, Point b) { return a.x * b.y - a.y * b.x; }

    bool any_ = false, around_ = false, right_found_ = false;
    Point first_{}, left_{}, right_{};
};

}  // namespace fewrays
