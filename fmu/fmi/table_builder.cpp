#include "fmu/fmi/table_builder.h"

namespace robotcell::fmi {
namespace {

constexpr std::array<const char*, 4> kQuaternionNames{"w", "x", "y", "z"};

}  // namespace

std::string indexed(const std::string& name, std::size_t index_from_0) {
  return name + "[" + std::to_string(index_from_0 + 1) + "]";
}

void TableBuilder::limit_integer(std::int32_t min, std::int32_t max) {
  table_.back().min = min;
  table_.back().max = max;
}

std::uint32_t TableBuilder::add_deviation(const std::string& name, Unit unit, const std::string& text,
                                          double& where) {
  return add("as_built." + name, Causality::kParameter, Variability::kFixed, unit,
             "Deviation of the cell as built from its description: " + text, where);
}

void TableBuilder::add_measurement(const std::string& prefix, const std::string& when, Measurement& where,
                                   const Refs& position_dependencies) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  for (std::size_t i = 0; i < kJoints; ++i) {
    add(indexed(prefix + "q", i), output, discrete, kRadian,
        "Angle of joint " + std::to_string(i + 1) + " as its encoder reads it" + when, where.position[i],
        position_dependencies);
  }
  for (std::size_t i = 0; i < kJoints; ++i) {
    add(indexed(prefix + "qd", i), output, discrete, kRadianPerSecond,
        "Rate of joint " + std::to_string(i + 1) + " as its drive reports it" + when, where.rate[i]);
  }
  add(prefix + "table", output, discrete, kRadian,
      "Angle of the table as its encoder reads it, not wrapped" + when, where.position[kTableAxis],
      position_dependencies);
  add(prefix + "table_rate", output, discrete, kRadianPerSecond,
      "Rate of the table as its drive reports it" + when, where.rate[kTableAxis]);
}

void TableBuilder::add_body(const std::string& prefix, const std::string& what, const std::string& when,
                            Variability variability, BodyState& where, const PoseDependencies& dependencies) {
  const auto output = Causality::kOutput;
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".position", i), output, variability, kMetre,
        std::string("True ") + kAxisNames[i] + " of the origin of " + what + " in the world" + when,
        where.position[i], dependencies.position);
  }
  for (std::size_t i = 0; i < 4; ++i) {
    add(indexed(prefix + ".orientation", i), output, variability, kNone,
        "True orientation of " + what + " in the world, " + kQuaternionNames[i] +
            " of the unit quaternion with w >= 0" + when,
        where.orientation[i], dependencies.orientation);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".velocity", i), output, variability, kMetrePerSecond,
        "True velocity of the origin of " + what + " along the world's " + kAxisNames[i] + when,
        where.velocity[i], dependencies.velocity);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".angular_velocity", i), output, variability, kRadianPerSecond,
        "True angular velocity of " + what + " about the world's " + kAxisNames[i] + when,
        where.angular_velocity[i]);
  }
}

void TableBuilder::add_bodies(const std::string& prefix, const std::string& when, Variability variability,
                              Bodies& where, const BodiesDependencies& dependencies) {
  for (std::size_t i = 0; i < kJoints; ++i) {
    add_body(indexed(prefix + "link", i), "link " + std::to_string(i + 1), when, variability, where.links[i],
             dependencies.links[i]);
  }
  add_body(prefix + "sensor", "the sensor", when, variability, where.sensor, dependencies.sensor);
  add_body(prefix + "table", "the table's platter", when, variability, where.table, dependencies.table);
  for (std::size_t i = 0; i < where.parts.size(); ++i) {
    add_body(indexed(prefix + "part", i), "part " + std::to_string(i + 1), when, variability, where.parts[i],
             dependencies.parts[i]);
  }
  for (std::size_t i = 0; i < where.fingers.size(); ++i) {
    add_body(indexed(prefix + "finger", i), "finger " + std::to_string(i + 1) + " of the gripper", when,
             variability, where.fingers[i], dependencies.fingers[i]);
  }
}

}  // namespace robotcell::fmi
