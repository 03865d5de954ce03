// Finds out where nothing that light samples have met comes between a receiver and any point of a lamp, so that its
// light need not be looked up point by point.
#pragma once

#include "lamp_reader.h"

namespace fewrays {

// Whether all of a lamp's light points shine on a camera sample's own point, by what lies within R of it, in units of
// spacing, as each of them sees it. May miss some, but is never wrong; misses all that move, and all of lamps that
// move.
bool gets_full_light(const Lamp& lamp, float radius, std::ptrdiff_t sample, Vector point, float first_time,
                     float last_time);

}  // namespace fewrays
