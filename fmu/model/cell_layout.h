// What determines the variables of a cell: the number of devices of each kind, and the dependencies of
// initial values.
#pragma once

#include <algorithm>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace robotcell {

struct PartLayout {
  bool on_table = true;  // starts on the rotary table, so its initial pose depends on the table as built
};

/// Derived from a description; equal layouts have the same variable table.
struct CellLayout {
  std::vector<PartLayout> parts;
  std::size_t conveyors = 0;
  bool gripper = false;
  std::size_t presence_sensors = 0;
  std::size_t distance_sensors = 0;
  bool collision_outputs = false;
  std::vector<std::string> bodies;  // names of the bodies that collision outputs refer to by number
  bool dynamic_drives = false;
};

/// Difference between two layouts as text, for example "2 parts instead of 1"; empty where they are equal.
std::string difference(const CellLayout& layout, const CellLayout& expected);

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
