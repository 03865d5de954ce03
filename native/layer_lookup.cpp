#include "layer_lookup.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "math/slope.h"

namespace fewrays {
namespace {

constexpr int shift = 17;  // leaves six bits of the mantissa

}  // namespace

LayerLookup::LayerLookup(const float* boundaries, int count) : boundaries_(boundaries, boundaries + count) {
    boundaries_.push_back(INFINITY);
    offset_ = count > 1 ? 0.5f * smallest_step() : 1.0f;
    first_cell_ = cell(0.0f);
    const float largest = count > 0 ? std::max(std::fabs(boundaries_[0]), std::fabs(boundaries_[count - 1])) : 0.0f;
    cells_ = cell(largest) - first_cell_ + 2;
    for (const bool negative : {true, false})
        for (int i = 0; i < cells_; ++i) {
            // The least slope that a cell can hold, with room for the rounding of |c| + offset.
            const float edge = std::bit_cast<float>((first_cell_ + i + negative) << shift) - offset_;
            const float least = negative ? -edge * 1.00001f - 1e-5f * offset_ : edge * 0.99999f - 1e-5f * offset_;
            table_.push_back(
                static_cast<std::int32_t>(std::upper_bound(boundaries_.begin(), boundaries_.end() - 1,
                                                           i + 1 == cells_ && negative ? -INFINITY : least) -
                                          boundaries_.begin()));
        }
}

FEWRAYS_CLONES void LayerLookup::run(const float* FEWRAYS_RESTRICT depth, int n, float c0, float c1,
                                     float* FEWRAYS_RESTRICT slopes, std::int32_t* FEWRAYS_RESTRICT layers) const {
    const float offset = offset_;
    const std::int32_t first_cell = first_cell_, cells = cells_;
    const std::int32_t* FEWRAYS_RESTRICT const table = table_.data();
    const float* FEWRAYS_RESTRICT const boundaries = boundaries_.data();
    for (int i = 0; i < n; ++i) slopes[i] = slope(depth[i], c0, c1);
    for (int i = 0; i < n; ++i) {
        const float c = slopes[i], magnitude = std::fabs(c) + offset;
        std::int32_t bits;
        std::memcpy(&bits, &magnitude, sizeof bits);
        const std::int32_t column = std::min((bits >> shift) - first_cell, cells - 1);
        const std::int32_t candidate = table[column + (c < 0 ? 0 : cells)];
        layers[i] = candidate + (c >= boundaries[candidate] ? 1 : 0);
    }
}

std::int32_t LayerLookup::cell(float magnitude) const {
    return static_cast<std::int32_t>(std::bit_cast<std::uint32_t>(magnitude + offset_) >> shift);
}

float LayerLookup::smallest_step() const {
    float step = INFINITY;
    for (std::size_t i = 1; i + 1 < boundaries_.size(); ++i) step = std::min(step, boundaries_[i] - boundaries_[i - 1]);
    return step;
}

}  // namespace fewrays
