// Arrays in, arrays out: shapes are checked by nanobind's types and by the caller, there is no logic here.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <tuple>
#include <vector>

#include "bindings.h"
#include "dynamic.h"
#include "layered.h"
#include "layered_published.h"
#include "math/sheared_filter.h"
#include "multiplane.h"
#include "sample_tree.h"
#include "samples.h"

namespace {

using namespace fewrays;

Samples make_samples(Array<const float, -1, -1, -1, 2> xy, Array<const float, -1, -1, -1, 2> uv,
                     Array<const float, -1, -1, -1> depth, Array<const float, -1, -1, -1, 3> color, float c0,
                     float c1) {
    for (std::size_t axis = 0; axis < 3; ++axis)
        if (xy.shape(axis) != depth.shape(axis) || uv.shape(axis) != depth.shape(axis) ||
            color.shape(axis) != depth.shape(axis))
            throw nb::value_error("xy, uv, depth and color differ in shape");
    return {xy.data(),
            uv.data(),
            depth.data(),
            color.data(),
            static_cast<int>(depth.shape(0)),
            static_cast<int>(depth.shape(1)),
            static_cast<int>(depth.shape(2)),
            c0,
            c1};
}

BlockLayers make_block_layers(int block, Array<const float, -1, -1, 4> extents,
                              Array<const std::int32_t, -1, -1, -1> counts, Array<const float, -1, -1, -1> slope_sums) {
    return {block, reinterpret_cast<const Extent*>(extents.data()), counts.data(), slope_sums.data()};
}

CoarseMap make_coarse_map(int layer, int row, int column, Array<float, 5, -1, -1> values) {
    return {values.data(), layer, row, column, static_cast<int>(values.shape(1)), static_cast<int>(values.shape(2))};
}

Sheets make_sheets(Array<const float, -1, -1, -1, 8> texels, Array<const float, -1, -1, -1, 2> pixels,
                   Array<const float, -1> behind) {
    return {reinterpret_cast<const Texel*>(texels.data()),
            reinterpret_cast<const WarpPixel*>(pixels.data()),
            behind.data(),
            static_cast<int>(texels.shape(0)),
            static_cast<int>(texels.shape(1)),
            static_cast<int>(texels.shape(2))};
}

using Texels = Array<float, -1, -1, 8>;

MipLevel make_mip_level(const Texels& texels) {
    return {reinterpret_cast<Texel*>(texels.data()), static_cast<int>(texels.shape(0)),
            static_cast<int>(texels.shape(1))};
}

// Planes as native code reads them: slope, motion (x, y) and scale of radiance; cells, left, top, columns, rows, first
// slot.
struct DepthPlanes {
    std::vector<DepthPlane> planes;
    float most_blur;

    DepthPlanes(Array<const float, -1, 4> shears, Array<const std::int32_t, -1, 6> grids, float most_blur_)
        : most_blur(most_blur_) {
        for (std::size_t k = 0; k < shears.shape(0); ++k) {
            const float* s = shears.data() + 4 * k;
            const std::int32_t* g = grids.data() + 6 * k;
            planes.push_back({s[0], s[1], s[2], s[3], g[0], g[1], g[2], g[3], g[4], g[5]});
        }
    }
    PlaneSet with_slots(const std::int32_t* slots) const {
        return {planes.data(), static_cast<int>(planes.size()), slots, most_blur};
    }
};

struct SampleRuns {
    std::vector<Run> runs;

    explicit SampleRuns(int count) : runs(static_cast<std::size_t>(count)) {}
};

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "Inner loops of fewrays. Internal: shapes and units are described where the calls are made.";

    nb::enum_<FilterFamily>(m, "FilterFamily")
        .value("sheared", FilterFamily::sheared)
        .value("axis_aligned", FilterFamily::axis_aligned);
    nb::enum_<Sampling>(m, "Sampling")
        .value("disc", Sampling::disc)
        .value("square", Sampling::square)
        .value("gaussian", Sampling::gaussian);
    nb::class_<FilterRule>(m, "FilterRule")
        .def(
            "__init__",
            [](FilterRule* self, FilterFamily family, double sigma_pix, double sigma_u, double max_sigma_x,
               Sampling sampling, double sampling_sigma, double k) {
                new (self) FilterRule{family, sigma_pix, sigma_u, max_sigma_x, sampling, sampling_sigma, k};
            },
            nb::kw_only(), "family"_a, "sigma_pix"_a, "sigma_u"_a, "max_sigma_x"_a, "sampling"_a, "sampling_sigma"_a,
            "k"_a);

    m.def(
        "layer_filter",
        [](double c_min, double c_max, const FilterRule& rule) {
            const LayerFilter filter = layer_filter(c_min, c_max, rule);
            return std::tuple(filter.eta, filter.variance, filter.falloff);
        },
        "c_min"_a, "c_max"_a, "rule"_a);
    m.def(
        "layer_taps",
        [](double variance, int ring) {
            std::vector<float> taps(static_cast<std::size_t>(ring) + 1);
            layer_taps(variance, ring, taps.data());
            return taps;
        },
        "variance"_a, "ring"_a);

    nb::class_<Samples>(m, "Samples")
        .def(
            "__init__",
            [](Samples* self, Array<const float, -1, -1, -1, 2> xy, Array<const float, -1, -1, -1, 2> uv,
               Array<const float, -1, -1, -1> depth, Array<const float, -1, -1, -1, 3> color, float c0,
               float c1) { new (self) Samples(make_samples(xy, uv, depth, color, c0, c1)); },
            nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(), "xy"_a,
            "uv"_a, "depth"_a, "color"_a, "c0"_a, "c1"_a);

    m.def(
        "block_extents",
        [](const Samples& samples, int block, float margin, int first, int last, Array<float, -1, -1, 4> extents) {
            block_extents(samples, block, margin, first, last, reinterpret_cast<Extent*>(extents.data()));
        },
        "samples"_a, "block"_a, "margin"_a, "first"_a, "last"_a, "extents"_a, nb::call_guard<nb::gil_scoped_release>());

    nb::class_<PublishedPlan>(m, "PublishedPlan")
        .def(
            "__init__",
            [](PublishedPlan* self, int tile, int ring, int max_layers, float bins_per_pixel, int first_bin,
               Array<const std::uint8_t, -1> partition_of_bin, Array<const std::int32_t, -1> slot_of_partition,
               const FilterRule& rule) {
                new (self) PublishedPlan{tile,
                                         ring,
                                         max_layers,
                                         bins_per_pixel,
                                         first_bin,
                                         static_cast<int>(partition_of_bin.shape(0)),
                                         static_cast<int>(slot_of_partition.shape(0)),
                                         partition_of_bin.data(),
                                         slot_of_partition.data(),
                                         rule};
            },
            nb::keep_alive<1, 7>(), nb::keep_alive<1, 8>(), "tile"_a, "ring"_a, "max_layers"_a, "bins_per_pixel"_a,
            "first_bin"_a, "partition_of_bin"_a, "slot_of_partition"_a, "rule"_a);

    m.def(
        "published_tiles",
        [](const Samples& samples, Array<const float, -1, -1, 4> extents, int block, const PublishedPlan& plan,
           int first, int last, Array<float, -1, -1, 3> image, Array<std::int32_t, -1> counts,
           std::optional<Array<float, -1, -1, -1, 4>> layer_images) {
            const PublishedOutput output{image.data(), counts.data(), layer_images ? layer_images->data() : nullptr,
                                         layer_images ? static_cast<int>(layer_images->shape(2)) : 0};
            published_tiles(samples, reinterpret_cast<const Extent*>(extents.data()), block, plan, first, last, output);
        },
        "samples"_a, "extents"_a, "block"_a, "plan"_a, "first"_a, "last"_a, "image"_a, "counts"_a,
        "layer_images"_a.none(), nb::call_guard<nb::gil_scoped_release>());

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

    bind_temporal(m);

    m.def(
        "dynamic_halve",
        [](Texels fine, Texels coarse, int first, int last) {
            dynamic_halve(make_mip_level(fine), make_mip_level(coarse), first, last);
        },
        "fine"_a, "coarse"_a, "first"_a, "last"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "dynamic_mipmap",
        [](const std::vector<Texels>& levels, float view_radius, int first, int last) {
            std::vector<MipLevel> views;
            for (const auto& level : levels) views.push_back(make_mip_level(level));
            dynamic_mipmap(views.data(), static_cast<int>(views.size()), view_radius, first, last);
        },
        "levels"_a, "view_radius"_a, "first"_a, "last"_a, nb::call_guard<nb::gil_scoped_release>());
    nb::class_<BlurRule>(m, "BlurRule")
        .def(
            "__init__",
            [](BlurRule* self, float radius, float tolerance, float relative, int level) {
                new (self) BlurRule{radius, tolerance, relative, level};
            },
            nb::kw_only(), "radius"_a, "tolerance"_a, "relative"_a, "level"_a);
    m.def(
        "dynamic_blur_along",
        [](Texels level, Texels passed, const BlurRule& rule, int first, int last) {
            dynamic_blur_along(make_mip_level(level), make_mip_level(passed), rule, first, last);
        },
        "level"_a, "passed"_a, "rule"_a, "first"_a, "last"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "dynamic_blur_down",
        [](Texels passed, Texels level, Texels sheet, const BlurRule& rule, int first, int last) {
            dynamic_blur_down(make_mip_level(passed), make_mip_level(level), make_mip_level(sheet), rule, first, last);
        },
        "passed"_a, "level"_a, "sheet"_a, "rule"_a, "first"_a, "last"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "dynamic_background",
        [](Array<const float, -1, -1, 4> light, Array<const float, -1, -1> slope, Array<const float, -1, -1> front,
           Array<const std::uint8_t, -1, -1> edge, Array<const std::uint8_t, -1, -1> needed, float most,
           float tolerance, float agreement, int reach, int first, int last, Array<float, -1, -1, 6> background) {
            const FrontImage image{light.data(),
                                   slope.data(),
                                   front.data(),
                                   edge.data(),
                                   needed.data(),
                                   static_cast<int>(slope.shape(0)),
                                   static_cast<int>(slope.shape(1)),
                                   most};
            dynamic_background(image, {tolerance, agreement, reach}, first, last,
                               reinterpret_cast<BackgroundPixel*>(background.data()));
        },
        "light"_a, "slope"_a, "front"_a, "edge"_a, "needed"_a, "most"_a, "tolerance"_a, "agreement"_a, "reach"_a,
        "first"_a, "last"_a, "background"_a, nb::call_guard<nb::gil_scoped_release>());
    nb::class_<FrontRim>(m, "FrontRim")
        .def(
            "__init__",
            [](FrontRim* self, float centre_x, float centre_y, float per_pixel, float radius, float softness) {
                new (self) FrontRim{centre_x, centre_y, per_pixel, radius, softness};
            },
            nb::kw_only(), "centre_x"_a, "centre_y"_a, "per_pixel"_a, "radius"_a, "softness"_a);
    nb::class_<Sheets>(m, "Sheets")
        .def(
            "__init__",
            [](Sheets* self, Array<const float, -1, -1, -1, 8> texels, Array<const float, -1, -1, -1, 2> pixels,
               Array<const float, -1> behind) { new (self) Sheets(make_sheets(texels, pixels, behind)); },
            nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(), "texels"_a, "pixels"_a, "behind"_a);
    m.def(
        "dynamic_blocks",
        [](const Sheets& sheets, int block, int first, int last, Array<float, -1, -1, -1, 4> blocks) {
            dynamic_blocks(sheets, block, first, last, reinterpret_cast<BlockRange*>(blocks.data()));
        },
        "sheets"_a, "block"_a, "first"_a, "last"_a, "blocks"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "dynamic_tiles",
        [](const Sheets& sheets, Array<const float, -1, -1, -1, 4> blocks, int block, int tile,
           Array<const float, -1, 3> views, float tolerance, int growth, const FrontRim* rim, int first, int last,
           Array<float, -1, -1, 5> sums, std::optional<Array<float, -1, -1>> passed) {
            const DynamicPlan plan{tile,
                                   block,
                                   reinterpret_cast<const BlockRange*>(blocks.data()),
                                   static_cast<int>(views.shape(0)),
                                   views.data(),
                                   tolerance,
                                   growth,
                                   rim,
                                   passed ? passed->data() : nullptr};
            const StageSeconds seconds = dynamic_tiles(sheets, plan, first, last, sums.data());
            return std::tuple(seconds.warping, seconds.synthesis);
        },
        "sheets"_a, "blocks"_a, "block"_a, "tile"_a, "views"_a, "tolerance"_a, "growth"_a, "rim"_a.none(), "first"_a,
        "last"_a, "sums"_a, "passed"_a.none(), nb::call_guard<nb::gil_scoped_release>());

    m.attr("BLOCK_ROWS") = block_rows;
    m.attr("BLOCK_COLUMNS") = block_columns;
    m.attr("TILE_ROWS") = tile_rows;
    m.attr("TILE_COLUMNS") = tile_columns;
    m.attr("UNIT_HALVES") = unit_halves;
    m.attr("HALF_PADDING") = half_padding;
    nb::class_<DepthPlanes>(m, "DepthPlanes")
        .def(nb::init<Array<const float, -1, 4>, Array<const std::int32_t, -1, 6>, float>(), "shears"_a, "grids"_a,
             "most_blur"_a);
    m.def(
        "multiplane_mark",
        [](const LightField& field, Array<const std::int16_t, -1> plane_of, const DepthPlanes& planes,
           Array<std::uint8_t, -1> marks, Array<float, -1> reach, Array<float, -1> brightest) {
            multiplane_mark(field, plane_of.data(), planes.with_slots(nullptr), marks.data(), reach.data(),
                            brightest.data());
        },
        "field"_a, "plane_of"_a, "planes"_a, "marks"_a, "reach"_a, "brightest"_a,
        nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "multiplane_runs",
        [](const LightField& field, Array<const std::int16_t, -1> plane_of, int length, int first, int last,
           SampleRuns& runs) { multiplane_runs(field, plane_of.data(), length, first, last, runs.runs.data()); },
        "field"_a, "plane_of"_a, "length"_a, "first"_a, "last"_a, "runs"_a, nb::call_guard<nb::gil_scoped_release>());
    nb::class_<SampleRuns>(m, "SampleRuns").def(nb::init<int>(), "count"_a);
    m.def(
        "multiplane_build",
        [](const LightField& field, Array<const std::int16_t, -1> plane_of, const DepthPlanes& planes,
           Array<const std::int32_t, -1> slots, const SampleRuns& runs, int run_length, Array<const float, -1> reach,
           float prior, Array<const std::int32_t, -1, 3> parts, int first, int last, Array<Half, -1> halves) {
            const BuildPlan plan{run_length, static_cast<int>(runs.runs.size()), runs.runs.data(), reach.data(), prior};
            for (int part = first; part < last; ++part) {
                const std::int32_t* row = parts.data() + std::ptrdiff_t{3} * part;
                multiplane_build(field, plane_of.data(), planes.with_slots(slots.data()), plan,
                                 {row[0], row[1], row[2]}, halves.data());
            }
        },
        "field"_a, "plane_of"_a, "planes"_a, "slots"_a, "runs"_a, "run_length"_a, "reach"_a, "prior"_a, "parts"_a,
        "first"_a, "last"_a, "halves"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "multiplane_smooth",
        [](const DepthPlanes& planes, Array<const std::int32_t, -1> slots, Array<const Half, -1> halves,
           Array<const float, -1> sigma, const DepthPlanes& copies, Array<const std::uint8_t, -1> is_halved,
           Array<std::int32_t, -1> places, Array<const std::int32_t, -1, 3> parts, int first, int last,
           Array<Half, -1> smoothed) {
            const SmoothCopies to{copies.planes.data(), is_halved.data(), places.data(), smoothed.data()};
            for (int part = first; part < last; ++part) {
                const std::int32_t* row = parts.data() + std::ptrdiff_t{3} * part;
                multiplane_smooth(planes.with_slots(slots.data()), halves.data(), sigma.data()[row[0]], to,
                                  {row[0], row[1], row[2]});
            }
        },
        "planes"_a, "slots"_a, "halves"_a, "sigma"_a, "copies"_a, "is_halved"_a, "places"_a, "parts"_a, "first"_a,
        "last"_a, "smoothed"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "multiplane_render",
        [](const DepthPlanes& planes, Array<const std::int32_t, -1> slots, Array<const Half, -1> built,
           Array<const Half, -1> smoothed, Array<const std::uint8_t, -1> is_smoothed,
           Array<const std::uint8_t, -1> is_halved, Array<const float, -1, 6> views, Array<const float, -1> shrink,
           Array<const float, -1, 2> reach, const FrontRim& rim, bool vignetted, bool darken, int first, int last,
           Array<float, -1, -1, 4> image) {
            const ViewSet set{
                static_cast<int>(views.shape(0)), views.data(), shrink.data(), reach.data(), rim, vignetted, darken};
            multiplane_render(planes.with_slots(slots.data()),
                              {built.data(), smoothed.data(), is_smoothed.data(), is_halved.data()}, set, first, last,
                              {static_cast<int>(image.shape(0)), static_cast<int>(image.shape(1)), image.data()});
        },
        "planes"_a, "slots"_a, "built"_a, "smoothed"_a, "is_smoothed"_a, "is_halved"_a, nb::kw_only(), "views"_a,
        "shrink"_a, "reach"_a, "rim"_a, "vignetted"_a, "darken"_a, "first"_a, "last"_a, "image"_a,
        nb::call_guard<nb::gil_scoped_release>());
}
