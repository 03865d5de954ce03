// The samples of pixels, as both layered methods take them: arrays in, arrays out.
#include <cstddef>

#include "bindings.h"
#include "samples.h"

namespace fewrays {
namespace {

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

}  // namespace

void bind_samples(nb::module_& m) {
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
}

}  // namespace fewrays
