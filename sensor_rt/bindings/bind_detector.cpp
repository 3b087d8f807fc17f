// Python bindings of the detector: expected electrons to images.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <vector>

#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/bindings/image_stack.h"
#include "sensor_rt/detector/detector.h"
#include "sensor_rt/geometry/parallel.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

/// Returns one value per frame, or throws std::invalid_argument.
template <typename T>
std::vector<T> per_frame(const char* name, const py::array& array, std::size_t frames) {
  if (!has_type<T>(array) || array.ndim() != 1 || array.shape(0) != static_cast<py::ssize_t>(frames)) {
    throw std::invalid_argument(std::string(name) + ": expected " +
                                py::str(py::dtype::of<T>()).cast<std::string>() + " (" +
                                std::to_string(frames) + "), got " + describe(array));
  }
  const auto values = py::array_t<T, py::array::c_style>::ensure(array);
  return {values.data(), values.data() + frames};
}

py::array_t<std::uint16_t> expose(const py::array& electrons, const Sensor& sensor, const py::array& duration,
                                  const py::array& index, unsigned threads) {
  const ImageStack<float> light("electrons", electrons, sensor);
  const auto durations = per_frame<double>("duration", duration, light.frames());
  const auto indices = per_frame<std::int64_t>("index", index, light.frames());
  py::array_t<std::uint16_t> images(
      {electrons.shape(0), electrons.shape(1), electrons.shape(2), electrons.shape(3)});
  std::uint16_t* out = images.mutable_data();
  {
    const py::gil_scoped_release release;
    const Detector& detector = *sensor.image_sensor;
    parallel_for(light.frames() * light.cameras(), threads, [&](std::size_t task, unsigned) {
      const std::size_t frame = task / light.cameras();
      const FrameId id{indices[frame], static_cast<int>(task % light.cameras()), durations[frame]};
      detector.expose(id, light.image(task),
                      {out + task * light.pixels(), light.width(), light.height(), light.width()});
    });
  }
  return images;
}

}  // namespace

void bind_detector(py::module_& module) {
  module.def("expose", &expose, py::arg("electrons"), py::arg("sensor"), py::arg("duration"),
             py::arg("index"), py::arg("threads") = 0u);
}

}  // namespace sensor_rt
