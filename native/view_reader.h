// Reads a light field at many places of one view, that is from one lens point at one time: they share the work of
// finding samples.
#pragma once

#include <utility>

#include "tree_gatherer.h"
#include "view_grid.h"

namespace fewrays {

class ViewReader {
public:
    // With `numbered`, what is found knows which samples it is.
    ViewReader(const SampleTree& tree, const SurfaceRule& rule, bool numbered = false)
        : grid_(tree, numbered), gatherer_(tree, numbered), surfaces_(rule) {}

    // Forgets the copies of samples made for an earlier part of the image.
    void clear() { grid_.clear(); }

    // Prepares for places in a box.
    void fill(const Box& places, const View& view);

    // Finds what is seen at a place, radiance and slope; false if no sample is near.
    bool read(float x, float y, float* seen);

    // Calls visit(sights, index, x, y, weight) for the samples that made it up: see Surfaces.
    template <typename Visit>
    void visit_found(Visit&& visit) const {
        surfaces_.visit_found(grid_.sights(), rows_, row_count_, x_, y_, std::forward<Visit>(visit));
    }

    const SurfaceStatistics& statistics() const { return surfaces_.statistics(); }

private:
    ViewGrid grid_;
    TreeGatherer gatherer_;
    Surfaces surfaces_;
    View view_{};
    SightRow rows_[ViewGrid::most_rows]{};  // around the place that was read last
    int row_count_ = 0;
    float x_ = 0, y_ = 0;
};

}  // namespace fewrays
