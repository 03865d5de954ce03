// The multiplane method: arrays in, arrays out.
#include <cstddef>
#include <vector>

#include "bindings.h"
#include "multiplane.h"
#include "sample_tree.h"

namespace fewrays {
namespace {

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

void bind_multiplane(nb::module_& m) {
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

}  // namespace fewrays
