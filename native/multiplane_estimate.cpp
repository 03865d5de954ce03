#include "multiplane_estimate.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "multiplane_edges.h"
#include "simd.h"

namespace fewrays {
namespace {

// Sums of 2 x 2 cells.
FEWRAYS_CLONES
void halve(const float* fine, int rows, int columns, float* coarse) {
    for (int i = 0; i < rows; ++i) {
        const float* FEWRAYS_RESTRICT above = fine + std::ptrdiff_t{4} * i * columns;
        const float* FEWRAYS_RESTRICT below = above + std::ptrdiff_t{2} * columns;
        float* FEWRAYS_RESTRICT out = coarse + std::ptrdiff_t{i} * columns;
        for (int j = 0; j < columns; ++j) out[j] = above[2 * j] + above[2 * j + 1] + below[2 * j] + below[2 * j + 1];
    }
}

// Interpolates a coarse map linearly to twice the resolution: rows [first, last) of that.
FEWRAYS_CLONES
void twice(const float* FEWRAYS_RESTRICT coarse, int rows, int columns, int first, int last,
           float* FEWRAYS_RESTRICT line, float* FEWRAYS_RESTRICT out) {
    for (int i = first; i < last; ++i) {
        const int own = i / 2, other = std::clamp(own + (i % 2 ? 1 : -1), 0, rows - 1);
        const float* FEWRAYS_RESTRICT near_row = coarse + std::ptrdiff_t{own} * columns;
        const float* FEWRAYS_RESTRICT far_row = coarse + std::ptrdiff_t{other} * columns;
        float* FEWRAYS_RESTRICT padded = line + 1;
        for (int j = 0; j < columns; ++j) padded[j] = 0.75f * near_row[j] + 0.25f * far_row[j];
        line[0] = padded[0];
        padded[columns] = padded[columns - 1];
        float* FEWRAYS_RESTRICT row = out + std::ptrdiff_t{2} * i * columns;
        for (int j = 0; j < columns; ++j) {
            const float middle = 0.75f * padded[j];
            row[2 * j] = middle + 0.25f * padded[j - 1];
            row[2 * j + 1] = middle + 0.25f * padded[j + 1];
        }
    }
}

// Draws what few samples say of a cell towards the estimate of the coarser cells around it, which `out` holds at first:
// (sum + share out) / (weight + count). The estimate counts as `count` samples; `share` is that, or more where only a
// part of the coarser cells is known.
FEWRAYS_CLONES
void draw_towards(const float* FEWRAYS_RESTRICT sum, const float* FEWRAYS_RESTRICT weight,
                  const float* FEWRAYS_RESTRICT share, const float* FEWRAYS_RESTRICT count, std::size_t cells,
                  float* FEWRAYS_RESTRICT out) {
    for (std::size_t i = 0; i < cells; ++i) out[i] = (sum[i] + share[i] * out[i]) / (weight[i] + count[i]);
}

// Estimates opacity and radiance of cells in rows [first, last), given the estimate of cells twice as wide.
void refine(const EstimateMaps& coarse, EstimateMaps& fine, float prior, int first, int last) {
    const std::size_t size = fine.cell_count(), columns = static_cast<std::size_t>(fine.columns);
    const std::size_t begin = static_cast<std::size_t>(first) * columns, end = static_cast<std::size_t>(last) * columns;
    std::vector<float> line(static_cast<std::size_t>(coarse.columns) + 2);
    const auto interpolate = [&](const std::vector<float>& from, std::size_t from_map, std::vector<float>& to,
                                 std::size_t to_map) {
        twice(from.data() + from_map, coarse.rows, coarse.columns, first, last, line.data(), to.data() + to_map);
    };
    const auto draw = [&](const std::vector<float>& sum, const std::vector<float>& weight, std::size_t map,
                          std::vector<float>& out) {
        draw_towards(sum.data() + map + begin, weight.data() + begin, fine.share.data() + begin,
                     fine.count.data() + begin, end - begin, out.data() + map + begin);
    };
    std::fill(fine.count.begin() + first * fine.columns, fine.count.begin() + last * fine.columns, prior);
    std::fill(fine.share.begin() + first * fine.columns, fine.share.begin() + last * fine.columns, prior);
    interpolate(coarse.opacity, 0, fine.opacity, 0);
    draw(fine.hits, fine.total, 0, fine.opacity);
    // Radiance is known only where something was hit.
    interpolate(coarse.known, 0, fine.known, 0);
    constexpr float none = 1e-30f;  // samples that leave a cell's own ones alone
    for (std::size_t i = begin; i < end; ++i) {
        const float known = fine.known[i];
        fine.share[i] = known > 0.0f ? prior / known : 0.0f;
        fine.count[i] = known > 0.0f ? prior : none;
        fine.known[i] = known > 0.0f || fine.hits[i] > 0.0f ? 1.0f : 0.0f;
    }
    for (std::size_t c = 0; c < 3; ++c) {
        interpolate(coarse.color, c * coarse.cell_count(), fine.color, c * size);
        draw(fine.radiance, fine.hits, c * size, fine.color);
    }
}

}  // namespace

std::vector<EstimateMaps> make_pyramid(int rows, int columns) {
    std::vector<EstimateMaps> pyramid;
    for (int level = 0; level <= estimate_levels; ++level) pyramid.emplace_back(rows >> level, columns >> level);
    return pyramid;
}

void estimate(std::vector<EstimateMaps>& pyramid, const EstimateRule& rule, const CellRange& range) {
    for (std::size_t level = 1; level < pyramid.size(); ++level) {
        const EstimateMaps& fine = pyramid[level - 1];
        EstimateMaps& coarse = pyramid[level];
        halve(fine.hits.data(), coarse.rows, coarse.columns, coarse.hits.data());
        halve(fine.total.data(), coarse.rows, coarse.columns, coarse.total.data());
        for (std::size_t c = 0; c < 3; ++c)
            halve(fine.radiance.data() + c * fine.cell_count(), coarse.rows, coarse.columns,
                  coarse.radiance.data() + c * coarse.cell_count());
    }
    EstimateMaps& top = pyramid.back();
    const std::size_t size = top.cell_count();
    for (std::size_t i = 0; i < size; ++i) {
        const bool hit = top.hits[i] > 0.0f;
        top.opacity[i] = top.total[i] > 0.0f ? top.hits[i] / top.total[i] : 0.0f;
        top.known[i] = hit ? 1.0f : 0.0f;
        for (std::size_t c = 0; c < 3; ++c)
            top.color[c * size + i] = hit ? top.radiance[c * size + i] / top.hits[i] : 0.0f;
    }
    for (std::size_t level = pyramid.size() - 1; level > 1; --level)
        refine(pyramid[level], pyramid[level - 1], rule.prior, 0, pyramid[level - 1].rows);
    if (rule.along > 0.0f) gather_along_edges(pyramid[1], rule.along, range, pyramid[0]);
    refine(pyramid[1], pyramid[0], rule.prior, range.top, range.bottom);
}

}  // namespace fewrays
