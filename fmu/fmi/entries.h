// Entries of a model description: variables, one by one or merged into arrays.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fmu/fmi/variable_table.h"

namespace robotcell::fmi {

/// A variable, or consecutive variables of the same kind (x[1], x[2], ... merged into x).
struct Entry {
  std::uint32_t reference;  // value reference of the entry: that of its first variable
  std::uint32_t size;       // number of variables; 1: scalar
  std::string name;
  std::string description;
  std::vector<std::uint32_t> initial_dependencies;  // references of entries, sorted
};

/// Merges indexed variables into arrays where `arrays` is true; otherwise each variable is an entry.
std::vector<Entry> list_entries(const std::vector<Variable>& variables, bool arrays);

}  // namespace robotcell::fmi
