// One registration function per folder of sensor_rt.
#pragma once

#include <pybind11/pybind11.h>

namespace sensor_rt {

void bind_sensor(pybind11::module_& module);
void bind_material(pybind11::module_& module);
void bind_scene(pybind11::module_& module);
void bind_detector(pybind11::module_& module);
void bind_imaging(pybind11::module_& module);
void bind_cloud(pybind11::module_& module);
void bind_visibility(pybind11::module_& module);
void bind_pipeline(pybind11::module_& module);

}  // namespace sensor_rt
