#include "fmu/fmi/variable_table.h"

#include <algorithm>
#include <cstdio>
#include <iomanip>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

std::size_t scalars_of(const Variable& variable) {
  std::size_t count = 1;
  for (const std::uint32_t size : variable.dimensions) count *= size;
  return count;
}

std::vector<TableOptions> table_options(int version) {
  const auto ahead = version == 2 ? PathAheadVariables::kScalars : PathAheadVariables::kArray;
  if (version == 2) return {{ahead, false}};
  return {{ahead, false}, {PathAheadVariables::kNone, true}, {ahead, true}};
}

RecordColumn::RecordColumn(const Variable& variable) : source(variable.value) {
  if (variable.type == Type::kReal) {
    reals = std::make_shared<std::vector<double>>(kMaxRecords);
  } else {
    integers = std::make_shared<std::vector<std::int32_t>>(kMaxRecords);
  }
}

void RecordColumn::copy(std::size_t place) const {
  if (reals) (*reals)[place] = *static_cast<const double*>(source);
  if (integers) (*integers)[place] = *static_cast<const std::int32_t*>(source);
}

void RecordColumn::clear_from(std::size_t place) const {
  const auto from = static_cast<std::ptrdiff_t>(place);
  if (reals) std::fill(reals->begin() + from, reals->end(), 0.0);
  if (integers) std::fill(integers->begin() + from, integers->end(), 0);
}

VariableTable::VariableTable(const CellLayout& layout, Values& values, const TableOptions& options) {
  TableBuilder table(layout);
  table.add("time", Causality::kIndependent, Variability::kContinuous, kSecond, "Simulation time",
            values.time);
  const Dependencies dependencies = add_parameters(table, layout, values.parameters);
  add_commands(table, values.inputs);
  add_outputs(table, values.outputs, dependencies);
  if (layout.dynamic_drives) add_motor_torques(table, values.outputs, dependencies);
  add_conveyors(table, values.inputs, values.outputs);
  if (layout.gripper) add_gripper(table, values.inputs.gripper, values.outputs.gripper, dependencies);
  add_sensing(table, layout, values.outputs, dependencies);
  // At the end, so that all other variables have the same references in all variants.
  add_path_ahead(table, values.path_ahead, options.path_ahead, dependencies);
  std::vector<RecordColumn> records;
  if (options.records) records = add_records(table, values.record_count);
  *this = VariableTable(table.take());
  records_ = std::move(records);
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

/// FNV-1a hash of all that importers read, but texts and start values: names, types, units, bounds, sizes,
/// items of enumerations.
std::string VariableTable::token(bool arrays) const {
  std::uint64_t low = 0xcbf29ce484222325u;
  std::uint64_t high = 0x84222325cbf29ce4u;
  const auto feed = [&low, &high](unsigned char byte) {
    low = (low ^ byte) * 0x100000001b3u;
    high = (high ^ (low >> 32)) * 0x100000001b3u;
  };
  const auto feed_bytes = [&feed](const void* value, std::size_t size) {
    const auto* bytes = static_cast<const unsigned char*>(value);
    for (std::size_t i = 0; i < size; ++i) feed(bytes[i]);
  };
  const auto feed_text = [&feed_bytes](const std::string& text) {
    feed_bytes(text.c_str(), text.size() + 1);
  };
  for (const Variable& variable : variables_) {
    feed_text(variable.name);
    feed(static_cast<unsigned char>(variable.type));
    feed(static_cast<unsigned char>(variable.causality));
    feed(static_cast<unsigned char>(variable.variability));
    feed(variable.clocked ? 1 : 0);
    const Unit& unit = variable.unit;
    for (const char* text : {unit.name, unit.display, unit.quantity, unit.base, unit.display_factor}) {
      feed_text(text);
    }
    feed_bytes(&variable.min, sizeof variable.min);
    feed_bytes(&variable.max, sizeof variable.max);
    feed_bytes(variable.dimensions.data(), variable.dimensions.size() * sizeof(std::uint32_t));
    if (variable.enumeration == nullptr) continue;
    feed_text(variable.enumeration->name);
    for (std::int32_t i = 0; i < variable.enumeration->count; ++i) {
      feed_text(variable.enumeration->items[i].name);
      feed_text(variable.enumeration->items[i].text);
    }
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
