// Depth to slope, the signed radius of the circle of confusion.
#pragma once

#include "host_device.h"

namespace fewrays {

// C(depth) = c0 / depth + c1 in pixels per lens unit. A division and an addition cannot be fused, so this is
// bit for bit what Lens.slope computes in float32, and both put a sample into the same layer.
FEWRAYS_HD inline float slope(float depth, float c0, float c1) { return c0 / depth + c1; }

}  // namespace fewrays
