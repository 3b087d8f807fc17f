// What a model description lists: the variables, one by one or merged into arrays.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fmu/fmi/variable_table.h"

namespace robotcell::fmi {

/// A variable, or consecutive ones of the same kind (x[1], x[2], ... merged into x).
struct Entry {
  std::uint32_t reference;  // of the first variable; it stands for the entry
  std::uint32_t size;       // number of variables; 1: no array
  std::string name;
  std::string description;
  std::vector<std::uint32_t> initial_dependencies;  // references of entries, sorted
};

/// `arrays` merges; otherwise each variable is an entry.
std::vector<Entry> list_entries(const std::vector<Variable>& variables, bool arrays);

}  // namespace robotcell::fmi
