#include "temporal.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "tree_gatherer.h"
#include "view_reader.h"

namespace fewrays {
namespace {

int band_of(const ViewPlan& plan, float slope) {
    int band = 0;
    while (band + 1 < plan.band_count && std::fabs(slope) >= plan.band_starts[band + 1]) ++band;
    return band;
}

// Reconstructs tiles; all pixels of a tile share a view's samples.
class TileViews {
public:
    TileViews(const SampleTree& tree, const ViewPlan& plan, const LitPlan* lit)
        : plan_(plan), reader_(tree, plan.rule, lit != nullptr) {
        if (lit) lighting_.emplace(tree.field(), *lit);
    }

    void run(int tile, float* bands) {
        const int columns = (plan_.width + plan_.tile - 1) / plan_.tile;
        top_ = tile / columns * plan_.tile;
        left_ = tile % columns * plan_.tile;
        rows_ = std::min(plan_.tile, plan_.height - top_);
        columns_ = std::min(plan_.tile, plan_.width - left_);
        reader_.clear();
        if (lighting_) lighting_->clear();
        for (int view = 0; view < plan_.view_count; ++view) add_view(view, bands);
    }

    const SurfaceStatistics& statistics() const { return reader_.statistics(); }

private:
    void add_view(int number, float* bands) {
        const float* const values = plan_.views + std::ptrdiff_t{6} * number;
        const View view{values[0], values[1], values[2]};
        const float x = static_cast<float>(left_) + 0.5f + values[3], y = static_cast<float>(top_) + 0.5f + values[4];
        reader_.fill({x, x + static_cast<float>(columns_ - 1), y, y + static_cast<float>(rows_ - 1)}, view);
        for (int row = 0; row < rows_; ++row)
            for (int column = 0; column < columns_; ++column) {
                float seen[4];  // radiance and slope
                const float at_x = x + static_cast<float>(column), at_y = y + static_cast<float>(row);
                if (!reader_.read(at_x, at_y, seen)) continue;
                const std::ptrdiff_t pixel = std::ptrdiff_t{top_ + row} * plan_.width + left_ + column;
                float* const sums = bands + 4 * (plan_.band_count * pixel + band_of(plan_, seen[3]));
                sums[3] += values[5];
                if (lighting_)
                    lighting_->see(reader_, {at_x, at_y, view.u, view.v, view.time}, number, values[5], sums);
                else
                    for (int channel = 0; channel < 3; ++channel) sums[channel] += values[5] * seen[channel];
            }
        if (lighting_) lighting_->light(number, view.time);
    }

    const ViewPlan& plan_;
    ViewReader reader_;
    std::optional<Relighting> lighting_;
    int top_ = 0, left_ = 0, rows_ = 0, columns_ = 0;
};

}  // namespace

void temporal_locations(const SampleTree& tree, const SurfaceRule& rule, const float* locations, std::int64_t count,
                        float* colors, std::uint8_t* found, SurfaceStatistics& statistics) {
    Surfaces surfaces(rule);
    TreeGatherer within(tree), beyond(tree);
    Crowd crowd;
    for (std::int64_t i = 0; i < count; ++i) {
        const float* const values = locations + 5 * i;
        const Location location{values[0], values[1], values[2], values[3], values[4]};
        within.gather(location, rule.radius, crowd);
        const SightRow row{0, crowd.size()};
        const auto look = [&](float radius, Crowd& near) { beyond.gather(location, radius, near); };
        float seen[4];
        found[i] = surfaces.resolve(within.sights(), &row, 1, 0.0f, 0.0f, look, seen);
        if (found[i]) std::copy_n(seen, 3, colors + 3 * i);
    }
    statistics += surfaces.statistics();
}

void temporal_tiles(const SampleTree& tree, const ViewPlan& plan, const LitPlan* lit, int first, int last, float* bands,
                    SurfaceStatistics& statistics) {
    TileViews views(tree, plan, lit);
    for (int tile = first; tile < last; ++tile) views.run(tile, bands);
    statistics += views.statistics();
}

}  // namespace fewrays
