#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <utility>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/visibility/covered.h"
#include "sensor_rt/visibility/pose_search.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

std::vector<Eigen::Vector3d> to_vectors(const Doubles& rows, const char* name) {
  require_shape(rows, name, {-1, 3});
  std::vector<Eigen::Vector3d> result;
  for (py::ssize_t i = 0; i < rows.shape(0); ++i)
    result.emplace_back(Eigen::Map<const Eigen::Vector3d>(rows.data(i, 0)));
  return result;
}

SensorOrientations to_orientations(const Doubles& rotations, const Doubles& lowest, int azimuths) {
  require_shape(rotations, "orientations", {-1, 3, 3});
  require_shape(lowest, "lowest", {rotations.shape(0)});
  SensorOrientations result;
  for (py::ssize_t i = 0; i < rotations.shape(0); ++i) {
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    result.frame_from_sensor.emplace_back(Eigen::Map<const RowMajor>(rotations.data(i, 0, 0)));
  }
  result.lowest.assign(lowest.data(), lowest.data() + lowest.size());
  result.azimuths = azimuths;
  return result;
}

SensorField to_field(const Doubles& points, const Integers<std::uint8_t>& seen, const Doubles& cameras,
                     double source_z) {
  require_shape(points, "field_points", {-1, 2});
  SensorField field;
  field.cameras = to_vectors(cameras, "cameras");
  require_shape(seen, "field_seen", {points.shape(0), cameras.shape(0)});
  for (py::ssize_t i = 0; i < points.shape(0); ++i)
    field.points.emplace_back(points.at(i, 0), points.at(i, 1));
  field.seen.assign(seen.data(), seen.data() + seen.size());
  field.source_z = source_z;
  return field;
}

std::unique_ptr<PoseSearch> make_search(const Doubles& vertices, const py::object& faces,
                                        const Doubles& samples, const Doubles& normals,
                                        const Doubles& orientations, const Doubles& lowest, int azimuths,
                                        const Doubles& field_points, const Integers<std::uint8_t>& field_seen,
                                        const Doubles& cameras, double source_z, double incidence_limit,
                                        double position_step) {
  const MeshArrays mesh(vertices, faces);
  SurfaceSamples surface{to_vectors(samples, "samples"), to_vectors(normals, "normals")};
  SensorOrientations sensor_orientations = to_orientations(orientations, lowest, azimuths);
  SensorField field = to_field(field_points, field_seen, cameras, source_z);
  const py::gil_scoped_release release;
  return std::make_unique<PoseSearch>(mesh.view(), std::move(surface),
                                      PoseGrid(std::move(sensor_orientations), std::move(field)),
                                      incidence_limit, position_step);
}

py::tuple next_poses(PoseSearch& search, const Integers<std::int64_t>& samples, unsigned threads) {
  require_shape(samples, "samples", {-1});
  const std::vector<FoundPose> found = without_gil(
      [&] { return search.next(samples.data(), static_cast<std::size_t>(samples.size()), threads); });
  const auto count = static_cast<py::ssize_t>(found.size());
  py::array_t<std::int64_t> sample(count);
  py::array_t<std::int32_t> key({count, py::ssize_t{4}});
  py::array_t<double> positions({count, py::ssize_t{3}, py::ssize_t{3}});
  for (py::ssize_t i = 0; i < count; ++i) {
    const FoundPose& pose = found[static_cast<std::size_t>(i)];
    sample.mutable_at(i) = pose.sample;
    std::copy(pose.key.begin(), pose.key.end(), key.mutable_data(i, 0));
    Eigen::Map<Eigen::Vector3d>(positions.mutable_data(i, 0, 0)) = pose.sample_position;
    Eigen::Map<Eigen::Vector3d>(positions.mutable_data(i, 1, 0)) = pose.source_position;
    Eigen::Map<Eigen::Vector3d>(positions.mutable_data(i, 2, 0)) = pose.camera_position;
  }
  return py::make_tuple(sample, key, positions);
}

void skip_directions(PoseSearch& search, const Integers<std::int64_t>& samples) {
  require_shape(samples, "samples", {-1});
  search.skip_directions(samples.data(), static_cast<std::size_t>(samples.size()));
}

void record_reachability(PoseSearch& search, const Integers<std::int32_t>& keys,
                         const py::array_t<bool>& reached) {
  require_shape(keys, "keys", {-1, 4});
  require_shape(reached, "reached", {keys.shape(0)});
  for (py::ssize_t i = 0; i < keys.shape(0); ++i)
    search.record_reachability({keys.at(i, 0), keys.at(i, 1), keys.at(i, 2), keys.at(i, 3)}, reached.at(i));
}

py::array_t<bool> py_covered_samples(const Doubles& samples, const Doubles& normals, const Doubles& points,
                                     const std::optional<Doubles>& point_normals, double tolerance,
                                     double min_cosine) {
  require_shape(samples, "samples", {-1, 3});
  require_shape(normals, "normals", {samples.shape(0), 3});
  require_shape(points, "points", {-1, 3});
  if (point_normals.has_value()) require_shape(*point_normals, "point_normals", {points.shape(0), 3});
  const OrientedPoints surface{samples.data(), normals.data(), static_cast<std::size_t>(samples.shape(0))};
  const OrientedPoints cloud{points.data(), point_normals.has_value() ? point_normals->data() : nullptr,
                             static_cast<std::size_t>(points.shape(0))};
  const std::vector<std::uint8_t> covered =
      without_gil([&] { return covered_samples(surface, cloud, tolerance, min_cosine); });
  py::array_t<bool> result(samples.shape(0));
  std::copy(covered.begin(), covered.end(), result.mutable_data());
  return result;
}

}  // namespace

void bind_visibility(py::module_& module) {
  py::class_<PoseSearch>(module, "PoseSearch", py::module_local())
      .def(py::init(&make_search), py::arg("vertices"), py::arg("faces"), py::arg("samples"),
           py::arg("normals"), py::arg("orientations"), py::arg("lowest"), py::arg("azimuths"),
           py::arg("field_points"), py::arg("field_seen"), py::arg("cameras"), py::arg("source_z"),
           py::arg("incidence_limit"), py::arg("position_step"))
      .def("next", &next_poses, py::arg("samples"), py::arg("threads") = 0)
      .def("skip_directions", &skip_directions, py::arg("samples"))
      .def("record_reachability", &record_reachability, py::arg("keys"), py::arg("reached"));
  module.def("covered_samples", &py_covered_samples, py::arg("samples"), py::arg("normals"),
             py::arg("points"), py::arg("point_normals"), py::arg("tolerance"), py::arg("min_cosine"));
}

}  // namespace sensor_rt
