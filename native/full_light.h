// Finds out where nothing that light samples have met comes between a receiver and any point of a lamp, so that its
// light need not be looked up point by point.
#pragma once

#include "lamp_reader.h"

namespace fewrays {

class FullLight {
public:
    // For a lamp with so many light points. Lengths of the rule are in units of spacing.
    FullLight(const Lamp& lamp, const SurfaceRule& rule, int point_count);

    // Whether all light points shine on a camera sample's own point, by what lies within R of it as each of them sees
    // it. May miss some, but is never wrong; misses all that move, and all of lamps that move.
    bool shines_on(std::ptrdiff_t sample, Vector point, Vector normal, float first_time, float last_time) const;

private:
    const Lamp& lamp_;
    const float radius_;
    float farthest_ = 0;  // light point from the lamp's centre, in units of the frame
};

}  // namespace fewrays
