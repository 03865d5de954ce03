// The filters of a layer: numbers in, numbers out.
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <tuple>
#include <vector>

#include "bindings.h"
#include "math/sheared_filter.h"

namespace fewrays {

void bind_sheared_filter(nb::module_& m) {
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
}

}  // namespace fewrays
