// What each block of pixels holds of each layer, and where its samples lie.
#include <algorithm>
#include <limits>
#include <vector>

#include "layer_lookup.h"
#include "layered.h"
#include "simd.h"

namespace fewrays {
namespace {

// Grows the box around samples, limits their slopes, and takes samples too far outside the image from their layers.
FEWRAYS_CLONES void survey_run(const float* FEWRAYS_RESTRICT xy, int n, float left_top, float right, float bottom,
                               std::int32_t no_layer, Extent& box, float* FEWRAYS_RESTRICT slopes,
                               std::int32_t* FEWRAYS_RESTRICT layers) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    constexpr int lanes = 16;  // each with a box of its own: the compiler keeps to the order of a single one
    float x_min[lanes], x_max[lanes], y_min[lanes], y_max[lanes];
    for (int lane = 0; lane < lanes; ++lane) {
        x_min[lane] = y_min[lane] = infinity;
        x_max[lane] = y_max[lane] = -infinity;
    }
    const auto look = [&](int k, int lane) {
        const float x = xy[2 * k], y = xy[2 * k + 1];
        const bool near_image = (x >= left_top) & (x <= right) & (y >= left_top) & (y <= bottom);
        const float low_x = near_image ? x : infinity, high_x = near_image ? x : -infinity;
        const float low_y = near_image ? y : infinity, high_y = near_image ? y : -infinity;
        x_min[lane] = low_x < x_min[lane] ? low_x : x_min[lane];
        x_max[lane] = high_x > x_max[lane] ? high_x : x_max[lane];
        y_min[lane] = low_y < y_min[lane] ? low_y : y_min[lane];
        y_max[lane] = high_y > y_max[lane] ? high_y : y_max[lane];
        slopes[k] = std::min(std::max(slopes[k], -max_slope), max_slope);
        layers[k] = near_image ? layers[k] : no_layer;
    };
    int k = 0;
    for (; k + lanes <= n; k += lanes)
        for (int lane = 0; lane < lanes; ++lane) look(k + lane, lane);
    for (; k < n; ++k) look(k, 0);
    for (int lane = 0; lane < lanes; ++lane)
        box = {std::min(box.x_min, x_min[lane]), std::max(box.x_max, x_max[lane]), std::min(box.y_min, y_min[lane]),
               std::max(box.y_max, y_max[lane])};
}

}  // namespace

void block_layers(const Samples& samples, const LayeredPlan& plan, float margin, int first, int last,
                  const BlockLayersOutput& output) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    const LayerLookup lookup(plan.boundaries, plan.layer_count - 1);
    const int block = output.block, columns = (samples.width + block - 1) / block;
    const float right = static_cast<float>(samples.width) + margin;
    const float bottom = static_cast<float>(samples.height) + margin;
    std::vector<float> slopes;
    std::vector<std::int32_t> layers;
    struct Tally {
        double sum;
        std::int32_t count;
    };
    constexpr int tallies_at_once = 4;
    std::vector<Tally> tallies;  // of each layer, and of samples that no layer gets
    for (int cell = first * columns; cell < last * columns; ++cell) {
        const int top = cell / columns * block, left = cell % columns * block;
        const int i_end = std::min(top + block, samples.height), j_end = std::min(left + block, samples.width);
        Extent box{infinity, -infinity, infinity, -infinity};
        tallies.assign(std::size_t{tallies_at_once} * (plan.layer_count + 1), {0.0, 0});
        std::int32_t* const counts = output.counts + std::ptrdiff_t{cell} * plan.layer_count;
        float* const slope_sums = output.slope_sums + std::ptrdiff_t{cell} * plan.layer_count;
        for (int i = top; i < i_end; ++i) {
            const std::ptrdiff_t row = std::ptrdiff_t{i} * samples.width;
            const std::ptrdiff_t begin = (row + left) * samples.spp;
            const auto n = static_cast<int>((row + j_end) * samples.spp - begin);
            slopes.resize(n);
            layers.resize(n);
            lookup.run(samples.depth + begin, n, samples.c0, samples.c1, slopes.data(), layers.data());
            survey_run(samples.xy + 2 * begin, n, -margin, right, bottom, plan.layer_count, box, slopes.data(),
                       layers.data());
            // Several tallies in turn, so that none is waited for.
            for (int k = 0; k < n; ++k) {
                Tally& tally = tallies[tallies_at_once * layers[k] + k % tallies_at_once];
                ++tally.count;
                tally.sum += double{slopes[k]};
            }
        }
        for (int layer = 0; layer < plan.layer_count; ++layer) {
            double sum = 0;
            for (int i = 0; i < tallies_at_once; ++i) {
                counts[layer] += tallies[tallies_at_once * layer + i].count;
                sum += tallies[tallies_at_once * layer + i].sum;
            }
            slope_sums[layer] = static_cast<float>(sum);
        }
        output.extents[cell] = box;
    }
}

}  // namespace fewrays
