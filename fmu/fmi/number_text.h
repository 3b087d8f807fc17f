// Numbers in messages and model descriptions.
#pragma once

#include <charconv>
#include <string>

namespace robotcell::fmi {

/// Shortest text that parses to the same number, independent of the locale.
inline std::string number_text(double value) {
  char buffer[32];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr};
}

inline std::string seconds(double time) { return number_text(time) + " s"; }

}  // namespace robotcell::fmi
