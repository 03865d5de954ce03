#include "tree_gatherer.h"

#include "view_grid.h"

namespace fewrays {
namespace {

// Calls visit(number, sight) for the samples within a radius of a location.
template <typename Visit>
void visit_near(const SampleTree& tree, const Location& at, float radius, Visit&& visit_sample) {
    const LightField& field = tree.field();
    tree.visit({at.x - radius, at.x + radius, at.y - radius, at.y + radius}, {at.u, at.v, at.time},
               [&](std::int32_t, const std::int32_t* samples, std::int32_t count) {
                   for (std::int32_t k = 0; k < count; ++k) {
                       const Path path = field.path(samples[k]);
                       if (depth_at(path, at.time) < nearest_depth) continue;
                       const Sight sight = sight_of(path, at.u, at.v, at.time, field.far_slope());
                       const float dx = sight.x - at.x, dy = sight.y - at.y;
                       if (dx * dx + dy * dy <= radius * radius) visit_sample(samples[k], sight);
                   }
               });
}

}  // namespace

void TreeGatherer::gather(const Location& location, float radius, Crowd& crowd) {
    const LightField& field = tree_.field();
    for (auto& values : fields_) values.clear();
    numbers_.clear();
    visit_near(tree_, location, radius, [&](std::int32_t number, const Sight& sight) {
        const std::ptrdiff_t i = number;
        float weight = 1.0f;
        if (field.bandwidth)
            weight = gloss_weight(location.u - field.uv[2 * i], location.v - field.uv[2 * i + 1], field.bandwidth[i]);
        int next = 0;
        for (float value : {sight.x - location.x, sight.y - location.y, sight.slope, sight.speed_x, sight.speed_y,
                            weight, field.color[3 * i], field.color[3 * i + 1], field.color[3 * i + 2],
                            field.spacing ? field.spacing[i] : 0.0f})
            fields_[next++].push_back(value);
        numbers_.push_back(number);
    });
    const auto count = static_cast<int>(numbers_.size());
    for (auto& values : fields_) values.resize(static_cast<std::size_t>(count) + read_beyond);
    crowd.begin(sights(), count);
    for (int i = 0; i < count; ++i) crowd.add(fields_[0][i], fields_[1][i], i);
}

Sights TreeGatherer::sights() const {
    const auto field = [&](int number) { return fields_[number].data(); };
    const bool moving = tree_.field().motion, glossy = tree_.field().bandwidth;
    return {field(0),
            field(1),
            field(2),
            moving ? field(3) : nullptr,
            moving ? field(4) : nullptr,
            glossy ? field(5) : nullptr,
            field(6),
            field(7),
            field(8),
            field(9),
            numbered_ ? numbers_.data() : nullptr};
}

std::vector<std::int32_t> samples_within(const SampleTree& tree, const Location& location, float radius) {
    std::vector<std::int32_t> numbers;
    visit_near(tree, location, radius, [&](std::int32_t number, const Sight&) { numbers.push_back(number); });
    return numbers;
}

}  // namespace fewrays
