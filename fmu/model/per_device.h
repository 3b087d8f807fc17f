// Values of all devices of a kind.
#pragma once

#include <algorithm>
#include <cstddef>
#include <stdexcept>
#include <vector>

namespace robotcell {

/// One T for each device of a kind. Its length is fixed, because variables point to its elements.
template <class T>
class PerDevice {
 public:
  PerDevice() = default;
  explicit PerDevice(std::size_t count, const T& value = T()) : elements_(count, value) {}
  PerDevice(const PerDevice&) = default;
  ~PerDevice() = default;

  /// Copies element by element, so that the addresses of the elements stay valid after a move, too.
  PerDevice& operator=(const PerDevice& other) {
    if (other.size() != size()) throw std::logic_error("values of another layout of the cell");
    std::copy(other.begin(), other.end(), begin());
    return *this;
  }

  std::size_t size() const { return elements_.size(); }
  T& operator[](std::size_t i) { return elements_[i]; }
  const T& operator[](std::size_t i) const { return elements_[i]; }
  auto begin() { return elements_.begin(); }
  auto end() { return elements_.end(); }
  auto begin() const { return elements_.begin(); }
  auto end() const { return elements_.end(); }

 private:
  std::vector<T> elements_;
};

}  // namespace robotcell
