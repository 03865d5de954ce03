// Samples near a location, gathered from wherever they are kept.
#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sights.h"

namespace fewrays {

// Samples near a location; positions are relative to it.
class Crowd {
public:
    // Keeps the nearest of them.
    void thin(int most);

    // Begins anew, with at most so many of certain samples.
    void begin(const Sights& from, int most);
    void add(float x, float y, std::int32_t i, bool wanted = true) {
        x_[size_] = x;
        y_[size_] = y;
        source_[size_] = i;
        size_ += wanted;
    }
    void finish();  // looks up what else there is to know of those that stay

    static constexpr int most_samples = 512;  // of more, the nearest stay

    int size() const { return size_; }
    const Sights& from() const { return from_; }
    std::ptrdiff_t source(int i) const { return source_[i]; }
    Sights sights() const;  // positions, slopes and speeds

private:
    struct Nearness {  // the nearest first
        float distance2, x, y;
        std::int32_t source;

        auto operator<=>(const Nearness&) const = default;
    };

    Sights from_{};
    int size_ = 0;
    std::vector<Nearness> order_;
    std::vector<std::int32_t> source_;
    std::vector<float> x_, y_, slope_, speed_x_, speed_y_;
};

}  // namespace fewrays
