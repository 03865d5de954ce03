#include "view_grid.h"

#include <algorithm>
#include <cmath>

#include "simd.h"

namespace fewrays {
namespace {

constexpr float nowhere = 1e30f;       // beyond every box
constexpr float least_weight = 1e-6f;  // of samples far from their lens point: where there are no others they count

FEWRAYS_CLONES void project_still(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y,
                                  const float* FEWRAYS_RESTRICT c, int n, float u, float v,
                                  float* FEWRAYS_RESTRICT seen_x, float* FEWRAYS_RESTRICT seen_y,
                                  float* FEWRAYS_RESTRICT slope) {
    for (int i = 0; i < n; ++i) {
        seen_x[i] = x[i] + u * c[i];
        seen_y[i] = y[i] + v * c[i];
        slope[i] = c[i];
    }
}

struct PathFields {
    const float *x, *y, *w, *dx, *dy, *dw, *c0;
};

FEWRAYS_CLONES void project_moving(const PathFields& path, int n, const View& view, float c1,
                                   float* FEWRAYS_RESTRICT seen_x, float* FEWRAYS_RESTRICT seen_y,
                                   float* FEWRAYS_RESTRICT slope, float* FEWRAYS_RESTRICT speed_x,
                                   float* FEWRAYS_RESTRICT speed_y) {
    const float u = view.u, v = view.v, time = view.time;
    for (int i = 0; i < n; ++i) {
        const Sight sight =
            sight_of({path.x[i], path.y[i], path.w[i], path.dx[i], path.dy[i], path.dw[i], path.c0[i]}, u, v, time, c1);
        const bool in_front = path.w[i] + time * path.dw[i] >= nearest_depth;
        seen_x[i] = in_front ? sight.x : nowhere;
        seen_y[i] = sight.y;
        slope[i] = sight.slope;
        speed_x[i] = sight.speed_x;
        speed_y[i] = sight.speed_y;
    }
}

// Numbers of the cells that samples lie in, or -1.
FEWRAYS_CLONES void find_cells(const float* FEWRAYS_RESTRICT x, const float* FEWRAYS_RESTRICT y, int n, float left,
                               float top, float per_pixel, int columns, int rows,
                               std::int32_t* FEWRAYS_RESTRICT cells) {
    const auto last_x = static_cast<float>(columns), last_y = static_cast<float>(rows);
    for (int i = 0; i < n; ++i) {
        const float column = (x[i] - left) * per_pixel, row = (y[i] - top) * per_pixel;
        const std::int32_t inside =
            -(static_cast<std::int32_t>(column >= 0.0f) & static_cast<std::int32_t>(column < last_x) &
              static_cast<std::int32_t>(row >= 0.0f) & static_cast<std::int32_t>(row < last_y));
        const auto in_column = static_cast<std::int32_t>(inside ? column : 0.0f);
        const auto in_row = static_cast<std::int32_t>(inside ? row : 0.0f);
        cells[i] = (in_row * columns + in_column) | ~inside;
    }
}

}  // namespace

float gloss_weight(float u, float v, float bandwidth) {
    u /= bandwidth;
    v /= bandwidth;
    return std::max(exp_negative(-0.5f * (u * u + v * v)), least_weight);
}

void LeafCache::clear() {
    for (std::int32_t leaf : leaves_) place_of_leaf_[leaf] = -1;
    leaves_.clear();
    for (auto& field : fields_) field.clear();
    numbers_.clear();
}

LeafCache::Place LeafCache::place(std::int32_t leaf, const std::int32_t* samples, std::int32_t count) {
    const std::int32_t padded = (count + group - 1) / group * group;
    if (place_of_leaf_[leaf] >= 0) return {place_of_leaf_[leaf], padded};
    const auto first = static_cast<std::int32_t>(fields_[0].size());
    place_of_leaf_[leaf] = first;
    leaves_.push_back(leaf);
    const LightField& from = tree_.field();
    const auto push = [&](int field, std::initializer_list<float> values) {
        for (float value : values) fields_[field++].push_back(value);
    };
    for (std::int32_t k = 0; k < padded; ++k) {
        const std::ptrdiff_t i = samples[std::min(k, count - 1)];
        const Path path = from.path(static_cast<std::int32_t>(i));
        numbers_.push_back(static_cast<std::int32_t>(i));
        const float x = k < count ? path.x : nowhere;
        if (moving())
            push(0, {x, path.y, path.w, path.dx, path.dy, path.dw, path.c0});
        else
            push(0, {x, path.y, path.c0 + from.far_slope()});
        push(color_field(), {from.color[3 * i], from.color[3 * i + 1], from.color[3 * i + 2]});
        if (spaced()) push(spacing_field(), {from.spacing[i]});
        if (glossy()) push(gloss_field(), {from.uv[2 * i], from.uv[2 * i + 1], from.bandwidth[i]});
    }
    return {first, padded};
}

void ViewGrid::fill(const Box& box, const View& view, float cell) {
    box_ = box;
    cell_ = cell;
    columns_ = static_cast<int>(std::ceil((box.right - box.left) / cell_)) + 1;
    rows_ = static_cast<int>(std::ceil((box.bottom - box.top) / cell_)) + 1;
    if (cache_.full()) cache_.clear();
    places_.clear();
    tree_.visit(box, view, [&](std::int32_t leaf, const std::int32_t* samples, std::int32_t count) {
        places_.push_back(cache_.place(leaf, samples, count));
    });
    project(view);
    sort(view);
}

void ViewGrid::project(const View& view) {
    std::size_t total = 0;
    for (const LeafCache::Place& place : places_) total += static_cast<std::size_t>(place.count);
    const int fields = moving() ? 5 : 3;
    for (int field = 0; field < fields; ++field) seen_[field].resize(total);
    cells_.resize(total);
    sources_.resize(total);
    const LightField& from = tree_.field();
    const auto at = [&](int field, const LeafCache::Place& place) { return cache_.field(field) + place.first; };
    std::ptrdiff_t done = 0;
    for (const LeafCache::Place& place : places_) {
        float *const x = seen_[0].data() + done, *const y = seen_[1].data() + done, *const c = seen_[2].data() + done;
        if (moving())
            project_moving(
                {at(0, place), at(1, place), at(2, place), at(3, place), at(4, place), at(5, place), at(6, place)},
                place.count, view, from.far_slope(), x, y, c, seen_[3].data() + done, seen_[4].data() + done);
        else
            project_still(at(0, place), at(1, place), at(2, place), place.count, view.u, view.v, x, y, c);
        for (std::int32_t k = 0; k < place.count; ++k) sources_[static_cast<std::size_t>(done + k)] = place.first + k;
        done += place.count;
    }
    find_cells(seen_[0].data(), seen_[1].data(), static_cast<int>(total), box_.left, box_.top, 1.0f / cell_, columns_,
               rows_, cells_.data());
}

void ViewGrid::sort(const View& view) {
    starts_.assign(static_cast<std::size_t>(rows_) * columns_ + 1, 0);
    std::int32_t* const starts = starts_.data() + 1;
    for (std::int32_t cell : cells_) ++starts[cell];  // strays, of cell -1, come first
    std::int32_t next = 0;
    for (std::int32_t& start : starts_) {
        const std::int32_t count = start;
        start = next;
        next += count;
    }
    // Placing samples moves each start to the cell's end, which is the next one's start.
    for (auto& field : sorted_) field.resize(cells_.size() + read_beyond);
    if (numbered_) sorted_numbers_.resize(cells_.size());
    const std::int32_t strays = starts_[1];
    const int colors = cache_.color_field(), gloss = cache_.gloss_field();
    for (std::size_t i = 0; i < cells_.size(); ++i) {
        if (cells_[i] < 0) continue;
        const auto to = static_cast<std::size_t>(starts[cells_[i]]++ - strays);
        const std::int32_t source = sources_[i];
        for (int field = 0; field < 3; ++field) sorted_[field][to] = seen_[field][i];
        if (numbered_) sorted_numbers_[to] = cache_.number(source);
        if (cache_.spaced()) sorted_[9][to] = cache_.field(cache_.spacing_field())[source];
        for (int channel = 0; colored_ && channel < 3; ++channel)
            sorted_[3 + channel][to] = cache_.field(colors + channel)[source];
        if (moving())
            for (int axis = 0; axis < 2; ++axis) sorted_[6 + axis][to] = seen_[3 + axis][i];
        if (glossy())
            sorted_[8][to] = gloss_weight(view.u - cache_.field(gloss)[source],
                                          view.v - cache_.field(gloss + 1)[source], cache_.field(gloss + 2)[source]);
    }
    for (std::int32_t& start : starts_) start -= strays;
    starts_[0] = 0;
}

int ViewGrid::rows_around(float x, float y, float distance, SightRow* rows) const {
    const auto cell = [&](float position, float origin, int limit) {
        return std::clamp(static_cast<int>(std::floor((position - origin) / cell_)), 0, limit - 1);
    };
    const int first = cell(x - distance, box_.left, columns_), last = cell(x + distance, box_.left, columns_);
    const int top = cell(y - distance, box_.top, rows_), bottom = cell(y + distance, box_.top, rows_);
    int count = 0;
    // starts_[k] is where cell k begins, now that samples are in place.
    for (int row = top; row <= bottom; ++row)
        rows[count++] = {starts_[static_cast<std::size_t>(row) * columns_ + first],
                         starts_[static_cast<std::size_t>(row) * columns_ + last + 1]};
    return count;
}

Sights ViewGrid::sights() const {
    const auto field = [&](int number) { return sorted_[number].data(); };
    return {field(0),
            field(1),
            field(2),
            moving() ? field(6) : nullptr,
            moving() ? field(7) : nullptr,
            glossy() ? field(8) : nullptr,
            colored_ ? field(3) : nullptr,
            colored_ ? field(4) : nullptr,
            colored_ ? field(5) : nullptr,
            cache_.spaced() ? field(9) : nullptr,
            numbered_ ? sorted_numbers_.data() : nullptr};
}

}  // namespace fewrays
