// Declaration of a structure's members, once: the variable table, both model descriptions, the documentation,
// serialized states and their checks are made from it.
//
// A structure has a static function template `declare`, which passes the structure and all its members to a
// visitor in one call:
//
//   template <class Visitor>
//   static void declare(Visitor& visit, BeltReading& belt) {
//     visit(belt, field(belt.speed, {"speed", kMetrePerSecond, "Speed of {}"}));
//   }
//
// A visitor that misses a member does not compile.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <utility>

#include "fmu/control/enumeration.h"

namespace robotcell {

struct Unit {
  const char* name;      // "" for a dimensionless number
  const char* display;   // "" for none
  const char* quantity;  // name of the declared type; "" for none
};

constexpr Unit kNone{"", "", ""};
constexpr Unit kSecond{"s", "ms", "Time"};
constexpr Unit kMetre{"m", "mm", "Length"};
constexpr Unit kRadian{"rad", "deg", "Angle"};
constexpr Unit kNewton{"N", "N", "Force"};
constexpr Unit kMetrePerSecond{"m/s", "mm/s", "Velocity"};
constexpr Unit kNewtonMetre{"N.m", "N.cm", "Torque"};
constexpr Unit kHertz{"Hz", "1/min", "Frequency"};
constexpr Unit kRadianPerSecond{"rad/s", "deg/s", "AngularVelocity"};

enum class Variability { kFixed, kDiscrete, kContinuous };

constexpr double kUnbounded = std::numeric_limits<double>::infinity();

constexpr double kNoInstant = -1;  // time of something that has not happened yet

/// What the initial value of an output depends on.
enum class Initial { kNothing, kDescription, kEncoders };

/// Name of an element of an array, after that of the array, and what replaces {e} in the text.
struct Element {
  const char* name;
  const char* text;
};

/// Properties of a member.
struct Field {
  const char* name;  // after the name of the device
  Unit unit = kNone;
  const char* text = nullptr;  // of the variable, with {} for the name of the device; null: state only
  double min = -kUnbounded;    // bounds of a number
  double max = kUnbounded;
  Variability variability = Variability::kDiscrete;
  bool instant = false;  // a simulation time, counted from the start; kNoInstant: none yet
  const Enumeration* enumeration = nullptr;  // whose member an integer holds
  const Element* elements = nullptr;         // of an array, one for each element
  bool per_axis = false;     // an array with an element for each axis; only those of the cell are variables
  bool axis_number = false;  // the number of an axis, counted from 1: the joints, then the table
  Initial initial = Initial::kNothing;
};

constexpr Field bounded(Field field, double min, double max = kUnbounded) {
  field.min = min;
  field.max = max;
  return field;
}

constexpr Field with_elements(Field field, const Element* elements) {
  field.elements = elements;
  return field;
}

/// One element for each axis, the places of all possible joints included. {t} in names and texts is the
/// number of the table, one more than that of the last joint.
constexpr Field with_axes(Field field, const Element* elements) {
  field.per_axis = true;
  return with_elements(field, elements);
}

constexpr Field axis_number(Field field) {
  field.axis_number = true;
  return bounded(field, 0);
}

constexpr Field continuous(Field field) {
  field.variability = Variability::kContinuous;
  return field;
}

constexpr Field initially(Initial initial, Field field) {
  field.initial = initial;
  return field;
}

/// An instant; in outputs it includes the start time of the simulation.
constexpr Field instant(const char* name, const char* text) {
  Field field{name, kSecond, text};
  field.instant = true;
  return field;
}

/// A member and its properties.
template <class T>
struct Declared {
  T& value;
  Field field;
};

template <class T>
constexpr Declared<T> field(T& value, const Field& properties) {
  return {value, properties};
}

/// An integer that holds a member of an enumeration.
template <class T>
constexpr Declared<std::int32_t> choice_field(std::int32_t& value, Field properties) {
  properties.enumeration = &enumeration_of<T>;
  properties.min = 0;
  properties.max = enumeration_of<T>.count - 1;
  return {value, properties};
}

/// A member of which only the state is kept.
template <class T>
constexpr Declared<T> state(T& value, const char* name) {
  return {value, Field{name}};
}

/// Converts to anything, to count the members of an aggregate.
struct AnyMember {
  template <class T>
  operator T() const;
};

template <class T, class Indices, class = void>
struct HasMemberCount : std::false_type {};
template <class T, std::size_t... I>
struct HasMemberCount<T, std::index_sequence<I...>, std::void_t<decltype(T{((void)I, AnyMember())...})>>
    : std::true_type {};

/// Size of a structure with these members in this order.
template <class... Members>
constexpr std::size_t size_with_members() {
  std::size_t end = 0;
  std::size_t alignment = 1;
  const auto add = [&](std::size_t size, std::size_t align) {
    end = (end + align - 1) / align * align + size;
    alignment = align > alignment ? align : alignment;
  };
  (add(sizeof(Members), alignof(Members)), ...);
  return (end + alignment - 1) / alignment * alignment;
}

/// Whether a list of members is complete: by their number in an aggregate, else by the size of the structure,
/// for which they must be in the order of their declaration.
template <class Structure, class... Members>
constexpr bool has_all_members() {
  constexpr std::size_t count = sizeof...(Members);
  if constexpr (std::is_aggregate_v<Structure>) {
    return HasMemberCount<Structure, std::make_index_sequence<count>>::value &&
           !HasMemberCount<Structure, std::make_index_sequence<count + 1>>::value;
  } else {
    return size_with_members<Members...>() == sizeof(Structure);
  }
}

}  // namespace robotcell
