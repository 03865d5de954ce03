// The layered method: arrays in, arrays out.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <vector>

#include "bindings.h"
#include "layered.h"

namespace fewrays {
namespace {

BlockLayers make_block_layers(int block, Array<const float, -1, -1, 4> extents,
                              Array<const std::int32_t, -1, -1, -1> counts, Array<const float, -1, -1, -1> slope_sums) {
    return {block, reinterpret_cast<const Extent*>(extents.data()), counts.data(), slope_sums.data()};
}

CoarseMap make_coarse_map(int layer, int row, int column, Array<float, 5, -1, -1> values) {
    return {values.data(), layer, row, column, static_cast<int>(values.shape(1)), static_cast<int>(values.shape(2))};
}

}  // namespace

void bind_layered(nb::module_& m) {
    nb::class_<LayeredPlan>(m, "LayeredPlan")
        .def(
            "__init__",
            [](LayeredPlan* self, int tile, Array<const float, -1> boundaries, Array<const std::int32_t, -1> levels,
               int deepest_tile_level, Array<const float, -1> reaches, double pixel_variance, double aperture_variance,
               double part_variance, Array<const float, -1, 3> parts, double interpolation, float full_weight,
               float seen, int finest_by_place) {
                new (self) LayeredPlan{tile,
                                       static_cast<int>(levels.shape(0)),
                                       boundaries.data(),
                                       levels.data(),
                                       deepest_tile_level,
                                       reaches.data(),
                                       {pixel_variance, aperture_variance, part_variance, interpolation},
                                       static_cast<int>(parts.shape(0)),
                                       parts.data(),
                                       full_weight,
                                       seen,
                                       finest_by_place};
            },
            nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(), nb::keep_alive<1, 7>(), nb::keep_alive<1, 11>(),
            nb::kw_only(), "tile"_a, "boundaries"_a, "levels"_a, "deepest_tile_level"_a, "reaches"_a,
            "pixel_variance"_a, "aperture_variance"_a, "part_variance"_a, "parts"_a, "interpolation"_a, "full_weight"_a,
            "seen"_a, "finest_by_place"_a);
    nb::class_<BlockLayers>(m, "BlockLayers")
        .def(
            "__init__",
            [](BlockLayers* self, int block, Array<const float, -1, -1, 4> extents,
               Array<const std::int32_t, -1, -1, -1> counts, Array<const float, -1, -1, -1> slope_sums) {
                new (self) BlockLayers(make_block_layers(block, extents, counts, slope_sums));
            },
            nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(), "block"_a, "extents"_a, "counts"_a,
            "slope_sums"_a);
    nb::class_<CoarseMap>(m, "CoarseMap")
        .def(
            "__init__",
            [](CoarseMap* self, int layer, int row, int column, Array<float, 5, -1, -1> values) {
                new (self) CoarseMap(make_coarse_map(layer, row, column, values));
            },
            nb::keep_alive<1, 5>(), "layer"_a, "row"_a, "column"_a, "values"_a);
    nb::class_<CoarsePass>(m, "CoarsePass")
        .def(
            "__init__",
            [](CoarsePass* self, int first_level, int last_level, int left, int top, int right, int bottom, int side) {
                new (self) CoarsePass{first_level, last_level, left, top, right, bottom, side};
            },
            nb::kw_only(), "first_level"_a, "last_level"_a, "left"_a, "top"_a, "right"_a, "bottom"_a, "side"_a);

    m.def(
        "block_layers",
        [](const Samples& samples, const LayeredPlan& plan, float margin, int first, int last, int block,
           Array<float, -1, -1, 4> extents, Array<std::int32_t, -1, -1, -1> counts,
           Array<float, -1, -1, -1> slope_sums) {
            block_layers(samples, plan, margin, first, last,
                         {block, reinterpret_cast<Extent*>(extents.data()), counts.data(), slope_sums.data()});
        },
        "samples"_a, "plan"_a, "margin"_a, "first"_a, "last"_a, "block"_a, "extents"_a, "counts"_a, "slope_sums"_a,
        nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "coarse_tiles",
        [](const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan, const CoarsePass& pass,
           const std::vector<CoarseMap>& maps, int first, int last) {
            coarse_tiles(samples, blocks, plan, pass, maps.data(), static_cast<int>(maps.size()), first, last);
        },
        "samples"_a, "blocks"_a, "plan"_a, "coarse_pass"_a, "maps"_a, "first"_a, "last"_a,
        nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "layered_tiles",
        [](const Samples& samples, const BlockLayers& blocks, const LayeredPlan& plan,
           const std::vector<CoarseMap>& maps, Array<const std::int32_t, -1> tiles, Array<float, -1, -1, 3> image,
           Array<std::int32_t, -1> counts, std::optional<Array<float, -1, -1, -1, 4>> contributions) {
            const LayeredOutput output{image.data(), counts.data(), contributions ? contributions->data() : nullptr};
            layered_tiles(samples, blocks, plan, maps.data(), static_cast<int>(maps.size()), tiles.data(),
                          static_cast<int>(tiles.shape(0)), output);
        },
        "samples"_a, "blocks"_a, "plan"_a, "maps"_a, "tiles"_a, "image"_a, "counts"_a, "contributions"_a.none(),
        nb::call_guard<nb::gil_scoped_release>());
}

}  // namespace fewrays
