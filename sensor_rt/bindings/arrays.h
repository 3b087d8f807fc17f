// Conversion between NumPy arrays and the types of the libraries.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/material.h"
#include "sensor_rt/scene/mesh_shape.h"

namespace sensor_rt {

/// Contiguous arrays, converted if necessary. forcecast also accepts integers where floats are expected.
using Doubles = pybind11::array_t<double, pybind11::array::c_style | pybind11::array::forcecast>;

template <typename T>
using Integers = pybind11::array_t<T, pybind11::array::c_style | pybind11::array::forcecast>;

/// Returns the result of call(), which runs without the GIL.
template <typename Call>
auto without_gil(const Call& call) {
  const pybind11::gil_scoped_release release;
  return call();
}

/// Returns the shape as text such as "(3, 4)".
std::string shape_text(const pybind11::array& array);

/// Throws std::invalid_argument unless the array has the given shape; -1 accepts any length.
void require_shape(const pybind11::array& array, const char* name,
                   const std::vector<pybind11::ssize_t>& shape);

/// Returns a pose from 16 row-major values. Throws std::invalid_argument unless it is finite and rigid
/// (orthonormal to 1e-6, right-handed, last row 0 0 0 1).
Rigid3 to_pose(const double* matrix, const char* name);

/// Returns a pose from an array of shape (4, 4).
Rigid3 to_pose(const Doubles& matrix, const char* name);

Eigen::Vector3d to_vector3(const Doubles& values, const char* name);

/// Converts a Material, or a number: the reflectance of a Lambertian surface.
Material to_material(const pybind11::object& value);

/// Mesh from vertices (n, 3) and faces (m, 3) of any integer type; owns converted copies.
class MeshArrays {
 public:
  MeshArrays(const Doubles& vertices, const pybind11::object& faces);
  MeshView view() const;

 private:
  Doubles vertices_;
  std::vector<std::uint32_t> faces_;
};

/// Returns an array that takes ownership of the values without copying.
template <typename T, typename Allocator>
pybind11::array_t<T> to_array(std::vector<T, Allocator>&& values, std::vector<pybind11::ssize_t> shape) {
  auto owner = std::make_unique<std::vector<T, Allocator>>(std::move(values));
  const T* data = owner->data();
  pybind11::capsule capsule(owner.get(), [](void* p) { delete static_cast<std::vector<T, Allocator>*>(p); });
  owner.release();
  return pybind11::array_t<T>(std::move(shape), data, capsule);
}

}  // namespace sensor_rt
