// What the files of bindings share.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace nb = nanobind;
using namespace nb::literals;

namespace fewrays {

template <typename Scalar, nb::ssize_t... shape>
using Array = nb::ndarray<Scalar, nb::shape<shape...>, nb::c_contig, nb::device::cpu>;

void bind_temporal(nb::module_& m);

}  // namespace fewrays
