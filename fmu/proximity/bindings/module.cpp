// Python bindings of PairDistances: arrays in, arrays out, checked.
#include <pybind11/stl.h>

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "fmu/proximity/bindings/arrays.h"
#include "fmu/proximity/bindings/motion_bindings.h"
#include "fmu/proximity/pair_distances.h"

namespace py = pybind11;

namespace robotcell::proximity {
namespace {

TriangleMesh to_mesh(const Doubles& vertices, const py::object& faces, std::size_t number) {
  const std::string name = "meshes[" + std::to_string(number) + "]";
  require_shape(vertices, name + " vertices", {-1, 3});
  const Integers corners = to_integers(faces, name + " faces");
  require_shape(corners, name + " faces", {-1, 3});
  TriangleMesh mesh;
  for (py::ssize_t i = 0; i < vertices.shape(0); ++i) {
    mesh.vertices.emplace_back(vertices.at(i, 0), vertices.at(i, 1), vertices.at(i, 2));
    if (!mesh.vertices.back().allFinite()) {
      throw std::invalid_argument(name + ": vertex " + std::to_string(i) + " is not finite");
    }
  }
  for (py::ssize_t i = 0; i < corners.shape(0); ++i) {
    std::array<int, 3> face{};
    for (std::size_t k = 0; k < 3; ++k) {
      const long long vertex = corners.at(i, static_cast<py::ssize_t>(k));
      if (vertex < 0 || vertex >= vertices.shape(0)) {
        throw std::invalid_argument(name + ": face " + std::to_string(i) + " names vertex " +
                                    std::to_string(vertex) + " of " + std::to_string(vertices.shape(0)));
      }
      face[k] = static_cast<int>(vertex);
    }
    mesh.faces.push_back(face);
  }
  return mesh;
}

bool is_rigid(const double* row_major) {
  using RowMajor = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  const Eigen::Map<const RowMajor> pose(row_major);
  const Eigen::Matrix3d rotation = pose.topLeftCorner<3, 3>();
  return pose.allFinite() && pose.row(3) == Eigen::RowVector4d(0, 0, 0, 1) &&
         (rotation.transpose() * rotation).isIdentity(1e-6) && rotation.determinant() > 0;
}

PoseBatch to_poses(const PairDistances& scene, const Doubles& poses) {
  const auto bodies = static_cast<py::ssize_t>(scene.bodies());
  require_shape(poses, "poses", {-1, bodies, 4, 4});
  for (py::ssize_t i = 0; i < poses.shape(0) * bodies; ++i) {
    if (is_rigid(poses.data() + 16 * i)) continue;
    throw std::invalid_argument("poses[" + std::to_string(i / bodies) + ", " + std::to_string(i % bodies) +
                                "]: expected a rigid transform (finite, orthonormal, right-handed)");
  }
  return {poses.data(), static_cast<std::size_t>(poses.shape(0))};
}

/// Bounds (count, pairs) from one number, one for each pair, or one for each pair and pose.
std::vector<double> to_bounds(const PairDistances& scene, const PoseBatch& poses, const Doubles& bound) {
  const auto pairs = static_cast<py::ssize_t>(scene.pairs());
  const auto count = static_cast<py::ssize_t>(poses.count);
  const bool per_pair = bound.ndim() == 1 && bound.shape(0) == pairs;
  const bool per_pose = bound.ndim() == 2 && bound.shape(0) == count && bound.shape(1) == pairs;
  if (bound.ndim() != 0 && !per_pair && !per_pose) {
    throw std::invalid_argument("bound: expected a number, shape (" + std::to_string(pairs) + ") or (" +
                                std::to_string(count) + ", " + std::to_string(pairs) + "), got " +
                                shape_text(bound));
  }
  for (py::ssize_t i = 0; i < bound.size(); ++i) {
    if (!(bound.data()[i] >= 0)) throw std::invalid_argument("bound: expected distances >= 0");
  }
  std::vector<double> bounds(poses.count * scene.pairs());
  for (std::size_t i = 0; i < bounds.size(); ++i) {
    bounds[i] = bound.ndim() == 0 ? *bound.data() : bound.data()[i % static_cast<std::size_t>(bound.size())];
  }
  return bounds;
}

std::unique_ptr<PairDistances> make_scene(const std::vector<std::pair<Doubles, py::object>>& meshes,
                                          const py::object& pairs) {
  std::vector<TriangleMesh> converted;
  for (const auto& [vertices, faces] : meshes)
    converted.push_back(to_mesh(vertices, faces, converted.size()));
  std::vector<PairDistances::Pair> numbers = to_pairs(pairs);
  const py::gil_scoped_release release;
  return std::make_unique<PairDistances>(std::move(converted), std::move(numbers));
}

py::array_t<double> distances(const PairDistances& scene, const Doubles& poses, const Doubles& bound,
                              unsigned threads) {
  const PoseBatch batch = to_poses(scene, poses);
  const std::vector<double> bounds = to_bounds(scene, batch, bound);
  py::array_t<double> result({poses.shape(0), static_cast<py::ssize_t>(scene.pairs())});
  double* values = result.mutable_data();
  const py::gil_scoped_release release;
  scene.distances(batch, bounds.data(), threads, values);
  return result;
}

py::tuple closest_points(const PairDistances& scene, const Doubles& poses, const Doubles& bound,
                         unsigned threads) {
  const PoseBatch batch = to_poses(scene, poses);
  const std::vector<double> bounds = to_bounds(scene, batch, bound);
  const auto pairs = static_cast<py::ssize_t>(scene.pairs());
  py::array_t<double> result({poses.shape(0), pairs});
  py::array_t<double> points({poses.shape(0), pairs, py::ssize_t{2}, py::ssize_t{3}});
  double* values = result.mutable_data();
  double* coordinates = points.mutable_data();
  {
    const py::gil_scoped_release release;
    scene.distances(batch, bounds.data(), threads, values, coordinates);
  }
  return py::make_tuple(result, points);
}

py::array_t<bool> collisions(const PairDistances& scene, const Doubles& poses, unsigned threads) {
  const PoseBatch batch = to_poses(scene, poses);
  py::array_t<bool> result({poses.shape(0), static_cast<py::ssize_t>(scene.pairs())});
  bool* values = result.mutable_data();
  const py::gil_scoped_release release;
  scene.collisions(batch, threads, values);
  return result;
}

}  // namespace

PYBIND11_MODULE(_native, module) {
  module.doc() = "Distances between rigid bodies with triangle meshes. SI units, float64.";
  py::class_<PairDistances>(module, "PairDistances", py::module_local())
      .def(py::init(&make_scene), py::arg("meshes"), py::arg("pairs"))
      .def(
          "with_pairs",
          [](const PairDistances& scene, const py::object& pairs) {
            return std::make_unique<PairDistances>(scene, to_pairs(pairs));
          },
          py::arg("pairs"))
      .def("distances", &distances, py::arg("poses"), py::arg("bound"), py::arg("threads") = 0)
      .def("closest_points", &closest_points, py::arg("poses"), py::arg("bound"), py::arg("threads") = 0)
      .def("collisions", &collisions, py::arg("poses"), py::arg("threads") = 0);
  bind_motion(module);
}

}  // namespace robotcell::proximity
