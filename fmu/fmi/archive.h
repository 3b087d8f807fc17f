// Serialization of a state. One function per structure lists its members for both directions, and for the
// fingerprint of their names and types.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "fmu/model/cell_layout.h"
#include "fmu/model/fields.h"

namespace robotcell::fmi {

constexpr double kRotationTolerance = 1e-6;
/// Bound of numbers that belong to moving bodies (SI units): beyond it the engine ends the process.
constexpr double kMaxMagnitude = 1e9;
constexpr double kNoLimit = std::numeric_limits<double>::max();

[[noreturn]] inline void reject_value() {
  throw std::invalid_argument("the serialized state holds an invalid value");
}

class Writer {
 public:
  static constexpr bool kReads = false;
  static constexpr bool kDescribes = false;

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
  static constexpr bool kDescribes = false;

  Reader(const std::uint8_t* bytes, std::size_t size) : next_(bytes), left_(size) {}

  template <class T>
  void raw(T& value) {
    static_assert(std::is_arithmetic_v<T>);
    if (left_ < sizeof value) throw std::invalid_argument("the serialized state is truncated");
    if constexpr (std::is_same_v<T, bool>) {
      if (*next_ > 1) reject_value();
    }
    std::memcpy(&value, next_, sizeof value);
    next_ += sizeof value;
    left_ -= sizeof value;
    if constexpr (std::is_same_v<T, double>) {
      if (!(std::abs(value) <= max_magnitude)) reject_value();
    }
  }

  std::size_t left() const { return left_; }

  double max_magnitude = kNoLimit;  // largest absolute value that is accepted

 private:
  const std::uint8_t* next_;
  std::size_t left_;
};

/// FNV-1a hash of the names and types of all members of a state, which tells layouts from each other.
class LayoutHash {
 public:
  static constexpr bool kReads = false;
  static constexpr bool kDescribes = true;

  template <class T>
  void raw(T& /*value*/) {
    static_assert(std::is_arithmetic_v<T>);
    feed(std::is_floating_point_v<T> ? 'f' : std::is_same_v<T, bool> ? 'b' : std::is_signed_v<T> ? 'i' : 'u');
    feed(static_cast<char>('0' + sizeof(T)));
  }

  void text(const char* characters) {
    while (*characters != '\0') feed(*characters++);
  }

  std::uint64_t value() const { return hash_; }

 private:
  void feed(char byte) { hash_ = (hash_ ^ static_cast<unsigned char>(byte)) * 0x100000001b3u; }

  std::uint64_t hash_ = 0xcbf29ce484222325u;
};

template <class Archive, class T>
std::enable_if_t<std::is_arithmetic_v<T>> exchange(Archive& archive, T& value) {
  archive.raw(value);
}

template <class Archive, class T, std::size_t N>
void exchange(Archive& archive, std::array<T, N>& values) {
  for (T& value : values) exchange(archive, value);
}

/// Serializes a number that may be infinite.
template <class Archive>
void exchange_unless_infinite(Archive& archive, double& value) {
  bool infinite = std::isinf(value);
  archive.raw(infinite);
  if (!infinite) return archive.raw(value);
  if constexpr (Archive::kReads) value = std::numeric_limits<double>::infinity();
}

/// Serializes an integer from 0 to `last`; others are rejected.
template <class Archive>
void exchange_up_to(Archive& archive, std::int32_t& number, std::int32_t last) {
  archive.raw(number);
  if constexpr (Archive::kDescribes) archive.text(std::to_string(last).c_str());
  if (Archive::kReads && (number < 0 || number > last)) reject_value();
}

/// Last member of an enumeration that begins at 0.
template <class T>
constexpr T kLast = static_cast<T>(enumeration_of<T>.count - 1);

/// Serializes an integer that holds a member of an enumeration.
template <class T, class Archive>
void exchange_choice(Archive& archive, std::int32_t& number) {
  exchange_up_to(archive, number, static_cast<std::int32_t>(kLast<T>));
}

template <class Archive, class T>
std::enable_if_t<std::is_enum_v<T>> exchange(Archive& archive, T& value) {
  static_assert(std::is_same_v<std::underlying_type_t<T>, std::int32_t>);
  auto number = static_cast<std::int32_t>(value);
  exchange_choice<T>(archive, number);
  if constexpr (Archive::kReads) value = static_cast<T>(number);  // writing must not change a shared state
}

template <class Archive, int N>
void exchange(Archive& archive, Eigen::Matrix<double, N, 1>& vector) {
  for (double& value : vector.reshaped()) archive.raw(value);
}

template <class Archive>
void exchange(Archive& archive, Eigen::Quaterniond& rotation) {
  for (double& value : rotation.coeffs().reshaped()) archive.raw(value);
  if (Archive::kReads && std::abs(rotation.norm() - 1) > kRotationTolerance) reject_value();
}

template <class Archive>
void exchange(Archive& archive, Eigen::Isometry3d& pose) {
  for (double& value : pose.matrix().reshaped()) archive.raw(value);
  const Eigen::Matrix3d rotation = pose.linear();
  const bool rigid = (rotation.transpose() * rotation).isIdentity(kRotationTolerance) &&
                     rotation.determinant() > 0 && pose.matrix().row(3) == Eigen::RowVector4d(0, 0, 0, 1);
  if (Archive::kReads && !rigid) reject_value();
}

/// Serializes the length of a sequence; rejected where the remaining bytes cannot hold it.
template <class Archive>
std::uint64_t exchange_length(Archive& archive, std::uint64_t length) {
  archive.raw(length);
  if constexpr (Archive::kReads) {
    if (length > archive.left()) throw std::invalid_argument("the serialized state is truncated");
  }
  return length;
}

/// Reads element by element, so that a wrong length cannot allocate more memory than there are bytes.
template <class Archive, class Container, class Element>
void exchange_sequence(Archive& archive, Container& values, const Element& empty) {
  if constexpr (Archive::kDescribes) {
    Element element = empty;
    archive.text("[");
    return exchange(archive, element);
  }
  const std::uint64_t length = exchange_length(archive, values.size());
  if constexpr (Archive::kReads) values.clear();
  for (std::uint64_t i = 0; i < length; ++i) {
    if constexpr (Archive::kReads) values.push_back(empty);
    exchange(archive, values[i]);
  }
}

template <class Archive, class T>
void exchange(Archive& archive, std::vector<T>& values) {
  exchange_sequence(archive, values, T());
}

/// An object that may be absent and never changes. Its bytes are written in full.
template <class Archive, class T>
void exchange(Archive& archive, std::shared_ptr<const T>& value) {
  bool present = Archive::kDescribes || value != nullptr;
  archive.raw(present);
  if constexpr (Archive::kReads) value.reset();
  if (!present) return;
  if constexpr (Archive::kReads || Archive::kDescribes) {
    const auto read = std::make_shared<T>();
    exchange(archive, *read);
    value = read;
  } else {
    exchange(archive, const_cast<T&>(*value));  // writing changes nothing
  }
}

/// The length is that of the layout; the bytes must agree.
template <class Archive, class T>
void exchange(Archive& archive, PerDevice<T>& values) {
  if constexpr (Archive::kDescribes) {
    T element{};
    archive.text("[");
    return exchange(archive, element);
  }
  if (exchange_length(archive, values.size()) != values.size()) {
    throw std::invalid_argument("the serialized state belongs to a cell with other devices");
  }
  for (T& value : values) exchange(archive, value);
}

template <class Archive>
void exchange(Archive& archive, std::string& text) {
  exchange_sequence(archive, text, char());
}

/// A member that is serialized by a function of its own.
template <class Function>
struct Special {
  Function function;
};
template <class T, class Function>
Special<Function> special(T& /*member*/, Function function) {
  return {std::move(function)};
}

/// An integer member from 0 to `last`.
template <class Archive>
auto up_to(Archive& archive, std::int32_t last, std::int32_t& number) {
  return special(number, [&archive, &number, last] { exchange_up_to(archive, number, last); });
}

/// A member whose numbers must not exceed `max_magnitude`.
template <class Archive, class T>
auto within(Archive& archive, double max_magnitude, T& value) {
  return special(value, [&archive, &value, max_magnitude] {
    [[maybe_unused]] double limit = max_magnitude;
    if constexpr (Archive::kReads) std::swap(archive.max_magnitude, limit);
    exchange(archive, value);
    if constexpr (Archive::kReads) std::swap(archive.max_magnitude, limit);
  });
}

template <class T>
constexpr bool kIsSpecial = false;
template <class Function>
constexpr bool kIsSpecial<Special<Function>> = true;

template <class Archive, class T>
void exchange_member(Archive& archive, T& value) {
  if constexpr (kIsSpecial<std::remove_const_t<T>>) {
    value.function();
  } else {
    exchange(archive, value);
  }
}

/// `names` are those of the members, for the fingerprint.
template <class Archive, class Structure, class... T>
void exchange_members(Archive& archive, Structure& structure, const char* names, T&&... members) {
  require_members<sizeof...(T)>(structure);
  if constexpr (Archive::kDescribes) archive.text(names);
  (exchange_member(archive, members), ...);
}

/// Serializes all members of a structure; does not compile where one is missing. Their names are part of the
/// fingerprint.
#define ROBOTCELL_EXCHANGE(archive, structure, ...) \
  ::robotcell::fmi::exchange_members(archive, structure, #__VA_ARGS__, __VA_ARGS__)

/// Visits the members that a structure declares (fields.h).
template <class Archive>
struct FieldArchive {
  Archive& archive;

  template <class Structure, class... T>
  void operator()(Structure& structure, const Declared<T>&... members) {
    require_members<sizeof...(T)>(structure);
    (visit(members), ...);
  }

 private:
  template <class T>
  void visit(const Declared<T>& member) {
    if constexpr (Archive::kDescribes) archive.text(member.field.name);
    if constexpr (std::is_same_v<T, std::int32_t>) {
      const Enumeration* enumeration = member.field.enumeration;
      if (enumeration != nullptr) return exchange_up_to(archive, member.value, enumeration->count - 1);
    }
    if (member.field.command) return within(archive, kNoLimit, member.value).function();
    exchange(archive, member.value);
  }
};

template <class Archive, class T>
auto exchange(Archive& archive, T& structure)
    -> decltype(T::declare(std::declval<FieldArchive<Archive>&>(), structure)) {
  FieldArchive<Archive> visit{archive};
  T::declare(visit, structure);
}

template <class Archive, class... T>
void exchange(Archive& archive, std::tuple<T...>& values) {
  std::apply([&archive](T&... value) { (exchange(archive, value), ...); }, values);
}

}  // namespace robotcell::fmi
