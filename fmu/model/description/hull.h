// Convex hulls.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace robotcell {

class JsonReader;

struct Hull {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::array<int, 3>> faces;  // counter-clockwise from outside
};

/// Throws DescriptionError.
Hull parse_hull(const JsonReader& json);

}  // namespace robotcell
