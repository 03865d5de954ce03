#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "math/plane_place.h"
#include "multiplane.h"
#include "multiplane_blocks.h"
#include "multiplane_estimate.h"
#include "simd.h"

namespace fewrays {
namespace {

constexpr int halo = estimate_halo;
constexpr int channels = block_channels;  // weight of hits, and their radiance

// Where the lens centre sees a sample's surface at half time.
Place seen_from_center(const LightField& field, std::int32_t i, float most_blur) {
    const float own = slope(field.depth[i], field.c0, field.c1);
    return place_on_plane(field.path(i), own, field.uv[2 * i], field.uv[2 * i + 1], most_blur, field.motion != nullptr,
                          field.far_slope());
}

int whole(float x) { return floor_to_int(x); }

// The sums of what hits and passes the blocks of some rows of a plane.
template <int cells>
class Evidence {
public:
    static constexpr int width = block_columns * cells, height = block_rows * cells;

    Evidence(const DepthPlane& plane, const std::int32_t* slots, int first_row, int last_row)
        : plane_(plane),
          first_row_(first_row),
          last_row_(last_row),
          local_(static_cast<std::size_t>(last_row - first_row) * static_cast<std::size_t>(plane.columns), -1) {
        std::int32_t count = 0;
        const std::int32_t* own = slots + plane.first_slot + std::ptrdiff_t{first_row} * plane.columns;
        for (std::size_t i = 0; i < local_.size(); ++i)
            if (own[i] >= 0) local_[i] = count++;
        const auto total = static_cast<std::size_t>(count) * width * height;
        hits_.resize(total * channels);
        passes_.resize(total);
    }

    bool any_block(float left, float right, float top, float bottom) const {
        const int first = std::max(block_column(left), 0), last = std::min(block_column(right), plane_.columns - 1);
        const int from = std::max(block_row(top), first_row_), to = std::min(block_row(bottom), last_row_ - 1);
        for (int row = from; row <= to; ++row)
            for (int column = first; column <= last; ++column)
                if (block(row, column) >= 0) return true;
        return false;
    }

    void hit(Place place, const float* color, float scale) {
        const float values[channels] = {1.0f, scale * color[0], scale * color[1], scale * color[2]};
        splat(place, [&](std::size_t cell, float weight) {
            float* sums = hits_.data() + cell * channels;
            for (int c = 0; c < channels; ++c) sums[c] += weight * values[c];
        });
    }

    void pass(Place place) {
        splat(place, [&](std::size_t cell, float weight) { passes_[cell] += weight; });
    }

    // Copies the sums of a rectangle of cells; 0 where there is no block. Sums of weights, of all, and of radiance;
    // `kept` is 1 where there is a block.
    void copy(int row, int column, int rows, int columns, float* hits, float* total, float* radiance,
              float* kept) const;

private:
    int block_column(float x) const { return whole((x - static_cast<float>(plane_.left)) / block_columns); }
    int block_row(float y) const { return whole((y - static_cast<float>(plane_.top)) / block_rows); }
    std::int32_t block(int row, int column) const {
        return local_[static_cast<std::size_t>(row - first_row_) * static_cast<std::size_t>(plane_.columns) +
                      static_cast<std::size_t>(column)];
    }

    std::size_t cell(std::int32_t own, int row, int column) const {
        return (static_cast<std::size_t>(own) * height + static_cast<std::size_t>(row)) * width +
               static_cast<std::size_t>(column);
    }

    // Shares a sample out among the four cells around it.
    template <typename Add>
    void splat(Place place, Add add) {
        const float x = (place.x - static_cast<float>(plane_.left)) * cells - 0.5f;
        const float y = (place.y - static_cast<float>(plane_.top)) * cells - 0.5f;
        const int top_cell = first_row_ * height, bottom_cell = last_row_ * height, end = plane_.columns * width;
        if (!(x >= -1.0f && y >= static_cast<float>(top_cell - 1) && x < static_cast<float>(end) &&
              y < static_cast<float>(bottom_cell)))
            return;
        const int column = floor_to_int(x), row = floor_to_int(y);
        const float right = x - static_cast<float>(column), down = y - static_cast<float>(row);
        const float above[2] = {(1.0f - down) * (1.0f - right), (1.0f - down) * right};
        const float below[2] = {down * (1.0f - right), down * right};
        const bool inside = column >= 0 && row >= top_cell && column % width < width - 1 && row % height < height - 1;
        if (inside) {  // most samples touch one block
            const std::int32_t own = block(row / height, column / width);
            if (own < 0) return;
            const std::size_t at = cell(own, row % height, column % width);
            add(at, above[0]);
            add(at + 1, above[1]);
            add(at + width, below[0]);
            add(at + width + 1, below[1]);
            return;
        }
        for (int j = 0; j < 2; ++j)
            for (int i = 0; i < 2; ++i) {
                const int to_row = row + j, to_column = column + i;
                if (to_row < top_cell || to_row >= bottom_cell || to_column < 0 || to_column >= end) continue;
                const std::int32_t own = block(to_row / height, to_column / width);
                if (own >= 0) add(cell(own, to_row % height, to_column % width), (j ? below : above)[i]);
            }
    }

    const DepthPlane& plane_;
    int first_row_, last_row_;
    std::vector<std::int32_t> local_;  // blocks that there are, by row and column
    std::vector<float> hits_, passes_;
};

template <int cells>
void Evidence<cells>::copy(int row, int column, int rows, int columns, float* hits, float* total, float* radiance,
                           float* kept) const {
    const auto size = static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
    std::fill(hits, hits + size, 0.0f);
    std::fill(total, total + size, 0.0f);
    std::fill(radiance, radiance + 3 * size, 0.0f);
    std::fill(kept, kept + size, 0.0f);
    const int row_end = std::min(row + rows, last_row_ * height);
    const int column_begin = std::max(column, 0), column_end = std::min(column + columns, plane_.columns * width);
    for (int i = std::max(row, first_row_ * height); i < row_end; ++i) {
        for (int j = column_begin; j < column_end;) {
            const int end = std::min(column_end, (j / width + 1) * width);
            const std::int32_t own = block(i / height, j / width);
            if (own >= 0) {
                const std::size_t from = cell(own, i % height, j % width);
                const std::size_t to = static_cast<std::size_t>(i - row) * static_cast<std::size_t>(columns) +
                                       static_cast<std::size_t>(j - column);
                for (int k = 0; k < end - j; ++k) {
                    const float* sums = hits_.data() + (from + static_cast<std::size_t>(k)) * channels;
                    const std::size_t at = to + static_cast<std::size_t>(k);
                    kept[at] = 1.0f;
                    hits[at] = sums[0];
                    total[at] = sums[0] + passes_[from + static_cast<std::size_t>(k)];
                    for (std::size_t c = 0; c < 3; ++c) radiance[c * size + at] = sums[1 + c];
                }
            }
            j = end;
        }
    }
}

// Turns the evidence of rows of blocks into maps, region by region.
template <int cells>
void resolve(const Evidence<cells>& evidence, const DepthPlane& plane, const std::int32_t* slots,
             const EstimateRule& rule, int first_row, int last_row, Half* halves) {
    using Blocks = Evidence<cells>;
    // Regions whose borders, in cells, are multiples of the widest neighbourhood.
    constexpr int across = 192 / Blocks::width, down = 192 / Blocks::height;
    constexpr int rows = down * Blocks::height + 2 * halo, columns = across * Blocks::width + 2 * halo;
    static_assert(rows % (1 << estimate_levels) == 0 && columns % (1 << estimate_levels) == 0);
    thread_local std::vector<EstimateMaps> pyramid = make_pyramid(rows, columns);
    EstimateMaps& maps = pyramid.front();
    const std::size_t size = maps.cell_count();
    std::vector<float> kept(size);
    for (int top = first_row; top < last_row; top += down) {
        for (int left = 0; left < plane.columns; left += across) {
            const int bottom = std::min(top + down, last_row), right = std::min(left + across, plane.columns);
            const auto slot = [&](int row, int column) {
                return slots[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column];
            };
            // Blocks that are kept, with the cells of their neighbours that they repeat.
            CellRange range{rows, 0, columns, 0};
            for (int row = top; row < bottom; ++row)
                for (int column = left; column < right; ++column) {
                    if (slot(row, column) < 0) continue;
                    const int y = halo + (row - top) * Blocks::height, x = halo + (column - left) * Blocks::width;
                    range = {std::min(range.top, y), std::max(range.bottom, y + Blocks::height + cells),
                             std::min(range.left, x), std::max(range.right, x + Blocks::width + cells)};
                }
            if (range.bottom == 0) continue;
            evidence.copy(top * Blocks::height - halo, left * Blocks::width - halo, rows, columns, maps.hits.data(),
                          maps.total.data(), maps.radiance.data(), kept.data());
            estimate(pyramid, rule, range);
            // Where no block is kept nothing was hit, though no pass was counted either.
            const std::size_t begin = static_cast<std::size_t>(range.top) * columns;
            const std::size_t end = static_cast<std::size_t>(range.bottom) * columns;
            for (std::size_t i = begin; i < end; ++i) maps.opacity[i] *= kept[i];
            for (std::size_t c = 0; c < 3; ++c)
                for (std::size_t i = begin; i < end; ++i) maps.color[c * size + i] *= maps.opacity[i];
            const float* const sources[channels] = {maps.opacity.data(), maps.color.data(), maps.color.data() + size,
                                                    maps.color.data() + 2 * size};
            for (int row = top; row < bottom; ++row)
                for (int column = left; column < right; ++column)
                    if (const std::int32_t own = slot(row, column); own >= 0)
                        write_block<cells>(sources, columns, halo + (row - top) * Blocks::height,
                                           halo + (column - left) * Blocks::width,
                                           halves + half_padding + own * unit_halves);
        }
    }
}

// Image positions, seen from the lens centre on a plane, of a run's samples.
FEWRAYS_CLONES
void passes_of_run(const float* FEWRAYS_RESTRICT xy, const float* FEWRAYS_RESTRICT uv,
                   const float* FEWRAYS_RESTRICT time, int count, const DepthPlane& plane, float* FEWRAYS_RESTRICT x,
                   float* FEWRAYS_RESTRICT y) {
    const float slope = plane.slope, motion_x = plane.motion_x, motion_y = plane.motion_y;
    for (int i = 0; i < count; ++i) {
        x[i] = xy[2 * i] - slope * uv[2 * i];
        y[i] = xy[2 * i + 1] - slope * uv[2 * i + 1];
    }
    if (time && (motion_x != 0.0f || motion_y != 0.0f))
        for (int i = 0; i < count; ++i) {
            x[i] -= motion_x * (time[i] - 0.5f);
            y[i] -= motion_y * (time[i] - 0.5f);
        }
}

template <int cells>
void build(const LightField& field, const std::int16_t* plane_of, const PlaneSet& set, const BuildPlan& plan,
           const PlanePart& part, Half* halves) {
    const DepthPlane& plane = set.planes[part.plane];
    constexpr int margin = (halo + Evidence<cells>::height - 1) / Evidence<cells>::height;
    const int first_row = std::max(part.first_row - margin, 0), last_row = std::min(part.last_row + margin, plane.rows);
    Evidence<cells> evidence(plane, set.slots, first_row, last_row);
    const float shift = std::fabs(plane.slope) + 0.5f * std::hypot(plane.motion_x, plane.motion_y);
    const float reach = 1.0f + std::max(shift, plan.reach[part.plane]);
    const float scale = 1.0f / plane.scale;
    std::vector<float> x(static_cast<std::size_t>(plan.run_length)), y(x);
    for (int number = 0; number < plan.run_count; ++number) {
        const Run& run = plan.runs[number];
        if (run.last_plane < part.plane) continue;
        if (!evidence.any_block(run.x_min - reach, run.x_max + reach, run.y_min - reach, run.y_max + reach)) continue;
        const std::int32_t first = number * plan.run_length;
        const int count = std::min(plan.run_length, field.count - first);
        passes_of_run(field.xy + 2 * std::ptrdiff_t{first}, field.uv + 2 * std::ptrdiff_t{first},
                      field.time ? field.time + first : nullptr, count, plane, x.data(), y.data());
        for (int i = 0; i < count; ++i) {
            const std::int32_t hit = plane_of[first + i];
            if (hit > part.plane)
                evidence.pass({x[static_cast<std::size_t>(i)], y[static_cast<std::size_t>(i)]});
            else if (hit == part.plane)
                evidence.hit(seen_from_center(field, first + i, set.most_blur),
                             field.color + 3 * std::ptrdiff_t{first + i}, scale);
        }
    }
    resolve<cells>(evidence, plane, set.slots, {plan.prior, plan.along[part.plane]}, part.first_row, part.last_row,
                   halves);
}

}  // namespace

void multiplane_mark(const LightField& field, const std::int16_t* plane_of, const PlaneSet& set, std::uint8_t* marks,
                     float* reach, float* brightest) {
    std::fill(reach, reach + set.count, 0.0f);
    std::fill(brightest, brightest + set.count, 0.0f);
    for (std::int32_t i = 0; i < field.count; ++i) {
        if (plane_of[i] < 0) continue;
        const DepthPlane& plane = set.planes[plane_of[i]];
        const Place place = seen_from_center(field, i, set.most_blur);
        const float* color = field.color + 3 * std::ptrdiff_t{i};
        for (int c = 0; c < 3; ++c) brightest[plane_of[i]] = std::max(brightest[plane_of[i]], std::fabs(color[c]));
        float& farthest = reach[plane_of[i]];
        farthest = std::max({farthest, std::fabs(place.x - field.xy[2 * i]), std::fabs(place.y - field.xy[2 * i + 1])});
        // Cells that share the sample, and one more to each side.
        const float around = 2.0f / static_cast<float>(plane.cells);
        const float x = place.x - static_cast<float>(plane.left), y = place.y - static_cast<float>(plane.top);
        const int left = std::max(whole((x - around) / block_columns), 0);
        const int right = std::min(whole((x + around) / block_columns), plane.columns - 1);
        const int top = std::max(whole((y - around) / block_rows), 0);
        const int bottom = std::min(whole((y + around) / block_rows), plane.rows - 1);
        for (int row = top; row <= bottom; ++row)
            for (int column = left; column <= right; ++column)
                marks[plane.first_slot + std::ptrdiff_t{row} * plane.columns + column] = 1;
    }
}

void multiplane_runs(const LightField& field, const std::int16_t* plane_of, int length, int first, int last,
                     Run* runs) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    for (int number = first; number < last; ++number) {
        Run run{infinity, -infinity, infinity, -infinity, -1};
        const std::int32_t end = std::min(field.count, (number + 1) * length);
        for (std::int32_t i = number * length; i < end; ++i) {
            if (plane_of[i] < 0) continue;
            run.x_min = std::min(run.x_min, field.xy[2 * i]);
            run.x_max = std::max(run.x_max, field.xy[2 * i]);
            run.y_min = std::min(run.y_min, field.xy[2 * i + 1]);
            run.y_max = std::max(run.y_max, field.xy[2 * i + 1]);
            run.last_plane = std::max(run.last_plane, std::int32_t{plane_of[i]});
        }
        runs[number] = run;
    }
}

void multiplane_build(const LightField& field, const std::int16_t* plane_of, const PlaneSet& set, const BuildPlan& plan,
                      const PlanePart& part, Half* halves) {
    switch (set.planes[part.plane].cells) {
        case 1:
            return build<1>(field, plane_of, set, plan, part, halves);
        case 2:
            return build<2>(field, plane_of, set, plan, part, halves);
        default:
            return build<3>(field, plane_of, set, plan, part, halves);
    }
}

}  // namespace fewrays
