#include "view_reader.h"

namespace fewrays {

void ViewReader::fill(const Box& places, const View& view) {
    view_ = view;
    const float margin = 2 * surfaces_.radius();
    grid_.fill({places.left - margin, places.right + margin, places.top - margin, places.bottom + margin}, view,
               surfaces_.radius());
}

bool ViewReader::read(float x, float y, float* seen) {
    x_ = x;
    y_ = y;
    const Sights sights = grid_.sights();
    row_count_ = grid_.rows_around(x, y, surfaces_.radius(), rows_);
    const auto look = [&](float radius, Crowd& crowd) {
        if (radius > 2 * surfaces_.radius())
            return gatherer_.gather({x, y, view_.u, view_.v, view_.time}, radius, crowd);
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
    return surfaces_.resolve(sights, rows_, row_count_, x, y, look, seen);
}

}  // namespace fewrays
