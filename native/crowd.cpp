#include "crowd.h"

#include <algorithm>

namespace fewrays {

void Crowd::begin(const Sights& from, int most) {
    from_ = from;
    size_ = 0;
    const std::size_t room = static_cast<std::size_t>(most) + read_beyond;
    if (x_.size() >= room) return;
    source_.resize(room);
    for (auto* field : {&x_, &y_, &slope_, &speed_x_, &speed_y_}) field->resize(room);
}

void Crowd::finish() {
    thin(most_samples);
    for (int i = 0; i < size_; ++i) slope_[i] = from_.slope[source_[i]];
    if (!from_.speed_x) return;
    for (int i = 0; i < size_; ++i) {
        speed_x_[i] = from_.speed_x[source_[i]];
        speed_y_[i] = from_.speed_y[source_[i]];
    }
}

void Crowd::thin(int most) {
    if (size_ <= most) return;
    order_.resize(static_cast<std::size_t>(size_));
    for (int i = 0; i < size_; ++i) order_[i] = {x_[i] * x_[i] + y_[i] * y_[i], x_[i], y_[i], source_[i]};
    std::nth_element(order_.begin(), order_.begin() + most, order_.end());
    for (size_ = 0; size_ < most; ++size_) {
        const Nearness& kept = order_[size_];
        x_[size_] = kept.x;
        y_[size_] = kept.y;
        source_[size_] = kept.source;
    }
}

Sights Crowd::sights() const {
    Sights sights{};
    sights.x = x_.data();
    sights.y = y_.data();
    sights.slope = slope_.data();
    if (from_.speed_x) {
        sights.speed_x = speed_x_.data();
        sights.speed_y = speed_y_.data();
    }
    return sights;
}

}  // namespace fewrays
