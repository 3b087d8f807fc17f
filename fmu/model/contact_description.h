// How contacts are found and solved.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace robotcell {

class JsonReader;

/// Two bodies by name ("table", "gripper", a conveyor's, a part's), and the most contact points between them.
struct ContactPair {
  std::array<std::string, 2> bodies;
  std::size_t points = 0;
};

struct ContactDescription {
  bool gauss_seidel = false;  // instead of Dantzig's exact method
  std::size_t points = 0;     // most contact points of pairs that are not named
  std::vector<ContactPair> pairs;
};

/// `bodies` are the names that pairs may use; throws DescriptionError.
ContactDescription parse_contact(const JsonReader& json, const std::vector<std::string>& bodies);

}  // namespace robotcell
