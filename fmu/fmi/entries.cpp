#include "fmu/fmi/entries.h"

#include <algorithm>
#include <string_view>

#include "fmu/fmi/table_builder.h"

namespace robotcell::fmi {
namespace {

/// "x" for "x[1]"; empty for other names.
std::string array_name(const std::string& name) {
  const std::string first = indexed("", 0);
  if (name.size() <= first.size() || name.compare(name.size() - first.size(), first.size(), first) != 0) {
    return "";
  }
  return name.substr(0, name.size() - first.size());
}

bool same_kind(const Variable& a, const Variable& b) {
  return a.type == b.type && a.causality == b.causality && a.variability == b.variability &&
         std::string_view(a.unit.quantity) == b.unit.quantity && a.min == b.min && a.max == b.max &&
         a.enumeration == b.enumeration && !is_array(a) && !is_array(b);
}

/// Number of variables from `first` on that form one array; 1 where there is none.
std::size_t array_size(const std::vector<Variable>& variables, std::size_t first) {
  const std::string name = array_name(variables[first].name);
  std::size_t size = 1;
  if (name.empty() || variables[first].type == Type::kString) return size;
  while (first + size < variables.size() && variables[first + size].name == indexed(name, size) &&
         same_kind(variables[first], variables[first + size])) {
    ++size;
  }
  return size;
}

Entry merged(const std::vector<Variable>& variables, std::size_t first, std::size_t size) {
  Entry entry{static_cast<std::uint32_t>(first),
              static_cast<std::uint32_t>(size),
              variables[first].name,
              variables[first].description,
              {}};
  if (size > 1) {
    entry.name = array_name(variables[first].name);
    entry.description.clear();
  }
  for (std::size_t i = 0; i < size; ++i) {
    const Variable& variable = variables[first + i];
    if (size > 1) entry.description += (i > 0 ? "; " : "") + indexed("", i) + " " + variable.description;
    entry.initial_dependencies.insert(entry.initial_dependencies.end(), variable.initial_dependencies.begin(),
                                      variable.initial_dependencies.end());
  }
  return entry;
}

/// Maps references of variables to those of the entries that contain them, sorted and unique.
void map_to_entries(std::vector<std::uint32_t>& references, const std::vector<std::uint32_t>& entry_of) {
  for (std::uint32_t& reference : references) reference = entry_of[reference];
  std::sort(references.begin(), references.end());
  references.erase(std::unique(references.begin(), references.end()), references.end());
}

}  // namespace

std::vector<Entry> list_entries(const std::vector<Variable>& variables, bool arrays) {
  std::vector<Entry> entries;
  std::vector<std::uint32_t> entry_of;
  while (entry_of.size() < variables.size()) {
    const std::size_t first = entry_of.size();
    entries.push_back(merged(variables, first, arrays ? array_size(variables, first) : 1));
    entry_of.insert(entry_of.end(), entries.back().size, static_cast<std::uint32_t>(first));
  }
  for (Entry& entry : entries) map_to_entries(entry.initial_dependencies, entry_of);
  return entries;
}

}  // namespace robotcell::fmi
