// Python bindings of CellMotion and MotionProof.
#pragma once

#include <pybind11/pybind11.h>

namespace robotcell::proximity {

void bind_motion(pybind11::module_& module);

}  // namespace robotcell::proximity
