// The module of all methods' kernels: shapes are checked by nanobind's types and by the caller, there is no logic here.
#include "bindings.h"

NB_MODULE(_native, m) {
    m.doc() = "Inner loops of fewrays. Internal: shapes and units are described where the calls are made.";

    // What a method takes from another is bound first, or its signature would not know the type's name in Python.
    fewrays::bind_sheared_filter(m);
    fewrays::bind_samples(m);
    fewrays::bind_layered_published(m);
    fewrays::bind_layered(m);
    fewrays::bind_temporal(m);
    fewrays::bind_dynamic(m);
    fewrays::bind_multiplane(m);
}
