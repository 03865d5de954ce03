// How much light the shutter lets pass per time: twin of `density` in src/fewrays/temporal/shutter.py.
#pragma once

#include <algorithm>
#include <cmath>

#include "host_device.h"

namespace fewrays {

struct ShutterLight {
    double opens, length;
    double peak;  // light per time where it is widest open
    double ramp;  // share of the time that opening takes, and closing; 0 for none
    double bell;  // 1 / (2 σ²) of a Gaussian response over that time; 0 for the others
};

FEWRAYS_HD inline double shutter_density(const ShutterLight& a, double time) {
    if (!(a.length > 0)) return 0;
    const double within = (time - a.opens) / a.length, from_middle = within - 0.5;
    if (!(within >= 0 && within <= 1)) return 0;
    if (a.bell > 0) return a.peak * std::exp(-a.bell * from_middle * from_middle);
    return a.ramp > 0 ? a.peak * std::min(std::min(within, 1 - within) / a.ramp, 1.0) : a.peak;
}

}  // namespace fewrays
