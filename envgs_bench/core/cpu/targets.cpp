// targets.h for Python. Compiled for any CPU of the architecture.
#include "targets.h"

#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

NB_MODULE(_targets, m) {
    m.doc() = "Which of the targets that the CPU backend is compiled for this CPU runs.";
    m.def("supported", &envgs::supported_targets, "Names of targets, the best first.");
    m.attr("SOURCES_DIGEST") = SOURCES_DIGEST;
}
