#include <pybind11/stl.h>

#include <memory>
#include <stdexcept>
#include <string>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/pipeline/scan.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

std::vector<py::ssize_t> images_shape(const Sensor& sensor, const Exposures& exposures) {
  const Camera& camera = sensor.cameras.front();
  return {static_cast<py::ssize_t>(exposures.count), static_cast<py::ssize_t>(sensor.cameras.size()),
          camera.height_px, camera.width_px};
}

/// Result of scan() in Python.
struct PyScanResult {
  py::object profiles;
  py::dict timings;
  py::object images = py::none();
  py::object background = py::none();
};

py::dict timings(const ScanResult& result) {
  py::dict seconds;
  for (std::size_t s = 0; s < result.seconds.size(); ++s) seconds[kStageNames[s]] = result.seconds[s];
  return seconds;
}

Engine to_engine(const std::string& name) {
  if (name == "geometric") return Engine::kGeometric;
  if (name == "ray-traced") return Engine::kRayTraced;
  throw std::invalid_argument("engine: expected ray-traced or geometric, got " + name);
}

PyScanResult py_scan(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                     const std::string& engine, unsigned threads, bool keep_images, const Sensor* as_built,
                     bool keep_rejected) {
  const ScanOptions options{to_engine(engine), threads, keep_images, keep_rejected};
  ScanResult result = without_gil(
      [&] { return scan(scene, as_built == nullptr ? sensor : *as_built, sensor, exposures, options); });
  PyScanResult converted{py::cast(std::move(result.profiles)), timings(result)};
  if (keep_images) {
    converted.images = to_array(std::move(result.images), images_shape(sensor, exposures));
    if (sensor.laser_off_frame)
      converted.background = to_array(std::move(result.background), images_shape(sensor, exposures));
  }
  return converted;
}

py::array py_render(const Scene& scene, const Sensor& sensor, const Exposures& exposures, unsigned threads,
                    bool laser_on) {
  return to_array(without_gil([&] { return render_images(scene, sensor, exposures, laser_on, threads); }),
                  images_shape(sensor, exposures));
}

py::array py_expected_electrons(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                unsigned threads) {
  const auto trace = [&] { return expected_electrons(scene, sensor, exposures, threads); };
  return to_array(without_gil(trace), images_shape(sensor, exposures));
}

}  // namespace

void bind_pipeline(py::module_& module) {
  py::class_<PyScanResult>(module, "ScanResult", py::module_local())
      .def_readonly("profiles", &PyScanResult::profiles)
      .def_readonly("timings", &PyScanResult::timings)
      .def_readonly("images", &PyScanResult::images)
      .def_readonly("background", &PyScanResult::background);
  module.def("scan", &py_scan, py::arg("scene"), py::arg("sensor"), py::arg("exposures"),
             py::arg("engine") = "ray-traced", py::arg("threads") = 0, py::arg("keep_images") = false,
             py::arg("as_built") = nullptr, py::arg("keep_rejected") = false);
  module.def(
      "check_engine",
      [](const Sensor& sensor, const std::string& engine) { check_engine(sensor, to_engine(engine)); },
      py::arg("sensor"), py::arg("engine"));
  module.def("render", &py_render, py::arg("scene"), py::arg("sensor"), py::arg("exposures"),
             py::arg("threads") = 0, py::arg("laser_on") = true);
  module.def("expected_electrons", &py_expected_electrons, py::arg("scene"), py::arg("sensor"),
             py::arg("exposures"), py::arg("threads") = 0);
}

}  // namespace sensor_rt
