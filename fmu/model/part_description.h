// Parts: the one that is scanned comes first.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

namespace robotcell {

class JsonReader;

/// What a part stands on.
struct StandsOn {
  enum class Kind { kWorld, kTable, kConveyor };
  Kind kind = Kind::kTable;
  std::size_t conveyor = 0;  // counted from 0
};

/// How a soft part yields.
struct SoftDescription {
  double stiffness = 0;      // N/m, of each point of the surface towards the core, in every direction
  double damping_ratio = 0;  // of the points' own oscillation
  double longest_edge = 0;   // m, between the points
};

struct PartDescription {
  std::string name;
  bool free = false;  // stands by gravity and friction instead of being clamped
  StandsOn stands_on;
  Eigen::Isometry3d support_from_part;  // at the start
  double mass = 0, friction = 0;
  std::optional<SoftDescription> soft;         // none: a rigid part
  std::vector<Eigen::Vector3d> hull_vertices;  // part frame
  std::vector<std::array<int, 3>> hull_faces;
  Eigen::Vector3d centre_of_mass;
  Eigen::Matrix3d inertia;  // about the centre of mass, part axes
};

/// What a cell with soft parts cannot promise, for people; empty for a cell without any.
std::string cost_of_soft_parts(const std::vector<PartDescription>& parts);

/// Throws DescriptionError.
PartDescription parse_part(const JsonReader& json, std::size_t conveyors);

}  // namespace robotcell
