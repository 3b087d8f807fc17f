// Checked arrays of the Python bindings.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace robotcell::proximity {

namespace py = pybind11;

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Integers = py::array_t<long long, py::array::c_style | py::array::forcecast>;

inline std::string shape_text(const py::array& array) {
  std::string text = "(";
  for (py::ssize_t k = 0; k < array.ndim(); ++k) text += (k > 0 ? ", " : "") + std::to_string(array.shape(k));
  return text + ")";
}

/// Throws std::invalid_argument unless an array has `shape`; -1 accepts any length.
inline void require_shape(const py::array& array, const std::string& name,
                          const std::vector<py::ssize_t>& shape) {
  bool fits = array.ndim() == static_cast<py::ssize_t>(shape.size());
  std::string expected;
  for (std::size_t k = 0; k < shape.size(); ++k) {
    fits = fits && (shape[k] < 0 || array.shape(static_cast<py::ssize_t>(k)) == shape[k]);
    expected += (k > 0 ? ", " : "") + (shape[k] < 0 ? std::string("n") : std::to_string(shape[k]));
  }
  if (!fits) {
    throw std::invalid_argument(name + ": expected shape (" + expected + "), got " + shape_text(array));
  }
}

/// Array of whole numbers; a list may be empty.
inline Integers to_integers(const py::object& values, const std::string& name) {
  const py::array array = py::array::ensure(values);
  if (!array) throw std::invalid_argument(name + ": expected an array of integers");
  const char kind = array.dtype().kind();
  if (kind != 'i' && kind != 'u' && array.size() > 0)
    throw std::invalid_argument(name + ": expected integers");
  return Integers::ensure(array);
}

inline std::vector<std::pair<std::size_t, std::size_t>> to_pairs(const py::object& values) {
  const Integers numbers = to_integers(values, "pairs");
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  if (numbers.size() == 0) return pairs;
  require_shape(numbers, "pairs", {-1, 2});
  for (py::ssize_t i = 0; i < numbers.shape(0); ++i) {
    if (numbers.at(i, 0) < 0 || numbers.at(i, 1) < 0) {
      throw std::invalid_argument("pairs: expected numbers of bodies, got a negative one at pair " +
                                  std::to_string(i));
    }
    pairs.emplace_back(numbers.at(i, 0), numbers.at(i, 1));
  }
  return pairs;
}

}  // namespace robotcell::proximity
