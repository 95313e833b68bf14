// What a module for one kind of CPU has in common with the others.
#pragma once
#include <nanobind/nanobind.h>

namespace envgs {

void bind(nanobind::module_& m);

}  // namespace envgs
