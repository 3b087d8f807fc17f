#include "sensor_rt/bindings/arrays.h"

#include <cmath>
#include <limits>
#include <stdexcept>

namespace py = pybind11;

namespace sensor_rt {

std::string shape_text(const py::array& array) {
  std::string text = "(";
  for (py::ssize_t k = 0; k < array.ndim(); ++k) text += (k > 0 ? ", " : "") + std::to_string(array.shape(k));
  return text + ")";
}

void require_shape(const py::array& array, const char* name, const std::vector<py::ssize_t>& shape) {
  bool fits = array.ndim() == static_cast<py::ssize_t>(shape.size());
  std::string expected;
  for (std::size_t k = 0; k < shape.size(); ++k) {
    fits = fits && (shape[k] < 0 || array.shape(static_cast<py::ssize_t>(k)) == shape[k]);
    expected += (k > 0 ? ", " : "") + (shape[k] < 0 ? std::string("n") : std::to_string(shape[k]));
  }
  if (!fits) {
    throw std::invalid_argument(std::string(name) + ": expected shape (" + expected + "), got " +
                                shape_text(array));
  }
}

Rigid3 to_pose(const double* matrix, const char* name) {
  using RowMajor = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  const Eigen::Map<const RowMajor> m(matrix);
  Rigid3 pose;
  pose.rotation = m.topLeftCorner<3, 3>();
  pose.translation = m.topRightCorner<3, 1>();
  const bool rigid = m.allFinite() && m.row(3) == Eigen::RowVector4d(0, 0, 0, 1) &&
                     (pose.rotation.transpose() * pose.rotation).isIdentity(1e-6) &&
                     pose.rotation.determinant() > 0.0;
  if (!rigid)
    throw std::invalid_argument(std::string(name) +
                                ": not a rigid transform (finite, orthonormal, right-handed)");
  return pose;
}

Rigid3 to_pose(const Doubles& matrix, const char* name) {
  require_shape(matrix, name, {4, 4});
  return to_pose(matrix.data(), name);
}

Eigen::Vector3d to_vector3(const Doubles& values, const char* name) {
  require_shape(values, name, {3});
  return {values.at(0), values.at(1), values.at(2)};
}

MeshArrays::MeshArrays(const Doubles& vertices, const py::object& face_indices) : vertices_(vertices) {
  const py::array faces = py::array::ensure(face_indices);
  if (!faces) throw std::invalid_argument("faces: expected an array of integers");
  require_shape(vertices, "vertices", {-1, 3});
  require_shape(faces, "faces", {-1, 3});
  const char kind = faces.dtype().kind();
  if (kind != 'i' && kind != 'u') throw std::invalid_argument("faces: expected integers");
  const auto wide = py::array_t<long long, py::array::c_style | py::array::forcecast>::ensure(faces);
  faces_.reserve(static_cast<std::size_t>(wide.size()));
  for (py::ssize_t i = 0; i < wide.size(); ++i) {
    const long long index = wide.data()[i];
    if (index < 0 || index >= vertices.shape(0)) {
      throw std::invalid_argument("face " + std::to_string(i / 3) + " names vertex " + std::to_string(index) +
                                  " of " + std::to_string(vertices.shape(0)));
    }
    faces_.push_back(static_cast<std::uint32_t>(index));
  }
}

MeshView MeshArrays::view() const {
  return {vertices_.data(), static_cast<std::size_t>(vertices_.shape(0)), faces_.data(), faces_.size() / 3};
}

}  // namespace sensor_rt
