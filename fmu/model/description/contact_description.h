// Settings of contact detection and of the contact solver.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "fmu/model/description/frame_numbers.h"
#include "fmu/model/description/hull.h"

namespace robotcell {

class JsonReader;

/// Contact of two bodies by name.
struct ContactPair {
  std::array<std::string, 2> bodies;
  std::size_t points = 0;  // maximum number of contact points
  bool response = true;    // false: the bodies pass through each other
};

/// A rigid body of the cell, attached to a link, the sensor, the table or the world, with its convex hull as
/// contact shape.
struct ContactBody {
  std::string name;
  std::size_t frame = kWorld;
  Hull hull;  // in this frame
};

struct ContactDescription {
  bool gauss_seidel = false;  // projected Gauss-Seidel instead of Dantzig's method
  bool stick = true;          // stick constraints keep sticking parts from creeping
  std::size_t points = 0;     // maximum number of contact points of pairs that are not listed
  double friction = 0;        // coefficient, of `bodies`
  std::vector<ContactBody> bodies;
  std::vector<ContactPair> pairs;
};

/// `others` holds the names of further bodies that pairs may use. Throws DescriptionError.
ContactDescription parse_contact(const JsonReader& json, const FrameNumbers& frames,
                                 std::vector<std::string> others);

}  // namespace robotcell
