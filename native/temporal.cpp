#include "temporal.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "view_grid.h"

namespace fewrays {
namespace {

// Calls visit(number, sight) for the samples within a radius of a location, by way of the tree.
template <typename Visit>
void visit_near(const SampleTree& tree, const float* location, float radius, Visit&& visit_sample) {
    const LightField& field = tree.field();
    const float x = location[0], y = location[1], u = location[2], v = location[3], time = location[4];
    tree.visit({x - radius, x + radius, y - radius, y + radius}, {u, v, time},
               [&](std::int32_t, const std::int32_t* samples, std::int32_t count) {
                   for (std::int32_t k = 0; k < count; ++k) {
                       const Path path = field.path(samples[k]);
                       if (depth_at(path, time) < nearest_depth) continue;
                       const Sight sight = sight_of(path, u, v, time, field.far_slope());
                       const float dx = sight.x - x, dy = sight.y - y;
                       if (dx * dx + dy * dy <= radius * radius) visit_sample(samples[k], sight);
                   }
               });
}

// The samples within a radius of a location, by way of the tree.
class TreeGatherer {
public:
    explicit TreeGatherer(const SampleTree& tree) : tree_(tree) {}

    void gather(const float* location, float radius, Crowd& crowd) {
        const LightField& field = tree_.field();
        for (auto& values : fields_) values.clear();
        visit_near(tree_, location, radius, [&](std::int32_t number, const Sight& sight) {
            const std::ptrdiff_t i = number;
            float weight = 1.0f;
            if (field.bandwidth)
                weight =
                    gloss_weight(location[2] - field.uv[2 * i], location[3] - field.uv[2 * i + 1], field.bandwidth[i]);
            int next = 0;
            for (float value : {sight.x - location[0], sight.y - location[1], sight.slope, sight.speed_x, sight.speed_y,
                                weight, field.color[3 * i], field.color[3 * i + 1], field.color[3 * i + 2]})
                fields_[next++].push_back(value);
        });
        const auto count = static_cast<int>(fields_[0].size());
        for (auto& values : fields_) values.resize(static_cast<std::size_t>(count) + read_beyond);
        crowd.begin(sights(), count);
        for (int i = 0; i < count; ++i) crowd.add(fields_[0][i], fields_[1][i], i);
    }

    // What was gathered last.
    Sights sights() const {
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
                field(8)};
    }

private:
    const SampleTree& tree_;
    std::vector<float> fields_[9];
};

// Reconstructs tiles; all pixels of a tile share a view's samples.
class TileViews {
public:
    TileViews(const SampleTree& tree, const ViewPlan& plan)
        : plan_(plan), grid_(tree, plan.rule.radius), gatherer_(tree), surfaces_(plan.rule) {}

    void run(int tile, float* bands) {
        const int columns = (plan_.width + plan_.tile - 1) / plan_.tile;
        top_ = tile / columns * plan_.tile;
        left_ = tile % columns * plan_.tile;
        rows_ = std::min(plan_.tile, plan_.height - top_);
        columns_ = std::min(plan_.tile, plan_.width - left_);
        grid_.clear();
        for (int view = 0; view < plan_.view_count; ++view) add_view(plan_.views + std::ptrdiff_t{6} * view, bands);
    }

    const SurfaceStatistics& statistics() const { return surfaces_.statistics(); }

private:
    void add_view(const float* values, float* bands) {
        const View view{values[0], values[1], values[2]};
        const float x = static_cast<float>(left_) + 0.5f + values[3], y = static_cast<float>(top_) + 0.5f + values[4];
        const float margin = 2 * plan_.rule.radius;
        grid_.fill({x - margin, x + static_cast<float>(columns_ - 1) + margin, y - margin,
                    y + static_cast<float>(rows_ - 1) + margin},
                   view);
        for (int row = 0; row < rows_; ++row)
            for (int column = 0; column < columns_; ++column) {
                const float location[5] = {x + static_cast<float>(column), y + static_cast<float>(row), view.u, view.v,
                                           view.time};
                float seen[4];  // radiance and slope
                if (!reconstruct(location, seen)) continue;
                const std::ptrdiff_t pixel = std::ptrdiff_t{top_ + row} * plan_.width + left_ + column;
                float* const sums = bands + 4 * (plan_.band_count * pixel + band_of(seen[3]));
                for (int channel = 0; channel < 3; ++channel) sums[channel] += values[5] * seen[channel];
                sums[3] += values[5];
            }
    }

    bool reconstruct(const float* location, float* seen) {
        const float x = location[0], y = location[1];
        const Sights sights = grid_.sights();
        SightRow rows[ViewGrid::most_rows];
        const int row_count = grid_.rows_around(x, y, plan_.rule.radius, rows);
        const auto look = [&](float radius, Crowd& crowd) {
            if (radius > 2 * plan_.rule.radius) return gatherer_.gather(location, radius, crowd);
            SightRow near[ViewGrid::most_rows];
            const int near_count = grid_.rows_around(x, y, radius, near);
            int most = 0;
            for (int row = 0; row < near_count; ++row) most += near[row].end - near[row].first;
            crowd.begin(sights, most);
            for (int row = 0; row < near_count; ++row)
                for (std::int32_t i = near[row].first; i < near[row].end; ++i) {
                    const float dx = sights.x[i] - x, dy = sights.y[i] - y;
                    crowd.add(dx, dy, i, dx * dx + dy * dy <= radius * radius);
                }
        };
        return surfaces_.resolve(sights, rows, row_count, x, y, look, seen);
    }

    int band_of(float slope) const {
        int band = 0;
        while (band + 1 < plan_.band_count && std::fabs(slope) >= plan_.band_starts[band + 1]) ++band;
        return band;
    }

    const ViewPlan& plan_;
    ViewGrid grid_;
    TreeGatherer gatherer_;
    Surfaces surfaces_;
    int top_ = 0, left_ = 0, rows_ = 0, columns_ = 0;
};

void add_up(const SurfaceStatistics& some, SurfaceStatistics& all) {
    all.locations += some.locations;
    all.empty += some.empty;
    all.single += some.single;
    all.quadrants += some.quadrants;
    all.covered += some.covered;
    all.last += some.last;
    all.wide += some.wide;
    all.surfaces += some.surfaces;
    all.merged += some.merged;
}

}  // namespace

std::vector<std::int32_t> samples_within(const SampleTree& tree, float x, float y, const View& view, float radius) {
    const float location[5] = {x, y, view.u, view.v, view.time};
    std::vector<std::int32_t> numbers;
    visit_near(tree, location, radius, [&](std::int32_t number, const Sight&) { numbers.push_back(number); });
    return numbers;
}

void temporal_locations(const SampleTree& tree, const SurfaceRule& rule, const float* locations, std::int64_t count,
                        float* colors, std::uint8_t* found, SurfaceStatistics& statistics) {
    Surfaces surfaces(rule);
    TreeGatherer within(tree), beyond(tree);
    Crowd crowd;
    for (std::int64_t i = 0; i < count; ++i) {
        const float* const location = locations + 5 * i;
        within.gather(location, rule.radius, crowd);
        const SightRow row{0, crowd.size()};
        const auto look = [&](float radius, Crowd& near) { beyond.gather(location, radius, near); };
        float seen[4];
        found[i] = surfaces.resolve(within.sights(), &row, 1, 0.0f, 0.0f, look, seen);
        if (found[i]) std::copy_n(seen, 3, colors + 3 * i);
    }
    add_up(surfaces.statistics(), statistics);
}

void temporal_tiles(const SampleTree& tree, const ViewPlan& plan, int first, int last, float* bands,
                    SurfaceStatistics& statistics) {
    TileViews views(tree, plan);
    for (int tile = first; tile < last; ++tile) views.run(tile, bands);
    add_up(views.statistics(), statistics);
}

}  // namespace fewrays
