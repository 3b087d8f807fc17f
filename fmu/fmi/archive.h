// Bytes of a state and back. One function per structure lists its members for both directions.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <cstring>
#include <deque>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace robotcell::fmi {

class Writer {
 public:
  static constexpr bool kReads = false;

  template <class T>
  void raw(T& value) {
    static_assert(std::is_arithmetic_v<T>);
    const auto* first = reinterpret_cast<const std::uint8_t*>(&value);
    bytes_.insert(bytes_.end(), first, first + sizeof value);
  }

  std::vector<std::uint8_t> take() { return std::move(bytes_); }

 private:
  std::vector<std::uint8_t> bytes_;
};

/// Throws std::invalid_argument where the bytes end too early.
class Reader {
 public:
  static constexpr bool kReads = true;

  Reader(const std::uint8_t* bytes, std::size_t size) : next_(bytes), left_(size) {}

  template <class T>
  void raw(T& value) {
    static_assert(std::is_arithmetic_v<T>);
    if (left_ < sizeof value) throw std::invalid_argument("the serialized state is cut off");
    if constexpr (std::is_same_v<T, bool>) {
      if (*next_ > 1) throw std::invalid_argument("the serialized state holds an impossible value");
    }
    std::memcpy(&value, next_, sizeof value);
    next_ += sizeof value;
    left_ -= sizeof value;
  }

  std::size_t left() const { return left_; }

 private:
  const std::uint8_t* next_;
  std::size_t left_;
};

template <class Archive, class T>
std::enable_if_t<std::is_arithmetic_v<T>> exchange(Archive& archive, T& value) {
  archive.raw(value);
}

template <class Archive, class T, std::size_t N>
void exchange(Archive& archive, std::array<T, N>& values) {
  for (T& value : values) exchange(archive, value);
}

template <class Archive>
void exchange(Archive& archive, Eigen::Vector3d& vector) {
  for (double& value : vector.reshaped()) archive.raw(value);
}

template <class Archive>
void exchange(Archive& archive, Eigen::Quaterniond& rotation) {
  for (double& value : rotation.coeffs().reshaped()) archive.raw(value);
}

template <class Archive>
void exchange(Archive& archive, Eigen::Isometry3d& pose) {
  for (double& value : pose.matrix().reshaped()) archive.raw(value);
}

/// Sizes are checked against what is left before memory is taken.
template <class Archive, class Container>
void exchange_sequence(Archive& archive, Container& values) {
  std::uint64_t size = values.size();
  archive.raw(size);
  if constexpr (Archive::kReads) {
    if (size > archive.left()) throw std::invalid_argument("the serialized state is cut off");
    values.resize(size);
  }
  for (auto& value : values) exchange(archive, value);
}

template <class Archive, class T>
void exchange(Archive& archive, std::deque<T>& values) {
  exchange_sequence(archive, values);
}

template <class Archive>
void exchange(Archive& archive, std::string& text) {
  exchange_sequence(archive, text);
}

template <class Archive, class... T>
void exchange_all(Archive& archive, T&... values) {
  (exchange(archive, values), ...);
}

}  // namespace robotcell::fmi
