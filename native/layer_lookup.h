// Which depth layer a slope belongs to.
#pragma once

#include <cstdint>
#include <vector>

#include "simd.h"

namespace fewrays {

// Answers `number of boundaries <= c` with one table look-up and one comparison. Boundaries are spaced so that
// |c| + offset, quantised to a few bits of its mantissa, leaves at most one of them in a cell of the table.
class LayerLookup {
public:
    LayerLookup(const float* boundaries, int count);

    // Slopes of `n` samples at some depths, and the layers that they belong to.
    void run(const float* FEWRAYS_RESTRICT depth, int n, float c0, float c1, float* FEWRAYS_RESTRICT slopes,
             std::int32_t* FEWRAYS_RESTRICT layers) const;

private:
    std::int32_t cell(float magnitude) const;
    float smallest_step() const;

    std::vector<float> boundaries_;
    std::vector<std::int32_t> table_;
    float offset_;
    std::int32_t first_cell_, cells_;
};

}  // namespace fewrays
