// The temporal method: arrays in, arrays out.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <tuple>
#include <vector>

#include "bindings.h"
#include "settle.h"
#include "temporal.h"
#include "tree_gatherer.h"

namespace fewrays {
namespace {

constexpr nb::ssize_t tree_node_words = sizeof(TreeNode) / sizeof(std::int32_t);

// Locations, empty, single, quadrants, covered, last, wide, surfaces, merged.
using Statistics = std::tuple<std::int64_t, std::int64_t, std::int64_t, std::int64_t, std::int64_t, std::int64_t,
                              std::int64_t, std::int64_t, std::int64_t>;

Statistics as_tuple(const SurfaceStatistics& s) {
    return {s.locations, s.empty, s.single, s.quadrants, s.covered, s.last, s.wide, s.surfaces, s.merged};
}

Vector vector_of(const float* values) { return {values[0], values[1], values[2]}; }

// Area lights, added one after the other, and what camera samples know of them.
struct Lights {
    LitPlan plan;

    Lights(Array<const float, 4> projection, const SurfaceRule& rule, Array<const float, -1, 3> unlit,
           Array<const float, -1, 3> normal, Array<const float, -1, 3> facing) {
        const float* const p = projection.data();
        plan = {{p[0], p[1], p[2], p[3]}, unlit.data(), normal.data(), facing.data(), {}, rule};
    }
    // The frame's rows: centre, axes u and v, normal.
    void add(const SampleTree& tree, Array<const float, -1, 3> reflectance, Array<const std::uint8_t, -1> arrives,
             Array<const float, -1, 2> points, Array<const float, 4, 3> frame, Array<const float, 2> half_size,
             float distance, Array<const float, 3> motion, std::optional<Array<const float, 3>> radiance, float area) {
        const float* const f = frame.data();
        const float* const half = half_size.data();
        float farthest = 0;
        for (std::size_t i = 0; i < points.shape(0); ++i)
            farthest = std::max(farthest, std::hypot(points(i, 0), points(i, 1)));
        plan.lamps.push_back(
            {&tree,
             reflectance.data(),
             arrives.data(),
             plan.facing,
             points.data(),
             {vector_of(f), vector_of(f + 3), vector_of(f + 6), vector_of(f + 9), half[0], half[1], distance},
             vector_of(motion.data()),
             radiance ? radiance->data() : nullptr,
             area,
             farthest});
    }
};

}  // namespace

void bind_temporal(nb::module_& m) {
    nb::class_<LightField>(m, "LightField")
        .def(
            "__init__",
            [](LightField* self, Array<const float, -1, 2> xy, Array<const float, -1, 2> uv,
               Array<const float, -1> depth, Array<const float, -1, 3> color,
               std::optional<Array<const float, -1>> time, std::optional<Array<const float, -1, 3>> motion,
               std::optional<Array<const float, -1>> bandwidth, std::optional<Array<const float, -1>> spacing, float c0,
               float c1) {
                new (self) LightField{xy.data(),
                                      uv.data(),
                                      depth.data(),
                                      color.data(),
                                      time ? time->data() : nullptr,
                                      motion ? motion->data() : nullptr,
                                      bandwidth ? bandwidth->data() : nullptr,
                                      spacing ? spacing->data() : nullptr,
                                      static_cast<std::int32_t>(depth.shape(0)),
                                      c0,
                                      c1};
            },
            nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(),
            nb::keep_alive<1, 6>(), nb::keep_alive<1, 7>(), nb::keep_alive<1, 8>(), nb::keep_alive<1, 9>(),
            nb::kw_only(), "xy"_a, "uv"_a, "depth"_a, "color"_a, "time"_a.none(), "motion"_a.none(),
            "bandwidth"_a.none(), "spacing"_a.none(), "c0"_a, "c1"_a);
    nb::class_<TreeRule>(m, "TreeRule")
        .def(
            "__init__",
            [](TreeRule* self, float bin, int most_samples, float along_lens, float along_time, float tolerance,
               float left, float right, float top, float bottom) {
                new (self) TreeRule{bin, most_samples, along_lens, along_time, tolerance, left, right, top, bottom};
            },
            nb::kw_only(), "bin"_a, "most_samples"_a, "along_lens"_a, "along_time"_a, "tolerance"_a, "left"_a,
            "right"_a, "top"_a, "bottom"_a);
    nb::class_<SampleTree>(m, "SampleTree")
        .def(nb::init<const LightField&, const TreeRule&>(), nb::keep_alive<1, 2>(),
             nb::call_guard<nb::gil_scoped_release>(), "field"_a, "rule"_a)
        .def_prop_ro("leaf_count", &SampleTree::leaf_count)
        .def_prop_ro("nbytes", &SampleTree::bytes)
        .def_prop_ro("node_count", &SampleTree::node_count)
        .def(
            "write_depth_first",
            [](const SampleTree& self, Array<std::int32_t, -1, tree_node_words> nodes, Array<std::int32_t, -1> order) {
                std::vector<TreeNode> found(self.node_count());
                self.write_depth_first(found.data());
                std::memcpy(nodes.data(), found.data(), found.size() * sizeof(TreeNode));
                std::copy(self.order().begin(), self.order().end(), order.data());
            },
            "nodes"_a, "order"_a)
        .def(
            "query",
            [](const SampleTree& self, float x, float y, float u, float v, float time, float radius) {
                return samples_within(self, {x, y, u, v, time}, radius);
            },
            "x"_a, "y"_a, "u"_a, "v"_a, "time"_a, "radius"_a);
    nb::class_<SurfaceRule>(m, "SurfaceRule")
        .def(
            "__init__",
            [](SurfaceRule* self, float radius, float along_lens, float along_time, float tolerance, float tent,
               float overhang) { new (self) SurfaceRule{radius, along_lens, along_time, tolerance, tent, overhang}; },
            nb::kw_only(), "radius"_a, "along_lens"_a, "along_time"_a, "tolerance"_a, "tent"_a, "overhang"_a);
    m.def(
        "temporal_locations",
        [](const SampleTree& tree, const SurfaceRule& rule, Array<const float, -1, 5> locations,
           Array<float, -1, 3> colors, Array<std::uint8_t, -1> found) {
            SurfaceStatistics statistics{};
            temporal_locations(tree, rule, locations.data(), static_cast<std::int64_t>(locations.shape(0)),
                               colors.data(), found.data(), statistics);
            return as_tuple(statistics);
        },
        "tree"_a, "rule"_a, "locations"_a, "colors"_a, "found"_a, nb::call_guard<nb::gil_scoped_release>());
    nb::class_<Lights>(m, "Lights")
        .def(nb::init<Array<const float, 4>, const SurfaceRule&, Array<const float, -1, 3>, Array<const float, -1, 3>,
                      Array<const float, -1, 3>>(),
             nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(), nb::keep_alive<1, 6>(), nb::kw_only(), "projection"_a,
             "rule"_a, "unlit"_a, "normal"_a, "facing"_a)
        .def("add", &Lights::add, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(),
             nb::keep_alive<1, 5>(), nb::keep_alive<1, 10>(), nb::kw_only(), "tree"_a, "reflectance"_a, "arrives"_a,
             "points"_a, "frame"_a, "half_size"_a, "distance"_a, "motion"_a, "radiance"_a.none(), "area"_a);
    m.def(
        "shade_tiles",
        [](const LightField& field, const Lights& lights, int tile, int share, Array<const float, -1> times,
           Array<const std::int32_t, -1> first_view, int first, int last, Array<float, -1, -1, -1, 3> radiance) {
            const ShadingPlan plan{static_cast<int>(radiance.shape(0)),
                                   static_cast<int>(radiance.shape(1)),
                                   static_cast<int>(radiance.shape(2)),
                                   tile,
                                   static_cast<int>(times.shape(0)),
                                   share,
                                   times.data(),
                                   first_view.data()};
            shade_tiles(field, lights.plan, plan, first, last, radiance.data());
        },
        "field"_a, "lights"_a, "tile"_a, "share"_a, "times"_a, "first_view"_a, "first"_a, "last"_a, "radiance"_a,
        nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "settle_rows",
        [](Array<const float, -1, -1, -1, 2> xy, Array<const float, -1, -1, -1, 2> at_center,
           Array<const float, -1, -1, -1> inverse_depth, Array<const float, -1, -1, -1, 2> inverse_gradient,
           Array<const float, -1, -1, -1, 3> normal, Array<const float, -1, -1, -1> light,
           Array<const float, -1, -1, -1> difference, float sigma, float pixel, int first, int last,
           Array<float, -1, -1, -1> share, Array<float, -1, -1, -1> variance) {
            const SettlePlan plan{static_cast<int>(xy.shape(0)),
                                  static_cast<int>(xy.shape(1)),
                                  static_cast<int>(xy.shape(2)),
                                  xy.data(),
                                  at_center.data(),
                                  inverse_depth.data(),
                                  inverse_gradient.data(),
                                  normal.data(),
                                  light.data(),
                                  difference.data(),
                                  sigma,
                                  pixel};
            settle_rows(plan, first, last, share.data(), variance.data());
        },
        "xy"_a, "at_center"_a, "inverse_depth"_a, "inverse_gradient"_a, "normal"_a, "light"_a, "difference"_a,
        "sigma"_a, "pixel"_a, "first"_a, "last"_a, "share"_a, "variance"_a, nb::call_guard<nb::gil_scoped_release>());
    m.def(
        "temporal_tiles",
        [](const SampleTree& tree, const SurfaceRule& rule, Array<const float, -1, 6> views, int tile,
           Array<const float, -1> band_starts, const Lights* lights, int first, int last,
           Array<float, -1, -1, -1, 4> bands) {
            SurfaceStatistics statistics{};
            const ViewPlan plan{static_cast<int>(bands.shape(0)),
                                static_cast<int>(bands.shape(1)),
                                tile,
                                static_cast<int>(views.shape(0)),
                                views.data(),
                                rule,
                                static_cast<int>(bands.shape(2)),
                                band_starts.data()};
            temporal_tiles(tree, plan, lights ? &lights->plan : nullptr, first, last, bands.data(), statistics);
            return as_tuple(statistics);
        },
        "tree"_a, "rule"_a, "views"_a, "tile"_a, "band_starts"_a, "lights"_a.none(), "first"_a, "last"_a, "bands"_a,
        nb::call_guard<nb::gil_scoped_release>());
}

}  // namespace fewrays
