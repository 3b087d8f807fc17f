// Names of the members of an enumeration, for the variables and states that hold one.
#pragma once

#include <cstddef>
#include <cstdint>

namespace robotcell {

struct EnumerationItem {
  const char* name;
  const char* text;
};

/// Members from 0 on, in order.
struct Enumeration {
  const char* name;  // of the type in the model descriptions
  const EnumerationItem* items;
  std::int32_t count;
};

template <std::size_t count>
constexpr Enumeration make_enumeration(const char* name, const EnumerationItem (&items)[count]) {
  return {name, items, static_cast<std::int32_t>(count)};
}

/// To be specialised beside every enumeration that a variable holds.
template <class T>
constexpr Enumeration enumeration_of = T::TheMembersOfThisEnumerationHaveNoNames;

}  // namespace robotcell
