// The samples near locations that have nothing in common, each found by way of the tree.
#pragma once

#include <cstdint>
#include <vector>

#include "sample_tree.h"
#include "surfaces.h"

namespace fewrays {

// Image position, in pixels, lens point and time.
struct Location {
    float x, y, u, v, time;
};

class TreeGatherer {
public:
    // With `numbered`, what is gathered knows which samples it is.
    explicit TreeGatherer(const SampleTree& tree, bool numbered = false) : tree_(tree), numbered_(numbered) {}

    // Makes a crowd of the samples within a radius of a location.
    void gather(const Location& location, float radius, Crowd& crowd);

    // What was gathered last, at positions relative to the location.
    Sights sights() const;

private:
    const SampleTree& tree_;
    const bool numbered_;
    std::vector<float> fields_[10];
    std::vector<std::int32_t> numbers_;
};

// Numbers of the samples within a radius of a location, in no particular order.
std::vector<std::int32_t> samples_within(const SampleTree& tree, const Location& location, float radius);

}  // namespace fewrays
