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
#include <string_view>

#include "fmu/control/enumeration.h"

namespace robotcell {

struct Unit {
  const char* name;            // "" for a dimensionless number
  const char* display;         // "" for none
  const char* quantity;        // name of the declared type; "" for none
  const char* base;            // exponents of the SI base units
  const char* display_factor;  // display unit per unit
};

constexpr const char* kDegrees = "57.29577951308232";
constexpr Unit kNone{"", "", "", "", ""};
constexpr Unit kSecond{"s", "ms", "Time", "s=\"1\"", "1000"};
constexpr Unit kMetre{"m", "mm", "Length", "m=\"1\"", "1000"};
constexpr Unit kRadian{"rad", "deg", "Angle", "rad=\"1\"", kDegrees};
constexpr Unit kNewton{"N", "N", "Force", "kg=\"1\" m=\"1\" s=\"-2\"", "1"};
constexpr Unit kMetrePerSecond{"m/s", "mm/s", "Velocity", "m=\"1\" s=\"-1\"", "1000"};
constexpr Unit kHertz{"Hz", "1/min", "Frequency", "s=\"-1\"", "60"};
constexpr Unit kNewtonMetre{"N.m", "N.cm", "Torque", "kg=\"1\" m=\"2\" s=\"-2\"", "100"};
constexpr Unit kRadianPerSecond{"rad/s", "deg/s", "AngularVelocity", "rad=\"1\" s=\"-1\"", kDegrees};
constexpr Unit kUnits[] = {kSecond,         kMetre, kRadian,      kNewton,
                           kMetrePerSecond, kHertz, kNewtonMetre, kRadianPerSecond};

enum class Variability { kFixed, kDiscrete, kContinuous };

constexpr double kUnbounded = std::numeric_limits<double>::infinity();

constexpr double kNoInstant = -1;  // time of something that has not happened yet

/// What the initial value of an output depends on.
enum class Initial { kNothing, kDescription, kEncoders };

/// Name of an element of an array, after that of the array, and what replaces {e} in the text.
///
/// In names and texts of elements {i} is the number of the element, {x} its letter x, y, z (or w, x, y, z of
/// a quaternion), {t} the number of the table, one more than that of the last joint, {a} the name of a
/// further axis, and {n} its number, counted on from the table. In an array of arrays {i} is the number of
/// the outer element, {k} and {x} are those of the inner one.
struct Element {
  const char* name;
  const char* text;
};

/// The joints, the table and the further axes.
constexpr Element kAxisElements[] = {
    {"q[{i}]", "joint {i}"}, {"table", "the rotary table, not wrapped"}, {"axis.{a}", "the axis {a}"}};

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
  const Element* elements = nullptr;         // of an array with an element for each axis: see with_axes
  bool distinct_joints = false;              // each joint has an element of its own
  bool axis_number = false;  // the number of an axis, counted from 1: the joints, then the table
  Initial initial = Initial::kNothing;
  bool command = false;  // a command, which is not bounded as the motion of bodies is
};

constexpr Field bounded(Field field, double min, double max = kUnbounded) {
  field.min = min;
  field.max = max;
  return field;
}

/// An array with an element for each axis, of which only those of the cell are variables. `elements`: for the
/// joints, the table and the further axes, or one for each possible joint, then for these.
template <std::size_t count>
constexpr Field with_axes(Field field, const Element (&elements)[count]) {
  field.elements = elements;
  field.distinct_joints = count > 3;
  return field;
}

/// The field of an axis that slides, in metres where that of a turning one is in radians.
constexpr Field sliding(Field field) {
  const std::string_view quantity = field.unit.quantity;
  if (quantity == kRadian.quantity) field.unit = kMetre;
  if (quantity == kRadianPerSecond.quantity) field.unit = kMetrePerSecond;
  return field;
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

/// The same for a command in the state of a moving body.
template <class T>
constexpr Declared<T> command_state(T& value, const char* name) {
  Field field{name};
  field.command = true;
  return {value, field};
}

/// Does not compile where a structure has not `count` members, none of them private.
template <std::size_t count, class Structure>
constexpr void require_members([[maybe_unused]] Structure& structure) {
  static_assert(count >= 1 && count <= 21, "add a line for this number of members");
  // clang-format off
  if constexpr (count == 1) { [[maybe_unused]] auto& [a] = structure; }
  else if constexpr (count == 2) { [[maybe_unused]] auto& [a, b] = structure; }
  else if constexpr (count == 3) { [[maybe_unused]] auto& [a, b, c] = structure; }
  else if constexpr (count == 4) { [[maybe_unused]] auto& [a, b, c, d] = structure; }
  else if constexpr (count == 5) { [[maybe_unused]] auto& [a, b, c, d, e] = structure; }
  else if constexpr (count == 6) { [[maybe_unused]] auto& [a, b, c, d, e, f] = structure; }
  else if constexpr (count == 7) { [[maybe_unused]] auto& [a, b, c, d, e, f, g] = structure; }
  else if constexpr (count == 8) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h] = structure; }
  else if constexpr (count == 9) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i] = structure; }
  else if constexpr (count == 10) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j] = structure; }
  else if constexpr (count == 11) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k] = structure; }
  else if constexpr (count == 12) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l] = structure; }
  else if constexpr (count == 13) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m] = structure; }
  else if constexpr (count == 14) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n] = structure; }
  else if constexpr (count == 15) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o] = structure; }
  else if constexpr (count == 16) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p] = structure; }
  else if constexpr (count == 17) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q] = structure; }
  else if constexpr (count == 18) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r] = structure; }
  else if constexpr (count == 19) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s] = structure; }
  else if constexpr (count == 20) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t] = structure; }
  else if constexpr (count == 21) { [[maybe_unused]] auto& [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t, u] = structure; }
  // clang-format on
}

}  // namespace robotcell
