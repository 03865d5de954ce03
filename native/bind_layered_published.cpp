// The layered method as published: arrays in, arrays out.
#include <nanobind/stl/optional.h>

#include <optional>

#include "bindings.h"
#include "layered_published.h"

namespace fewrays {

void bind_layered_published(nb::module_& m) {
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
}

}  // namespace fewrays
