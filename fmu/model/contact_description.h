// Settings of contact detection and of the contact solver.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

namespace robotcell {

class JsonReader;

/// Two bodies by name ("table", "gripper", of a conveyor or a part), and their maximum number of contact
/// points.
struct ContactPair {
  std::array<std::string, 2> bodies;
  std::size_t points = 0;
};

struct ContactDescription {
  bool gauss_seidel = false;  // projected Gauss-Seidel instead of Dantzig's method
  bool stick = true;          // stick constraints keep sticking parts from creeping
  std::size_t points = 0;     // maximum number of contact points of pairs that are not listed
  std::vector<ContactPair> pairs;
};

/// `bodies` holds the names that pairs may use. Throws DescriptionError.
ContactDescription parse_contact(const JsonReader& json, const std::vector<std::string>& bodies);

}  // namespace robotcell
