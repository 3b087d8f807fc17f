#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <array>
#include <stdexcept>
#include <string>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/optics/laser_emitter.h"
#include "sensor_rt/optics/trapezoid.h"
#include "sensor_rt/pipeline/sensor.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

Eigen::Matrix4d to_matrix(const Rigid3& pose) {
  Eigen::Matrix4d matrix = Eigen::Matrix4d::Identity();
  matrix.topLeftCorner<3, 3>() = pose.rotation;
  matrix.topRightCorner<3, 1>() = pose.translation;
  return matrix;
}

/// Applies map(row pointer) -> vector to each row of an (n, from) array.
template <typename Map>
py::array_t<double> map_rows(const Doubles& rows, const char* name, py::ssize_t from, py::ssize_t to,
                             const Map& map) {
  require_shape(rows, name, {-1, from});
  py::array_t<double> result({rows.shape(0), to});
  for (py::ssize_t i = 0; i < rows.shape(0); ++i) {
    const auto value = map(rows.data(i, 0));
    for (py::ssize_t k = 0; k < to; ++k) result.mutable_at(i, k) = value[static_cast<std::size_t>(k)];
  }
  return result;
}

py::array_t<double> project(const Camera& camera, const Doubles& points_in_sensor) {
  const Rigid3 camera_from_sensor = camera.sensor_from_camera.inverse();
  return map_rows(points_in_sensor, "points_in_sensor", 3, 2, [&](const double* p) {
    return camera.project(camera_from_sensor * Eigen::Vector3d(p[0], p[1], p[2]));
  });
}

py::array_t<double> view_rays(const Camera& camera, const Doubles& pixels) {
  return map_rows(pixels, "pixels", 2, 3, [&](const double* p) {
    return Eigen::Vector3d(camera.sensor_from_camera.rotation * camera.ray({p[0], p[1]}));
  });
}

py::array_t<double> paper_coordinates(const Camera& camera, const Doubles& pixels) {
  return map_rows(pixels, "pixels", 2, 2, [&](const double* p) {
    return camera.paper_coordinates({p[0], p[1]});
  });
}

/// Returns the irradiance (W/m²) on surface elements that face the centre of the laser source.
py::array_t<double> laser_irradiance(const Sensor& sensor, const Doubles& points_in_sensor) {
  const Rigid3 sheet_from_sensor = sensor.laser.sensor_from_sheet.inverse();
  const LaserEmitter laser(sensor.laser);
  const Eigen::Vector3d source(0.0, 0.0, sensor.laser.source_z);
  return map_rows(points_in_sensor, "points_in_sensor", 3, 1, [&](const double* p) {
    const Eigen::Vector3d at = sheet_from_sensor * Eigen::Vector3d(p[0], p[1], p[2]);
    return std::array<double, 1>{laser.at(at - source).irradiance};
  });
}

Trapezoid trapezoid(const Sensor& sensor, std::size_t camera) {
  if (camera >= sensor.cameras.size())
    throw std::invalid_argument("camera: index " + std::to_string(camera) + " is out of range");
  const Camera& optics = sensor.cameras[camera];
  return sensor.range_as_printed ? range_trapezoid_as_printed(optics) : range_trapezoid(optics);
}

}  // namespace

void bind_sensor(py::module_& module) {
  py::class_<Camera>(module, "Camera", py::module_local())
      .def_readonly("name", &Camera::name)
      .def_readonly("side", &Camera::side)
      .def_readonly("width_px", &Camera::width_px)
      .def_readonly("height_px", &Camera::height_px)
      .def_readonly("focal_px", &Camera::focal_px)
      .def_property_readonly("sensor_from_camera",
                             [](const Camera& c) { return to_matrix(c.sensor_from_camera); })
      .def("project", &project, py::arg("points_in_sensor"))
      .def("view_rays", &view_rays, py::arg("pixels"))
      .def("paper_coordinates", &paper_coordinates, py::arg("pixels"));

  py::class_<Sensor>(module, "Sensor", py::module_local())
      .def(py::init(&parse_sensor), py::arg("json"))
      .def_readonly("name", &Sensor::name)
      .def_property_readonly("cameras", [](const Sensor& s) { return s.cameras; })
      .def_property_readonly("exposure", [](const Sensor& s) { return s.detector.exposure; })
      .def_readonly("row_readout", &Sensor::row_readout)
      .def_readonly("laser_off_frame", &Sensor::laser_off_frame)
      .def_property_readonly("range", [](const Sensor& s) { return py::make_tuple(s.near, s.far); })
      .def("laser_irradiance", &laser_irradiance, py::arg("points_in_sensor"))
      .def("trapezoid", &trapezoid, py::arg("camera") = 0);
}

}  // namespace sensor_rt
