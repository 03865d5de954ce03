// The dynamic method: arrays in, arrays out.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <tuple>
#include <vector>

#include "bindings.h"
#include "dynamic.h"

namespace fewrays {
namespace {

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

}  // namespace

void bind_dynamic(nb::module_& m) {
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
}

}  // namespace fewrays
