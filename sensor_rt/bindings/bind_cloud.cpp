#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/cloud/normals.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

py::array_t<double> py_estimate_normals(const Doubles& points, const Integers<std::int64_t>& frame,
                                        const Integers<std::int32_t>& camera,
                                        const Integers<std::int64_t>& column, const Doubles& light,
                                        unsigned threads) {
  require_shape(points, "points", {-1, 3});
  const py::ssize_t count = points.shape(0);
  require_shape(frame, "frame", {count});
  require_shape(camera, "camera", {count});
  require_shape(column, "column", {count});
  require_shape(light, "light", {-1, 3});
  const CloudView cloud{points.data(),
                        frame.data(),
                        camera.data(),
                        column.data(),
                        static_cast<std::size_t>(count),
                        light.data(),
                        static_cast<std::size_t>(light.shape(0))};
  return to_array(without_gil([&] { return estimate_normals(cloud, threads); }), {count, py::ssize_t{3}});
}

}  // namespace

void bind_cloud(py::module_& module) {
  module.def("estimate_normals", &py_estimate_normals, py::arg("points"), py::arg("frame"), py::arg("camera"),
             py::arg("column"), py::arg("light"), py::arg("threads") = 0);
}

}  // namespace sensor_rt
