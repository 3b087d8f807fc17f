#include "sensor_rt/bindings/bindings.h"

PYBIND11_MODULE(_native, module) {
  module.doc() =
      "Laser profile sensor: ray tracing, stripe extraction, triangulation. SI units, float64 poses.";
  sensor_rt::bind_sensor(module);
  sensor_rt::bind_material(module);
  sensor_rt::bind_scene(module);
  sensor_rt::bind_detector(module);
  sensor_rt::bind_imaging(module);
  sensor_rt::bind_cloud(module);
  sensor_rt::bind_visibility(module);
  sensor_rt::bind_pipeline(module);
}
