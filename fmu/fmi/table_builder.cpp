#include "fmu/fmi/table_builder.h"

#include <cmath>
#include <iterator>
#include <string_view>

#include "fmu/model/description/value_limits.h"

namespace robotcell::fmi {
namespace {

constexpr std::array<const char*, 4> kQuaternionNames{"w", "x", "y", "z"};

}  // namespace

std::string indexed(const std::string& name, std::size_t index_from_0) {
  return name + "[" + std::to_string(index_from_0 + 1) + "]";
}

/// A text with the names of the device and of the element of an array, and the number of the table.
std::string FieldTable::with_names(std::string text, const Element& element,
                                   const ElementIndex& index) const {
  const std::string letters = index.inner_count == kQuaternionNames.size() ? "wxyz" : "xyz";
  const std::size_t further = index.outer >= kFirstFurtherAxis ? index.outer - kFirstFurtherAxis : 0;
  const std::string axis = further < table_.axes().size() ? table_.axes()[further].name : "";
  const std::string letter = index.inner < letters.size() ? letters.substr(index.inner, 1) : "";
  for (const auto& [place, name] : {std::pair<std::string, std::string>{"{}", device_},
                                    {"{e}", element.text},
                                    {"{i}", std::to_string(index.outer + 1)},
                                    {"{k}", std::to_string(index.inner + 1)},
                                    {"{x}", letter},
                                    {"{t}", std::to_string(table_.joints() + 1)},
                                    {"{a}", axis},
                                    {"{n}", std::to_string(table_.joints() + 2 + further)}}) {
    for (std::size_t at = text.find(place); at != std::string::npos;
         at = text.find(place, at + name.size())) {
      text.replace(at, place.size(), name);
    }
  }
  return text;
}

const Refs& FieldTable::initial_of(const Field& field) const {
  static const Refs nothing;
  if (field.initial == Initial::kDescription) return dependencies_.file;
  return field.initial == Initial::kEncoders ? dependencies_.measured : nothing;
}

void TableBuilder::enumerate(const Enumeration& enumeration) {
  Variable& variable = table_.back();
  variable.type = Type::kEnumeration;
  variable.enumeration = &enumeration;
  bound(0, enumeration.count - 1);
  for (std::int32_t i = 0; i < enumeration.count; ++i) {
    const EnumerationItem& item = enumeration.items[i];
    variable.description +=
        (i == 0 ? ": " : ", ") + std::to_string(i) + " " + item.name + " (" + item.text + ")";
  }
}

void TableBuilder::replace_angles() {
  std::string& text = table_.back().description;
  for (const auto& [angle, position] : {std::pair<std::string, std::string>{"angular velocity", "velocity"},
                                        {"Angle", "Position"},
                                        {"angle", "position"}}) {
    const std::size_t at = text.find(angle);
    if (at != std::string::npos) text.replace(at, angle.size(), position);
  }
}

std::vector<Variable> TableBuilder::clocked_variables() const {
  std::vector<Variable> clocked;
  std::copy_if(table_.begin(), table_.end(), std::back_inserter(clocked),
               [](const Variable& variable) { return variable.clocked; });
  return clocked;
}

void TableBuilder::add_array(Variable of, const std::string& name, void* value, std::uint32_t size) {
  of.name = name;
  of.description = "Of each of the last records: " + of.description;
  of.value = value;
  of.dimensions = {size};
  of.instant = false;
  table_.push_back(std::move(of));
}

std::vector<Variable> TableBuilder::take() {
  for (Variable& variable : table_) {
    const bool bounded = std::isfinite(variable.min) || std::isfinite(variable.max);
    if (bounded && is_clamped(variable)) {
      variable.description += ". A value out of range is clamped, with a warning";
    }
  }
  return std::move(table_);
}

void TableBuilder::bound(double min, double max) {
  table_.back().min = min;
  table_.back().max = max;
}

std::uint32_t TableBuilder::add_deviation(const std::string& name, Unit unit, const std::string& text,
                                          double& value) {
  const std::uint32_t reference = add("as_built." + name, Causality::kParameter, Variability::kFixed, unit,
                                      "Deviation as built from nominal: " + text, value);
  const std::string_view symbol = unit.name;
  if (symbol == kMetre.name) bound(-kMaxCoordinate, kMaxCoordinate);
  if (symbol == kRadian.name) bound(-kMaxAngle, kMaxAngle);
  if (symbol == kHertz.name) bound(0, kMaxFrequency);
  return reference;
}

void TableBuilder::add_body(const std::string& prefix, const std::string& what, const std::string& suffix,
                            Variability variability, BodyState& value, const PoseDependencies& dependencies) {
  const auto output = Causality::kOutput;
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".position", i), output, variability, kMetre,
        std::string("True position of ") + what + ": " + kAxisNames[i] + " of its origin, world frame" +
            suffix,
        value.position[i], dependencies.position);
  }
  for (std::size_t i = 0; i < 4; ++i) {
    add(indexed(prefix + ".orientation", i), output, variability, kNone,
        "True orientation of " + what + ": " + kQuaternionNames[i] +
            " of the unit quaternion world_from_body with w >= 0" + suffix,
        value.orientation[i], dependencies.orientation);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".velocity", i), output, variability, kMetrePerSecond,
        "True velocity of the origin of " + what + ": " + kAxisNames[i] + " component, world frame" + suffix,
        value.velocity[i], dependencies.velocity);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".angular_velocity", i), output, variability, kRadianPerSecond,
        "True angular velocity of " + what + ": " + kAxisNames[i] + " component, world frame" + suffix,
        value.angular_velocity[i]);
  }
}

void TableBuilder::add_bodies(const std::string& prefix, const std::string& suffix, Variability variability,
                              Bodies& value, const BodiesDependencies& dependencies) {
  for (std::size_t i = 0; i < value.links.size(); ++i) {
    add_body(indexed(prefix + "link", i), "link " + std::to_string(i + 1), suffix, variability,
             value.links[i], dependencies.links[i]);
  }
  for (std::size_t i = 0; i < value.axes.size(); ++i) {
    add_body(prefix + "axis_frame." + axes_[i].name, "what the axis " + axes_[i].name + " carries", suffix,
             variability, value.axes[i], dependencies.axes[i]);
  }
  add_body(prefix + "sensor", "the sensor", suffix, variability, value.sensor, dependencies.sensor);
  add_body(prefix + "table", "the table's platter", suffix, variability, value.table, dependencies.table);
  for (std::size_t i = 0; i < value.parts.size(); ++i) {
    add_body(indexed(prefix + "part", i), "part " + std::to_string(i + 1), suffix, variability,
             value.parts[i], dependencies.parts[i]);
  }
  for (std::size_t i = 0; i < value.fingers.size(); ++i) {
    add_body(indexed(prefix + "finger", i), "finger " + std::to_string(i + 1) + " of the gripper", suffix,
             variability, value.fingers[i], dependencies.fingers[i]);
  }
  for (std::size_t i = 0; i < value.further_sensors.size(); ++i) {
    const std::string number = std::to_string(i + 2);
    add_body(prefix + "sensor[" + number + "]", "sensor " + number, suffix, variability,
             value.further_sensors[i], dependencies.further_sensors[i]);
  }
}

}  // namespace robotcell::fmi
