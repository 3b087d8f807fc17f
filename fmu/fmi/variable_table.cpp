#include "fmu/fmi/variable_table.h"

#include <cstdio>
#include <iomanip>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

VariableTable::VariableTable(const CellLayout& layout, Values& values) {
  TableBuilder table(layout.joints.size());
  table.add("time", Causality::kIndependent, Variability::kContinuous, kSecond, "Simulation time",
            values.time);
  const Dependencies dependencies = add_parameters(table, layout, values.parameters);
  add_commands(table, values.inputs);
  add_outputs(table, values.outputs, dependencies);
  if (layout.dynamic_drives) add_motor_torques(table, values.outputs, dependencies);
  add_conveyors(table, values.inputs, values.outputs);
  if (layout.gripper) add_gripper(table, values.inputs.gripper, values.outputs.gripper, dependencies);
  add_sensing(table, layout, values.outputs, dependencies);
  *this = VariableTable(table.take());
}

VariableTable::VariableTable(std::vector<Variable> variables) : variables_(std::move(variables)) {
  for (const Variable& variable : variables_) {
    if (variable.instant) instants_.push_back(&member<double>(variable));
  }
}

const Variable& VariableTable::at(std::uint32_t reference) const {
  if (reference >= variables_.size()) {
    throw std::invalid_argument("unknown value reference " + std::to_string(reference));
  }
  return variables_[reference];
}

void VariableTable::use_integers() {
  for (Variable& variable : variables_) {
    if (variable.type == Type::kEnumeration) variable.type = Type::kInteger;
  }
}

/// FNV-1a hash of order, names, types and causalities.
std::string VariableTable::token(bool arrays) const {
  std::uint64_t low = 0xcbf29ce484222325u;
  std::uint64_t high = 0x84222325cbf29ce4u;
  const auto feed = [&low, &high](unsigned char byte) {
    low = (low ^ byte) * 0x100000001b3u;
    high = (high ^ (low >> 32)) * 0x100000001b3u;
  };
  for (const Variable& variable : variables_) {
    for (const char c : variable.name) feed(static_cast<unsigned char>(c));
    feed(static_cast<unsigned char>(variable.type));
    feed(static_cast<unsigned char>(variable.causality));
  }
  if (arrays) feed(1);
  char text[40];
  std::snprintf(text, sizeof text, "{%08x-%04x-%04x-%04x-%012llx}", static_cast<unsigned>(high >> 32),
                static_cast<unsigned>(high >> 16 & 0xffff), static_cast<unsigned>(high & 0xffff),
                static_cast<unsigned>(low >> 48), static_cast<unsigned long long>(low & 0xffffffffffffu));
  return text;
}

std::string out_of_range(const Variable& variable, double value) {
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text << variable.name << " must be from " << variable.min << " to " << variable.max << " "
       << variable.unit.name << (*variable.unit.name == '\0' ? "" : ", ") << "not " << std::setprecision(17)
       << value;
  return text.str();
}

}  // namespace robotcell::fmi
