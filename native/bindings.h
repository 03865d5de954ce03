// What the files of bindings share: bind_METHOD.cpp each add one method's kernels to the module.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace nb = nanobind;
using namespace nb::literals;

namespace fewrays {

template <typename Scalar, nb::ssize_t... shape>
using Array = nb::ndarray<Scalar, nb::shape<shape...>, nb::c_contig, nb::device::cpu>;

void bind_dynamic(nb::module_& m);
void bind_layered(nb::module_& m);
void bind_layered_published(nb::module_& m);
void bind_multiplane(nb::module_& m);
void bind_samples(nb::module_& m);
void bind_sheared_filter(nb::module_& m);
void bind_temporal(nb::module_& m);

}  // namespace fewrays
